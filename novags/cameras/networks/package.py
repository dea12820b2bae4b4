"""Packages and weights of others: what to do where one is missing, and files of weights read without running code."""

import argparse
import importlib
import importlib.util
from pathlib import Path
from typing import Any

import torch

from novags.splats.files.tensors import check_lengths
from sensor_model.files.door import admitted


def require(source: str, package: str, install: str, checkpoint: Path, weights: str) -> None:
    """Raise a ValueError that says what to do if the package or its weights are missing.

    Args:
        source: The camera source.
        package: Its top-level module.
        install: What to do without it, its licence included.
        checkpoint: The weights.
        weights: Which they are and where they come from.
    """
    if importlib.util.find_spec(package) is None:
        raise ValueError(
            f"cameras {source} need the package {package}, which is not installed: {install}, and give its weights as "
            f"{source}:checkpoint=FILE"
        )
    require_weights(source, checkpoint, weights)


def require_weights(source: str, checkpoint: Path, weights: str) -> None:
    """Raise a ValueError that says what to do if the weights are missing."""
    if not checkpoint.is_file():
        raise ValueError(
            f"no {source.upper()} weights at {checkpoint}: download {weights} and give {source}:checkpoint=FILE"
        )


def part(source: str, module: str) -> Any:
    """A module of a package that `require` found.

    Raises:
        ValueError: If it cannot be imported, as when one of its own requirements is missing.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ValueError(
            f"cameras {source}: {module} cannot be imported ({error}): install the packages it asks for"
        ) from error


def read_checkpoint(checkpoint: Path) -> Any:
    """The content of a file of weights: of .safetensors tensors by name, else the object that `torch.save` wrote.

    Of the latter only tensors, plain containers and `argparse.Namespace` are read: a pickle of anything else could run
    code, and no package's own loader, which would run it, is called.

    Raises:
        ValueError: If the file is damaged or holds something else.
    """
    try:
        if checkpoint.suffix == ".safetensors":
            from safetensors.torch import load_file

            return load_file(admitted(checkpoint))
        check_lengths(checkpoint)
        with torch.serialization.safe_globals([argparse.Namespace]):
            return torch.load(admitted(checkpoint), map_location="cpu", weights_only=True)
    except Exception as error:  # each format has errors of its own
        raise ValueError(
            f"{checkpoint} cannot be read as weights without running code that it may hold: {brief(error)}; "
            "download it again, or take the .safetensors file of the same weights"
        ) from error


def with_weights(
    model: Any, checkpoint: Path, name: str, device: str | torch.device, *, strict: bool = True, hint: str = ""
) -> Any:
    """A network with the weights of a file, for inference.

    Args:
        model: A module of the package.
        checkpoint: Tensors by name.
        name: Of the network, for messages.
        device: Where it will run.
        strict: False: tensors of other names in the file are left out. None of the network's own may be missing.
        hint: What else may be wrong, for messages.

    Raises:
        ValueError: If the file cannot be read safely, or names or shapes are not the network's.
    """
    held = read_checkpoint(checkpoint)
    try:
        missing = model.load_state_dict(held, strict=strict).missing_keys
        if missing:
            raise ValueError(f"{len(missing)} of its tensors are missing, {missing[0]} for one")
    except Exception as error:  # other names, other shapes, or no tensors at all
        raise ValueError(f"{checkpoint} does not hold the weights of {name}: {brief(error)}{hint}") from error
    return model.eval().to(device)


def brief(error: Exception) -> str:
    """The first line of an error; torch adds a page of advice to load the file unsafely."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
