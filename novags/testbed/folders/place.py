"""Where that lies from which a folder was made: as its record says, or where it was when it was asked for again.

The record stays as it is, because it is part of what later stages were made from.
"""

import os
from pathlib import Path

from novags.testbed.cache import read_json, write_json

MOVED = ".moved.json"  # hidden, so that it is part of no digest


def place_of(folder: Path, recorded: str) -> Path:
    """The folder from which `folder` was made; it need not be there.

    Args:
        folder: A capture or a run.
        recorded: What its record says, relative to it.

    Raises:
        ValueError: If the file that says where it was moved to is damaged.
    """
    if (folder / MOVED).is_file():
        moved = (folder / read_json(folder / MOVED, {"path": str})["path"]).resolve()
        if moved.exists():
            return moved
    return (folder / recorded).resolve()


def keep_place(folder: Path, recorded: str, found: Path) -> None:
    """Remember where that is from which `folder` was made, if its record says something else."""
    if (folder / recorded).resolve() == found.resolve():
        (folder / MOVED).unlink(missing_ok=True)
    else:
        write_json(folder / MOVED, {"path": os.path.relpath(found.resolve(), folder.resolve())})
