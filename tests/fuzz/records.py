"""How far a run is, what it found, and the table of it."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.fuzz.engine import Work, run
from tests.fuzz.judge import Finding, jsonable

BATCH = 500  # cases between two notes of how far it is


def advance(record: dict[str, Any], work: Work, numbers: Sequence[int], folder: Path, upto: int) -> None:
    """Run cases up to the `upto`-th of `numbers`, in a record that says how many were run, and what was found."""
    while record["cases"] < upto:
        start = time.monotonic()
        batch = numbers[record["cases"] : min(upto, record["cases"] + BATCH)]
        for found in run(work, batch, folder):
            record["findings"].append(jsonable(found))
            place = f"{found.reader} {found.case} {found.file}"
            print(f"{place}: {found.kind} {found.place} {found.detail}", flush=True)
        record["cases"] += len(batch)
        record["seconds"] += time.monotonic() - start


def opened(note: Path, name: str, seed: int, count: int) -> dict[str, Any]:
    """The record of an earlier run that this one continues, or a new one."""
    new = {"reader": name, "seed": seed, "of": count, "cases": 0, "seconds": 0.0, "findings": []}
    if not note.is_file():
        return new
    earlier: dict[str, Any] = json.loads(note.read_text())
    if earlier["of"] != count:
        raise SystemExit(f"{note} is of a run of {earlier['of']} cases, not {count}: give another --out, or --fresh")
    return earlier


def table(records: list[dict[str, Any]]) -> str:
    """Markdown: a row for each reader or command."""
    rows = ["| reader | cases | cases/s | findings | causes |", "| --- | ---: | ---: | ---: | --- |"]
    for r in records:
        causes = Counter(Finding(**f).signature for f in r["findings"])
        listed = "; ".join(f"{cause} ({n})" for cause, n in causes.most_common(4)) or "none"
        rate = r["cases"] / max(r["seconds"], 1e-9)
        rows.append(f"| {r['reader']} | {r['cases']:,} | {rate:.0f} | {len(r['findings'])} | {listed} |")
    total = sum(r["cases"] for r in records)
    rows.append(f"| all | {total:,} | | {sum(len(r['findings']) for r in records)} | |")
    return "\n".join(rows) + "\n"


LEAST = 5  # cases of the slowest reader, in however short a run


def shares(cases: int, weights: dict[str, float]) -> dict[str, int]:
    """How many of `cases` each reader or command gets."""
    whole = sum(weights.values())
    return {name: max(min(LEAST, cases), round(cases * weight / whole)) for name, weight in weights.items()}
