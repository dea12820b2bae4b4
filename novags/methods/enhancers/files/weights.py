"""Weights of networks on disk: official files, never unpickled freely, and weights of this project's own trainings."""

import argparse
import hashlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from novags.methods.enhancers.files.keras_file import read_keras
from novags.splats.files.tensors import check_lengths
from sensor_model.files.door import admitted, read_bytes
from sensor_model.files.reading import brief, reading

REMEDY = "fetch or make it anew"
LARGEST = 200_000_000  # bytes of a file; the largest network here has 20 MB
KERAS = (".h5", ".hdf5")
WRAPPERS = ("state_dict", "params")  # keys under which official files keep their weights


def read_weights(paths: Sequence[Path]) -> dict[str, Tensor]:
    """The tensors of one or more files by name; tensors of parts of a network as "part.name".

    Args:
        paths: .safetensors, .h5 of Keras, or a file of `torch.save`: of the latter only tensors, plain containers and
            `argparse.Namespace` are read, and no code is run.

    Raises:
        ValueError: If a file is missing, too large or damaged, holds no tensors, or one that is not finite.
    """
    found: dict[str, Tensor] = {}
    for path in paths:
        if not path.is_file():
            raise ValueError(f"there are no weights at {path}: name the file that holds them")
        with reading(path, REMEDY):
            tensors = _read(path)
            if not tensors:
                raise ValueError("it holds no tensors")
            for name, value in tensors.items():
                if value.is_floating_point() and not bool(torch.isfinite(value).all()):
                    raise ValueError(f"{brief(name, 100)} is not finite")
        found |= tensors
    return found


def _read(path: Path) -> dict[str, Tensor]:
    if path.suffix == ".safetensors":
        return load_file(admitted(path, most=LARGEST))
    if path.suffix in KERAS:
        return read_keras(read_bytes(path, most=LARGEST))
    check_lengths(path)
    with torch.serialization.safe_globals([argparse.Namespace]):
        # From memory: of a file, a damaged length would be reserved before it is found to be too long.
        value: Any = torch.load(io.BytesIO(read_bytes(path, most=LARGEST)), map_location="cpu", weights_only=True)
    if not isinstance(value, Mapping):
        raise ValueError(f"it holds a {type(value).__name__}, not tensors by name")
    inner = [value[name] for name in WRAPPERS if isinstance(value.get(name), Mapping)]
    return _flat(inner[0] if inner else value)


def _flat(value: Mapping[Any, Any], prefix: str = "", depth: int = 0) -> dict[str, Tensor]:
    """The tensors in nested mappings; other values are ignored."""
    if depth > 3:
        raise ValueError("it is nested too deeply")
    found: dict[str, Tensor] = {}
    for name, part in value.items():
        if isinstance(part, Tensor):
            found[f"{prefix}{name}".removeprefix("module.")] = part.detach()  # of torch's DataParallel
        elif isinstance(part, Mapping):
            found |= _flat(part, f"{prefix}{name}.", depth + 1)
    return found


def digest_of(paths: Sequence[Path]) -> str:
    """Sixteen hexadecimal digits that differ for files of other content."""
    sums = hashlib.sha256()
    for path in paths:
        sums.update(hashlib.sha256(read_bytes(path, most=LARGEST)).digest())
    return sums.hexdigest()[:16]


def fill(network: nn.Module, tensors: Mapping[str, Tensor], paths: Sequence[Path]) -> None:
    """Give a network its weights; further tensors are ignored.

    Raises:
        ValueError: If one is missing or has another shape.
    """
    files = ", ".join(map(str, paths))
    for name, own in network.state_dict().items():
        given = tensors.get(name)
        if given is None or given.shape != own.shape:
            has = "none of that name" if given is None else f"one of {list(given.shape)}"
            raise ValueError(
                f"{files}: the network needs a tensor {name} of {list(own.shape)}, and there is {has}: these are the "
                "weights of another network"
            )
    network.load_state_dict({name: tensors[name].to(own.dtype) for name, own in network.state_dict().items()})
