"""Context views moved to a target by its true depth: python feedforward.py data/dark-rooms."""

import csv
import sys
from pathlib import Path

import numpy as np
import torch
from torch.nn.functional import grid_sample
from torch.utils.data import DataLoader, Dataset


class Scenes(Dataset):
    """A target and its nearest context views, one after another in each array [1+C,...]."""

    def __init__(self, root, split, context=2):
        with (root / "training/feedforward/index.csv").open(newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["split"] == split]
        named = [(root / row["file"], row["context"].split()[:context]) for row in rows]
        self.files = [[file, *(file.with_name(f"{name}.npz") for name in names)] for file, names in named]

    def __len__(self):
        return len(self.files)

    def __getitem__(self, i):
        views = [np.load(file) for file in self.files[i]]
        return {name: torch.from_numpy(np.stack([view[name] for view in views])) for name in views[0].files}


def moved(pictures, depth, viewmat, K):
    """Pictures [V,3,h,w] of all views where they see the target's surface, whose depth is [h,w]."""
    y, x = torch.meshgrid(*(torch.arange(side) + 0.5 for side in depth.shape), indexing="ij")
    points = torch.stack([x, y, torch.ones_like(x)], -1) @ K[0].inverse().T * depth[..., None]
    relative = viewmat @ viewmat[0].inverse()
    seen = (points @ relative[:, None, :3, :3].mT + relative[:, None, None, :3, 3]) @ K[:, None].mT
    at = seen[..., :2] / seen[..., 2:] / torch.tensor(depth.shape[::-1]) * 2 - 1
    return grid_sample(pictures, at, padding_mode="border", align_corners=False)


for scene in DataLoader(Scenes(Path(sys.argv[1]), "train"), batch_size=None):
    black, white, depth, lit = scene["black"][0], scene["white"][0], scene["depth"][0], scene["lit"] / 255
    dark = (scene["dark"] - black) / (white - black)  # [1+C,L,3,h,w] of L light levels, what a network is given
    seen, surface = moved(lit, depth, scene["viewmat"], scene["K"]), depth.isfinite()
    errors = ((pictures[1:] - lit[0]).abs()[..., surface].mean() for pictures in (seen, lit))
    print("light {:.4f}, error of moved views {:.4f}, not moved {:.4f}".format(dark[0].mean(), *errors))
