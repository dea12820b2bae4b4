"""Stages as folders: content hashes, atomic writes, completion, resuming.

A stage writes into one folder and puts its record there last (`set.json`, `capture.json`, `run.json`, ...), so a folder
with a record is complete. The record's `stage` entry holds the key: a hash of the stage's name, the contents of its
input folders and its resolved configuration. Same key: not run again. While a stage is under way, `unfinished.json`
holds the key of the work in the folder; a later start with the same key continues it, another key clears it first.
Nothing is cleared until the inputs of the new work have been read and found valid.
"""

import hashlib
import json
import math
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from novags.testbed.console import Console
from novags.testbed.provenance import PeakMemory, environment, package_version
from sensor_model.files.atomic import atomic

Prepared = TypeVar("Prepared")

UNFINISHED = "unfinished.json"
# Entries of a record that say what it cost, not what it is.
VOLATILE = ("stage", "seconds", "predicted_seconds", "peak_bytes", "versions")


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


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text atomically."""
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write `jsonable(value)` atomically, indented so that people can read and compare it."""
    write_text(path, json.dumps(jsonable(value), indent=1, allow_nan=False) + "\n")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        ValueError: If the file is missing, unreadable, not JSON, or not an object.
    """
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise ValueError(
            f"{path} is not valid JSON ({error}): remove it and run the stage that makes it again"
        ) from error
    if not isinstance(value, dict):
        raise ValueError(f"{path} must hold a JSON object, got {type(value).__name__}")
    return value


def digest(value: Any) -> str:
    """Hash of a value's canonical JSON: equal configurations hash equally whatever their key order."""
    text = json.dumps(jsonable(value), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def folder_digest(folder: Path, names: Sequence[str] | None = None, *, beside: Mapping[str, Path] | None = None) -> str:
    """Hash of every file's relative name and content; hidden files are left out.

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
    roots = [folder] if names is None else [folder / name for name in names]
    found = {path for root in roots for path in (root, *root.rglob("*")) if path.is_file()}
    files = {path.relative_to(folder).as_posix(): path for path in found} | dict(beside or {})
    total = hashlib.blake2b(digest_size=16)
    for name, path in sorted(files.items()):
        if name != UNFINISHED and not any(part.startswith(".") for part in name.split("/")):
            total.update(f"{name}\0".encode())
            total.update(_content_digest(path))
    return total.hexdigest()


_CONTENTS: dict[
    tuple[Path, int, int, int], bytes
] = {}  # hashes of files seen before: every method reads the same inputs
SETTLED = 2_000_000_000  # ns; a file changed more recently may change again without its time stamp showing it


def _content_digest(path: Path) -> bytes:
    path = path.resolve()
    stat = path.stat()
    key = (path, stat.st_ino, stat.st_mtime_ns, stat.st_size)
    if key in _CONTENTS:
        return _CONTENTS[key]
    content = _read_digest(path)
    if time.time_ns() - stat.st_mtime_ns > SETTLED:
        _CONTENTS[key] = content
    return content


def _read_digest(path: Path) -> bytes:
    if path.suffix == ".json" and (record := _record(path)) is not None:
        return digest(_lasting(record)).encode()
    content = hashlib.blake2b()
    with path.open("rb") as file:
        while chunk := file.read(1 << 20):
            content.update(chunk)
    return content.digest()


def _record(path: Path) -> dict[str, Any] | None:
    """The record of a stage, or None for any other JSON file."""
    try:
        value = json.loads(path.read_bytes())
    except ValueError:
        return None
    return value if isinstance(value, dict) and "stage" in value else None


def _lasting(value: Any) -> Any:
    """The value without what it cost, at any depth."""
    if isinstance(value, dict):
        return {name: _lasting(part) for name, part in value.items() if name not in VOLATILE}
    return [_lasting(part) for part in value] if isinstance(value, list) else value


def run_stage(
    name: str,
    folder: Path,
    record_name: str,
    *,
    inputs: Mapping[str, str],
    config: Mapping[str, Any],
    owns: Sequence[str],
    prepare: Callable[[], Prepared],
    work: Callable[[Prepared], Mapping[str, Any]],
    console: Console,
    stale: Sequence[Path] = (),
) -> dict[str, Any]:
    """Do a stage's work unless its folder already holds the result of the same inputs and configuration.

    Args:
        name: What the stage is called in messages and records.
        folder: Where it writes.
        record_name: The record, written last.
        inputs: Content hash of each input, by name.
        config: The resolved configuration (JSON-able).
        owns: Names in `folder` that the stage writes; nothing else is ever removed.
        prepare: Reads and checks the inputs. An earlier result stays untouched until it has returned.
        work: Fills the folder (picking up what is there) with what `prepare` read, and returns the record's body.
        console: Where progress goes.
        stale: Files elsewhere that describe an earlier result in `folder`; removed together with it.

    Returns:
        The record, as it stands in the folder.

    Raises:
        ValueError: If `folder` holds files that no stage of this kind has written, or an input is wrong.
    """
    config = jsonable(config)
    key = digest({"stage": name, "version": package_version("novags"), "inputs": inputs, "config": config})
    record_path = folder / record_name
    if record_path.exists() and (record := read_json(record_path)).get("stage", {}).get("key") == key:
        console.note(f"{name}: unchanged, kept {folder}")
        return record
    earlier = _earlier_seconds(name, folder, record_name, key, owns, console)
    start = time.perf_counter()
    memory = PeakMemory()
    prepared = prepare()
    if earlier is None:
        told = stale if record_path.exists() else ()
        _clear(name, folder, key, [*told, *(folder / owned for owned in (record_name, *owns))])
    try:
        body = dict(work(prepared))
    except BaseException:
        _mark(name, folder, key, (earlier or 0.0) + time.perf_counter() - start)
        raise
    body["stage"] = {
        "name": name,
        "key": key,
        "inputs": dict(inputs),
        "config": config,
        "seconds": (earlier or 0.0) + time.perf_counter() - start,
        "peak_bytes": memory.peak_bytes(),
        **environment(),
    }
    write_json(record_path, body)
    (folder / UNFINISHED).unlink(missing_ok=True)
    return read_json(record_path)


def _earlier_seconds(
    name: str, folder: Path, record_name: str, key: str, owns: Sequence[str], console: Console
) -> float | None:
    """Seconds spent by interrupted attempts at the work of `key`; None if the folder has to be cleared for it."""
    if (folder / UNFINISHED).exists():
        state = read_json(folder / UNFINISHED)
        if state.get("key") == key:
            console.note(f"{name}: continuing in {folder}")
            return float(state.get("seconds", 0.0))
    elif (folder / record_name).exists():
        if "stage" not in read_json(folder / record_name):
            raise ValueError(f"{folder} holds a {record_name} that novags {name} did not write: choose another --out")
        console.note(f"{name}: inputs or configuration changed, doing {folder} again")
    elif taken := sorted(owned for owned in owns if (folder / owned).exists()):
        raise ValueError(
            f"{folder} already holds {', '.join(taken)}, and novags {name} did not write them: choose another --out"
        )
    return None


def _clear(name: str, folder: Path, key: str, targets: Sequence[Path]) -> None:
    """Remove files and folders, in this order; what an interruption leaves behind belongs to no work."""
    folder.mkdir(parents=True, exist_ok=True)
    _mark(name, folder, None, 0.0)
    for target in targets:
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        else:
            target.unlink(missing_ok=True)
    _mark(name, folder, key, 0.0)


def _mark(name: str, folder: Path, key: str | None, seconds: float) -> None:
    """Record whose unfinished work is in the folder; a key of None marks remains that are being cleared away."""
    write_json(folder / UNFINISHED, {"stage": name, "key": key, "seconds": seconds})
