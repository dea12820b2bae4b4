"""The common part of methods that split a picture into reflectance and illumination."""

import torch
from torch import Tensor

EDGE = 10.0  # how much an edge of the reflectance allows one of the illumination
DIMMEST = 1e-3  # illumination, a quarter of a code of 8 bits: black would have no logarithm


def slopes(image: Tensor) -> tuple[Tensor, Tensor]:
    """Absolute differences to the right and downward neighbour, mean over channels: [H, W - 1] and [H - 1, W]."""
    return image.diff(dim=1).abs().mean(-1), image.diff(dim=0).abs().mean(-1)


def smoothness(illumination: Tensor, reflectance: Tensor) -> Tensor:
    """Mean slope of the illumination [H, W, D], where the reflectance [H, W, 3] has no edge; it only says where."""
    edges = slopes(reflectance.detach())
    terms = [(s * torch.exp(-EDGE * e)).sum() for s, e in zip(slopes(illumination), edges, strict=True)]
    return torch.stack(terms).sum() / illumination[..., 0].numel()
