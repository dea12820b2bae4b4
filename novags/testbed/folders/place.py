"""Where the folder is that a capture or a run was made from, if that has been moved.

The record says where it was: {"place": "../set"}. The place does not belong to the content of the record. In records of
0.1.0 the place is a plain text, and does. A hidden file beside the record says where the folder was when the same
result was last asked for.
"""

import os
from collections.abc import Mapping
from pathlib import Path

from novags.testbed.ledger.contents import read_json, write_json
from sensor_model.files.door import resolved

MOVED = ".moved.json"  # digests leave hidden files out
PLACE = ({"place": str}, str)  # the shape of a place in a record
Recorded = Mapping[str, str] | str


def recorded_place(folder: Path, source: Path) -> dict[str, str]:
    """The entry of the record of `folder` about `source`, the folder that it is made from."""
    return {"place": os.path.relpath(resolved(source), resolved(folder))}


def place_text(recorded: Recorded) -> str:
    """The path in a record, relative to the folder of the record."""
    return recorded if isinstance(recorded, str) else recorded["place"]


def place_of(folder: Path, recorded: Recorded) -> Path:
    """The folder from which `folder` was made; it need not be there.

    Args:
        folder: A capture or a run.
        recorded: The path in its record, relative to it.

    Raises:
        ValueError: If the file that says where it was moved to is damaged.
    """
    if (folder / MOVED).is_file():
        moved = resolved(folder / read_json(folder / MOVED, {"path": str})["path"])
        if moved.exists():
            return moved
    return resolved(folder / place_text(recorded))


def keep_place(folder: Path, recorded: Recorded, found: Path) -> None:
    """Remember that the input of `folder` is now at `found`, if its record says something else."""
    if resolved(folder / place_text(recorded)) == resolved(found):
        (folder / MOVED).unlink(missing_ok=True)
    else:
        write_json(folder / MOVED, {"path": recorded_place(folder, found)["place"]})
