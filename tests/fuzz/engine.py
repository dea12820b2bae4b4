"""Runs cases in a forked child, many in one as long as it lives, and says which of them did what no case may.

A case may read its file, or raise ValueError or OSError with a message of some lines. It may not crash, take more
than 20 s or 2 GiB, or raise anything else, warnings included. A child that dies is replaced; the case in which it died
is run again alone, so that no case is blamed for another.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import json
import mmap
import os
import re
import resource
import select
import signal
import struct
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tests.fuzz.case import Cases

SECONDS, BYTES = 20.0, 2 << 30
LONGEST = 2000  # characters of a message
MEMORY = ("bad_alloc", "Unable to allocate", "Cannot allocate", "not enough memory", "DefaultCPUAllocator")
ROOT = Path(__file__).resolve().parents[2]
RENEW = 77  # exit status of a child that wants to be replaced


@dataclass(frozen=True)
class Limits:
    """What one case may take."""

    seconds: float = SECONDS
    bytes: int = BYTES


@dataclass(frozen=True)
class Finding:
    """A case that did what none may.

    Attributes:
        reader: Its reader.
        case: Its number.
        file: What was damaged.
        kind: "crash", "hang", "memory", "exception", "warning" or "message".
        detail: What happened, in a line.
        place: Where in the project's code, as far as known.
    """

    reader: str
    case: int
    file: str
    kind: str
    detail: str
    place: str

    @property
    def signature(self) -> str:
        """The same for findings that have one cause, as a rule."""
        return f"{self.kind} {re.sub(r'[0-9]+', '', self.detail)[:60] if not self.place else self.place}"


def judged(read: Callable[[], object]) -> tuple[str, str, str] | None:
    """Kind, detail and place of what a call did wrong; None if it did as documented."""
    try:
        read()
    except (ValueError, OSError) as error:
        text = str(error)
        if _is_memory(error):
            return "memory", _line(error), _place(error)
        if isinstance(error, OSError) and error.errno is not None:
            return None  # the system's own words
        if not text.strip() or len(text) > LONGEST:
            return "message", f"{type(error).__name__} of {len(text)} characters: {text[:80]!r}", _place(error)
        return None
    except MemoryError as error:
        return "memory", _line(error), _place(error)
    except Exception as error:
        kind = "memory" if _is_memory(error) else "warning" if isinstance(error, Warning) else "exception"
        return kind, _line(error), _place(error)
    except BaseException as error:
        return "exception", _line(error), _place(error)
    return None


def _is_memory(error: BaseException | None) -> bool:
    seen = 0
    while error is not None and seen < 20:
        if isinstance(error, MemoryError) or any(words in str(error) for words in MEMORY):
            return True
        error, seen = error.__cause__ or error.__context__, seen + 1
    return False


def _line(error: BaseException) -> str:
    try:
        text = str(error)
    except Exception as inner:
        text = f"(its text cannot be made: {inner!r})"
    return f"{type(error).__name__}: {' '.join(text.split())}"[:300].encode("utf-8", "replace").decode()


def _place(error: BaseException) -> str:
    """The innermost line of the project itself."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if f.filename.startswith(str(ROOT)) and "/tests/fuzz/" not in f.filename]
    return f"{Path(own[-1].filename).relative_to(ROOT)}:{own[-1].lineno} {own[-1].name}" if own else ""


def run(cases: Cases, numbers: Sequence[int], folder: Path, limits: Limits = Limits()) -> Iterator[Finding]:
    """Run cases; yields what is wrong as it is found.

    Args:
        cases: Of one reader.
        numbers: Of the cases.
        folder: The reader's valid folder, in which files are damaged and restored.
        limits: Of each case.
    """
    at = 0
    while at < len(numbers):
        child = _Child(cases, numbers[at:], folder, limits)
        yield from child.findings()
        if child.outcome == "done":
            return
        died = at + child.position
        at = died + 1
        if child.outcome == "renew":
            continue
        if child.position == 0:
            yield cases_finding(cases, numbers[died], *child.death())
            continue
        alone = _Child(cases, [numbers[died]], folder, limits)
        yield from alone.findings()
        if alone.outcome not in ("done", "renew"):
            yield cases_finding(cases, numbers[died], *alone.death())
        else:
            kind, detail, place = child.death()
            first = numbers[died - child.position]
            yield cases_finding(cases, numbers[died], kind, f"{detail}; not alone, after cases from {first} on", place)


def cases_finding(cases: Cases, number: int, kind: str, detail: str, place: str) -> Finding:
    """A finding of one of these cases."""
    return Finding(cases.reader.name, number, cases.case(number)[0], kind, detail, place)


