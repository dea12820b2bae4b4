"""The store: results of stages, one folder an entry, found again by its inputs.

store/set/tabletop-20x160x160-1f3a…/   store/capture/…   store/run/…   store/measurement/…

The end of a name is the key: a hash of the stage's code and whole configuration and of all its inputs. It is known
before anything is computed, and nothing else ever writes to that folder. When an entry is complete its seal is written,
a hidden file that names its inputs and its cost, and holds the hashes of its stages' records; these hold the checksum
of every file. Before an entry is used again, all are compared. Studies that run at the same time may share a
store: locks on the folders protect it.
"""

import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from novags.testbed.ledger.code import Code
from novags.testbed.ledger.contents import digest, not_as_written, read_json, write_json
from novags.testbed.ledger.source import hashed
from sensor_model.files.atomic import remove
from sensor_model.files.door import read_bytes
from sensor_model.files.reading import brief

KINDS = ("set", "capture", "run", "measurement")  # in the order in which they are made
SEAL = ".sealed.json"  # hidden, so that it is part of no digest
SHAPE: Any = {
    "key": str, "content": str, "made_of": dict, "records": {"*": str},
    "cost": {"seconds": {"*": float}, "peak_bytes": int, "bytes": int, "work": float, "pixels": float, "memory?": float,
             "disk?": float, "group": str, "threads": int},
}  # fmt: skip
RECORD = {"stage": {"files": {"*": str}}}  # the entries that a seal needs of the record of a stage


def key_of(kind: str, recipe: dict[str, Any], code: Code) -> str:
    """The key of an entry.

    Args:
        kind: One of `KINDS`.
        recipe: Configuration and the keys or contents of its inputs (JSON-able).
        code: The code that makes it.
    """
    return digest({"kind": kind, "code": code.key, **recipe})


def named(name: str, key: str) -> str:
    """The folder of an entry: a name for people, then the beginning of its key."""
    return f"{re.sub(r'[^A-Za-z0-9._+-]+', '-', name)[:80].strip('-')}-{key[:16]}"


@dataclass(frozen=True)
class Seal:
    """The state of an entry when it was complete."""

    key: str
    content: str  # hash of all its files
    made_of: dict[str, Any]  # contents of the entries it was made from, and other dependencies
    cost: dict[str, Any]
    records: dict[str, str]  # of the record that each stage wrote last, a hash of all of it, costs included


def write_seal(folder: Path, key: str, made_of: dict[str, Any], cost: dict[str, Any], records: Iterable[str]) -> Seal:
    """Seal a complete entry; `cost` as in `SHAPE`, but for the bytes; `records`: the last files of its stages."""
    files = files_of(folder, records)
    size = sum((folder / name).stat().st_size for name in files)
    found = {name: _whole(folder / name) for name in records}
    seal = Seal(key, digest(files), made_of, {**cost, "bytes": size}, found)
    with suppress(ValueError):  # a damaged one is written again
        if read_seal(folder) == seal:
            return seal
    write_json(folder / SEAL, asdict(seal))
    return seal


def read_seal(folder: Path, name: str = SEAL) -> Seal | None:
    """The seal of an entry; None if it is not complete.

    Raises:
        ValueError: If the seal itself is damaged.
    """
    if not (folder / name).exists():
        return None
    found = read_json(folder / name, SHAPE)
    return Seal(**{part: found[part] for part in SHAPE})


def files_of(folder: Path, records: Iterable[str]) -> dict[str, str]:
    """Checksum of every file of an entry, its records included, by relative name, as these records say.

    Raises:
        ValueError: If a record is missing, damaged, or names a file elsewhere.
    """
    found: dict[str, str] = {}
    for record in records:
        found |= read_json(folder / record, RECORD)["stage"]["files"]
    if wrong := [name for name in found if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts]:
        raise ValueError(f"{folder} names files elsewhere: {brief(wrong[0], 100)}")
    return found


def damaged(folder: Path, seal: Seal) -> list[str]:
    """The files that have changed since the entry was sealed. Files that came later do not count."""
    return not_as_written(folder, seal.records, _whole) or not_as_written(folder, files_of(folder, seal.records))


def _whole(path: Path) -> str:
    return hashed(read_bytes(path))


def clear(folder: Path) -> None:
    """Remove all that an entry holds but its lock; the seal first, so that an interruption leaves nothing believed."""
    (folder / SEAL).unlink(missing_ok=True)
    for path in folder.iterdir():
        if path.is_dir() or not path.name.startswith("."):
            remove(path)


def costs(root: Path) -> Iterator[dict[str, Any]]:
    """The cost of every entry of a store, with its kind; damaged seals are left out."""
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
