"""Meanings of the colours of Gaussians other than a picture: tones of light, or radiance that a camera responds to.

Tones are about logarithmic, so that dark and bright parts take their share of the Gaussians:

    lin(r) = top * expm1(k r) / expm1(k)        r = 0 is black, r = 1 is `top`

k is chosen so that the logarithm's knee, top / expm1(k), is a sixth of the median of the scene, for any lamp that sets
`top`: the median then lies at r = ln 7 / k, 0.4 to 0.5 in most scenes here. Linear colours would spend most Gaussians
on the brightest parts.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

KNEE = 0.167  # of the median, below which the curve is about straight
NEIGHBOURS = (1, 4, 16, 64, 256, 1024)  # in a row, whose means take the place of single data in too little light
BRIGHTEST = 0.999  # quantile of the pixels that is `top`; brighter ones have r > 1


@dataclass(frozen=True)
class ToneCurve:
    """Light as a function of a tone r, both of any shape; smooth, increasing, and defined for all r.

    Attributes:
        top: Light at r = 1, > 0, unit of the data.
        k: Curvature, > 0.
    """

    top: float
    k: float
    STEEPEST: ClassVar[float] = 60.0  # of k r: beyond it, exp overflows float32, and its square float64 before long

    def __post_init__(self) -> None:
        if not (0 < self.top < math.inf and 0 < self.k < math.inf):
            raise ValueError(f"top and k must be > 0 and finite, got {self.top} and {self.k}")

    @property
    def knee(self) -> float:
        """Light below which the curve is about straight."""
        return self.top / math.expm1(self.k)

    def light(self, tone: Tensor) -> Tensor:
        """lin(r)."""
        return self.knee * torch.expm1((self.k * tone).clamp_max(self.STEEPEST))

    def slope(self, tone: Tensor) -> Tensor:
        """The derivative d lin / d r, > 0."""
        return self.knee * self.k * torch.exp((self.k * tone).clamp_max(self.STEEPEST))

    def tone(self, light: Tensor) -> Tensor:
        """The tone r of light above -knee; darker light (noise) is taken for the darkest."""
        # 1e-3 of the knee: at -knee itself the logarithm is -inf
        return torch.log1p((light / self.knee).clamp_min(-1 + 1e-3)) / self.k


def tone_curve(light: Tensor) -> ToneCurve:
    """The curve for pictures of this light.

    Args:
        light: Of the training pictures, noise included, unit of the data, any shape, row by row; of a
            mosaic its greens.

    Raises:
        ValueError: If no `median_light` is above 0, so that there is nothing but noise.
    """
    values = light.flatten().double()
    median = median_light(values)
    top = float(torch.quantile(values[:: max(1, len(values) // 4_000_000)], BRIGHTEST))
    if not median > 0:
        raise ValueError(
            f"the median of the green pixels must be above black, got {median:.3g}: there is less light than this "
            "method can use, or the black level of the camera is wrong"
        )
    return ToneCurve(top, math.log1p(top / (KNEE * median)))


def median_light(values: Tensor) -> float:
    """The median of noisy values [n]; if it is not above 0, the median of means over just enough neighbours to be so.

    Where most of a picture has a fraction of an electron, most data are the code of black or below: only the mean of
    several of them is above it.
    """
    for count in NEIGHBOURS:
        whole = values[: len(values) // count * count].reshape(-1, count).mean(1)
        if len(whole) and float(whole.median()) > 0:
            return float(whole.median())
    return float(values.median())


@dataclass(frozen=True, kw_only=True)
class ResponseTable:
    """A camera's response: codes over the logarithm of radiance, in steps of equal width, straight between them.

    Attributes:
        faint: Added to radiance before the logarithm, > 0, which is finite for black then.
        low: Ln(radiance + faint) of the first code; darker light has it too.
        high: Of the last one; brighter light has it too.
        values: The codes, at least 2.
    """

    faint: float
    low: float
    high: float
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if not (self.faint > 0 and self.low < self.high and len(self.values) >= 2):
            raise ValueError(
                "a response needs faint > 0, low < high and two values at least, got "
                f"{self.faint}, {self.low}, {self.high} and {len(self.values)} values"
            )

    def codes(self, radiance: Tensor) -> Tensor:
        """The codes of radiance of any shape; negative radiance counts as black."""
        logs = torch.log(radiance.clamp_min(0) + self.faint)
        table, last = radiance.new_tensor(self.values), len(self.values) - 1
        place = ((logs - self.low) / (self.high - self.low)).clamp(0, 1) * last
        below = place.detach().floor().clamp_max(last - 1)
        index, share = below.long(), place - below
        return (1 - share) * table[index] + share * table[index + 1]
