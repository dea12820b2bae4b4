"""Targeted blind-spot masking and its loss (paper, section 4.3.1 and 4.3.3; Noise2Void).

Batches are [B, D, H, W] with D = 3 colour channels, 4 of packed mosaics, or 1 where each is blinded on its own. A mask
is bool [B, H, W], True where the network is blinded: there its input is another pixel of the neighbourhood, and only
there the loss is evaluated.
"""

import torch
import torch.nn.functional as F
from torch import Tensor


def laplacian_prior(images: Tensor) -> Tensor:
    """P(u, v) = |lap| / sum |lap| of the grey image (equations 6 and 7).

    Args:
        images: [B, D, H, W].

    Returns:
        [B, H, W], each summing to 1; uniform where an image is constant.
    """
    grey = images.mean(1, keepdim=True)
    kernel = images.new_tensor([[0.0, 1.0, 0.0], [1.0, -4.0, 1.0], [0.0, 1.0, 0.0]])
    magnitude = F.conv2d(F.pad(grey, (1, 1, 1, 1), mode="replicate"), kernel[None, None]).abs()[:, 0]
    # Floor: a constant image would be divided by zero; with it every pixel is equally likely.
    magnitude = magnitude + 1e-12
    return magnitude / magnitude.sum((1, 2), keepdim=True)


def _draw(weights: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Indices [B, count] drawn without replacement with probability proportional to weights [B, N].

    The count largest weight / Exp(1) are such a sample (exponential races); unlike torch.multinomial this accepts
    zero weights, which come last.
    """
    race = torch.empty_like(weights).exponential_(generator=generator)
    # Floor: a draw of exactly 0 would make every weight infinite, and zero ones NaN.
    return (weights / race.clamp_min(1e-30)).topk(count, dim=1).indices


def sample_mask(images: Tensor, fraction: float, laplacian_share: float, generator: torch.Generator) -> Tensor:
    """Blind spots from the mixture of the Laplacian prior and the uniform distribution, without repetition.

    Args:
        images: [B, D, H, W], the noisy enhanced images.
        fraction: Share of pixels to blind; at least one pixel is.
        laplacian_share: Share of the blind spots that follow `laplacian_prior`.
        generator: Source of randomness, on the images' device.

    Returns:
        bool [B, H, W] with round(fraction H W) True each.
    """
    batch, _, height, width = images.shape
    count = max(1, round(fraction * height * width))
    targeted = round(laplacian_share * count)
    mask = torch.zeros(batch, height * width, dtype=torch.bool, device=images.device)
    if targeted:
        mask.scatter_(1, _draw(laplacian_prior(images).flatten(1), targeted, generator), True)
    if count > targeted:
        mask.scatter_(1, _draw((~mask).to(images.dtype), count - targeted, generator), True)
    return mask.reshape(batch, height, width)


def replace_masked(images: Tensor, mask: Tensor, window: int, generator: torch.Generator) -> Tensor:
    """The network's input: each blinded pixel takes the colour of one random other pixel of its neighbourhood.

    The window is shifted inwards at the border, so that it always holds the same number of candidates.

    Args:
        images: [B, D, H, W].
        mask: bool [B, H, W].
        window: Edge of the neighbourhood, px; its centre pixel is excluded.
        generator: Source of randomness.

    Returns:
        [B, D, H, W], equal to `images` outside the mask.

    Raises:
        ValueError: If the image has a single pixel, hence no neighbour.
    """
    if images.shape[-2] * images.shape[-1] < 2:
        raise ValueError(f"blind spots need a neighbour, got images of {images.shape[-2]} x {images.shape[-1]} px")
    if mask.device.type != "cpu":
        return replaced_everywhere(images, mask, window, generator)
    view, y, x = mask.nonzero(as_tuple=True)
    replaced = images.clone()
    replaced[view, :, y, x] = _neighbours(images, view, y, x, window, generator)
    return replaced


def replaced_everywhere(images: Tensor, mask: Tensor, window: int, generator: torch.Generator) -> Tensor:
    """`replace_masked` with draws for all pixels, blinded or not: to know which are, a GPU would have to be waited for.

    Arguments are the same.
    """
    view, y, x = torch.meshgrid(*(torch.arange(size, device=mask.device) for size in mask.shape), indexing="ij")
    found = _neighbours(images, view, y, x, window, generator)
    return torch.where(mask[:, None], found.movedim(-1, 1), images)


def _neighbours(images: Tensor, view: Tensor, y: Tensor, x: Tensor, window: int, generator: torch.Generator) -> Tensor:
    """The colours [..., D] of one random other pixel in the neighbourhood of each of these."""
    height, width = images.shape[-2:]
    rows, columns = min(window, height), min(window, width)
    top, left = (y - window // 2).clamp(0, height - rows), (x - window // 2).clamp(0, width - columns)
    pick = torch.randint(rows * columns - 1, y.shape, generator=generator, device=images.device)
    # Skipping the pixel's own index leaves the others equally likely.
    pick = pick + (pick >= (y - top) * columns + (x - left))
    return images[view, :, top + pick // columns, left + pick % columns]


def n2v_loss(prediction: Tensor, noisy: Tensor, mask: Tensor) -> Tensor:
    """Sum of squared colour differences over the blind spots divided by their number (equation 8).

    Args:
        prediction: [B, D, H, W], the network's output for the blinded input.
        noisy: [B, D, H, W], the enhanced images themselves.
        mask: bool [B, H, W], at least one True.

    Returns:
        Scalar.
    """
    squared = ((prediction - noisy) ** 2).sum(1)
    blinded = squared[mask] if mask.device.type == "cpu" else torch.where(mask, squared, 0.0)
    return blinded.sum() / mask.sum()
