"""Independent passes over one view, averaged in float64, and what their spread says about the error.

A pass stays at 1024 samples per pixel at most: Mitsuba's film adds up in float32, where a longer sum loses the small
contributions (relative bias 1e-4 at 65k samples, 1e-6 at 1k).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_PASS_SPP = 1024


@dataclass(frozen=True)
class Radiance:
    """The combined passes of one view.

    Attributes:
        mean: Radiance, float32 [h,w,3].
        variance: Estimated variance of `mean`, float32 [h,w,3]; unbiased, but from few passes, so noisy per pixel.
        spp: Samples per pixel behind `mean`, on average over the view.
        error: Relative RMSE: root of the mean variance over the mean radiance.
        fireflies: Pixels whose variance is far above that of their neighbourhood: rare bright paths.
    """

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    spp: int
    error: float
    fireflies: int


def pass_spp(spp: float) -> int:
    """The largest power of four that is at most `spp` (and at least 1).

    Only these sizes are repeatable bit for bit: they fit the sampler's grid, and the samples of a pixel never straddle
    two work units of Dr.Jit, whose threads would add to the pixel in an order that changes from run to run.
    """
    return int(4 ** max(0, math.floor(math.log2(max(spp, 1)) / 2)))


def split_passes(spp: int) -> tuple[int, int]:
    """Number of passes (at least 2) and samples per pixel of each, together at least `spp`."""
    if spp < 2:
        raise ValueError(f"spp must be >= 2, because the variance needs two independent passes, got {spp}")
    size = min(pass_spp(spp / 2), MAX_PASS_SPP)
    return math.ceil(spp / size), size


class Passes:
    """Running mean and scatter of equal passes, float64 [h,w,3]."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.count = 0
        self.mean = np.zeros((*shape, 3))
        self.scatter = np.zeros((*shape, 3))

    def add(self, image: NDArray[Any]) -> None:
        """Welford's update: the naive sum of squares loses the variance of well-converged pixels to rounding."""
        self.count += 1
        delta = image - self.mean
        self.mean += delta / self.count
        self.scatter += delta * (image - self.mean)

    def error(self) -> float:
        """Relative RMSE of the mean so far, from two passes up."""
        level = float(self.mean.mean())
        return float(np.sqrt(self._variance().mean())) / level if level > 0 else 0.0

    def _variance(self) -> NDArray[np.float64]:
        return self.scatter / (self.count * (self.count - 1))

    def result(self, spp_per_pass: float) -> Radiance:
        """Mean, variance of the mean, and relative error of the whole view."""
        variance = self._variance()
        return Radiance(
            mean=self.mean.astype(np.float32),
            variance=variance.astype(np.float32),
            spp=round(self.count * spp_per_pass),
            error=self.error(),
            fireflies=count_fireflies(variance.mean(-1), float(self.mean.mean())),
        )


def sample_shares(variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of the samples that each pixel [h,w] of this variance should get, 1 on average.

    The error of the whole view is least with shares in proportion to the standard deviation. A pilot knows that only
    roughly, so it is smoothed over neighbours, and no pixel gets less than a third of an even share.
    """
    from scipy.ndimage import gaussian_filter

    deviation = np.sqrt(gaussian_filter(variance, 1.0, mode="nearest"))
    if not deviation.any():
        return np.ones_like(deviation)
    shares = np.maximum(deviation / deviation.mean(), 1 / 3)
    return np.asarray(shares / shares.mean())


def count_fireflies(variance: NDArray[Any], level: float) -> int:
    """Pixels [h,w] with 50 times the median variance around them, if that is more than 5 % of the mean radiance."""
    from scipy.ndimage import median_filter

    around = median_filter(variance, size=5, mode="nearest")
    return int(((variance > 50 * around) & (variance > (0.05 * level) ** 2)).sum())
