"""Adam over the tensors of a set of Gaussians, with a learning rate per tensor (and one for the SH rest)."""

import math
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ...cpu.parallel import run
from ...cpu.training import optimizer
from ...gaussians import Gaussians
from ...sh import n_coefficients
from ..config import LearningRates

BETA1, BETA2 = 0.9, 0.999
EPS = 1e-15  # 3DGS: gradients are tiny, torch's 1e-8 would damp them; without any, 0 / 0 for a Gaussian never seen


class Adam:
    """Adam moments of a set of Gaussians. Rows follow the Gaussians: `grow` and `reset` keep them in step."""

    def __init__(self, gaussians: Gaussians) -> None:
        self.count = 0
        # Contiguous for any tensors: like them the moments are updated in place.
        zeros = partial(torch.zeros_like, memory_format=torch.contiguous_format)
        self.first = {name: zeros(tensor) for name, tensor in gaussians.tensors().items()}
        self.second = {name: zeros(tensor) for name, tensor in gaussians.tensors().items()}

    @torch.no_grad()
    def step(
        self, gaussians: Gaussians, rates: LearningRates, means_rate: float, sh_degree: int = 3,
        good: Tensor | None = None,
    ) -> None:  # fmt: skip
        """Update the Gaussians in place from their `.grad`; tensors without one are left alone.

        Args:
            gaussians: Leaves with gradients.
            rates: Learning rates of all but the means.
            means_rate: Learning rate of the means, world units.
            sh_degree: Spherical harmonics above it are left alone: with no gradient so far they would not move.
            good: On a GPU: 0-d bool; where it is False nothing changes, but `count`.

        Raises:
            ValueError: If a tensor is not contiguous: a copy of it would be updated instead.
        """
        for name, tensor in gaussians.tensors().items():
            if not tensor.is_contiguous():
                raise ValueError(
                    f"{name} must be contiguous to be updated in place, got strides {tensor.stride()} for shape "
                    f"{list(tensor.shape)}: call .contiguous() on it before the first step"
                )
        self.count += 1
        for name, tensor in gaussians.tensors().items():
            if tensor.grad is None:
                continue
            moments = self.first[name], self.second[name]
            if name == "sh":
                columns = torch.full((3 * min(n_coefficients(sh_degree), tensor.shape[1]),), rates.sh_rest)
                columns[:3] = rates.sh_dc  # on the CPU, and brought over
                flat = (tensor.data.flatten(1), tensor.grad.flatten(1), moments[0].flatten(1), moments[1].flatten(1))
                self._update(*flat, columns, good)
            else:
                rate = means_rate if name == "means" else float(getattr(rates, name))
                self._update(tensor.data, tensor.grad, *moments, rate, good)

    @staticmethod
    def numbers(count: int) -> tuple[np.float32, ...]:
        """Scalar arguments of the kernels for step number `count`, from 1."""
        corrections = 1 - BETA1**count, math.sqrt(1 - BETA2**count)
        return tuple(np.float32(x) for x in (BETA1, BETA2, *corrections, EPS))

    def _update(
        self,
        value: Tensor,
        gradient: Tensor,
        first: Tensor,
        second: Tensor,
        rate: float | Tensor,
        good: Tensor | None = None,
    ) -> None:
        if value.device.type == "cpu":
            arrays = [t.contiguous().numpy() for t in (value, gradient, first, second)]
            numbers = self.numbers(self.count)
            if isinstance(rate, Tensor):
                run(optimizer.adam_columns, len(value), 1024, *arrays, rate.numpy(), *numbers)
            else:
                run(optimizer.adam, value.numel(), 4096, *(a.reshape(-1) for a in arrays), np.float32(rate), *numbers)
            return
        correction1, correction2 = 1 - BETA1**self.count, math.sqrt(1 - BETA2**self.count)
        _update_torch(value, gradient, first, second, rate, correction1, correction2, good)

    def reset(self, rows: Tensor) -> None:
        """Forget the moments of some Gaussians."""
        for moments in (self.first, self.second):
            for tensor in moments.values():
                tensor[rows] = 0

    def grow(self, gaussians: Gaussians) -> None:
        """Append zero moments for Gaussians added at the end."""
        for moments in (self.first, self.second):
            for name, tensor in gaussians.tensors().items():
                new = torch.zeros_like(tensor[len(moments[name]) :])
                moments[name] = torch.cat([moments[name], new])


def _update_torch(
    value: Tensor, gradient: Tensor, first: Tensor, second: Tensor, rate: float | Tensor, correction1: float,
    correction2: float, good: Tensor | None = None,
) -> None:  # fmt: skip
    """The CPU kernel's update, on any device; a tensor of rates holds the rates of the first columns.

    Without `good`, or where it is True.
    """
    if isinstance(rate, Tensor):
        value, gradient, first, second = (t[:, : len(rate)] for t in (value, gradient, first, second))
        rate = rate.to(value.device)
    mean = first.lerp(gradient, 1 - BETA1)
    square = (BETA2 * second).addcmul_(gradient, gradient, value=1 - BETA2)
    moved = value - rate / correction1 * mean / (square.sqrt() / correction2 + EPS)
    for old, new in ((first, mean), (second, square), (value, moved)):
        old.copy_(new if good is None else torch.where(good, new, old))
