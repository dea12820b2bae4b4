"""The plain fit that the method has to beat: L1 to the data as they are, without a model of their noise.

Its distance is between tones, which keeps the median: the median of tones is the tone of the median, also where noise
lies so far below black that a tone ends.
"""

from dataclasses import replace

import numpy as np
from torch import Tensor

from novags.splats.training.config import FitConfig
from novags.splats.training.step import Step


def plain_config(base: FitConfig, iterations: int) -> FitConfig:
    """The settings of `naive-l1` in rates, movement and regularisers, all others of `base`."""
    usual = FitConfig()
    return replace(
        base, iterations=iterations, dssim_weight=0.0, rates=usual.rates, mcmc=usual.mcmc,
        opacity_reg=usual.opacity_reg, opacity_reg_fall=usual.opacity_reg_fall, scale_reg=usual.scale_reg,
    )  # fmt: skip


class Distance:
    """Mean distance of a picture from data [H, W, 3]; nan data are left out. A `PixelLoss`."""

    def __call__(self, step: Step, target: Tensor) -> Tensor:
        """The loss by autograd, on any device."""
        there = ~target.isnan()
        return (step.render - target.where(there, step.render.detach())).abs().sum() / there.sum().clamp_min(1)

    def compare(self, image: np.ndarray, target: np.ndarray) -> tuple[np.float32, np.ndarray]:
        """The loss of float32 arrays, and its gradient for the image."""
        there = ~np.isnan(target)
        count = max(1, int(there.sum()))
        residual = np.where(there, image - target, np.float32(0))
        return np.float32(np.abs(residual, dtype=np.float64).sum() / count), np.sign(residual) / np.float32(count)
