"""Helpers of several methods on pictures: refuse other data, find the exponent for a mean, say how far a mean is
off.
"""

import torch
import torch.nn.functional as F
from torch import Tensor

from novags.methods.enhancers.choice import EnhanceConfig

EXPOSURE, PATCH = 0.6, 16  # mean that a patch of so many px is to have


def solve_gamma(brightness: Tensor, config: EnhanceConfig) -> Tensor:
    """Gamma per image such that mean(L**gamma) = target, by bisection on the monotone mean. brightness: [B, ...] > 0.

    Where no exponent in the configured range reaches the target (a constant white image), the nearest end is returned.
    """
    flat = brightness.detach().double().flatten(1)
    low = torch.full_like(flat[:, :1], config.gamma_min)
    high = torch.full_like(low, config.gamma_max)
    for _ in range(config.bisection_steps):
        middle = (low + high) / 2
        too_bright = (flat**middle).mean(1, keepdim=True) > config.target
        low, high = torch.where(too_bright, middle, low), torch.where(too_bright, high, middle)
    return ((low + high) / 2).squeeze(1)


def check_picture(dark: Tensor) -> None:
    """Raise ValueError unless `dark` is a float image [H, W, 3] or [C, H, W, 3] in 0..1."""
    if dark.ndim not in (3, 4) or dark.shape[-1] != 3 or 0 in dark.shape or not dark.is_floating_point():
        raise ValueError(
            f"dark must be a float image [H, W, 3] or [C, H, W, 3], got {dark.dtype} {tuple(dark.shape)}; "
            "divide 8-bit codes by 255"
        )
    bad = ~(torch.isfinite(dark) & (dark >= 0) & (dark <= 1))
    if bad.any():
        first = tuple(int(i) for i in bad.nonzero()[0])
        raise ValueError(
            f"dark must be finite and in 0..1, got {float(dark[first])} at {first} "
            f"({int(bad.sum())} of {dark.numel()} values); clip it after encoding"
        )


def pooled(pictures: Tensor, size: int) -> Tensor:
    """Mean grey of whole patches, [B, 1, h, w]."""
    grey = pictures.mean(1, keepdim=True)
    return F.avg_pool2d(grey, (min(size, grey.shape[2]), min(size, grey.shape[3])))


def exposure(bright: Tensor, target: float = EXPOSURE) -> Tensor:
    """The mean square by which grey patches of pictures [B, 3, H, W] are off the target."""
    return (pooled(bright, PATCH) - target).square().mean()
