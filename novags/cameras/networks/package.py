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


def brief(error: Exception) -> str:
    """The first line of an error; torch adds a page of advice to load the file unsafely."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]
