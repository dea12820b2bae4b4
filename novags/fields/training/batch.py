"""One step's rays: which pixels, their samples, and the field's outputs there."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from novags.fields.march import Rays, Samples
from novags.splats.views import Views


@dataclass(frozen=True)
class Batch:
    """The input of a loss.

    Attributes:
        iteration: From 0.
        view: Index of the training view [R].
        x: Columns [R].
        y: Rows [R].
        patch: Side of the squares that the pixels make; one after the other, row by row.
        rays: Their rays.
        samples: Along them.
        raw: Outputs of the field [R, N, K]; the gradient of the loss is taken for it.
        weights: Share of every sample in its ray's colour [R, N].
    """

    iteration: int
    view: Tensor
    x: Tensor
    y: Tensor
    patch: int
    rays: Rays
    samples: Samples
    raw: Tensor
    weights: Tensor

    def of(self, images: Tensor) -> Tensor:
        """The pixels of images [C, H, W, ...]."""
        return images[self.view, self.y, self.x]

    def squares(self, values: Tensor) -> Tensor:
        """Values [R, ...] of pixels as [squares, patch, patch, ...]."""
        return values.reshape(-1, self.patch, self.patch, *values.shape[1:])

    def rendered(self, values: Tensor) -> Tensor:
        """Values of samples [R, N, D] summed by weight, [R, D]."""
        return (self.weights[..., None] * values).sum(1)


def chosen_pixels(views: Views, rays: int, patch: int, rng: np.random.Generator) -> tuple[Tensor, Tensor, Tensor]:
    """View, column and row [rays] of random squares of pixels; drawn with replacement.

    Raises:
        ValueError: If the pictures are smaller than a patch.
    """
    if patch > min(views.width, views.height):
        raise ValueError(f"pictures must be at least as large as a patch of {patch}, got {views.width}x{views.height}")
    n = rays // patch**2
    view = rng.integers(0, len(views), n)
    x, y = rng.integers(0, views.width - patch + 1, n), rng.integers(0, views.height - patch + 1, n)
    dy, dx = (d.reshape(-1) for d in np.mgrid[:patch, :patch])
    columns = np.repeat(view, patch**2), (x[:, None] + dx).reshape(-1), (y[:, None] + dy).reshape(-1)
    view_, x_, y_ = (torch.from_numpy(c) for c in columns)
    return view_, x_, y_


def distortion(weights: Tensor, distances: Tensor, widths: Tensor) -> Tensor:
    """How far apart the weights of a ray lie, mean over rays; Barron et al. 2022, equation 15.

    Args:
        weights: [R, N].
        distances: Of the samples [R, N], in front-to-back order.
        widths: Of their intervals [R, N], the same unit.
    """
    before, moment = torch.cumsum(weights, 1) - weights, weights * distances
    apart = 2 * (weights * distances * before - weights * (torch.cumsum(moment, 1) - moment)).sum(1)
    return (apart + (weights**2 * widths).sum(1) / 3).mean()
