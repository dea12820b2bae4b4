"""Targets of the training views in stage 2: estimates of their light from different evidence.

Each estimate counts by its own variance. In the dark an estimate may lie below zero, where tones fall without end: as a
fixed share of a target it would make the target far darker than black.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import torch
from torch import Tensor

from novags.methods.denoised.config import DenoiseConfig
from novags.methods.denoised.denoiser import denoised
from novags.methods.denoised.measured import in_electrons
from novags.methods.nova_plus.average import Sums, of_views
from novags.methods.nova_plus.data import LightMeasurements
from novags.methods.nova_plus.likelihood import exactness
from novags.methods.problem import gathered
from novags.methods.reconstruction import Progress
from novags.methods.tone import ToneCurve

LEFT = 1 / 16  # of a datum's variance is left by the denoiser: a round figure, measured nowhere


def towards(light: Tensor, estimate: Tensor, variance: Tensor, curve: ToneCurve, least: float) -> Tensor:
    """Light moved to an estimate of it, all the way to an exact estimate.

    Args:
        light: Of any shape.
        estimate: The other light, of the same shape.
        variance: Of the estimate.
        curve: From tones to light; what the variance means in tone is decided at `light`.
        least: Share of the way at least, 0..1.
    """
    share = exactness(variance, curve.slope(curve.tone(light))).clamp_min(least)
    return light + share * (estimate - light)


def guided_light(
    guide: Tensor, data: LightMeasurements, curve: ToneCurve, h: float, share: float, least: float
) -> Tensor:
    """Raw data averaged along the guide, mixed with the guide itself: the knowledge from this scene.

    Args:
        guide: Tones [C, H, W, 3].
        data: The measurements.
        curve: From tones to light.
        h: As in `averages`.
        share: Of exact averages; the rest is the guide.
        least: As for `towards`.

    Returns:
        Light [C, H, W, 3].
    """

    def mixed(view: int, sums: Sums) -> Tensor:
        light = curve.light(guide[view])
        near = towards(light, sums.mean(light), data.noise(light) * sums.variance, curve, least)
        return share * near + (1 - share) * light

    return gathered(of_views(guide, data.fitted_of, mixed, h=h, patch=1), guide)


def denoised_light(
    data: LightMeasurements,
    expected: Iterable[Tensor],
    config: DenoiseConfig,
    *,
    seed: int,
    progress: Progress | None = None,
) -> Iterator[Tensor]:
    """The measurements through the trained denoiser, which knows other pictures and sees each view by itself.

    Args:
        data: The measurements. Held-out data are not seen.
        expected: Light [H, W, 3] of each view that takes the place of held-out data.
        config: How to denoise.
        seed: Of the adaptation.
        progress: As for `denoised`.

    Returns:
        Light [H, W, 3] of all channels, not clipped, view by view.

    Raises:
        LacksInput: For data whose noise is shared, and for data without noise.
    """
    views = zip(data.light, data.held, expected, strict=True)
    seen = (torch.where(~light.isnan() & held[..., None], guess, light) for light, held, guess in views)
    return denoised(in_electrons(replace(data, matrix=None), seen), config, seed=seed, progress=progress)
