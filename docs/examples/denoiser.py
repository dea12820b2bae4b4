"""A denoiser of raw frames, in units of each frame's mean: python denoiser.py data/dark-rooms."""

import csv
import sys
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset


class Pairs(Dataset):
    """Noisy and clean frame [4,h/2,w/2] of a mosaic: red, both greens, blue."""

    def __init__(self, root, split):
        with (root / "training/denoiser/index.csv").open(newline="") as file:
            self.files = [root / row["file"] for row in csv.DictReader(file) if row["split"] == split]

    def __len__(self):
        return len(self.files)

    def __getitem__(self, i):
        with np.load(self.files[i]) as held:
            noisy, clean = (
                torch.from_numpy(held[name].astype("float32") - held["black"]) for name in ("noisy", "clean")
            )
        return noisy / noisy.mean(), clean / noisy.mean()


torch.manual_seed(0)
root = Path(sys.argv[1])
train, val = (DataLoader(Pairs(root, split), batch_size=4, shuffle=split == "train") for split in ("train", "val"))
model = torch.nn.Sequential(torch.nn.Conv2d(4, 32, 3, padding=1), torch.nn.ReLU(), torch.nn.Conv2d(32, 4, 3, padding=1))
optimiser = torch.optim.Adam(model.parameters(), 3e-3)
for epoch in range(30):
    for noisy, clean in train:
        optimiser.zero_grad()
        (model(noisy) - clean).square().mean().backward()
        optimiser.step()
    with torch.no_grad():
        errors = [((model(noisy) - clean).square().mean(), (noisy - clean).square().mean()) for noisy, clean in val]
    print("epoch", epoch, "val {:.4f}, without it {:.4f}".format(*np.mean(errors, axis=0)))
