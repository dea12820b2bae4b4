"""Runs one command in a forked child, in the folder of the project, as a terminal would; and what came of it."""

from __future__ import annotations

import ctypes
import faulthandler
import os
import signal
import sys
import time
import traceback
import warnings
from collections.abc import Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from tests.fuzz.inside import limit
from tests.fuzz.judge import Limits

UNCAUGHT = 99
FILTERS = warnings.filters[:]  # as Python starts, before the harness makes errors of warnings


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes:
        code: Exit code; negative: the signal that ended it; None: it did not end in time.
        out: Standard output.
        err: Standard error.
        stack: Where it was when it had to be ended.
        trace: The traceback that it wrote to a file of its own, if it did.
    """

    code: int | None
    out: str
    err: str
    stack: str = ""
    trace: str = ""


def do(words: Sequence[str], world: Path, limits: Limits) -> Ended:
    """Run `novags` with these words in the project."""
    logs = [world.parent / name for name in ("stdout", "stderr", "stack")]
    temporary = world.parent / "tmp"
    for old in temporary.glob("novags-traceback-*"):
        old.unlink()
    pid = os.fork()
    if pid == 0:
        _be_the_command(words, world, logs, limits)
    code = _wait(pid, 3 * limits.seconds)
    _end_children()
    out, err, stack = (log.read_text(errors="replace") for log in logs)
    traces = [path.read_text(errors="replace") for path in temporary.glob("novags-traceback-*")]
    return Ended(code, out, err, stack if code is None or code < 0 else "", "".join(traces))


def _wait(pid: int, seconds: float) -> int | None:
    end, watched = time.monotonic() + seconds, os.pidfd_open(pid)
    pause = 0.002
    while time.monotonic() < end:
        if os.waitid(os.P_PIDFD, watched, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
            break
        time.sleep(pause)
        pause = min(0.05, pause * 1.5)
    else:
        os.kill(pid, signal.SIGUSR2)  # where it is
        time.sleep(0.3)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(watched)
        return None
    os.close(watched)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def adopt() -> None:
    """Make this process the parent of what its descendants leave behind."""
    ctypes.CDLL(None).prctl(36, 1)  # PR_SET_CHILD_SUBREAPER


def _end_children() -> None:
    """End the processes that a command left behind: they are our children now."""
    for pid in Path(f"/proc/self/task/{os.getpid()}/children").read_text().split():
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(int(pid), signal.SIGKILL)
            os.waitpid(int(pid), 0)


def _be_the_command(words: Sequence[str], world: Path, logs: list[Path], limits: Limits) -> NoReturn:
    code = UNCAUGHT
    try:
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
        os.setsid()
        descriptors = [os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC) for log in logs]
        os.dup2(descriptors[0], 1), os.dup2(descriptors[1], 2)
        sys.stdout, sys.stderr = (os.fdopen(i, "w", encoding="utf-8", closefd=False, buffering=1) for i in (1, 2))
        sys.__stdout__, sys.__stderr__ = sys.stdout, sys.stderr
        faulthandler.enable(descriptors[2])
        faulthandler.register(signal.SIGUSR2, descriptors[2], all_threads=False)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        warnings.filters[:] = FILTERS
        warnings.simplefilter("default", UserWarning)
        os.chdir(world)
        sys.argv = ["novags", *words]
        limit(limits.bytes)
        code = _main()
        sys.stdout.flush(), sys.stderr.flush()
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        code = UNCAUGHT
    finally:
        os._exit(code & 0xFF)


def _main() -> int:
    from novags import cli

    try:
        cli.main()
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):
            return end.code or 0
        print(end.code, file=sys.stderr)
        return 1
    return 0


def load() -> None:
    """Import what commands need, without threads, which no fork inherits; Mitsuba has one that only waits."""
    import cv2
    import torch

    import novags.testbed.report.page
    import novags.testbed.study.conduct
    import novags.testbed.study.place  # noqa: F401
    import novags.testbed.viewer.server as server

    torch.set_num_threads(1)
    cv2.setNumThreads(0)
    server.serving = _shown  # type: ignore[assignment]
    assert _threads() == 1, "threads were started"
    import drjit
    import mitsuba  # noqa: F401

    # Mitsuba translates its differentiable integrators anew for every variant, which takes seconds; nobody needs them.
    drjit.syntax = lambda function=None, **_: function if function is not None else (lambda other: other)


def warm(folder: Path, commands: Sequence[Sequence[str]]) -> None:
    """Run commands in this process, so that what they compile is there; they may not start threads either."""
    here, threads = os.getcwd(), _threads()
    os.chdir(folder)
    for words in commands:
        sys.argv = ["novags", *words]
        if code := _main():
            raise SystemExit(f"novags {' '.join(words)}: exit code {code}")
    os.chdir(here)
    assert _threads() == threads, "threads were started"


def _threads() -> int:
    return len(os.listdir("/proc/self/task"))


@contextmanager
def _shown(shown: Any, host: str, port: int) -> Any:
    """Instead of a server: every picture that it would show, then the end that Ctrl-C makes."""
    for one in list(shown):
        for name in one.runs:
            for kind in one.kinds(name):
                one.picture(kind, name, 0)
    raise KeyboardInterrupt
    yield
