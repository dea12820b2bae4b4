"""Whose the checkpoints of a run of several fits are: checkpoints of single fits say nothing of targets and losses."""

import dataclasses
import hashlib
import json
from pathlib import Path
from typing import Any

from novags.methods.nova_plus.data import LightMeasurements
from novags.methods.problem import Problem
from novags.splats.files.tensors import digest
from sensor_model.files.atomic import write_text
from sensor_model.files.door import read_bytes

OWNER = "run"  # file that holds the identity of the run


def run_identity(problem: Problem, config: Any, data: LightMeasurements) -> str:
    """Hash of everything that a run depends on.

    Args:
        problem: The problem.
        config: The resolved configuration, a dataclass with `pictures`.
        data: The measurements.
    """
    views, start, dark = problem.views, problem.start, problem.encoded(config.pictures)
    content = digest(views.viewmats, views.Ks, dark, data.light, data.held, start.points, start.colors)
    settings = [dataclasses.asdict(config), problem.seed, dataclasses.asdict(data.noise.curve)]
    return hashlib.blake2b((content + json.dumps(settings, default=str)).encode(), digest_size=16).hexdigest()


def claim(folder: Path, identity: str) -> None:
    """Begin a run with its checkpoints in a folder, or go on with one.

    Raises:
        ValueError: If the folder holds another run's checkpoints.
    """
    owner = folder / OWNER
    theirs = any(folder.glob("*.safetensors")) and not (owner.is_file() and read_bytes(owner) == identity.encode())
    if theirs:
        raise ValueError(f"{folder} belongs to a run of other pictures or settings: delete it or restore them")
    write_text(owner, identity)
