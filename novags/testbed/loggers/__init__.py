"""Loggers of experiments: the losses of a fit, as they are written, go to a program that shows them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sensor_model.files.registry import Registry

Logger = Literal["tensorboard", "wandb", "rerun"]


@dataclass(frozen=True)
class Sink:
    """Where the losses of one run go."""

    add: Callable[[int, Mapping[str, float]], None]  # step, values by name
    close: Callable[[], None]


# Name -> (folder for its files, name of the run) -> sink. Raises ModuleNotFoundError without its package.
LOGGERS: Registry[Callable[[Path, str], Sink]] = Registry(
    {
        "tensorboard": "novags.testbed.loggers.with_tensorboard:sink",
        "wandb": "novags.testbed.loggers.with_wandb:sink",
        "rerun": "novags.testbed.loggers.with_rerun:sink",
    }
)
