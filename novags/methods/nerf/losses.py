"""Losses that several methods with a field share."""

import torch
from torch import Tensor

GREY = (0.299, 0.587, 0.114)


def raw_loss(render: Tensor, data: Tensor, epsilon: float, white: Tensor | None = None) -> Tensor:
    """Mean of ((min(render, white) - data) / (sg(render) + epsilon))^2, where sg holds its argument fixed.

    Mildenhall et al. 2022 (RawNeRF), section 4.1.

    Args:
        render: [..., 3].
        data: The same shape; nan is left out.
        epsilon: Without it, black renders would be divided by zero.
        white: Where each channel saturates, [3]; None: nowhere.
    """
    there = ~data.isnan()
    shown = render if white is None else torch.minimum(render, white)
    residual = torch.where(there, shown - data, 0.0) / (render.detach() + epsilon)
    return residual.square().sum() / there.sum().clamp_min(1)


def grey_of(image: Tensor) -> Tensor:
    """Luminance of [..., 3]."""
    return image @ image.new_tensor(GREY)


def differences(values: Tensor) -> Tensor:
    """Between neighbours of squares [n, p, p, ...], to the right and then below, flat."""
    right, below = values[:, :, 1:] - values[:, :, :-1], values[:, 1:] - values[:, :-1]
    return torch.cat([right.flatten(), below.flatten()])
