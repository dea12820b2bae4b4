"""The first points as a second witness: the field's look there, from any side.

Rays say least about places that one view sees, or none. Gaussians start there with the colours of the first points, and
keep them. A field has no such start, for its features are shared: it is reminded of them in every step.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from novags.fields.box import Box, contracted
from novags.fields.evaluate import evaluate, gradients
from novags.fields.field import Field

COUNT = 256  # points a step, beside the samples of some hundred rays
ALL_WAYS = (1.0, 0.0, 0.0, 0.0)  # basis of an output averaged over all directions

PointLoss = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Anchors:
    """First points, and the colours that a field should show there.

    Attributes:
        positions: Of the points in the unit cube, float32 [P, 3].
        loss: Scalar loss of (which points [n], the field's outputs there [n, K]).
        weight: Of that loss beside the loss of the rays.
    """

    positions: np.ndarray
    loss: PointLoss
    weight: float

    @classmethod
    def at(cls, points: Tensor, box: Box, loss: PointLoss, weight: float) -> "Anchors":
        """At world points [P, 3]."""
        return cls(contracted(points.double().cpu(), box).float().numpy(), loss, weight)

    def slopes(self, field: Field, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Gradients of the field's tensors, from `COUNT` of the points, drawn with replacement."""
        chosen = rng.integers(0, len(self.positions), COUNT)
        places, basis = self.positions[chosen], np.tile(np.array(ALL_WAYS, np.float32), (COUNT, 1))
        flat, encoded = evaluate(field, places, basis)
        raw = torch.from_numpy(flat).requires_grad_()
        (self.weight * self.loss(torch.from_numpy(chosen), raw)).backward()
        assert raw.grad is not None
        return gradients(field, places, basis, encoded, raw.grad.contiguous().numpy())
