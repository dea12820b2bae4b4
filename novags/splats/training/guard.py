"""Training stops at the first number that is not finite, and says where it was."""

import math
from collections.abc import Iterable, Mapping

import torch
from torch import Tensor


class NotFinite(ValueError):
    """A loss, gradient or parameter is NaN or infinite; the message says which, in which step and of which view.

    Attributes:
        resumable: Whether the parameters are unchanged since before that step, so that a checkpoint of them leads there
            again at once. If not, the last checkpoint does, or the start.
    """

    def __init__(self, message: str, *, resumable: bool = True) -> None:
        super().__init__(message)
        self.resumable = resumable


def all_finite(tensors: Iterable[Tensor]) -> bool:
    """Whether all numbers are finite, by their sums: one pass, and one transfer from a GPU."""
    total = sum(tensor.detach().sum().double() for tensor in tensors)
    # a sum of large numbers may overflow; callers that are told so look at the numbers themselves
    return math.isfinite(float(total))


def require_finite(what: str, tensors: Mapping[str, Tensor], where: str, *, resumable: bool) -> None:
    """Raise NotFinite for the first tensor that is not finite.

    Args:
        what: The kind of tensors: "parameter", "gradient of".
        tensors: By name.
        where: Step and view.
        resumable: See NotFinite.
    """
    if all_finite(tensors.values()):
        return
    for name, tensor in tensors.items():
        wrong = ~torch.isfinite(tensor.detach())
        if wrong.any():
            index = wrong.nonzero()[0].tolist()
            value, count = float(tensor.detach()[tuple(index)]), int(wrong.sum())
            raise NotFinite(
                f"{what} {name} must be finite, got {value} at {index} ({count} of {wrong.numel()} values) {where}",
                resumable=resumable,
            )


def norms(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Euclidean norm of each tensor, a scalar, by its name with "norm_" before it."""
    return {f"norm_{name}": torch.linalg.vector_norm(tensor.detach()) for name, tensor in tensors.items()}
