"""Averages over pixels that look alike in a guide: of the guide itself (non-local means), or of raw data.

Weights depend on the guide alone. The noise of the data reaches their average only through the guide, a render fitted
to them, in which the noise of a single pixel hardly shows:

    w(x, y) = exp(-D(x, y) / h**2),    D = mean squared difference of the patches around x and y over pixels, channels
"""

# mypy: allow-untyped-defs

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from novags.splats.cpu.compiler import inline, kernel
from novags.splats.cpu.vectors.simd import LANES, bits, load, select, splat, store
from novags.splats.cpu.vectors.vector_math import exp

REACH = 7  # px, half the window that is searched
MARGIN = LANES  # columns of zeros beside every row, for its neighbours and for the last pixels of a vector
Result = TypeVar("Result")
ZERO, ONE = np.float32(0.0), np.float32(1.0)
LEAST = np.float32(1e-4)  # weights below it are dropped: they hardly change an average, but cost time


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
    found = list(of_views(guide, data.__getitem__, lambda view, sums: sums, h=h, patch=patch, own=own))
    return Sums(*(torch.stack([getattr(sums, part.name) for sums in found]) for part in fields(Sums)))


def of_views(
    guide: Tensor, data: Callable[[int], Tensor], finish: Callable[[int, Sums], Result], *, h: float, patch: int,
    own: bool = True,
) -> Iterator[Result]:  # fmt: skip
    """Sums view by view, as many at a time as there are threads: those of all views are large.

    Args:
        guide: As in `averages`.
        data: The data [H, W, 3] of a view.
        finish: (view, its sums [H, W, 3]) -> what is wanted of them.
        h: As in `averages`.
        patch: As in `averages`.
        own: As in `averages`.
    """
    if not h > 0:
        raise ValueError(f"h must be > 0, got {h}")
    height, width = guide.shape[1:3]
    stride = _stride(width)

    def planes(view: int) -> tuple[np.ndarray, ...]:
        measured = data(view)
        return tuple(_planes(t.cpu().numpy()) for t in (guide[view], measured.nan_to_num(0.0), ~measured.isnan()))

    def summed(seen: np.ndarray, values: np.ndarray, known: np.ndarray) -> np.ndarray:
        # of itself a datum is w = 1 away
        sums = np.stack([values, known, known]) if own else np.zeros((3, values.size), np.float32)
        accumulate(seen, values, known, height, width, stride, patch, REACH, np.float32(1 / h**2), *sums)
        inner = sums.reshape(3, 3, height, stride)[..., MARGIN : MARGIN + width]
        return np.ascontiguousarray(inner.transpose(0, 2, 3, 1))

    count, threads = len(guide), min(torch.get_num_threads(), os.cpu_count() or 1)
    with ThreadPoolExecutor(threads) as pool:
        for begin in range(0, count, threads):
            views = range(begin, min(begin + threads, count))
            for view, parts in zip(views, pool.map(summed, *zip(*map(planes, views), strict=True)), strict=True):
                yield finish(view, Sums(*(torch.from_numpy(part).to(guide.device) for part in parts)))


def _planes(picture: np.ndarray) -> np.ndarray:
    """[H, W, 3] as rows with zeros before and behind them, channel by channel, flat: [3 * H * stride] float32."""
    height, width, _ = picture.shape
    planes = np.zeros((3, height, _stride(width)), np.float32)
    planes[..., MARGIN : MARGIN + width] = picture.transpose(2, 0, 1)
    return planes.reshape(-1)


def _stride(width: int) -> int:
    """Floats from one row of a plane to the next."""
    return 2 * MARGIN + -(-width // LANES) * LANES


def non_local_means(image: Tensor, h: float) -> Iterator[Tensor]:
    """Pictures [C, H, W, 3], one by one, each pixel averaged over those like it in the same picture (Buades et al.
    2005).
    """
    return of_views(image, image.__getitem__, lambda i, sums: sums.mean(image[i]), h=h, patch=2)


@kernel
def accumulate(guide, data, known, height, width, stride, patch, reach, scale, total, weight, squares):
    """Add w * data, w and w**2 over the window of one picture to the sums.

    Pictures and sums are flat planes as `_planes` makes them; known is 1 where data are, else both are 0. The reach is
    at most MARGIN. Every offset is worked on sixteen pixels at a time, and counts for both ends.
    """
    size = height * stride
    inside, share = np.zeros(stride, np.float32), np.zeros(stride, np.float32)
    distance, across = np.zeros(size, np.float32), np.zeros(size, np.float32)
    for dy in range(min(reach, height - 1) + 1):
        for dx in range(-min(reach, width - 1), min(reach, width - 1) + 1):
            if dy == 0 and dx <= 0:
                continue  # done with the opposite offset
            rows, left, right, shift = height - dy, max(0, -dx), min(width, width - dx), dy * stride + dx
            for x in range(width):
                inside[MARGIN + x], share[MARGIN + x] = ZERO, ZERO
                if left <= x < right:
                    columns = min(right, x + patch + 1) - max(left, x - patch)
                    inside[MARGIN + x], share[MARGIN + x] = ONE, scale / np.float32(3 * columns)
            for y in range(rows):
                _distances(guide, inside, y * stride, size, shift, width, patch, distance, across)
            for y in range(rows):
                first, last = max(0, y - patch), min(rows, y + patch + 1)
                for i in range(MARGIN, MARGIN + width, LANES):
                    d = splat(ZERO)
                    for row in range(first, last):
                        d += load(across, row * stride + i)
                    w = exp(-(d * load(share, i)) / np.float32(last - first)) * load(inside, i)
                    w = select(w > LEAST, w, ZERO)
                    if bits(w > ZERO) == 0:
                        continue
                    for c in range(3):
                        here = c * size + y * stride + i
                        _add(data, known, here, here + shift, w, total, weight, squares)
                        _add(data, known, here + shift, here, w, total, weight, squares)


@inline
def _distances(guide, inside, row, size, shift, width, patch, distance, across):
    """Squared differences of a row to its shifted one, summed over channels; and their sums along the patch."""
    for i in range(MARGIN, MARGIN + width, LANES):
        d = splat(ZERO)
        for c in range(3):
            at = c * size + row + i
            difference = load(guide, at) - load(guide, at + shift)
            d += difference * difference
        store(distance, row + i, d * load(inside, i))
    for i in range(MARGIN, MARGIN + width, LANES):
        d = splat(ZERO)
        for u in range(-patch, patch + 1):
            d += load(distance, row + i + u)
        store(across, row + i, d)


@inline
def _add(data, known, source, to, w, total, weight, squares):
    there = load(known, source)
    store(total, to, load(total, to) + w * load(data, source))
    store(weight, to, load(weight, to) + w * there)
    store(squares, to, load(squares, to) + w * w * there)
