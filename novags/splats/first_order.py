"""Backward passes made of kernels: they are not differentiable themselves, and raise when asked to be."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import torch


def first_order(backward: Callable[..., Any]) -> Callable[..., Any]:
    """Make the backward of an autograd function refuse to be part of a graph.

    Unlike `torch.autograd.function.once_differentiable` it also refuses where only the inputs of the forward pass, and
    not the incoming gradient, would carry the second derivative, which would silently be left out.
    """

    @wraps(backward)
    def checked(ctx: Any, *gradients: Any) -> Any:
        if torch.is_grad_enabled():  # in a backward pass: only with create_graph=True
            raise RuntimeError(
                "the CPU kernels have no second derivative, got create_graph=True: use rasterize(..., backend='torch') "
                "and, for the losses, tensors in float64"
            )
        return backward(ctx, *gradients)

    return checked
