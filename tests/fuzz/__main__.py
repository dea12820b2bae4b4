"""The long run of readers, `python -m tests.fuzz`, and of commands, `python -m tests.fuzz --commands --cases 2000`.

Interrupted, it goes on where it was; see docs/fuzz.md.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

# One core, and no threads before a fork: set before numpy, torch and OpenCV are loaded.
os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}

from tests.fuzz.case import DAMAGE, Reader
from tests.fuzz.damage.places import RULE
from tests.fuzz.damage.tree import remove
from tests.fuzz.engine import Work, run
from tests.fuzz.inside import Reading, applied, outside
from tests.fuzz.judge import SECONDS, Limits
from tests.fuzz.prepared import made
from tests.fuzz.readers import READERS
from tests.fuzz.records import advance, opened, shares, table

Job = tuple[dict[str, Any], Work, list[int], Path, Path]  # record, work, numbers of cases, folder, the record's file


def main() -> None:
    given = _arguments()
    if given.commands:
        from tests.fuzz.commands.job import jobs, show
    else:
        jobs, show = _readers, _show
    if given.case is not None:
        show(given)
        return
    if given.fresh:
        shutil.rmtree(given.out, ignore_errors=True)
    given.out.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        _run(jobs(given, stack), given.out, max(1, given.cases // (200 if given.commands else 20_000)))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--commands", action="store_true", help="whole commands instead of readers")
    parser.add_argument("--cases", type=int, default=1_000_000, help="of all readers or commands together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", action="append", help="only this reader or command; repeatable")
    parser.add_argument("--case", type=int, help="run this case alone, with what it says, and keep its files")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of computing that a case may take")
    parser.add_argument("--new", action="store_true", help="only what is no damage: odd texts, links, devices")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="where findings and the table go")
    parser.add_argument("--fresh", action="store_true", help="forget an earlier run in this folder")
    return parser.parse_args()


def _run(jobs: list[Job], out: Path, rounds: int) -> None:
    records = [record for record, *_ in jobs]
    for done in range(1, rounds + 1):  # all by turns, so that an interrupted run has tried each
        for record, work, numbers, folder, note in jobs:
            advance(record, work, numbers, folder, record["of"] * done // rounds)
            note.write_text(json.dumps(record))
        (out / "table.md").write_text(table(records))
    print(table(records))
    sys.exit(any(r["findings"] for r in records))


def _chosen(names: list[str] | None) -> list[Reader]:
    if wrong := set(names or ()) - set(READERS):
        raise SystemExit(f"no reader {', '.join(wrong)}; there are {', '.join(READERS)}")
    return [READERS[name] for name in names or READERS]


def _readers(given: argparse.Namespace, stack: ExitStack) -> list[Job]:
    """The work on all readers, their valid folders being there as long as the stack is open."""
    chosen, limits = _chosen(given.reader), Limits(seconds=given.seconds)
    counts = shares(given.cases, {reader.name: reader.share for reader in chosen})
    jobs: list[Job] = []
    for reader in chosen:
        note = given.out / f"{reader.name}.{given.seed}.json"
        cases, folder = stack.enter_context(made(reader, given.seed))
        numbers = cases.chosen(counts[reader.name])
        if given.new:
            numbers = [k for k in cases.chosen(counts[reader.name] * 5) if cases.case(k).kind != DAMAGE]
            numbers = numbers[: counts[reader.name]]
        record = opened(note, reader.name, given.seed, len(numbers))
        jobs.append((record, Reading(cases, limits), numbers, folder, note))
    return jobs


def _show(given: argparse.Namespace) -> None:
    (reader,) = _chosen(given.reader)[:1]
    with made(reader, given.seed) as (cases, folder):
        case = cases.case(given.case)
        kept = given.out / f"{reader.name}.{given.case}" / case.name
        if case.kind not in RULE:  # what is put in a file's place cannot be kept
            kept.parent.mkdir(parents=True, exist_ok=True)
            kept.write_bytes(case.content)
        work = Reading(cases, Limits(seconds=given.seconds))
        print(f"{kept} ({case.kind}): {next(run(work, [given.case], folder), 'as documented')}", flush=True)
        remove(outside(folder))
        with applied(case, folder, cases.files):
            try:
                reader.read(folder, folder / case.name)
            except (ValueError, OSError) as error:
                print(f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
