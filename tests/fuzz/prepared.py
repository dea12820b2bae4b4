"""The valid folder of a reader, and its cases; a folder that is not read without any error stops the run."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from tests.fuzz.case import Cases, Reader
from tests.fuzz.digest import digest
from tests.fuzz.engine import run
from tests.fuzz.inside import Reading
from tests.fuzz.judge import Finding


@contextmanager
def made(reader: Reader, seed: int) -> Iterator[tuple[Cases, Path]]:
    """The cases of a reader and its valid folder, in memory where that can be."""
    with memory_folder() as temporary:
        folder = temporary / reader.name
        folder.mkdir()
        reader.prepare()
        in_child(lambda: reader.make(folder))
        cases = Cases.of(reader, folder, seed)
        if (problem := _whole(cases, folder)) is not None:
            raise SystemExit(f"{reader.name}: the undamaged file is a finding: {problem}")
        yield cases, folder


@contextmanager
def memory_folder() -> Iterator[Path]:
    """A temporary folder, in memory where that can be."""
    place = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=place) as temporary:
        yield Path(temporary).resolve()


def in_child(work: Callable[[], object]) -> None:
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


def _whole(cases: Cases, folder: Path) -> Finding | None:
    """What reading the undamaged files does wrong: they must be read without any error, and twice alike."""
    reader = cases.reader
    intact = replace(reader, read=lambda folder, path: _must_read(reader, folder, path))
    whole = Cases(intact, cases.files, cases.seed, list(cases.files.items()), [], cases.tree)
    return next(run(Reading(whole), range(len(whole.whole)), folder), None)


def _must_read(reader: Reader, folder: Path, path: Path) -> None:
    compared = reader.placed or reader.odd
    try:
        found = {digest(reader.read(folder, path)) for _ in range(2 if compared else 1)}
    except (ValueError, OSError) as error:
        raise RuntimeError(f"refused: {error}") from error
    if len(found) > 1:
        raise RuntimeError("two readings differ")
