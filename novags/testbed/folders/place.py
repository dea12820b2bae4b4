"""Where the folder is that a capture or a run was made from, if that has been moved.

The record says where it was. It stays as it is, because it is part of what later stages were made from; a hidden file
beside it says where the folder was when the same result was last asked for.
"""

import os
from pathlib import Path

from novags.testbed.ledger.contents import read_json, write_json
from sensor_model.files.door import resolved

MOVED = ".moved.json"  # digests leave hidden files out


def place_of(folder: Path, recorded: str) -> Path:
    """The folder from which `folder` was made; it need not be there.

    Args:
        folder: A capture or a run.
        recorded: What its record says, relative to it.

    Raises:
        ValueError: If the file that says where it was moved to is damaged.
    """
    if (folder / MOVED).is_file():
        moved = resolved(folder / read_json(folder / MOVED, {"path": str})["path"])
        if moved.exists():
            return moved
    return resolved(folder / recorded)


def keep_place(folder: Path, recorded: str, found: Path) -> None:
    """Remember that `folder` was made from what is now at `found`, if its record says something else."""
    if resolved(folder / recorded) == resolved(found):
        (folder / MOVED).unlink(missing_ok=True)
    else:
        write_json(folder / MOVED, {"path": os.path.relpath(resolved(found), resolved(folder))})
