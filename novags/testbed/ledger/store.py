"""The store: what stages made, one folder an entry, found again by what it was made from.

store/set/tabletop-20x160x160-1f3a…/   store/capture/…   store/run/…

The end of a name is the key: a hash of the stage's code and whole configuration and of all that it was made from. It
is known before anything is computed, and nothing else ever writes to that folder. When an entry is complete its seal is
written, a hidden file that lists every file with its checksum and says what it cost. Before an entry is used again, its
files are compared with the seal. Studies that run at the same time may share a store: locks on the folders protect it.
"""

import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from novags.testbed.ledger.code import Code
from novags.testbed.ledger.contents import checksum, digest, holds, read_json, write_json
from novags.testbed.ledger.source import hashed
from sensor_model.files.atomic import remove, write_text
from sensor_model.files.door import admitted, read_bytes, read_text

KINDS = ("set", "capture", "run")  # in the order in which they are made
RECORDS = ("set.json", "capture.json", "run.json", "metrics.json")  # of stages
SAME = ".same"  # of a kind: which entry has which mark, see `find_same`
SEAL = ".sealed.json"  # hidden, so that it is part of no digest
SHAPE: Any = {
    "key": str, "files": {"*": str}, "records?": {"*": str},
    "cost": {"seconds": {"*": float}, "peak_bytes": int, "bytes": int, "work": float, "pixels": float, "group": str,
             "threads": int},
}  # fmt: skip


def key_of(kind: str, recipe: dict[str, Any], code: Code) -> str:
    """The key of an entry.

    Args:
        kind: One of `KINDS`.
        recipe: Configuration and the keys or contents of what it is made from (JSON-able).
        code: What makes it.
    """
    return digest({"kind": kind, "code": code.key, **recipe})


def named(name: str, key: str) -> str:
    """The folder of an entry: a name for people, then the beginning of its key."""
    return f"{re.sub(r'[^A-Za-z0-9._+-]+', '-', name)[:80].strip('-')}-{key[:16]}"


@dataclass(frozen=True)
class Seal:
    """What an entry held when it was complete."""

    key: str
    files: dict[str, str]  # relative name -> checksum
    made_of: dict[str, Any]  # the contents of the entries it was made from, and what else its making depended on
    cost: dict[str, Any]
    records: dict[str, str] = field(default_factory=dict)  # of records the hash of all of it, costs included

    @property
    def content(self) -> str:
        """Hash of all files."""
        return digest(self.files)


def checksums(folder: Path) -> dict[str, str]:
    """Checksum of every file in a folder, by its relative name; hidden ones are left out."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    names = {path: path.relative_to(folder).as_posix() for path in files}
    return {name: checksum(path) for path, name in names.items() if not any(p[0] == "." for p in name.split("/"))}


def write_seal(folder: Path, key: str, made_of: dict[str, Any], cost: dict[str, Any]) -> Seal:
    """Seal a complete entry; `cost` as in `SHAPE`, but for the bytes."""
    files = checksums(folder)
    size = sum((folder / name).stat().st_size for name in files)
    records = {name: _whole(folder / name) for name in files if name.endswith(".json") and "/" not in name}
    seal = Seal(key, files, made_of, {**cost, "bytes": size}, records)
    write_json(folder / SEAL, {"key": key, "made_of": made_of, "cost": seal.cost, "files": files, "records": records})
    return seal


def _whole(path: Path) -> str:
    return hashed(read_bytes(path))


def read_seal(folder: Path, name: str = SEAL) -> Seal | None:
    """The seal of an entry; None if it is not complete.

    Raises:
        ValueError: If the seal itself is damaged.
    """
    path = folder / name
    if not path.exists():
        return None
    found = read_json(path, {**SHAPE, "made_of": dict})
    return Seal(found["key"], found["files"], found["made_of"], found["cost"], found.get("records", {}))


def damaged(folder: Path, seal: Seal) -> list[str]:
    """The files that are not as they were when the entry was sealed. Files that came later do not count."""
    wrong = [name for name, known in seal.files.items() if not holds(folder / name, known)]
    return [
        *wrong,
        *(name for name, known in seal.records.items() if name not in wrong and _whole(folder / name) != known),
    ]


def clear(folder: Path) -> None:
    """Remove all that an entry holds but its lock; the seal first, so that an interruption leaves nothing believed."""
    (folder / SEAL).unlink(missing_ok=True)
    for path in folder.iterdir():
        if path.is_dir() or not path.name.startswith("."):
            remove(path)


def costs(root: Path) -> Iterator[dict[str, Any]]:
    """What every entry of a store cost, with its kind; damaged seals are left out."""
    for kind in KINDS:
        for path in sorted(root.glob(f"{kind}/*/{SEAL}")):
            try:
                yield {"kind": kind, **read_json(path, SHAPE)["cost"]}
            except ValueError:
                continue  # said when the entry itself is asked for


def other_entries(root: Path, keys: set[str]) -> int:
    """How many entries of a store have none of these keys."""
    ends = {key[:16] for key in keys}
    return sum(path.parent.name.rpartition("-")[2] not in ends for path in root.glob(f"*/*/{SEAL}"))


def remember_same(folder: Path, same: str) -> None:
    """Note that an entry is the one of its kind with this mark, see `find_same`; "" is no mark."""
    note = folder.parent / SAME / same
    if same and not (note.is_file() and read_text(note, most=1000) == folder.name):
        write_text(note, folder.name)


def find_same(folder: Path, same: str) -> Path | None:
    """Another entry of the kind of `folder` that was made by the same code from equal contents; None if none is known.

    Args:
        folder: Of an entry; it need not be there.
        same: Mark of code, configuration and contents.
    """
    note = folder.parent / SAME / same
    if not same or not note.is_file():
        return None
    name = read_text(note, most=1000)
    other = folder.parent / name
    inside = re.fullmatch(r"[A-Za-z0-9._+-]+", name) and not name.startswith(".")
    return other if inside and other.is_dir() and name != folder.name else None


def copy_files(source: Path, target: Path) -> None:
    """Give an empty entry the files of another one; they share the disk where that is possible."""
    for path in sorted(source.rglob("*")):
        name = path.relative_to(source)
        # Of hidden files those that say with which code the stages worked; not seals, locks, places of other folders.
        if not path.is_file() or (name.parts[0].startswith(".") and name.parts[0][1:] not in RECORDS):
            continue
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(path, target / name)
        except OSError:  # another disk, or a file system without links
            shutil.copyfile(admitted(path), target / name)
