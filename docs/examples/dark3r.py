"""A student that sees in the dark what its frozen teacher sees in the light: python dark3r.py data/dark-rooms."""

import copy
import csv
import sys
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset


class Exposures(Dataset):
    """A bright and a dark exposure [3,h/2,w/2] of a view, each over its mean: the black level stays in them."""

    def __init__(self, root, split):
        with (root / "training/dark3r/index.csv").open(newline="") as file:
            self.files = [root / row["file"] for row in csv.DictReader(file) if row["split"] == split]

    def __len__(self):
        return len(self.files)

    def __getitem__(self, i):
        with np.load(self.files[i]) as held:
            level = torch.randint(len(held["dark"]), ())  # held["snr_db"][level] says how dark it is
            pictures = held["bright"], held["dark"][level]
        return [torch.from_numpy(picture / picture.mean()) for picture in pictures]


torch.manual_seed(0)
root = Path(sys.argv[1])
train = DataLoader(Exposures(root, "train"), batch_size=4, shuffle=True)
teacher = torch.nn.Sequential(torch.nn.Conv2d(3, 16, 5, padding=2), torch.nn.ReLU(), torch.nn.Conv2d(16, 16, 3))
student = copy.deepcopy(teacher)  # MASt3R and its copy with LoRA, in the paper
optimiser = torch.optim.Adam(student.parameters(), 1e-2)
for epoch in range(30):
    for bright, dark in train:
        loss, clean = ((student(x) - teacher(bright).detach()).square().mean() for x in (dark, bright))
        loss = loss + 0.3 * clean
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    print(f"epoch {epoch}: {loss.item():.5f}")
