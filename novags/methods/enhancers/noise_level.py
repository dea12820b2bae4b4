"""Noise level of one image, from itself or by a known camera. Images are [D, H, W]; sigma is in image units."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from novags.methods.noise import Variance

LEVEL_WINDOW = 5  # px; the light that a pixel's variance follows is the mean over so many squared


def immerkaer_sigma(image: Tensor) -> Tensor:
    """Standard deviation of white noise from the mean magnitude of a Laplacian difference (Immerkaer 1996).

    Fast, biased upward by texture, and far too low on demosaiced data, whose noise is smooth.

    Args:
        image: [D, H, W]. Images narrower than 3 px have no estimate and give 0.

    Returns:
        Scalar float64 tensor >= 0, mean over channels.
    """
    if min(image.shape[-2:]) < 3:
        return image.new_zeros((), dtype=torch.float64)
    row = image.new_tensor([1.0, -2.0, 1.0], dtype=torch.float64)
    response = F.conv2d(image.double()[:, None], torch.outer(row, row)[None, None])
    # The mask has norm 6, and E|N(0, s)| = s sqrt(2 / pi).
    return math.sqrt(math.pi / 2) / 6 * response.abs().mean()


def patch_pca_sigma(image: Tensor, patch: int = 8, max_patches: int = 20_000) -> Tensor:
    """Standard deviation of white noise from the flat tail of the patch covariance spectrum (Chen, Zhu, Heng 2015).

    Eigenvalues of pure-noise directions scatter around sigma²; the largest ones are dropped until the mean of the rest
    equals its median.

    Args:
        image: [D, H, W].
        patch: Patch edge in px; shrunk until there are four patches per dimension (fewer make the spectrum useless).
        max_patches: Patches lie on a grid as dense as this number allows.

    Returns:
        Scalar float64 tensor >= 0.
    """
    height, width = image.shape[-2:]
    while patch > 1 and (height - patch + 1) * (width - patch + 1) < 4 * 3 * patch**2:
        patch -= 1
    stride = math.ceil(math.sqrt((height - patch + 1) * (width - patch + 1) / max_patches)) or 1
    columns = F.unfold(image.double()[None], patch, stride=stride)[0]
    centred = columns - columns.mean(1, keepdim=True)
    tail = torch.linalg.eigvalsh(centred @ centred.T / columns.shape[1]).clamp_min(0)
    counts = torch.arange(1, len(tail) + 1, device=tail.device)
    means = torch.cumsum(tail, 0) / counts
    medians = (tail[(counts - 1) // 2] + tail[counts // 2]) / 2
    flat = (means <= medians).nonzero()
    return (means[flat[-1, 0]] if len(flat) else means[0]).sqrt()


def known_sigma(image: Tensor, noise: Variance, weights: tuple[float, float, float] | None = None) -> Tensor:
    """Root mean square over an sRGB-encoded image of the noise that a known camera leaves in it.

    The variance of each pixel's light, at the mean light around it, times the squared slope of the sRGB curve there
    (delta method). Clipping at black and rounding to 8 bits are not in it: where noise is clipped it is too large.

    Args:
        image: [3, H, W], sRGB code in 0..1.
        noise: Of the linear picture.
        weights: Of a sum of the three channels whose noise is wanted, taken as independent; None: the mean square over
            the channels.

    Returns:
        Scalar float64 tensor >= 0.
    """
    half = LEVEL_WINDOW // 2
    code = F.avg_pool2d(image.double()[None], LEVEL_WINDOW, 1, half, count_include_pad=False)[0].movedim(0, -1)
    linear = torch.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    # The floor is never used: below 0.0031308 the other branch is taken, but 0 ** -0.58 would be infinite.
    slope = torch.where(linear <= 0.0031308, 12.92, 1.055 / 2.4 * linear.clamp_min(0.0031308) ** (1 / 2.4 - 1))
    variance = noise(linear) * slope.square()
    if weights is not None:
        variance = (variance * variance.new_tensor(weights).square()).sum(-1)
    return variance.mean().sqrt()
