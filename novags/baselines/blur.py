"""A Gaussian blur: the bar a denoiser has to clear."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor


def gaussian_blur(images: Tensor, sigma: float) -> Tensor:
    """Blur images, borders repeated.

    Args:
        images: [H, W, D] or [C, H, W, D].
        sigma: Standard deviation in px, > 0; the kernel is cut at four of them.

    Returns:
        Same shape and dtype.

    Raises:
        ValueError: For another shape or sigma <= 0.
    """
    if images.ndim not in (3, 4) or not sigma > 0:
        raise ValueError(f"need images [H, W, D] or [C, H, W, D] and sigma > 0, got {tuple(images.shape)} and {sigma}")
    radius = math.ceil(4 * sigma)
    offsets = torch.arange(-radius, radius + 1, dtype=images.dtype, device=images.device)
    line = torch.exp(-0.5 * (offsets / sigma) ** 2)
    line = line / line.sum()
    planes = (images if images.ndim == 4 else images[None]).movedim(-1, 1)
    shape = planes.shape
    padded = F.pad(planes.flatten(0, 1)[:, None], (radius,) * 4, mode="replicate")
    rows = F.conv2d(padded, line.reshape(1, 1, -1, 1))
    blurred = F.conv2d(rows, line.reshape(1, 1, 1, -1))[:, 0].reshape(shape).movedim(1, -1)
    return blurred if images.ndim == 4 else blurred[0]
