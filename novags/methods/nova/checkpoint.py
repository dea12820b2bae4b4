"""Networks in training on disk, as safetensors: weights, Adam moments and everything else the next step depends on.

Networks that learn beside a fit keep the fit's own checkpoint in the same file: the two then always belong together.
"""

from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.optim import Adam

from sensor_model.files.atomic import atomic
from sensor_model.files.reading import brief

_MOMENTS = ("step", "exp_avg", "exp_avg_sq")


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
    """Restore what `pack` saved.

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
            # torch keeps Adam's step count on the CPU whatever the device of the weights.
            adam.state[parameter] = {k: v if k == "step" else v.to(parameter) for k, v in moments.items()}
        if gradient is not None:
            parameter.grad = torch.zeros_like(parameter).copy_(
                gradient
            )  # in the layout that autograd continues adding to


def _alike(value: Tensor, like: Tensor) -> bool:
    return value.shape == like.shape and value.dtype == like.dtype and bool(torch.isfinite(value).all())


def read(path: Path) -> dict[str, Tensor]:
    """The tensors `write_tensors` saved.

    Raises:
        ValueError: If the file is not a safetensors file.
    """
    try:
        return load_file(path)
    except Exception as error:  # safetensors raises its own class, which it does not promise to keep
        raise ValueError(f"{path} is damaged ({brief(error)}): delete it, the run then starts over") from error


def file_as_tensor(path: Path) -> Tensor:
    """The bytes of a file, uint8."""
    return torch.frombuffer(bytearray(path.read_bytes()), dtype=torch.uint8)


def tensor_as_file(content: Tensor, path: Path) -> None:
    """Write the bytes that `file_as_tensor` read; the file appears whole or not at all."""
    with atomic(path) as temporary:
        temporary.write_bytes(content.numpy().tobytes())
