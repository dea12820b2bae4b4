"""Parts that a method trains beside the Gaussians by the same loss (tone curves, networks), and networks on disk."""

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim import Adam

PREFIX = "companion"
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


@dataclass(kw_only=True)
class Companion:
    """A network that learns beside a fit; `fit` steps its optimiser, watches its gradients and keeps it in checkpoints.

    Attributes:
        network: On the device of the Gaussians; changed in place.
        optimizer: Of all its parameters; its groups may have rates of their own.
        cool_to: Rates at the end of the run, as a share of themselves; they fall log-linearly.
    """

    network: nn.Module
    optimizer: Adam
    cool_to: float = 1.0
    rates: list[float] = field(init=False)

    def __post_init__(self) -> None:
        if not 0 < self.cool_to <= 1:
            raise ValueError(f"cool_to must lie in (0, 1], got {self.cool_to}")
        groups: list[dict[str, Any]] = self.optimizer.param_groups
        theirs = {id(parameter) for group in groups for parameter in group["params"]}
        if theirs != {id(parameter) for parameter in self.network.parameters()}:
            raise ValueError("the optimizer of a companion must have all parameters of its network, and no others")
        self.rates = [float(group["lr"]) for group in groups]

    def clear(self) -> None:
        """Forget the gradients."""
        self.optimizer.zero_grad(set_to_none=True)

    def step(self, iteration: int, iterations: int, bad: Tensor | None = None) -> None:
        """One step from the gradients, with the rates of an `iteration` of a run of `iterations`.

        `bad`: on a GPU: 1.0 if nothing is to change, else 0.0.
        """
        share = self.cool_to ** (iteration / max(1, iterations))
        for group, rate in zip(self.optimizer.param_groups, self.rates, strict=True):
            group["lr"] = share * rate
        masked_step(self.optimizer, bad)
        self.clear()

    def named_parameters(self) -> dict[str, Tensor]:
        """Parameters by name, for messages."""
        return {f"companion {name}": parameter for name, parameter in self.network.named_parameters()}

    def state(self) -> dict[str, Tensor]:
        """The state that the next iteration depends on."""
        self.clear()
        return pack(PREFIX, self.network, self.optimizer)

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue from `state`.

        Raises:
            ValueError: If it is of a network of another shape, or damaged.
        """
        unpack(PREFIX, tensors, self.network, self.optimizer)


def masked_step(optimizer: Adam, bad: Tensor | None = None) -> None:
    """A step; on a GPU nothing at all where `bad` is 1.0, by torch's own way for gradients that overflow."""
    if bad is not None:
        optimizer.found_inf = bad  # type: ignore[attr-defined]
        for group in optimizer.param_groups:
            group["fused"] = True  # the only one that looks at it
    optimizer.step()


def pack(prefix: str, network: nn.Module, adam: Adam) -> dict[str, Tensor]:
    """Weights, Adam moments and gradients pending for the next step, each name starting with `prefix`."""
    tensors = {f"{prefix}.weights.{name}": value for name, value in network.state_dict().items()}
    for name, parameter in network.named_parameters():
        for key, value in adam.state.get(parameter, {}).items():
            tensors[f"{prefix}.{key}.{name}"] = value
        if parameter.grad is not None:
            tensors[f"{prefix}.grad.{name}"] = parameter.grad
    return tensors


def unpack(prefix: str, tensors: dict[str, Tensor], network: nn.Module, adam: Adam) -> None:
    """Restore the state that `pack` saved.

    Raises:
        ValueError: If the tensors belong to a network of another shape, or are damaged.
    """
    start = f"{prefix}.weights."
    weights = {name.removeprefix(start): value for name, value in tensors.items() if name.startswith(start)}
    own = network.state_dict()
    if weights.keys() != own.keys() or any(not _alike(weights[name], own[name]) for name in own):
        raise ValueError(
            f"the checkpoint's {prefix} has another shape than the configured one: delete it or restore it"
        )
    network.load_state_dict(weights)
    for name, parameter in network.named_parameters():
        like = {"step": torch.zeros(()), "exp_avg": parameter, "exp_avg_sq": parameter}
        moments = {key: tensors[f"{prefix}.{key}.{name}"] for key in _MOMENTS if f"{prefix}.{key}.{name}" in tensors}
        gradient = tensors.get(f"{prefix}.grad.{name}")
        whole = not moments or (len(moments) == len(like) and all(_alike(v, like[key]) for key, v in moments.items()))
        # not finite where a training has stopped for that, and is to stop there again
        if not whole or not (gradient is None or _alike(torch.nan_to_num(gradient), parameter)):
            raise ValueError(f"the checkpoint's {prefix} is damaged in {name}: delete it, the run then starts over")
        if moments:
            # the step count too: `masked_step` has it where the weights are
            adam.state[parameter] = {key: value.to(parameter) for key, value in moments.items()}
        if gradient is not None:
            # A copy in the layout of the parameter, to which autograd goes on adding.
            parameter.grad = torch.zeros_like(parameter).copy_(gradient)


def _alike(value: Tensor, like: Tensor) -> bool:
    return value.shape == like.shape and value.dtype == like.dtype and bool(torch.isfinite(value).all())
