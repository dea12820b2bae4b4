"""Targets of the training views in stage 2: estimates of their light from different evidence."""

from dataclasses import replace

import torch
from torch import Tensor

from novags.methods.denoised.config import DenoiseConfig
from novags.methods.denoised.denoiser import denoised
from novags.methods.denoised.measured import in_electrons
from novags.methods.nova_plus.average import averages
from novags.methods.nova_plus.data import LightMeasurements
from novags.methods.reconstruction import Progress
from novags.methods.tone import ToneCurve


def guided_light(guide: Tensor, data: LightMeasurements, curve: ToneCurve, h: float, share: float) -> Tensor:
    """Raw data averaged along the guide, mixed with the guide itself: the knowledge from this scene.

    Args:
        guide: Tones [C, H, W, 3].
        data: The measurements.
        curve: From tones to light.
        h: As in `averages`.
        share: Of the averages; the rest is the guide.

    Returns:
        Light [C, H, W, 3].
    """
    light = curve.light(guide)
    return share * averages(guide, data.fitted, h=h, patch=1).mean(light) + (1 - share) * light


def denoised_light(
    data: LightMeasurements, expected: Tensor, config: DenoiseConfig, *, seed: int, progress: Progress | None = None
) -> Tensor:
    """The measurements through the trained denoiser, which knows other pictures and sees each view by itself.

    Args:
        data: The measurements. Held-out data are not seen.
        expected: Light [C, H, W, 3] that takes the place of held-out data.
        config: How to denoise.
        seed: Of the adaptation.
        progress: As for `denoised`.

    Returns:
        Light [C, H, W, 3] of all channels, not clipped.

    Raises:
        LacksInput: For data whose noise is shared, and for data without noise.
    """
    seen = torch.where(data.measured & data.held[..., None], expected, data.light)
    return denoised(in_electrons(replace(data, light=seen, matrix=None)), config, seed=seed, progress=progress)
