"""Training state on disk, as safetensors: a run that is stopped and resumed gives the same bits as one that was not."""

import json
import os
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file

from .adam import Adam
from .gaussians import Gaussians


def save_checkpoint(path: Path, gaussians: Gaussians, adam: Adam, iteration: int, settings: dict[str, object]) -> None:
    """Write everything the next iteration depends on, atomically.

    Args:
        path: File to write.
        gaussians: Current Gaussians.
        adam: Their optimiser.
        iteration: Iterations done.
        settings: What the run was started with, JSON-able; compared on resume.
    """
    tensors = {f"gaussians.{name}": t.detach() for name, t in gaussians.tensors().items()}
    tensors |= {f"first.{name}": t for name, t in adam.first.items()}
    tensors |= {f"second.{name}": t for name, t in adam.second.items()}
    metadata = {"iteration": str(iteration), "adam": str(adam.count), "settings": json.dumps(settings, sort_keys=True)}
    temporary = path.with_name(path.name + f".tmp{os.getpid()}")
    save_file({name: t.contiguous() for name, t in tensors.items()}, temporary, metadata=metadata)
    temporary.replace(path)


def load_checkpoint(path: Path, settings: dict[str, object], device: torch.device) -> tuple[Gaussians, Adam, int]:
    """Read what `save_checkpoint` wrote.

    Raises:
        ValueError: If the checkpoint belongs to a run with other settings.
    """
    with safe_open(path, framework="pt", device=str(device)) as file:
        metadata = file.metadata()
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    saved = json.loads(metadata["settings"])
    now = json.loads(json.dumps(settings))
    different = sorted(key for key in saved.keys() | now.keys() if saved.get(key) != now.get(key))
    if different:
        changes = ", ".join(f"{key}: {saved.get(key)!r} there, {now.get(key)!r} now" for key in different)
        raise ValueError(
            f"checkpoint {path} belongs to a run with other settings ({changes}); delete it or restore them"
        )

    def part(prefix: str) -> dict[str, torch.Tensor]:
        return {name.removeprefix(prefix): t for name, t in tensors.items() if name.startswith(prefix)}

    gaussians = Gaussians(**part("gaussians."))
    adam = Adam(gaussians)
    adam.count, adam.first, adam.second = int(metadata["adam"]), part("first."), part("second.")
    return gaussians, adam, int(metadata["iteration"])
