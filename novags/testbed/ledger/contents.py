"""Content: values as canonical JSON, and hashes of values, files and folders."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from novags.testbed.ledger.difference import listed
from novags.testbed.ledger.hashes import remembered
from novags.testbed.ledger.source import hashed
from sensor_model.files.atomic import write_text
from sensor_model.files.door import check_links, opened
from sensor_model.files.reading import brief
from sensor_model.files.records import read_record, read_whole

UNFINISHED = "unfinished.json"  # while a stage is under way: part of nothing
# The way in which files are hashed here: another version of this file may do it in another one.
HOW = hashlib.blake2b(Path(__file__).read_bytes(), digest_size=8).hexdigest()
# Entries of a record that state the result's cost, not its content.
VOLATILE = ("stage", "place", "seconds", "predicted_seconds", "peak_bytes", "frames_per_second", "versions")


def jsonable(value: Any) -> Any:
    """Plain JSON types for dataclasses, paths, numpy numbers and containers; infinities and NaN become strings.

    Raises:
        TypeError: For a type that has no obvious JSON form.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return jsonable(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): jsonable(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(v) for v in value]
    if isinstance(value, np.ndarray | np.generic):
        return jsonable(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)  # strict JSON has no inf or nan, and browsers and jq refuse them
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, str | int | float | bool):
        return value
    raise TypeError(f"{type(value).__name__} has no JSON form: {value!r}")


def write_json(path: Path, value: Any) -> None:
    """Write `jsonable(value)` atomically, indented so that people can read and compare it."""
    write_text(path, json.dumps(jsonable(value), indent=1, allow_nan=False) + "\n")


def read_json(path: Path, shape: Any = dict) -> dict[str, Any]:
    """Read a JSON object of a shape (see `sensor_model.files.records`).

    Raises:
        ValueError: If the file is missing, unreadable, not JSON, or of another shape.
    """
    value: dict[str, Any] = read_record(path, shape, "remove it and run the stage that makes it again")
    return value


def digest(value: Any) -> str:
    """Hash of a value's canonical JSON: equal configurations hash equally in any order of keys."""
    text = json.dumps(jsonable(value), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def folder_digest(folder: Path, names: Sequence[str] | None = None, *, beside: Mapping[str, Path] | None = None) -> str:
    """Hash of every file's relative name and content; hidden files are left out, unless they are named.

    Of a record, costs and versions are left out as well: repeated work with the same outcome does not make the
    stages after it stale.

    Args:
        folder: Where to look.
        names: The entries of `folder` that count, where they exist; None: all of them.
        beside: Further files by any name, wherever they are.

    Raises:
        ValueError: If `folder` is not a folder.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder")
    total = hashlib.blake2b(digest_size=16)
    for name, path in sorted({**shown(folder, names), **(beside or {})}.items()):
        total.update(f"{name}\0".encode())
        total.update(remembered(path, read_digest, HOW))
    return total.hexdigest()


def shown(folder: Path, names: Sequence[str] | None) -> dict[str, Path]:
    """The files of a folder that are not hidden, by relative name."""
    roots = [folder] if names is None else [folder / name for name in names]
    found = {path for root in roots for path in (root, *root.rglob("*")) if path.is_file()}
    named = {path.relative_to(folder).as_posix(): path for path in found}
    return {n: p for n, p in named.items() if n != UNFINISHED and not any(part[0] == "." for part in n.split("/"))}


def stage_key(stage: Mapping[str, Any]) -> str:
    """The key of a result, of the entry "stage" in its record: a hash of name, code, inputs and configuration."""
    return digest({part: stage.get(part) for part in ("name", "code", "inputs", "config")})


def checksum(path: Path) -> str:
    """The entry of a file in records: a hash of its content, without costs and versions where it is a record."""
    return hashed(remembered(path, read_digest, HOW))


def not_as_written(folder: Path, files: Mapping[str, str], known_by: Callable[[Path], str] = checksum) -> list[str]:
    """The names of the files that are missing or have another checksum. Further files do not count.

    Args:
        folder: Where they are.
        files: Checksum by relative name.
        known_by: Gives the checksum of a file.

    Raises:
        ValueError: If one lies behind a link that leads out of the given folders.
    """
    return [name for name, known in files.items() if not _holds(folder / name, known, known_by)]


def in_words(wrong: Sequence[str]) -> str:
    """That these files have changed since they were written."""
    return f"{listed([brief(name, 100) for name in wrong])} not as written (checksum)"


def refuse_damage(folder: Path, stage: Mapping[str, Any], remedy: str, names: Sequence[str] | None = None) -> None:
    """Refuse a finished result whose files are not as its stage wrote them: exchanged, edited or damaged ones.

    Args:
        folder: Of the stage.
        stage: The entry "stage" of its record; before there were checksums, it held none.
        remedy: What the user can do beside putting back the original.
        names: The files that are to be looked at; None: all.

    Raises:
        ValueError: Naming them.
    """
    files: Mapping[str, str] = stage.get("files", {})
    if names is not None:
        files = {name: files[name] for name in names if name in files}
    wrong = not_as_written(folder, files)
    if not wrong and "code" in stage and stage.get("key") != stage_key(stage):
        wrong = ["the entry stage of its record"]
    if wrong:
        raise ValueError(f"{folder}: {in_words(wrong)}; put back the original, or {remedy}")


def _holds(path: Path, known: str, known_by: Callable[[Path], str]) -> bool:
    try:
        return known_by(path) == known
    except OSError:  # missing, or not to be read
        return False
    except ValueError:  # not a regular file; or behind a link that leads out, which is said as that
        check_links(path)
        return False


def read_digest(path: Path) -> bytes:
    """The whole digest of a file, from the disk, without any cache."""
    if path.suffix == ".json":
        with suppress(ValueError):  # not JSON: its bytes count
            found = read_whole(path)
            is_record = isinstance(found.value, dict) and "stage" in found.value
            return record_digest(found.value) if is_record else found.hash
    content = hashlib.blake2b()
    with opened(path, fetched=False) as file:  # what is used is refused by its reader
        while chunk := file.read(1 << 20):
            content.update(chunk)
    return content.digest()


def record_digest(record: Mapping[str, Any]) -> bytes:
    """The whole digest of the record of a stage: of the result's description, not of its cost, nor where its inputs
    lie.
    """
    return digest(_lasting(jsonable(record))).encode()


def _lasting(value: Any) -> Any:
    """The value without its cost and the places of its inputs, at any depth."""
    if isinstance(value, dict):
        return {name: _lasting(part) for name, part in value.items() if name not in VOLATILE}
    return [_lasting(part) for part in value] if isinstance(value, list) else value
