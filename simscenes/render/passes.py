"""Independent passes over one view, averaged in float64, and what their spread says about the error.

The samples of a pass are stratified together: the error of a pass falls faster than one over the root of its samples,
where light and surfaces are smooth. So passes are as few and as large as an honest variance allows: two. Each pixel
then has one degree of freedom, and the variance is pooled over its 3 x 3 neighbourhood, which has some nine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_PASS_SPP = 1024  # of a film of a scalar variant in float32: relative bias 1e-6 there, 1e-4 at 65k samples
POOL = 3  # pixels across the neighbourhood that shares its variance


@dataclass(frozen=True)
class Radiance:
    """The combined passes of one view.

    Attributes:
        mean: Radiance, float32 [h,w,3].
        variance: Estimated variance of `mean`, float32 [h,w,3], averaged over 3 x 3 pixels: unbiased for that average,
            and in sum for the view. From n passes it has up to 9 (n - 1) degrees of freedom in each pixel.
        spp: Samples per pixel behind `mean`, on average over the view.
        error: Relative RMSE: root of the mean variance over the mean radiance.
        fireflies: Pixels whose variance is far above that of their neighbourhood: rare bright paths.
    """

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    spp: int
    error: float
    fireflies: int


def pass_spp(spp: NDArray[np.float64]) -> NDArray[np.int64]:
    """The largest powers of four that are at most `spp` (and at least 1): few sizes, since each is a kernel."""
    return np.asarray(4 ** np.floor(np.log2(np.maximum(spp, 1)) / 2).astype(np.int64))


def grid_spp(spp: float) -> int:
    """The smallest number of samples from `spp` up that the sampler can stratify: a grid of k x k, k + 1 or k + 2."""
    wanted = max(math.ceil(spp), 1)
    k = math.isqrt(wanted)
    return next(n for n in (k * k, k * (k + 1), k * (k + 2), (k + 1) ** 2) if n >= wanted)


def split_passes(spp: int) -> tuple[int, int]:
    """Number of passes (at least 2) and samples per pixel of each, together at least `spp`."""
    if spp < 2:
        raise ValueError(f"spp must be >= 2, because the variance needs two independent passes, got {spp}")
    count = max(2, math.ceil(spp / MAX_PASS_SPP))
    return count, grid_spp(spp / count)


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
        return relative_error(self.mean, self.variance())

    def variance(self) -> NDArray[np.float64]:
        """Of the mean so far, in every pixel by itself."""
        return self.scatter / (self.count * (self.count - 1))

    def result(self, spp_per_pass: float) -> Radiance:
        """Mean, variance of the mean, and relative error of the whole view."""
        return summary(self.mean, self.variance(), self.count * spp_per_pass)


def relative_error(mean: NDArray[np.float64], variance: NDArray[np.float64]) -> float:
    """Relative RMSE of a view: root of the mean variance over the mean radiance; 0 for a black one."""
    level = float(mean.mean())
    return float(np.sqrt(variance.mean())) / level if level > 0 else 0.0


def summary(mean: NDArray[np.float64], variance: NDArray[np.float64], spp: float) -> Radiance:
    """A view from its mean and the variance of that in every pixel, [h,w,3]."""
    return Radiance(
        mean=mean.astype(np.float32),
        variance=pooled(variance).astype(np.float32),
        spp=round(spp),
        error=relative_error(mean, variance),
        fireflies=count_fireflies(variance.mean(-1), float(mean.mean())),
    )


def pooled(variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variances [h,w,c] averaged over neighbouring pixels; their sum stays, since the border mirrors."""
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(variance, size=(POOL, POOL, 1), mode="reflect"))


def count_fireflies(variance: NDArray[Any], level: float) -> int:
    """Pixels [h,w] with 50 times the median variance around them, if that is more than 5 % of the mean radiance."""
    from scipy.ndimage import median_filter

    around = median_filter(variance, size=5, mode="nearest")
    return int(((variance > 50 * around) & (variance > (0.05 * level) ** 2)).sum())