class _Clock:
    """How long a process has been at one case: what it computed, since other work on the machine must not count."""

    def __init__(self, pid: int) -> None:
        self.pid, self.position, self.start, self.computed = pid, -1, 0.0, 0.0

    def is_over(self, position: int, seconds: float) -> bool:
        """Whether it has computed for longer than `seconds`, or waited for three times as long."""
        try:
            state, *fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(") ")[2].split()
        except OSError:
            return False  # it is just leaving
        computed = (int(fields[10]) + int(fields[11])) / os.sysconf("SC_CLK_TCK")  # user and system
        if position != self.position or state == "R":
            self.start = time.monotonic()  # of waiting
        if position != self.position:
            self.position, self.computed = position, computed
        return computed - self.computed > seconds or time.monotonic() - self.start > 3 * seconds


class _Child:
    """A forked process that runs cases until it is through, dies or is killed."""

    def __init__(self, cases: Cases, numbers: Sequence[int], folder: Path, limits: Limits) -> None:
        self.limits, self.numbers = limits, numbers
        self.log = folder.parent / f"{folder.name}.stderr"
        self.shared = mmap.mmap(-1, 8)  # the place in `numbers` of the case under way
        self.position, self.outcome, self.code = 0, "", 0
        self.pipe, end = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(self.pipe)
            _work(cases, numbers, folder, limits, self.shared, end, self.log)
        os.close(end)

    def findings(self) -> Iterator[Finding]:
        """What the child finds; returns when it is gone."""
        watched, buffer, clock = os.pidfd_open(self.pid), b"", _Clock(self.pid)
        killed = ended = False
        while not ended:
            ready, _, _ = select.select([self.pipe, watched], [], [], min(0.5, self.limits.seconds / 4))
            ended = watched in ready
            while select.select([self.pipe], [], [], 0)[0]:
                data = os.read(self.pipe, 1 << 16)
                if not data:
                    break
                buffer += data
            *lines, buffer = buffer.split(b"\n")
            for line in lines:
                yield Finding(**json.loads(line))
            if not (ended or killed) and clock.is_over(struct.unpack("q", self.shared[:8])[0], self.limits.seconds):
                os.kill(self.pid, signal.SIGKILL)  # whatever it ignores
                killed = True
        os.close(watched)
        os.close(self.pipe)
        self.code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        self.position = struct.unpack("q", self.shared[:8])[0]
        through = self.code == 0 and self.position == len(self.numbers)  # a reader may end the process itself
        self.outcome = "hang" if killed else "done" if through else "renew" if self.code == RENEW else "crash"

    def death(self) -> tuple[str, str, str]:
        """Kind, detail and place."""
        if self.outcome == "hang":
            return "hang", f"not finished after {self.limits.seconds:g} s", ""
        name = signal.Signals(-self.code).name if self.code < 0 else f"exit status {self.code}"
        said = self.log.read_text(errors="replace") if self.log.exists() else ""
        own = [f"{Path(m[1]).relative_to(ROOT)}:{m[2]} {m[3]}" for m in _FRAME.finditer(said) if _is_own(m[1])]
        return "crash", name, own[0] if own else ""


_FRAME = re.compile(r'File "([^"]+)", line (\d+) in (\S+)')


def _is_own(file: str) -> bool:
    return file.startswith(str(ROOT)) and "/tests/fuzz/" not in file


def _work(
    cases: Cases, numbers: Sequence[int], folder: Path, limits: Limits, shared: mmap.mmap, pipe: int, log: Path
) -> None:
    """The life of a child."""
    code = 1
    try:
        _isolate(log)
        for name, content in cases.files.items():
            (folder / name).write_bytes(content)
        for position, number in enumerate(numbers):
            shared[:8] = struct.pack("q", position)
            if (found := _one(cases, number, folder, limits)) is not None:
                os.write(pipe, json.dumps(asdict(found)).encode() + b"\n")
                if found.kind == "memory":
                    code = RENEW
                    return
        shared[:8] = struct.pack("q", len(numbers))
        code = 0
    except BaseException:
        traceback.print_exc(file=sys.__stderr__)
    finally:
        os._exit(code)


def _one(cases: Cases, number: int, folder: Path, limits: Limits) -> Finding | None:
    name, content = cases.case(number)
    path = folder / name
    path.write_bytes(content)
    _limit_memory(limits.bytes)
    try:
        found = judged(lambda: cases.reader.read(folder, path))
    finally:
        _limit_memory(None)
        with contextlib.suppress(OSError):
            path.write_bytes(cases.files[name]) if name in cases.files else path.unlink()
    return None if found is None else Finding(cases.reader.name, number, name, *found)


def _limit_memory(more: int | None) -> None:
    """Let this process reserve so many bytes beyond what it has; None: any number."""
    limit = resource.RLIM_INFINITY
    if more is not None:
        used = re.search(rb"VmData:\s+(\d+) kB", Path("/proc/self/status").read_bytes())
        assert used is not None
        limit = (int(used[1]) << 10) + more
    resource.setrlimit(resource.RLIMIT_DATA, (limit, resource.RLIM_INFINITY))


def _isolate(log: Path) -> None:
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


def jsonable(finding: Finding) -> dict[str, Any]:
    """For a record."""
    return asdict(finding)
