"""Where training runs."""

import torch

from novags.testbed.console.terminal import Console
from sensor_model.files.reading import brief

DEVICES = ("auto", "cpu", "cuda")


def chosen_device(name: str, console: Console) -> torch.device:
    """The device of that name; "auto" takes a GPU if torch can use one and gsplat is installed, and reports its choice.

    Raises:
        ValueError: If the name is unknown, or the device is not on this machine.
    """
    if name not in DEVICES:
        raise ValueError(f"device must be one of {', '.join(DEVICES)}, got {brief(repr(name), 100)}")
    if name == "auto":
        gpu = torch.cuda.is_available() and has_gsplat()
        if gpu:
            console.warn(f"device: {torch.cuda.get_device_name(0)} (cuda); choose another one with --device cpu")
        elif torch.cuda.is_available():
            console.warn("device: cpu; the GPU needs gsplat: pip install 'novags[cuda]'")
        return torch.device("cuda" if gpu else "cpu")
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("device cuda: torch finds no GPU that it can use on this machine; use --device cpu or auto")
    return torch.device(name)


def has_gsplat() -> bool:
    """Whether the rasteriser for GPUs is installed."""
    from importlib.util import find_spec

    return find_spec("gsplat") is not None
