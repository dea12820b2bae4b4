"""Losses that several methods with a field share."""

import torch
from torch import Tensor

GREY = (0.299, 0.587, 0.114)


def grey_of(image: Tensor) -> Tensor:
    """Luminance of [..., 3]."""
    return image @ image.new_tensor(GREY)


def differences(values: Tensor) -> Tensor:
    """Between neighbours of squares [n, p, p, ...], to the right and then below, flat."""
    right, below = values[:, :, 1:] - values[:, :, :-1], values[:, 1:] - values[:, :-1]
    return torch.cat([right.flatten(), below.flatten()])
