"""Equal results of a store under different entries.

An entry has another key where the code of its inputs changes. If that came out equal, the stage asks for the same as
before: its own key holds contents, and a note under it says which entry has the result.
"""

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from novags.testbed.ledger.contents import not_as_written, read_json
from novags.testbed.ledger.made import made_name
from sensor_model.files.atomic import write_text
from sensor_model.files.door import admitted, read_text
from sensor_model.files.lock import locked

SAME = ".same"  # folder of these notes, in the store
RECORD = {"stage": {"key": str, "files": {"*": str}}}

_store: ContextVar[tuple[Path, list[str]] | None] = ContextVar("store", default=None)


@contextmanager
def sharing(store: Path) -> Iterator[list[str]]:
    """While the block runs, stages take over equal results of other entries of a store.

    Yields:
        A list, to which the names of these entries are added.
    """
    token = _store.set((store, found := list[str]()))
    try:
        yield found
    finally:
        _store.reset(token)


def remember(entry: Path, records: Iterable[str]) -> None:
    """Note that an entry has the results of its stages, whose records are these."""
    place = f"{entry.parent.name}/{entry.name}"
    for record in records:
        note = entry.parent.parent / SAME / read_json(entry / record, RECORD)["stage"]["key"]
        if not (note.is_file() and read_text(note, most=1000) == place):
            write_text(note, place)


def taken_over(folder: Path, record: str, key: str) -> str:
    """Give a folder without a result the result of the same key in another entry.

    Returns:
        The name of that entry; "" if there is none, or its files have changed since they were written.
    """
    shared = _store.get()
    if shared is None or not (note := shared[0] / SAME / key).is_file():
        return ""
    kind, _, name = read_text(note, most=1000).partition("/")
    other = shared[0] / kind / name
    if kind != folder.parent.name or "/" in name or name.startswith(".") or not other.is_dir() or name == folder.name:
        return ""
    try:
        with locked(other, make=False):
            stage = read_json(other / record, RECORD)["stage"]
            if stage["key"] != key or not_as_written(other, stage["files"]):
                return ""
            for file in (*stage["files"], made_name(record)):  # the record, which says that all is there, goes last
                if file != record and (other / file).exists():
                    _give(other / file, folder / file)
            _give(other / record, folder / record)
    except (BlockingIOError, ValueError):  # somebody is at work there; or its record is damaged
        return ""
    shared[1].append(name)
    return name


def _give(file: Path, target: Path) -> None:
    """Files share the disk where that is possible."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(file, target)
    except OSError:  # another disk, or a file system without links
        shutil.copyfile(admitted(file), target)
