"""Adam over the tensors of a set of Gaussians, with a learning rate per tensor (and one for the SH rest)."""

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ...cpu.parallel import run
from ...cpu.training import optimizer
from ...gaussians import Gaussians
from ...sh import n_coefficients

BETA1, BETA2 = 0.9, 0.999
EPS = 1e-15  # 3DGS: gradients are tiny, torch's 1e-8 would damp them; without any, 0 / 0 for a Gaussian never seen
COOLED = ("quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest", "features")  # by `cool_to`


@dataclass(frozen=True, kw_only=True)
class LearningRates:
    """Learning rates of 3DGS (per iteration).

    Attributes:
        means: At the start, in units of the scene extent.
        means_final: At the end of the schedule, same units; log-linear in between, so > 0 unless `means` is 0.
        schedule: "original": `means_final` is reached after 30,000 iterations, however long the run (3DGS, 3DGS-MCMC);
            "gsplat": at the end of the run.
        quats: Rotation.
        log_scales: Log scale.
        logit_opacities: Logit opacity.
        sh_dc: Constant colour.
        sh_rest: Higher spherical harmonics.
        features: `Gaussians.features`.
        cool_from: Share of the run after which all rates but that of the means fall, log-linearly.
        cool_to: What they fall to at its end, as a share of themselves; 1: they do not.
    """

    means: float = 1.6e-4
    means_final: float = 1.6e-6
    schedule: str = "gsplat"
    quats: float = 1e-3
    log_scales: float = 5e-3
    logit_opacities: float = 5e-2
    sh_dc: float = 2.5e-3
    sh_rest: float = 1.25e-4
    features: float = 2.5e-3
    cool_from: float = 0.6
    cool_to: float = 1.0

    def __post_init__(self) -> None:
        if self.schedule not in ("original", "gsplat"):
            raise ValueError(f"schedule must be 'original' or 'gsplat', got {self.schedule!r}")
        for name in ("means", "means_final", *COOLED):
            if not getattr(self, name) >= 0:
                raise ValueError(f"learning rate {name} must be >= 0, got {getattr(self, name)}")
        if self.means > 0 and self.means_final == 0:
            raise ValueError(
                f"means_final must be > 0 where means is (the rate falls log-linearly), got 0 and means {self.means}: "
                "take a small share of means, or means itself for a rate that does not fall"
            )
        if not (0 <= self.cool_from < 1 and 0 < self.cool_to <= 1):
            raise ValueError(
                f"cool_from must lie in [0, 1) and cool_to in (0, 1], got {self.cool_from} and {self.cool_to}"
            )

    def at(self, iteration: int, iterations: int) -> "LearningRates":
        """These rates at an `iteration` of a run of `iterations`: cooled, but for those of the means."""
        begin = self.cool_from * iterations
        if self.cool_to == 1 or iteration <= begin:
            return self
        factor = self.cool_to ** ((iteration - begin) / (iterations - begin))
        return replace(self, **{name: factor * getattr(self, name) for name in COOLED})

    def means_at(self, iteration: int, iterations: int, extent: float) -> float:
        """Learning rate of the means, world units, at `iteration` of a run of `iterations`."""
        if self.means == 0:
            return 0.0
        progress = min(1.0, iteration / (30_000 if self.schedule == "original" else max(1, iterations)))
        return extent * self.means * (self.means_final / self.means) ** progress


class Adam:
    """Adam moments of a set of Gaussians. Rows follow the Gaussians: `grow` and `reset` keep them in step."""

    def __init__(self, gaussians: Gaussians) -> None:
        self.count = 0
        # Contiguous whatever the tensors are: like them the moments are updated in place.
        zeros = partial(torch.zeros_like, memory_format=torch.contiguous_format)
        self.first = {name: zeros(tensor) for name, tensor in gaussians.tensors().items()}
        self.second = {name: zeros(tensor) for name, tensor in gaussians.tensors().items()}

    @torch.no_grad()
    def step(self, gaussians: Gaussians, rates: LearningRates, means_rate: float, sh_degree: int = 3) -> None:
        """Update the Gaussians in place from their `.grad`; tensors without one are left alone.

        Args:
            gaussians: Leaves with gradients.
            rates: Learning rates of all but the means.
            means_rate: Learning rate of the means, world units.
            sh_degree: Spherical harmonics above it are left alone: with no gradient so far they would not move.

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
                columns[:3] = rates.sh_dc
                flat = (tensor.data.flatten(1), tensor.grad.flatten(1), moments[0].flatten(1), moments[1].flatten(1))
                self._update(*flat, columns)
            else:
                rate = means_rate if name == "means" else float(getattr(rates, name))
                self._update(tensor.data, tensor.grad, *moments, rate)

    @staticmethod
    def numbers(count: int) -> tuple[np.float32, ...]:
        """Scalar arguments of the kernels for step number `count`, from 1."""
        corrections = 1 - BETA1**count, math.sqrt(1 - BETA2**count)
        return tuple(np.float32(x) for x in (BETA1, BETA2, *corrections, EPS))

    def _update(self, value: Tensor, gradient: Tensor, first: Tensor, second: Tensor, rate: float | Tensor) -> None:
        if value.device.type == "cpu":
            arrays = [t.contiguous().numpy() for t in (value, gradient, first, second)]
            numbers = self.numbers(self.count)
            if isinstance(rate, Tensor):
                run(optimizer.adam_columns, len(value), 1024, *arrays, rate.numpy(), *numbers)
            else:
                run(optimizer.adam, value.numel(), 4096, *(a.reshape(-1) for a in arrays), np.float32(rate), *numbers)
            return
        correction1, correction2 = 1 - BETA1**self.count, math.sqrt(1 - BETA2**self.count)
        _update_torch(value, gradient, first, second, rate, correction1, correction2)

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
    correction2: float,
) -> None:  # fmt: skip
    """What the CPU's kernel does, on any device; a tensor of rates holds those of the first columns."""
    if isinstance(rate, Tensor):
        value, gradient, first, second = (t[:, : len(rate)] for t in (value, gradient, first, second))
        rate = rate.to(value.device)
    first.lerp_(gradient, 1 - BETA1)
    second.mul_(BETA2).addcmul_(gradient, gradient, value=1 - BETA2)
    value.sub_(rate / correction1 * first / (second.sqrt() / correction2 + EPS))
