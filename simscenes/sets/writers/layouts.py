"""Further layouts of a set or a capture: `EXPORTS` names them, `export` writes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sensor_model.files.registry import Registry
from simscenes.rigs import Rig


@dataclass(frozen=True)
class Layout:
    """A further layout of a set or a capture.

    Attributes:
        write: (views, folder, *, truth=None) -> the folder.
        check: Raises ValueError for cameras that it cannot hold; before anything takes time.
        needs_depth: It states near and far of every view.
    """

    write: Callable[..., Path]
    check: Callable[[Rig], None]
    needs_depth: bool = False


EXPORTS: Registry[Layout] = Registry({
    "blender": "simscenes.sets.writers.export:BLENDER",
    "llff": "simscenes.sets.writers.export:LLFF",
})  # fmt: skip
