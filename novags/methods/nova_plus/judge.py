"""Which of two reconstructions agrees better with the held-out data: a test that needs no truth.

The test needs data whose noise is independent. Where neighbouring data share noise, none are held out, and no verdict
is given. A datum counts by its exactness in tone: with equal weights, the noise of the dark drowns the verdict.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from novags.methods.nova_plus.data import LightMeasurements
from novags.methods.nova_plus.likelihood import exactness
from novags.methods.tone import ToneCurve


@dataclass(frozen=True)
class Verdict:
    """How much one reconstruction's weighted squared error exceeds another's, in squared tone.

    Attributes:
        excess: Mean over the held-out data.
        deviation: Standard error of that mean; inf without held-out data.
    """

    excess: float
    deviation: float

    @property
    def worse(self) -> bool:
        """Whether the data say so beyond doubt: by more than two standard errors."""
        return self.excess > 2 * self.deviation


def compare(
    tones: Iterable[Tensor], other: Tensor, data: LightMeasurements, curve: ToneCurve, weights: Tensor
) -> Verdict:
    """The verdict of held-out data on two reconstructions of the training views.

    For a datum y that no fit has seen, (y - mu)**2 is v + (mu - truth)**2 on average. The difference between two
    reconstructions a and b is therefore the difference of their squared errors, and most of the noise cancels: (y -
    a)**2 - (y - b)**2 = (b - a) (2 y - a - b).

    Args:
        tones: Rendered views [H, W, 3] of the first.
        other: Of the second [C, H, W, 3].
        data: The measurements.
        curve: From tones to light.
        weights: Of each datum [C, H, W, 3], beside its `exactness` at the mean of both.
    """
    parts = []
    for a, b, light, held, weight in zip(tones, other, data.light, data.held, weights, strict=True):
        there = held[..., None] & ~light.isnan()
        first, second, datum = (values[there].double() for values in (curve.light(a), curve.light(b), light))
        middle = (a + b) / 2
        slope, variance = (values[there].double() for values in (curve.slope(middle), data.noise(curve.light(middle))))
        counts = weight[there].double() * exactness(variance, slope) / slope.square()
        parts.append(counts * (second - first) * (2 * datum - first - second))
    difference = torch.cat(parts)
    if len(difference) < 2:
        return Verdict(0.0, math.inf)
    return Verdict(float(difference.mean()), float(difference.std() / math.sqrt(len(difference))))


def mean_tone(tones: Sequence[Tensor], curve: ToneCurve) -> Tensor:
    """The tones of the mean light of several reconstructions; of one view or of many."""
    return curve.tone(torch.stack([curve.light(each) for each in tones]).mean(0)).to(tones[0])
