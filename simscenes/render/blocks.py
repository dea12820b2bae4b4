"""Blocks of samples, more of them where a pilot saw noise; nothing about it biases the mean.

A pilot that decides how many samples a pixel gets is no sample itself: a pixel whose pilot came out dark gets few
others, and an average with the pilot in it would stay dark. Where all pixels get as many, it counts like the rest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.render.passes import Passes

AROUND = 1.0  # px, of the smoothing: 0.7 and 2.5 leave up to 5 % more variance on tabletop, cornell and gallery
LEAST = 0.15  # of an even share


def sample_shares(variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of the samples that each pixel [h,w] of this variance should get, 1 on average.

    The error of the whole view is least with shares in proportion to the standard deviation. A pilot knows that only
    roughly, so it is smoothed over neighbours, and no pixel gets less than `LEAST` of an even share.
    """
    from scipy.ndimage import gaussian_filter

    deviation = np.sqrt(gaussian_filter(variance, AROUND, mode="nearest"))
    if not deviation.any():
        return np.ones_like(deviation)
    shares = np.maximum(deviation / deviation.mean(), LEAST)
    return np.asarray(shares / shares.mean())


class Blocks:
    """A pilot of two passes or more, and blocks of samples: as many in a pixel as its share asks for.

    Args:
        pilot: Equal passes over the view.
        kept: Samples per pixel in all of them, if every pixel gets as many blocks; 0 if the pilot decides how many.
        size: Samples in a block of each pixel, [h,w].
    """

    def __init__(self, pilot: Passes, kept: int, size: NDArray[np.int64]) -> None:
        self.pilot, self.kept, self.size = pilot, kept, size
        self.count = np.zeros(pilot.mean.shape[:2], dtype=np.int64)
        # Sums of deviations from the pilot, not of values: their squares keep the variance of well-converged pixels.
        self._sum, self._squares = np.zeros_like(pilot.mean), np.zeros_like(pilot.mean)

    def lacking(self, spp: float, shares: NDArray[np.float64]) -> NDArray[np.int64]:
        """Blocks to add to each pixel, [h,w], for `spp` samples on average; two are the least that tell a variance."""
        wanted = np.rint((spp * shares - self.kept) / self.size).astype(np.int64)
        return np.maximum(np.maximum(wanted, 2) - self.count, 0)

    def add(self, pixels: NDArray[np.intp], values: NDArray[np.float64]) -> None:
        """Add the means of blocks [n,3] to the pixels [n] (row by row) that they belong to."""
        away = values - self.pilot.mean.reshape(-1, 3)[pixels]
        for total, part in ((self._sum, away), (self._squares, away**2)):
            sums = [np.bincount(pixels, column, self.count.size) for column in part.T]
            total += np.stack(sums, -1).reshape(total.shape)
        self.count += np.bincount(pixels, minlength=self.count.size).reshape(self.count.shape)

    @property
    def spp(self) -> float:
        """Samples per pixel so far, on average."""
        return self.kept + float((self.count * self.size).mean())

    def mean(self) -> NDArray[np.float64]:
        """Mean of all samples that count, [h,w,3]."""
        return self.pilot.mean + self._part() * self._offset()

    def variance(self) -> NDArray[np.float64]:
        """Unbiased variance of `mean`: the pilot's passes and the blocks each tell their own."""
        n = self.count[..., None]
        scatter = np.maximum(self._squares - n * self._offset() ** 2, 0)  # rounding can go below 0
        of_blocks = scatter / np.maximum(n * (n - 1), 1)
        return (1 - self._part()) ** 2 * self.pilot.variance() + self._part() ** 2 * of_blocks

    def _offset(self) -> NDArray[Any]:
        return np.asarray(self._sum / np.maximum(self.count, 1)[..., None])

    def _part(self) -> NDArray[Any]:
        """Share of the blocks in the samples of each pixel, [h,w,1]."""
        samples = (self.count * self.size.astype(float))[..., None]
        return np.asarray(samples / np.maximum(samples + self.kept, 1))
