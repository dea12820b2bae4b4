"""What a study holds after a making: which results were made, and their bytes without costs, dates and versions."""

import hashlib
import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SCORES, UNFINISHED = "metrics.json", "unfinished.json"
COSTS = ("seconds", "predicted_seconds", "peak_bytes")
KEY = re.compile(r"-[0-9a-f]{16}\b")  # of the name of an entry


@dataclass(frozen=True)
class Made:
    """What came of a making.

    Attributes:
        begun: The results that a stage began to make.
        bytes: Hash of each result that is there.
        failed: Why results are missing; "" if none is.
        files: The files of code of each of these.
    """

    begun: frozenset[str]
    bytes: dict[str, str]
    failed: str
    files: dict[str, list[str]]


def read_made(said: Path, work: Path, code: int | None) -> Made:
    """What the process of `making.py` said.

    Args:
        said: The file.
        work: The folder in which the process worked.
        code: Its exit code; None if it was stopped because it took too long.
    """
    lines = [json.loads(line) for line in said.read_text().splitlines()] if said.exists() else []
    folders = {line["result"]: work / line["folder"] for line in lines if "result" in line}
    there = {line["there"] for line in lines if "there" in line}
    failed = "; ".join(f"{line['failed']}: {line['why']}" for line in lines if "failed" in line)
    if not any("over" in line for line in lines):
        failed = failed or ("it took too long" if code is None else f"it ended with {code} before the first result"
                            if not lines else f"it ended with {code}")  # fmt: skip
    begun = frozenset(line["begun"] for line in lines if "begun" in line)
    found = {name: hashed(folders[name], name.endswith(" scores")) for name in folders if name in there}
    return Made(begun, found, failed, {name: files_of(folders[name], name) for name in found})


def files_of(folder: Path, name: str) -> list[str]:
    """The files of code that a result reaches."""
    record = SCORES if name.endswith(" scores") else f"{name if name in ('set', 'capture') else 'run'}.json"
    return sorted(json.loads((folder / f".{record}").read_text())["code"])


def hashed(folder: Path, scores: bool) -> str:
    """Hash of a result: of the scores of a run, or of all that is visible beside them."""
    total = hashlib.blake2b(digest_size=16)
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if path.is_file() and not hidden and path.name != UNFINISHED and (path.name == SCORES) == scores:
            total.update(f"{path.relative_to(folder)}\0".encode())
            total.update(content(path))
    return total.hexdigest()


def content(path: Path) -> bytes:
    """What counts of a file."""
    if path.suffix != ".json":
        return path.read_bytes()
    return KEY.sub("", json.dumps(_lasting(json.loads(path.read_text())), sort_keys=True)).encode()


def _lasting(value: Any) -> Any:
    """What a record says beside costs, versions, dates and keys: of its stage the configuration alone."""
    if isinstance(value, dict):
        kept = {name: _lasting(part) for name, part in value.items() if name not in COSTS}
        return {**kept, "stage": kept["stage"].get("config")} if isinstance(kept.get("stage"), dict) else kept
    return [_lasting(part) for part in value] if isinstance(value, list) else value
