"""A denoiser of single pictures, from dark 16-bit pictures of a data set to the same views in good light.

python training_loop.py data/dark-rooms
"""

import csv
import sys
from pathlib import Path

import cv2
import torch
from torch.utils.data import DataLoader, Dataset

BLACK = 4096  # code of black in 16-bit pictures, below which noise goes


class DarkViews(Dataset):
    """Pairs of a dark linear picture [3,h,w], scaled to unit mean, and the view in good light [3,h,w]."""

    def __init__(self, root, split):
        self.root = Path(root)
        with (self.root / "index.csv").open(newline="") as file:
            self.rows = [row for row in csv.DictReader(file) if row["split"] == split]

    def __len__(self):
        return len(self.rows)

    def __getitem__(self, i):
        row = self.rows[i]
        dark = (self._codes(row["dark16"]) - BLACK) / (65535 - BLACK)
        return dark / dark.mean(), self._codes(row["lit"]) / 255

    def _codes(self, name):
        codes = cv2.imread(str(self.root / name), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)[..., ::-1]
        return torch.from_numpy(codes.astype("float32")).permute(2, 0, 1)


def run(model, loader, optimiser=None):
    """Mean L1 loss over a split; trains if there is an optimiser."""
    losses = []
    for dark, lit in loader:
        loss = (model(dark) - lit).abs().mean()
        if optimiser is not None:
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        losses.append(loss.item())
    return sum(losses) / len(losses)


torch.manual_seed(0)
root = sys.argv[1]
train = DataLoader(DarkViews(root, "train"), batch_size=4, shuffle=True)
val = DataLoader(DarkViews(root, "val"), batch_size=4)
model = torch.nn.Sequential(
    torch.nn.Conv2d(3, 16, 3, padding=1), torch.nn.ReLU(), torch.nn.Conv2d(16, 3, 3, padding=1), torch.nn.Sigmoid()
)
optimiser = torch.optim.Adam(model.parameters(), 1e-2)
for epoch in range(20):
    loss = run(model, train, optimiser)
    with torch.no_grad():
        print(f"epoch {epoch}: train {loss:.4f}, val {run(model, val):.4f}")
