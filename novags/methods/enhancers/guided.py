"""Structure-aware enhancement: brighten a dark image through its guided-filtered brightness map (paper, section 4.2).

`dark` is the sRGB-encoded input in 0..1, `brightness` (L) its edge-preserving smooth version, `gamma` the exponent that
brings the mean of L**gamma to the target exposure, `ratio` (R) the factor every pixel is multiplied with. Images are
[H, W, 3] or [C, H, W, 3]; every image gets its own gamma and epsilon. Every colour channel has a brightness map of its
own, guided by itself, or all three share the luminance's map.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.noise_level import immerkaer_sigma, known_sigma, patch_pca_sigma
from novags.methods.enhancers.pictures import check_picture, solve_gamma
from novags.methods.inputs import LacksInput
from novags.methods.noise import Variance

LUMINANCE = (0.2126, 0.7152, 0.0722)  # of sRGB code: Rec. 709


@dataclass(frozen=True, kw_only=True)
class EnhanceParams:
    """The parameters that one enhancement chose, so that another exposure of the same view can be enhanced alike."""

    gamma: Tensor  # [C] or scalar for a single image
    epsilon: Tensor  # same shape; regulariser of the guided filter, squared image units
    radius: int  # px; window = 2 radius + 1


def typical(params: Sequence[EnhanceParams]) -> EnhanceParams:
    """Typical parameters of several single images: the mean gamma and epsilon."""
    return EnhanceParams(
        gamma=torch.stack([each.gamma for each in params]).mean(),
        epsilon=torch.stack([each.epsilon for each in params]).mean(),
        radius=params[0].radius,
    )


def box_mean(image: Tensor, radius: int) -> Tensor:
    """Mean over a (2 radius + 1)² window, normalised by the number of pixels inside the image. image: [B, D, H, W]."""
    size = 2 * radius + 1
    rows = F.avg_pool2d(image, (size, 1), stride=1, padding=(radius, 0), count_include_pad=False)
    return F.avg_pool2d(rows, (1, size), stride=1, padding=(0, radius), count_include_pad=False)


def guided_filter(image: Tensor, radius: int, epsilon: Tensor) -> Tensor:
    """Self-guided filter (supplement, section B.1): q = mean(a) I + mean(b), a = var / (var + eps), b = mean (1 - a).

    Args:
        image: [B, D, H, W], any scale. Every channel guides itself.
        radius: Window radius in px, at most (min(H, W) - 1) // 2.
        epsilon: [B], squared image units. 0 returns the image.

    Returns:
        [B, D, H, W], same dtype; each pixel is a convex combination of window means and the pixel itself.
    """
    # float64: the variance is a difference of squares, and dark images have variances near 1e-6.
    wide = image.double()
    mean = box_mean(wide, radius)
    variance = (box_mean(wide * wide, radius) - mean * mean).clamp_min(0)
    # Floor: without it a constant window with epsilon 0 is 0 / 0; with it a = 0 and q = mean.
    a = variance / (variance + epsilon.double().clamp_min(1e-14).reshape(-1, 1, 1, 1))
    b = mean * (1 - a)
    return (box_mean(a, radius) * wide + box_mean(b, radius)).to(image.dtype)


def _guides(images: Tensor, config: EnhanceConfig) -> Tensor:
    """The source of the brightness maps, [B, 3, H, W] or [B, 1, H, W], from images [B, 3, H, W]."""
    if config.guide == "channel":
        return images
    return (images * images.new_tensor(LUMINANCE)[:, None, None]).sum(1, keepdim=True)


def _new_params(images: Tensor, config: EnhanceConfig, noise: Variance | None) -> tuple[Tensor, int]:
    """Epsilon [B] and radius for images [B, 3, H, W]."""
    radius = min(config.window // 2, (min(images.shape[-2:]) - 1) // 2)
    images = images.detach()
    if config.noise_estimator == "camera":
        if noise is None:
            raise LacksInput(
                "noise_estimator = camera needs the noise of the camera, known or estimated from the pictures, and "
                "neither was given: use patch-pca"
            )
        weights = None if config.guide == "channel" else LUMINANCE
        sigma = torch.stack([known_sigma(image, noise, weights) for image in images])
    else:
        estimate = patch_pca_sigma if config.noise_estimator == "patch-pca" else immerkaer_sigma
        sigma = torch.stack([estimate(guide) for guide in _guides(images, config)])
    return config.noise_factor * sigma**2, radius


def enhance(
    dark: Tensor, config: EnhanceConfig | None = None, params: EnhanceParams | None = None,
    noise: Variance | None = None,
) -> tuple[Tensor, EnhanceParams]:  # fmt: skip
    """Brighten images to the target exposure: I_enh = min(I_dark * L**gamma / (L + eta), 1), equations 3 to 5.

    Differentiable in `dark`; gamma and epsilon count as constants. A black image stays black, an image brighter than
    the target is darkened (gamma > 1).

    Args:
        dark: [H, W, 3] or [C, H, W, 3], sRGB-encoded, 0..1.
        config: Choices; None takes the defaults.
        params: Gamma, epsilon and radius of an earlier call, used instead of new ones: a noise-free exposure then goes
            through the same enhancement as its noisy twin.
        noise: Variance of the linear pictures over their mean, of a known camera or estimated from the pictures.

    Returns:
        The enhanced images, same shape and dtype, 0..1, and the parameters used.

    Raises:
        ValueError: If the shape is wrong, a value is not finite or outside 0..1, or `params` belongs to another
            number of images.
        LacksInput: If the noise of the camera is to be used, and is not known.
    """
    config = config or EnhanceConfig()
    check_picture(dark)
    images = (dark if dark.ndim == 4 else dark[None]).movedim(-1, 1)
    if params is None:
        epsilon, radius = _new_params(images, config, noise)
    else:
        if params.gamma.shape != dark.shape[:-3]:
            raise ValueError(f"params hold {tuple(params.gamma.shape)} gammas, images are {tuple(dark.shape[:-3])}")
        epsilon, radius = params.epsilon.reshape(-1), params.radius
    smooth = guided_filter(_guides(images, config), radius, epsilon)
    eta = images.new_tensor(config.eta)
    # Clamp: 0**gamma has an infinite slope for gamma < 1, which would turn gradients into NaN.
    bounded = smooth.clamp_min(eta)
    gamma = solve_gamma(bounded, config) if params is None else params.gamma.reshape(-1)
    ratio = bounded ** gamma.to(images.dtype).reshape(-1, 1, 1, 1) / (smooth + eta)
    enhanced = (images * ratio).clamp_max(1).movedim(1, -1)
    used = EnhanceParams(gamma=gamma.reshape(dark.shape[:-3]), epsilon=epsilon.reshape(dark.shape[:-3]), radius=radius)
    return (enhanced if dark.ndim == 4 else enhanced[0]), used
