"""Trained weights on disk: a safetensors file of half-precision numbers that says how it was made."""

import dataclasses
import json
from functools import cache
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file

from novags.methods.denoised.network import Network, NetworkConfig
from sensor_model.files.atomic import atomic
from sensor_model.files.door import admitted
from sensor_model.files.reading import brief
from sensor_model.files.records import parse_json

PACKAGED = Path(__file__).with_name("weights.safetensors")


def save_weights(path: Path, network: Network, made: dict[str, Any]) -> None:
    """Write weights and how they were made ("command", "seed", ...), which `made_by` reads."""
    tensors = {name: value.detach().to(torch.float16).contiguous() for name, value in network.state_dict().items()}
    facts = {"config": dataclasses.asdict(network.config), "made": made}
    with atomic(path) as temporary:
        save_file(tensors, temporary, {name: json.dumps(value) for name, value in facts.items()})


def load_weights(path: Path = PACKAGED) -> Network:
    """A network with these weights, in float32, ready to predict.

    Raises:
        ValueError: If the file is missing, damaged, or holds weights of another network.
    """
    config, tensors = _read(path)
    network = Network(config)
    own = network.state_dict()
    if tensors.keys() != own.keys() or any(tensors[name].shape != own[name].shape for name in own):
        raise ValueError(
            f"{path} holds weights of another network than its config {config} says: make or fetch it anew"
        )
    if not all(bool(torch.isfinite(value).all()) for value in tensors.values()):
        raise ValueError(f"{path} holds weights that are not finite: make or fetch it anew")
    network.load_state_dict({name: value.float() for name, value in tensors.items()})
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch's stubs lack this one
    return network.eval()


def made_by(path: Path = PACKAGED) -> dict[str, Any]:
    """How the weights came about: command, seed, steps, seconds."""
    return _facts(path)["made"]


@cache
def _read(path: Path) -> tuple[NetworkConfig, dict[str, torch.Tensor]]:
    facts = _facts(path)
    try:
        config = NetworkConfig(**{name: tuple(value) for name, value in facts["config"].items()})
        with safe_open(admitted(path), "pt") as file:
            return config, {name: file.get_tensor(name) for name in file.keys()}  # not a dict
    except (TypeError, AttributeError) as error:
        raise ValueError(f"{path} names no network of this version ({brief(error)}): make or fetch it anew") from error


def _facts(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise ValueError(f"there are no weights at {path}: install the package anew, as a whole")
    try:
        with safe_open(admitted(path), "pt") as file:
            stated = file.metadata() or {}
        return {name: parse_json(stated[name], f"its {name}") for name in ("config", "made")}
    except Exception as error:  # safetensors raises its own class, which it does not promise to keep
        raise ValueError(f"{path} is damaged ({brief(error)}): make or fetch it anew") from error
