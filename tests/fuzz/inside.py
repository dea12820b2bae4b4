"""The life of a child: the cases of a reader, one after the other, each within its limits."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import os
import re
import resource
import signal
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz.case import Case, Cases
from tests.fuzz.damage import places
from tests.fuzz.damage.tree import remove
from tests.fuzz.digest import digest
from tests.fuzz.judge import Finding, Limits, Outcome, judged

LARGEST = 1 << 30  # bytes of a file that a case may write: a copy of a terabyte of holes would fill the memory


@dataclass
class Reading:
    """Damages files of a valid folder, reads it, and puts it right again."""

    cases: Cases
    limits: Limits = Limits()
    many = True  # cases in one child
    valid: dict[str, tuple[object, object]] = field(
        default_factory=dict
    )  # digests of a file's reading, there and missing

    def label(self, number: int) -> tuple[str, str]:
        """Reader and file of a case."""
        return self.cases.reader.name, str(self.cases.case(number))

    def start(self, folder: Path) -> None:
        """Before the first case: the folder as it was, entered as one that was given."""
        self.cases.tree.restore(folder)
        remove(outside(folder))
        outside(folder).mkdir()
        if self.cases.reader.placed:
            from sensor_model.files.door import enter

            enter(folder)

    def one(self, number: int, folder: Path) -> Finding | None:
        """Do a case."""
        case = self.cases.case(number)
        outcome = self._read(case, folder)
        fault = outcome.fault or self._wrong(case, folder, outcome)
        return None if fault is None else Finding(self.cases.reader.name, number, str(case), *fault)

    def _read(self, case: Case, folder: Path, compared: bool | None = None) -> Outcome:
        """Read the folder with the file as the case has it; of what is compared, the value is a digest."""
        path, compared = folder / case.name, case.rule != "any" if compared is None else compared
        with applied(case, folder, self.cases.files):
            limit(self.limits.bytes)
            try:
                outcome = judged(lambda: self.cases.reader.read(folder, path))
                found = outcome.value if not compared or outcome.value is None else digest(outcome.value)
                return Outcome(outcome.fault, outcome.refused, found)
            finally:
                limit(None)

    def _wrong(self, case: Case, folder: Path, outcome: Outcome) -> tuple[str, str, str] | None:
        """What is wrong with the result, where it can be told."""
        if case.rule == "any":
            return None
        valid, missing = self._expected(case.name, folder)
        if case.rule == "refused":
            followed = outcome.value is not None and outcome.value == valid != missing
            return ("wrong", f"{case.kind}: read through it", "") if followed else None
        if outcome.refused is not None:
            return ("wrong", f"{case.kind}: refused: {outcome.refused[:200]}", "") if case.rule == "same" else None
        return ("wrong", f"{case.kind}: another result", "") if outcome.value != valid else None

    def _expected(self, name: str, folder: Path) -> tuple[object, object]:
        """What reading gives with the valid file, and without it."""
        if name not in self.valid:
            whole, without = Case(name, self.cases.files[name]), Case(name, b"", "missing")
            self.valid[name] = (self._read(whole, folder, True).value, self._read(without, folder, True).value)
        return self.valid[name]


def outside(folder: Path) -> Path:
    """A folder beside the given one, where links may lead."""
    return folder.with_name("outside")


@contextlib.contextmanager
def applied(case: Case, folder: Path, files: dict[str, bytes]) -> Iterator[None]:
    """A file as the case has it, for a while."""
    path = folder / case.name
    if case.kind in places.RULE:
        with places.standing(case.kind, folder, case.name, outside(folder)):
            yield
        return
    path.write_bytes(case.content)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.write_bytes(files[case.name]) if case.name in files else path.unlink()


def limit(more: int | None) -> None:
    """Let this process reserve so many bytes beyond what it has, and write no large files; None: any number."""
    memory = size = resource.RLIM_INFINITY
    if more is not None:
        used = re.search(rb"VmData:\s+(\d+) kB", Path("/proc/self/status").read_bytes())
        assert used is not None
        memory, size = (int(used[1]) << 10) + more, LARGEST
    resource.setrlimit(resource.RLIMIT_DATA, (memory, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


def isolate(log: Path) -> None:
    """No input, no output but a log, no survival of the parent; warnings are errors, but for what tells the user."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    null, err = os.open(os.devnull, os.O_RDWR), os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for source, target in ((null, 0), (null, 1), (err, 2)):
        os.dup2(source, target)
    faulthandler.enable(file=2, all_threads=False)
    warnings.resetwarnings()
    warnings.simplefilter("error")
    for allowed in (UserWarning, ResourceWarning):  # the first is how readers report skipped views
        warnings.simplefilter("ignore", allowed)
