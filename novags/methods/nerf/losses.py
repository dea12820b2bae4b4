"""Losses that several methods with a field share."""

import torch
from torch import Tensor

GREY = (0.299, 0.587, 0.114)
ROUNDED = 1e-3  # error below which the robust loss is rounded: at 0 the slope of |e| jumps, and Adam would swing
USUAL = 0.025  # error at which its slope and the slope of e^2 agree: other losses then weigh as beside a squared error


def robust(errors: Tensor) -> Tensor:
    """Mean of 2 USUAL sqrt(e^2 + ROUNDED^2), which is |e| but for its tip; Charbonnier et al. 1994.

    Glass, mirrors and things that only one view sees leave large errors, which no field of a static scene can remove;
    squared, they distort everything around them.
    """
    return 2 * USUAL * (errors.square() + ROUNDED**2).sqrt().mean()


def grey_of(image: Tensor) -> Tensor:
    """Luminance of [..., 3]."""
    return image @ image.new_tensor(GREY)


def differences(values: Tensor) -> Tensor:
    """Between neighbours of squares [n, p, p, ...], to the right and then below, flat."""
    right, below = values[:, :, 1:] - values[:, :, :-1], values[:, 1:] - values[:, :-1]
    return torch.cat([right.flatten(), below.flatten()])
