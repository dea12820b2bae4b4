"""Noise-guided spherical-harmonic regularisation (paper, section 4.6)."""

import torch
import torch.nn.functional as F
from torch import Tensor


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


def sh_penalty(sh: Tensor, means2d: Tensor, radii: Tensor, noise: Tensor) -> Tensor:
    """L_SH: mean over visible Gaussians of w_i sum over k > 0 of |c_ik|² (equation 16).

    Args:
        sh: [N, K, 3]; the first coefficient is the base colour and is not penalised.
        means2d: [N, 2] projected centres in pixels.
        radii: [N], 0 where a Gaussian is not visible.
        noise: E_noise of this view, [H, W].

    Returns:
        Scalar; zero if no Gaussian is visible or there are no higher orders.
    """
    height, width = noise.shape
    inside = (means2d >= 0).all(-1) & (means2d[:, 0] <= width) & (means2d[:, 1] <= height)
    visible = (radii > 0) & inside
    if sh.shape[1] == 1 or not visible.any():
        return sh.new_zeros(())
    # Weights of zero instead of an index: nothing has to be gathered, nor scattered in the backward pass.
    weights = torch.where(visible, noise_weights(noise, means2d), 0.0)
    return (weights * sh[:, 1:].square().sum((1, 2))).sum() / visible.sum()
