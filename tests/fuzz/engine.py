"""Runs cases in a forked child, many in one as long as it lives, and says which of them did what no case may.

A case may read its file, or raise ValueError or OSError with a message of some lines. It may not crash, take more
than 20 s or 2 GiB, or raise anything else, warnings included. A child that dies is replaced; the case in which it died
is run again alone, so that no case is blamed for another.
"""

from __future__ import annotations

import json
import mmap
import os
import select
import signal
import struct
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Protocol

from tests.fuzz.inside import isolate
from tests.fuzz.judge import Finding, Limits, places_in

RENEW = 77  # exit status of a child that wants to be replaced
SPARE = 1 << 30  # bytes of resident memory above the limit on what is reserved: files that are mapped count in it


class Work(Protocol):
    """What a child does.

    Attributes:
        limits: Of each case.
        many: Whether a child does many cases; else it does one.
    """

    limits: Limits
    many: bool

    def label(self, number: int) -> tuple[str, str]:
        """Reader and file of a case, for a finding."""

    def start(self, folder: Path) -> None:
        """In the child, before its first case."""

    def one(self, number: int, folder: Path) -> Finding | None:
        """In the child: do a case."""


def run(work: Work, numbers: Sequence[int], folder: Path) -> Iterator[Finding]:
    """Run cases; yields what is wrong as it is found.

    Args:
        work: What a child does.
        numbers: Of the cases.
        folder: In which files are damaged and restored.
    """
    at = 0
    while at < len(numbers):
        part = numbers[at:] if work.many else numbers[at : at + 1]
        child = _Child(work, part, folder)
        yield from child.findings()
        if child.outcome == "done":
            at += len(part)
            continue
        died = at + child.position
        at = died + 1
        if child.outcome == "renew":
            continue
        if child.position == 0:
            yield Finding(*_place(work, numbers[died]), *child.death())
            continue
        alone = _Child(work, [numbers[died]], folder)
        yield from alone.findings()
        if alone.outcome not in ("done", "renew"):
            yield Finding(*_place(work, numbers[died]), *alone.death())
        else:
            kind, detail, place = child.death()
            first = numbers[died - child.position]
            said = f"{detail}; not alone, after cases from {first} on"
            yield Finding(*_place(work, numbers[died]), kind, said, place)


def _place(work: Work, number: int) -> tuple[str, int, str]:
    reader, file = work.label(number)
    return reader, number, file


class _Clock:
    """How long a process has been at one case, and what it holds.

    What it computed counts, since other work on the machine must not.
    """

    def __init__(self, pid: int, limits: Limits) -> None:
        self.pid, self.limits, self.position, self.start, self.computed = pid, limits, -1, 0.0, 0.0
        self.held: int | None = None

    def over(self, position: int) -> str:
        """ "hang" if it has computed for longer than the limit, or waited for three times as long; "memory"; or ""."""
        try:
            state, *fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(") ")[2].split()
        except OSError:
            return ""  # it is just leaving
        computed = (int(fields[10]) + int(fields[11])) / os.sysconf("SC_CLK_TCK")  # user and system
        held = int(fields[20]) * os.sysconf("SC_PAGE_SIZE")
        self.held = held if self.held is None else self.held
        if held - self.held > self.limits.bytes + SPARE:
            return "memory"
        if position != self.position or state == "R":
            self.start = time.monotonic()  # of waiting
        if position != self.position:
            self.position, self.computed = position, computed
        seconds = self.limits.seconds
        slow = computed - self.computed > seconds or time.monotonic() - self.start > 3 * seconds
        return "hang" if slow else ""


class _Child:
    """A forked process that runs cases until it is through, dies or is killed."""

    def __init__(self, work: Work, numbers: Sequence[int], folder: Path) -> None:
        self.limits, self.numbers = work.limits, numbers
        self.log = folder.parent / f"{folder.name}.stderr"
        self.shared = mmap.mmap(-1, 8)  # the place in `numbers` of the case under way
        self.position, self.outcome, self.code = 0, "", 0
        self.pipe, end = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(self.pipe)
            _live(work, numbers, folder, self.shared, end, self.log)
        os.close(end)

    def findings(self) -> Iterator[Finding]:
        """What the child finds; returns when it is gone."""
        watched, buffer, clock = os.pidfd_open(self.pid), b"", _Clock(self.pid, self.limits)
        killed, ended = "", False
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
            if not (ended or killed) and (killed := clock.over(struct.unpack("q", self.shared[:8])[0])):
                os.kill(self.pid, signal.SIGKILL)  # whatever it ignores
        os.close(watched)
        os.close(self.pipe)
        self.code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        self.position = struct.unpack("q", self.shared[:8])[0]
        through = self.code == 0 and self.position == len(self.numbers)  # a reader may end the process itself
        self.outcome = killed or ("done" if through else "renew" if self.code == RENEW else "crash")

    def death(self) -> tuple[str, str, str]:
        """Kind, detail and place."""
        if self.outcome == "hang":
            return "hang", f"not finished after {self.limits.seconds:g} s", ""
        if self.outcome == "memory":
            return "memory", f"more than {self.limits.bytes + SPARE:,} bytes resident", ""
        name = signal.Signals(-self.code).name if self.code < 0 else f"exit status {self.code}"
        own = places_in(self.log.read_text(errors="replace") if self.log.exists() else "")
        return "crash", name, own[0] if own else ""


def _live(work: Work, numbers: Sequence[int], folder: Path, shared: mmap.mmap, pipe: int, log: Path) -> None:
    """The life of a child."""
    code = 1
    try:
        isolate(log)
        work.start(folder)
        for position, number in enumerate(numbers):
            shared[:8] = struct.pack("q", position)
            if (found := work.one(number, folder)) is not None:
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
