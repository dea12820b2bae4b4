"""Image losses for splat training."""

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..cpu.chains import training as chains
from ..cpu.memory import empty
from ..cpu.parallel import run_chain
from ..first_order import first_order

WINDOW, SIGMA = 11, 1.5  # Wang et al. 2004, and every 3DGS code since
C1, C2 = 0.01**2, 0.03**2


@lru_cache
def _kernel(dtype: torch.dtype) -> Tensor:
    x = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    weights = torch.exp(-0.5 * (x / SIGMA) ** 2)
    return (weights / weights.sum()).to(dtype)


def _blur(images: Tensor) -> Tensor:
    """Separable Gaussian over [B, H, W], zero outside."""
    kernel = _kernel(images.dtype).to(images.device)
    pad = WINDOW // 2
    rows = torch.nn.functional.conv2d(images[:, None], kernel.reshape(1, 1, 1, -1), padding=(0, pad))
    return torch.nn.functional.conv2d(rows, kernel.reshape(1, 1, -1, 1), padding=(pad, 0))[:, 0]


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """Structural similarity of Wang et al. 2004: 11x11 window, sigma 1.5, data range 1, zeros outside as in 3DGS.

    Args:
        image: [H, W, C].
        target: [H, W, C].

    Returns:
        [H, W, C]; 1 where the windows are equal.

    Raises:
        ValueError: If the shapes differ.
    """
    _check(image, target)
    x, y = image.movedim(-1, 0), target.movedim(-1, 0)
    n = len(x)
    moments = _blur(torch.cat([x, y, x * x, y * y, x * y]))
    mx, my, xx, yy, xy = (moments[i * n : (i + 1) * n] for i in range(5))
    variance_sum = (xx - mx * mx) + (yy - my * my)
    covariance = xy - mx * my
    score = (2 * mx * my + C1) * (2 * covariance + C2) / ((mx * mx + my * my + C1) * (variance_sum + C2))
    return score.movedim(0, -1)


def ssim(image: Tensor, target: Tensor) -> Tensor:
    """Mean of `ssim_map` over pixels and channels, a scalar."""
    return ssim_map(image, target).mean()


def _check(image: Tensor, target: Tensor) -> None:
    if image.shape != target.shape or image.ndim != 3:
        raise ValueError(f"image and target must both be [H, W, C], got {list(image.shape)} and {list(target.shape)}")


def photometric_loss(image: Tensor, target: Tensor, dssim_weight: float) -> Tensor:
    """(1 - w) L1 + w (1 - SSIM), the 3DGS loss; w = 0 is plain L1.

    Args:
        image: [H, W, C].
        target: [H, W, C]. If both are float32 on the CPU, value and gradient come from one kernel.
        dssim_weight: w, 0..1.

    Returns:
        A scalar.

    Raises:
        ValueError: If the shapes differ.
    """
    _check(image, target)
    if all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (image, target)):
        return _Photometric.apply(image, target, dssim_weight)
    l1 = (image - target).abs().mean()
    if dssim_weight == 0:
        return l1
    return (1 - dssim_weight) * l1 + dssim_weight * (1 - ssim(image, target))


def compare(image: np.ndarray, target: np.ndarray, dssim_weight: float) -> tuple[np.float32, np.ndarray]:
    """`photometric_loss` of float32 images [H, W, C], and its gradient for the first, by the CPU's kernels."""
    height, width, channels = image.shape
    x, y = (a.reshape(height, width * channels) for a in (image, target))
    score_sums, l1_sums, v_image = np.zeros(height), np.empty(height), empty(x.shape)
    factors = np.float32((1 - dssim_weight) / x.size), np.float32(-dssim_weight / x.size)
    run_chain(
        chains.compare, x.size, x, y, channels, _kernel(torch.float32).numpy(), *factors, score_sums, l1_sums, v_image
    )
    value = (1 - dssim_weight) * l1_sums.sum() / x.size + dssim_weight * (1 - score_sums.sum() / x.size)
    with np.errstate(over="ignore"):  # an infinite loss is reported by the caller
        return np.float32(value), v_image.reshape(image.shape)


class _Photometric(torch.autograd.Function):
    """The gradients are made together with the value: they need the same window sums.

    Both pictures have the same part in the loss, so that of the target, where it is wanted, comes from exchanging them.
    """

    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor, dssim_weight: float) -> Tensor:
        x, y = image.detach().contiguous().numpy(), target.detach().contiguous().numpy()
        value, v_image = compare(x, y, dssim_weight)
        ctx.v_image, ctx.v_target = torch.from_numpy(v_image), None
        if ctx.needs_input_grad[1]:
            ctx.v_target = torch.from_numpy(compare(y, x, dssim_weight)[1])
        return image.new_tensor(value)

    @staticmethod
    @first_order
    def backward(ctx: Any, v_loss: Tensor) -> tuple[Tensor, Tensor | None, None]:
        return v_loss * ctx.v_image, None if ctx.v_target is None else v_loss * ctx.v_target, None
