"""Equal entries of a store under different keys.

What an entry was made from gets another key where its code changes. If it comes out equal, what follows need not be
made again: it has another key too, and the mark of its code, its configuration and the contents that it is made from is
the same. A note under this mark says which entry has it.
"""

import os
import re
import shutil
from pathlib import Path

from novags.testbed.ledger.made import made_name
from novags.testbed.ledger.store import damaged, files_of, read_seal
from sensor_model.files.atomic import write_text
from sensor_model.files.door import admitted, read_text
from sensor_model.files.lock import locked

SAME = ".same"  # folder of these notes, of a kind of entries


def remember(folder: Path, same: str) -> None:
    """Note that an entry is the one of its kind with this mark; "" is no mark."""
    note = folder.parent / SAME / same
    if same and not (note.is_file() and read_text(note, most=1000) == folder.name):
        write_text(note, folder.name)


def taken_over(folder: Path, same: str) -> str:
    """Give an empty entry the files of another one with this mark; its stages then keep them.

    Returns:
        The name of the other one; "" if there is none, or this entry is not empty.
    """
    note = folder.parent / SAME / same
    if not same or not note.is_file() or any(path for path in folder.iterdir() if not path.name.startswith(".")):
        return ""
    name = read_text(note, most=1000)
    other = folder.parent / name
    inside = re.fullmatch(r"[A-Za-z0-9._+-]+", name) and not name.startswith(".")
    if not inside or not other.is_dir() or other == folder:
        return ""
    try:
        with locked(other, make=False):
            seal = read_seal(other)
            if seal is None or damaged(other, seal):
                return ""
            # With what explains them: the hidden files that say with which code the stages worked.
            explained = [name for name in map(made_name, seal.records) if (other / name).exists()]
            for file in (*files_of(other, seal.records), *explained):
                _give(other / file, folder / file)
    except (BlockingIOError, ValueError):  # somebody is at work there; or its seal is damaged
        return ""
    return name


def _give(file: Path, target: Path) -> None:
    """Files share the disk where that is possible."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(file, target)
    except OSError:  # another disk, or a file system without links
        shutil.copyfile(admitted(file), target)
