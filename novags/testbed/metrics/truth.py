"""The noise of a rendered truth in scores: taken out of squared errors, measured in all others.

A render of finitely many samples is y + e: the truth and noise of zero mean, whose variance v of each value is known. A
picture x that never saw this noise has the measured squared error mean (x - y - e)², on average mean (x - y)² + mean v:
so mean v is subtracted. A fit of the picture to the noisy reference (`tone`) takes part of the noise along, h v of each
value, where h is the leverage of the value on its own fit; mean (1 - h) v is what is left to subtract.

The noise is known from two halves: references of half the samples each, through the same curves. A quarter of the
square of their difference has the mean v in every pixel by itself; averages over neighbours do not, where a dark pixel,
whose curve is steep, lies beside a bright one. With a and b the errors of the halves, e² less that estimate is a b: of
variance 4 v² whatever the distribution of a and b, and uncorrelated with e. So the corrected sum has the variance sum 4
(x - y)² v + 4 v². It is estimated by sum 4 r² v, r the measured error, which is too large where tails are heavier than
a Gaussian's. The channels of a pixel share their paths of light: their errors are added before they are squared.

Scores that are no mean of squares are not corrected. The halves have twice the noise, so that a score against them is
moved once more by what the truth's noise has moved it already: this is their bias, to first order in v.
"""

from dataclasses import dataclass
from math import inf, log, log10, sqrt
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from novags.testbed.metrics.picture import Image

WITHIN = "within the truth's noise"
ERROR = "_error"  # behind the name of a score: its standard error by the truth's noise
BIAS = "_bias"  # by how much the truth's noise has moved it, of a score that is not corrected
VARIANCE = "truth_variance"  # the mean variance of a reference, beside its scores

Halves: TypeAlias = tuple[Image, Image]
"""A reference from each half of its samples, [h,w,c]; the reference itself is close to their mean."""


@dataclass(frozen=True)
class SquaredError:
    """A mean squared error to the noise-free truth.

    Attributes:
        value: Without the truth's noise; below 0 by chance where it is far smaller than that noise.
        error: Its standard error by the truth's noise.
    """

    value: float
    error: float

    def decibels(self, ceiling: float) -> tuple[float | None, float]:
        """PSNR for a peak of 1, dB, at most `ceiling`, and its standard error; (None, inf) within the truth's noise."""
        if self.value < 0:
            return None, inf
        if self.value == 0:
            return ceiling, 0.0
        return min(-10 * log10(self.value), ceiling), 10 / log(10) * self.error / self.value


def named(score: str, known: tuple[float | None, float | None]) -> dict[str, float | None]:
    """A score and its standard error, by their names."""
    return {score: known[0], score + ERROR: known[1]}


def variance_of(first: Image, second: Image) -> NDArray[np.float64]:
    """Variance of each value of a reference, from its halves: one degree of freedom each."""
    return np.asarray((first.astype(np.float64) - second) ** 2 / 4)


def squared_error(
    image: Image, reference: Image, variance: NDArray[np.float64], leverage: NDArray[np.float64] | float = 0.0
) -> SquaredError:
    """Mean squared error of an image to the noise-free truth.

    Args:
        image: [h,w,c].
        reference: The rendered truth [h,w,c].
        variance: Of the noise of each value of it [h,w,c].
        leverage: Of each value of the reference on `image`, where that was fitted to it [h,w,c].
    """
    apart = image.astype(np.float64) - reference
    value = float(np.mean(apart**2) - np.mean((1 - leverage) * variance))
    each = 2 * (np.abs(apart) * np.sqrt(variance)).sum(-1)
    return SquaredError(value, sqrt(float((each**2).sum())) / apart.size)


def leverage(aligned: Image, kind: Literal["none", "affine", "tone"]) -> NDArray[np.float64] | float:
    """Leverage of each value of a reference on the picture that was aligned to it, [h,w,c]; 0 for none.

    The diagonal of the projection that the fit is, by channel: of gain and offset 1/n + (x - mean)² / sum (x - mean)²;
    of a monotone curve 1/m, where m values share a step of it.
    """
    if kind == "none":
        return 0.0
    found = np.empty(aligned.shape)
    for c in range(aligned.shape[2]):
        x = aligned[..., c].astype(np.float64)
        if kind == "affine":
            squares = (x - x.mean()) ** 2
            found[..., c] = 1 / x.size + squares / max(squares.sum(), 1e-300)  # of a constant: its mean alone
        else:
            _, step, count = np.unique(x.ravel(), return_inverse=True, return_counts=True)
            found[..., c] = (1 / count)[step.ravel()].reshape(x.shape)
    return found
