"""Noise-guided spherical-harmonic regularisation (paper, section 4.6).

L_SH is the mean over visible Gaussians of w_i times the sum over k > 0 of |c_ik|^2 (equation 16). Here are its weights;
the rest is a `HarmonicsPenalty`.
"""

# mypy: allow-untyped-defs

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from novags.splats.cpu.compiler import kernel


def noise_map(enhanced: Tensor, denoised: Tensor) -> Tensor:
    """E_noise: mean over colours of |I_enh - I_clean| (equation 15). Both [..., H, W, 3]; returns [..., H, W]."""
    return (enhanced - denoised).abs().mean(-1)


def noise_weights(noise: Tensor, means2d: Tensor) -> Tensor:
    """The noise map at projected centres, bilinear, without gradient (else splats would drift to quiet pixels).

    Args:
        noise: [H, W].
        means2d: [N, 2] pixels (x, y), centres at +0.5; outside the frame they get any weight.

    Returns:
        w, [N].
    """
    size = means2d.new_tensor([noise.shape[1], noise.shape[0]])
    grid = (2 * means2d.detach() / size - 1)[None, None]
    weights = F.grid_sample(
        noise.detach()[None, None], grid, mode="bilinear", padding_mode="border", align_corners=False
    )
    return weights[0, 0, 0]


def penalty_weights(means2d: Tensor, visible: Tensor, noise: Tensor) -> Tensor:
    """The weights of `harmonics_penalty` that make it L_SH: w_i over the number of visible Gaussians.

    Args:
        means2d: [N, 2] projected centres in pixels.
        visible: [N] bool; a Gaussian whose centre lies outside the frame does not count.
        noise: E_noise of this view, [H, W].

    Returns:
        [N], without gradient; 0 where a Gaussian is not visible.
    """
    means2d, noise = means2d.detach(), noise.detach()
    if all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (means2d, noise)):
        weights = np.zeros(len(means2d), np.float32)
        count = _look_up(means2d.numpy(), visible.numpy(), noise.contiguous().numpy(), weights)
        return torch.from_numpy(weights) / max(1, count)
    height, width = noise.shape
    x, y = means2d.unbind(1)
    visible = visible & (x >= 0) & (y >= 0) & (x <= width) & (y <= height)
    return torch.where(visible, noise_weights(noise, means2d), 0.0) / visible.sum().clamp_min(1)


@kernel
def _look_up(means2d, visible, noise, weights):
    """`noise_weights` of the visible Gaussians within the frame; returns their number."""
    height, width = noise.shape
    count = 0
    for i in range(len(weights)):
        x, y = means2d[i, 0], means2d[i, 1]
        if not visible[i] or not (0 <= x <= width and 0 <= y <= height):
            continue
        count += 1
        # the nearest colours beyond the outermost centres
        u = min(max(x - np.float32(0.5), np.float32(0)), np.float32(width - 1))
        v = min(max(y - np.float32(0.5), np.float32(0)), np.float32(height - 1))
        left, top = int(u), int(v)
        right, low = min(left + 1, width - 1), min(top + 1, height - 1)
        s, t = u - np.float32(left), v - np.float32(top)
        upper = noise[top, left] + s * (noise[top, right] - noise[top, left])
        lower = noise[low, left] + s * (noise[low, right] - noise[low, left])
        weights[i] = upper + t * (lower - upper)
    return count
