"""The samples of one view: two independent sequences in every pixel, continued where a pilot saw noise.

A pilot that decides how many samples a pixel gets must not count among them: a pixel whose pilot came out dark would
get few others, and stay dark. Here the neighbours of a pixel decide its share of the samples, so all of its own count.
Only the total follows from all pixels, as wherever samples are drawn until an error is reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

AROUND = (1.0, 2.0, 4.0)  # px, of the neighbourhoods to choose from
LEAST = 0.25  # of an even share
POOL = 3  # pixels across the neighbourhood that shares its variance


@dataclass(frozen=True)
class Radiance:
    """One view, and how good it is.

    Attributes:
        mean: Radiance, float32 [h,w,3].
        variance: Estimated variance of `mean`, float32 [h,w,3], averaged over 3 x 3 pixels: unbiased for that average,
            and in sum for the view. It has up to 9 degrees of freedom in each pixel.
        half: Half the difference between the means of the two sequences, float32 [h,w,3]: added to `mean` and taken
            from it, it gives two independent pictures of half the samples. Its square is the variance of each pixel.
        spp: Samples per pixel behind `mean`, on average over the view.
        error: Relative RMSE: root of the mean variance over the mean radiance.
        fireflies: Pixels whose variance is far above their neighbourhood's: rare bright paths.
    """

    mean: NDArray[np.float32]
    variance: NDArray[np.float32]
    half: NDArray[np.float32]
    spp: int
    error: float
    fireflies: int


def sample_shares(variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share of the samples that each pixel [h,w] of this variance should get, 1 on average.

    The error of the whole view is least with shares in proportion to the standard deviation. A pixel's standard
    deviation is taken from the pixels around it, without its own, and no pixel gets less than about `LEAST` of an even
    share. The width of the neighbourhood is chosen for the least variance of the view. That variance is computed from
    each pixel's own variance, on which its share does not depend: noise that neighbours do not predict is left to even
    shares.
    """
    choices = [np.ones_like(variance), *(_shares_around(variance, width) for width in AROUND)]
    return min(choices, key=lambda shares: float((variance / shares).mean()))


def _shares_around(variance: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    from scipy.ndimage import gaussian_filter

    peak = np.zeros((2 * round(4 * width) + 1,) * 2)
    peak[len(peak) // 2, len(peak) // 2] = 1
    own = gaussian_filter(peak, width).max()
    around, whole = (gaussian_filter(v, width, mode="constant") for v in (variance, np.ones_like(variance)))
    others = np.maximum(around - own * variance, 0)  # rounding can go below 0
    # A picture of one pixel has no others.
    deviation = np.sqrt(others / np.maximum(whole - own, 1e-9))
    shares = np.maximum(deviation / max(deviation.mean(), 1e-300), LEAST)
    return np.asarray(shares / shares.mean())


def good_counts(wanted: NDArray[np.float64]) -> NDArray[np.int64]:
    """The nearest 2^k or 3 2^k, by ratio; at least 1. Between them Sobol points are up to a fifth less even."""
    octave = np.exp2(np.floor(np.log2(np.maximum(wanted, 1))))
    ratio = wanted / octave
    return np.rint(octave * np.where(ratio < np.sqrt(1.5), 1, np.where(ratio < np.sqrt(3), 1.5, 2))).astype(np.int64)


class Sequences:
    """Sums of the samples that two sequences of each pixel have given so far.

    Args:
        shape: Of the view, (h, w).
        whole: Samples that a sequence grows by at least: one for each pose of a moving camera.
    """

    def __init__(self, shape: tuple[int, int], whole: int = 1) -> None:
        self.whole = whole
        self.count = np.zeros(shape, dtype=np.int64)  # samples in each of the two
        self.sums = np.zeros((2, *shape, 3))

    def even(self, spp: float) -> NDArray[np.int64]:
        """Samples to add to each sequence, [h,w], for `spp` in every pixel in both together, and one at least."""
        wanted = max(math.ceil(spp / 2 / self.whole - 1e-9), 1) * self.whole  # 7.000000001 are 7
        return np.maximum(wanted - self.count, 0)

    def lacking(self, spp: float, shares: NDArray[np.float64]) -> NDArray[np.int64]:
        """The same for about `spp` on average, spread by `shares` [h,w], 1 on average."""
        return np.maximum(good_counts(spp / 2 * shares / self.whole) * self.whole - self.count, 0)

    @property
    def spp(self) -> float:
        """Samples per pixel so far, on average."""
        return 2 * float(self.count.mean())

    def mean(self) -> NDArray[np.float64]:
        """Mean of all samples, [h,w,3]."""
        return np.asarray(self._means().mean(0))

    def variance(self) -> NDArray[np.float64]:
        """Unbiased variance of `mean`, from the two sequences: one degree of freedom in each pixel."""
        return self.half() ** 2

    def half(self) -> NDArray[np.float64]:
        """Half the difference between the means of the two sequences, [h,w,3]."""
        first, second = self._means()
        return np.asarray((first - second) / 2)

    def error(self, margin: float = 0.0) -> float:
        """Relative RMSE of the mean so far; with `margin` standard errors of its square more, pixels being independent.

        The margin is for stopping rules: where few pixels have most of the noise, the first estimate below a target
        tends to be an underestimate.
        """
        level = float(self.mean().mean())
        return math.sqrt(mean_at_most(self.variance().mean(-1), margin)) / level if level > 0 else 0.0

    def result(self) -> Radiance:
        """Mean, variance of the mean, and relative error of the whole view."""
        return summary(self.mean(), self.half(), self.spp)

    def _means(self) -> NDArray[np.float64]:
        return self.sums / np.maximum(self.count, 1)[..., None]


def mean_at_most(values: NDArray[np.float64], margin: float) -> float:
    """Mean of independent values, and `margin` of its standard errors more."""
    return float(values.mean() + margin * values.std() / np.sqrt(values.size))


def relative_error(mean: NDArray[np.float64], variance: NDArray[np.float64]) -> float:
    """Relative RMSE of a view: root of the mean variance over the mean radiance; 0 for a black one."""
    level = float(mean.mean())
    return float(np.sqrt(variance.mean())) / level if level > 0 else 0.0


def summary(mean: NDArray[np.float64], half: NDArray[np.float64], spp: float) -> Radiance:
    """A view from its mean and half the difference of its two sequences in every pixel, [h,w,3]."""
    variance = half**2
    return Radiance(
        mean=mean.astype(np.float32),
        variance=pooled(variance).astype(np.float32),
        half=half.astype(np.float32),
        spp=round(spp),
        error=relative_error(mean, variance),
        fireflies=count_fireflies(variance.mean(-1), float(mean.mean())),
    )


def pooled(variance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Variances [h,w,c] averaged over neighbouring pixels; their sum stays, since the border mirrors."""
    from scipy.ndimage import uniform_filter

    mean = uniform_filter(variance, size=(POOL, POOL, 1), mode="reflect")
    return np.asarray(np.maximum(mean, 0))  # its running sums can end below 0 where the variance is 0


def count_fireflies(variance: NDArray[Any], level: float) -> int:
    """Pixels [h,w] with 50 times the median variance around them, if that is more than 5 % of the mean radiance."""
    from scipy.ndimage import median_filter

    around = median_filter(variance, size=5, mode="nearest")
    return int(((variance > 50 * around) & (variance > (0.05 * level) ** 2)).sum())
