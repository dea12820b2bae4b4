"""Gradients of the visible Gaussians alone, as sparse tensors, which torch.optim.SparseAdam takes."""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor


def sparse_gradients(gaussians: tuple[Any, ...]) -> tuple[tuple[Any, ...], Callable[[list[Tensor]], None]]:
    """Means, quats and scales [N, ...] with sparse gradients, and opacities with a dense one, as in gsplat.

    Also returns the function to call with the radii [N] of each camera after rendering.
    """
    *shape, opacities = gaussians
    rows: list[Tensor] = []

    def see(radii: list[Tensor]) -> None:
        rows.append(torch.nonzero(torch.stack(radii).amax(0))[:, 0])

    return (*(_Sparse.apply(tensor, rows) for tensor in shape), opacities), see


class _Sparse(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, tensor: Tensor, rows: list[Tensor]) -> Tensor:
        ctx.rows = rows
        return tensor.view_as(tensor)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        (rows,) = ctx.rows
        return torch.sparse_coo_tensor(rows[None], gradient[rows], gradient.shape, check_invariants=False), None
