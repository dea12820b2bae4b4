"""Averages over pixels that look alike in a guide: of the guide itself (non-local means), or of raw data.

Weights depend on the guide alone. The noise of the data reaches their average only through the guide, a render fitted
to them, in which the noise of a single pixel hardly shows:

    w(x, y) = exp(-D(x, y) / h**2),    D = mean squared difference of the patches around x and y over pixels, channels
"""

# mypy: allow-untyped-defs

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from novags.splats.cpu.compiler import kernel

REACH = 7  # px, half the window that is searched
LEAST = 1e-4  # weights below it are dropped: they hardly change an average, but cost time


@dataclass(frozen=True)
class Sums:
    """Sums of weights over the neighbours of each datum, all [C, H, W, 3]."""

    data: Tensor  # w y
    weights: Tensor  # w
    squares: Tensor  # w**2

    def mean(self, fallback: Tensor) -> Tensor:
        """The average; the fallback where hardly anything is like the pixel."""
        # with less than a hundredth of a neighbour, the average would be one very different pixel
        return torch.where(self.weights > 0.01, self.data / self.weights.clamp_min(0.01), fallback)

    @property
    def variance(self) -> Tensor:
        """Variance of the average if the data have variance 1."""
        return self.squares / self.weights.clamp_min(0.01).square()


def averages(guide: Tensor, data: Tensor, *, h: float, patch: int, own: bool = True) -> Sums:
    """Sums over the window of each pixel of each view, weighted by how alike the guide is there.

    Args:
        guide: [C, H, W, 3], float32.
        data: [C, H, W, 3], float32; nan where nothing was measured.
        h: Difference of the guide, RMS over a patch, at which a neighbour counts 1 / e; > 0.
        patch: px, half the side of a patch.
        own: Whether a datum is part of its own average, with weight 1.
    """
    if not h > 0:
        raise ValueError(f"h must be > 0, got {h}")

    guides, values = guide.cpu().numpy(), data.cpu().numpy()

    def one(view: int) -> list[np.ndarray]:
        found = [np.zeros(values.shape[1:], np.float32) for _ in range(3)]
        accumulate(guides[view], values[view], patch, REACH, 1 / h**2, own, *found)
        return found

    with ThreadPoolExecutor(min(torch.get_num_threads(), os.cpu_count() or 1)) as pool:
        found = list(pool.map(one, range(len(data))))
    return Sums(*(torch.from_numpy(np.stack(parts)).to(data.device) for parts in zip(*found, strict=True)))


def non_local_means(image: Tensor, h: float) -> Tensor:
    """Pictures [C, H, W, 3], each pixel averaged over those like it in the same picture (Buades et al. 2005)."""
    return averages(image, image, h=h, patch=2).mean(image)


@kernel
def accumulate(guide, data, patch, reach, scale, own, total, weight, squares):
    """Add w * data, w and w**2 over the window of one picture to the sums; all [H, W, 3]."""
    height, width = guide.shape[:2]
    distance = np.empty((height, width), np.float32)
    if own:
        for y in range(height):
            for x in range(width):
                _add(data, y, x, y, x, np.float32(1), total, weight, squares)
    for dy in range(reach + 1):
        for dx in range(-reach, reach + 1):
            if dy == 0 and dx <= 0:
                continue  # done with the opposite offset
            rows, left, right = height - dy, max(0, -dx), min(width, width - dx)
            for y in range(rows):
                for x in range(left, right):
                    d = np.float32(0)
                    for c in range(3):
                        d += (guide[y, x, c] - guide[y + dy, x + dx, c]) ** 2
                    distance[y, x] = d
            for y in range(rows):
                for x in range(left, right):
                    d, n = np.float32(0), 0
                    for v in range(max(0, y - patch), min(rows, y + patch + 1)):
                        for u in range(max(left, x - patch), min(right, x + patch + 1)):
                            d += distance[v, u]
                            n += 3
                    w = np.float32(math.exp(-scale * d / n))
                    if w > LEAST:
                        _add(data, y, x, y + dy, x + dx, w, total, weight, squares)
                        _add(data, y + dy, x + dx, y, x, w, total, weight, squares)


@kernel
def _add(data, y, x, from_y, from_x, w, total, weight, squares):
    for c in range(3):
        datum = data[from_y, from_x, c]
        if not math.isnan(datum):
            total[y, x, c] += w * datum
            weight[y, x, c] += w
            squares[y, x, c] += w * w
