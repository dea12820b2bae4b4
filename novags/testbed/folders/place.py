"""Where the folder is that a capture or a run was made from, if that has been moved.

The record says where it was, as {"place": "../set"}, which is no part of its content; earlier records say it as a text,
which was. A hidden file beside it says where the folder was when the same result was last asked for.
"""

import os
from collections.abc import Mapping
from pathlib import Path

from novags.testbed.ledger.contents import read_json, write_json
from sensor_model.files.door import resolved

MOVED = ".moved.json"  # digests leave hidden files out
PLACE = ({"place": str}, str)  # the shape of what a record says
Recorded = Mapping[str, str] | str


def told(folder: Path, source: Path) -> dict[str, str]:
    """What the record of `folder` says of the folder that it is made from."""
    return {"place": os.path.relpath(resolved(source), resolved(folder))}


def said(recorded: Recorded) -> str:
    """What a record says, in words."""
    return recorded if isinstance(recorded, str) else recorded["place"]


def place_of(folder: Path, recorded: Recorded) -> Path:
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
    return resolved(folder / said(recorded))


def keep_place(folder: Path, recorded: Recorded, found: Path) -> None:
    """Remember that `folder` was made from what is now at `found`, if its record says something else."""
    if resolved(folder / said(recorded)) == resolved(found):
        (folder / MOVED).unlink(missing_ok=True)
    else:
        write_json(folder / MOVED, {"path": said(told(folder, found))})
