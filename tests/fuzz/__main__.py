"""The long run: `python -m tests.fuzz --cases 1000000`. Interrupted, it goes on where it was; see docs/fuzz.md."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

# One core, and no threads before a fork: set before numpy, torch and OpenCV are loaded.
os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}

from tests.fuzz.case import Cases, Reader
from tests.fuzz.engine import Finding, jsonable, run
from tests.fuzz.readers import READERS

BATCH = 500  # cases between two notes of how far it is


@contextmanager
def made(reader: Reader, seed: int) -> Iterator[tuple[Cases, Path]]:
    """The cases of a reader and its valid folder, in memory where that can be."""
    place = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=place) as temporary:
        folder = Path(temporary) / reader.name
        folder.mkdir()
        reader.prepare()
        _in_child(lambda: reader.make(folder))
        cases = Cases.of(reader, folder, seed)
        problem = [found for name in cases.files if (found := _whole(cases, folder, name))]
        if problem:
            raise SystemExit(f"{reader.name}: the undamaged file is a finding: {problem[0]}")
        yield cases, folder


def _in_child(work: Any) -> None:
    """Writers start threads, which no later fork may inherit."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
            os._exit(0)
        except BaseException:
            sys.excepthook(*sys.exc_info())
            os._exit(1)
    if os.waitpid(pid, 0)[1]:
        raise SystemExit("the valid files could not be written, see above")


def _whole(cases: Cases, folder: Path, name: str) -> Finding | None:
    """What reading the undamaged file does wrong: it must be read without any error."""
    intact = Reader(
        cases.reader.name, cases.reader.make, lambda f, p: _must_read(cases.reader, f, p), cases.reader.damage
    )
    whole = Cases(intact, cases.files, cases.seed, [(name, cases.files[name])], [])
    return next(run(whole, [0], folder), None)


def _must_read(reader: Reader, folder: Path, path: Path) -> None:
    try:
        reader.read(folder, path)
    except (ValueError, OSError) as error:
        raise RuntimeError(f"refused: {error}") from error


def advance(record: dict[str, Any], cases: Cases, folder: Path, upto: int) -> None:
    """Run the cases of a reader up to the `upto`-th, in a record that says how many were run, and what was found."""
    numbers = cases.chosen(record["of"])
    while record["cases"] < upto:
        start = time.monotonic()
        batch = numbers[record["cases"] : min(upto, record["cases"] + BATCH)]
        for found in run(cases, batch, folder):
            record["findings"].append(jsonable(found))
            place = f"{found.reader} {found.case} {found.file}"
            print(f"{place}: {found.kind} {found.place} {found.detail}", flush=True)
        record["cases"] += len(batch)
        record["seconds"] += time.monotonic() - start


def opened(note: Path, reader: Reader, seed: int, count: int) -> dict[str, Any]:
    """The record of an earlier run that this one continues, or a new one."""
    new = {"reader": reader.name, "seed": seed, "of": count, "cases": 0, "seconds": 0.0, "findings": []}
    if not note.is_file():
        return new
    earlier: dict[str, Any] = json.loads(note.read_text())
    if earlier["of"] != count:
        raise SystemExit(f"{note} is of a run of {earlier['of']} cases, not {count}: give another --out, or --fresh")
    return earlier


def table(records: list[dict[str, Any]]) -> str:
    """Markdown: a row for each reader."""
    rows = ["| reader | cases | cases/s | findings | causes |", "| --- | ---: | ---: | ---: | --- |"]
    for r in records:
        causes = Counter(Finding(**f).signature for f in r["findings"])
        listed = "; ".join(f"{cause} ({n})" for cause, n in causes.most_common(4)) or "none"
        rate = r["cases"] / max(r["seconds"], 1e-9)
        rows.append(f"| {r['reader']} | {r['cases']:,} | {rate:.0f} | {len(r['findings'])} | {listed} |")
    total = sum(r["cases"] for r in records)
    rows.append(f"| all | {total:,} | | {sum(len(r['findings']) for r in records)} | |")
    return "\n".join(rows) + "\n"


def shares(cases: int, readers: list[Reader]) -> dict[str, int]:
    """How many of `cases` each reader gets."""
    whole = sum(reader.share for reader in readers)
    return {reader.name: max(1, round(cases * reader.share / whole)) for reader in readers}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=1_000_000, help="of all readers together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reader", action="append", choices=sorted(READERS), help="only this one; repeatable")
    parser.add_argument("--case", type=int, help="run this case alone, with its traceback, and keep its file")
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"), help="where findings and the table go")
    parser.add_argument("--fresh", action="store_true", help="forget an earlier run in this folder")
    given = parser.parse_args()
    readers = [READERS[name] for name in given.reader or READERS]
    if given.case is not None:
        _show(readers[0], given.seed, given.case, given.out)
        return
    if given.fresh:
        shutil.rmtree(given.out, ignore_errors=True)
    given.out.mkdir(parents=True, exist_ok=True)
    counts = shares(given.cases, readers)
    records, rounds = [], max(1, given.cases // 20_000)
    with ExitStack() as stack:
        jobs = []
        for reader in readers:
            note = given.out / f"{reader.name}.{given.seed}.json"
            records.append(opened(note, reader, given.seed, counts[reader.name]))
            jobs.append((records[-1], *stack.enter_context(made(reader, given.seed)), note))
        for done in range(1, rounds + 1):  # all readers by turns, so that an interrupted run has tried each
            for record, cases, folder, note in jobs:
                advance(record, cases, folder, record["of"] * done // rounds)
                note.write_text(json.dumps(record))
            (given.out / "table.md").write_text(table(records))
    print(table(records))
    sys.exit(any(r["findings"] for r in records))


def _show(reader: Reader, seed: int, number: int, out: Path) -> None:
    with made(reader, seed) as (cases, folder):
        name, content = cases.case(number)
        kept = out / f"{reader.name}.{number}" / name
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(content)
        print(f"{kept}: {next(run(cases, [number], folder), 'as documented')}")
        (folder / name).write_bytes(content)
        try:
            reader.read(folder, folder / name)
        except (ValueError, OSError) as error:
            print(f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
