"""A worker process: it takes one task after another from the process that started it, and ends with it.

Its arguments are the descriptor of a pipe and MODULE:FUNCTION. The function does a task; it gets a `Console` that
reports its progress, and may raise anything. Its output goes to the log of the task.
"""

import ctypes
import errno
import faulthandler
import os
import pickle
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NoReturn

from novags.process import settle
from novags.testbed.console.terminal import Console, Update
from sensor_model.files.door import descriptor_of_our_own
from sensor_model.files.outside import arrive
from sensor_model.files.reading import brief
from sensor_model.files.registry import loaded

BETWEEN = 0.5  # s between two reports of progress
PR_SET_PDEATHSIG = 1
# Nothing is wrong with a task that meets these: the machine has to be put right first.
OF_MACHINE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.EFBIG)


class MachineError(OSError):
    """Something to put right on the machine: nothing is wrong with the task."""


@dataclass(frozen=True)
class Outcome:
    """How a task ended.

    Attributes:
        state: "ready" before the first task; "done"; "failed" for a fault of the task; "machine" for one of the
            machine, such as a full disk; "busy" if another process is at work on it; "skipped" if it was not tried
            because one that it needs has failed.
        said: The result, or the reason in a line.
        stage: Where it failed.
        cause: Of a "skipped" job: the job that failed.
    """

    state: str
    said: Any = None
    stage: str = ""
    cause: str = ""


class Reporting(Console):
    """A console that passes its display to the parent process; notes go to the log."""

    def __init__(self, tell: Callable[[tuple[str, int, int, str]], None]) -> None:
        super().__init__(stream=sys.stderr)
        self.tell, self.last = tell, 0.0

    @contextmanager
    def progress(self, stage: str, parts: Mapping[str, int] | None = None) -> Iterator[Update]:
        """Report how far `stage` is, not too often."""

        def update(done: int, total: int, what: str) -> None:
            now = time.monotonic()
            if now - self.last >= BETWEEN:
                self.last = now
                self.tell((stage, done, total, what))

        self.tell((stage, 0, 0, ""))
        yield update


def main() -> None:
    """Do tasks until the parent ends or says so."""
    settle()
    connection, place = Connection(int(sys.argv[1])), sys.argv[2]
    parent = os.getppid()
    _end_with_parent()
    if os.getppid() != parent:
        return  # it ended before that
    tasks: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(connection, tasks), daemon=True).start()
    try:
        refused = arrive()  # before a task is unpacked, whose classes may be of a plugin
        connection.send(Outcome("ready"))
        # Until it has loaded, a signal to stop ends the process: an exception raised inside an import can be lost.
        with suppress(Exception):  # said with the first task, whose function it is
            function_at(place)
        signal.signal(signal.SIGTERM, _stop)
        while (request := pickle.loads(tasks.get())) is not None:
            connection.send(Outcome("machine", refused) if refused else _outcome(place, request, connection))
    except (KeyboardInterrupt, BrokenPipeError):
        pass
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)  # without the seconds that the libraries take to clear up


def _listen(connection: Connection, tasks: "queue.SimpleQueue[bytes]") -> None:
    """Pass on tasks. When the parent ends, this process ends too, even at work.

    They stay packed: unpacking imports modules, and two threads that import the same ones meet them half made.
    """
    while True:
        try:
            tasks.put(connection.recv_bytes())
        except (EOFError, OSError):  # the parent is gone
            os.kill(os.getpid(), signal.SIGKILL)


def _end_with_parent() -> None:
    """Let the kernel kill this process with its parent; a thread that listens does elsewhere, if it gets to run."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


def _stop(*_: object) -> NoReturn:
    raise KeyboardInterrupt


def _outcome(place: str, request: Mapping[str, Any], connection: Connection) -> Outcome:
    """Do a task."""
    try:
        _log_to(Path(request["log"]))
        console = Reporting(connection.send)
    except ValueError as error:  # of a name that somebody has put something else at
        return Outcome("machine", f"cannot write a log: {brief(error)}")
    except OSError as error:
        return Outcome("machine", f"cannot write the log {request['log']}: {error.strerror or error}")
    try:
        work, task = function_at(place), request["task"]
        signal.signal(signal.SIGTERM, _stop)  # a library may have taken it over
        return Outcome("done", work(pickle.loads(task) if isinstance(task, bytes) else task, console))
    except BlockingIOError as error:
        return Outcome("busy", brief(error))
    except (KeyboardInterrupt, BrokenPipeError):
        raise
    except BaseException as error:  # panics of libraries written in Rust are not Exceptions
        traceback.print_exc()
        return failure(error, getattr(error, "stage", ""))


def function_at(place: str) -> Callable[[Any, Console], Any]:
    """The function MODULE:FUNCTION that does tasks."""
    function: Callable[[Any, Console], Any] = loaded(place)
    return function


def failure(error: BaseException, stage: str) -> Outcome:
    """How a task ended that raised this."""
    if isinstance(error, MachineError) or (isinstance(error, OSError) and _is_of_machine(error)):
        return Outcome("machine", brief(error), stage)
    said = brief(error) or "no message"
    expected = isinstance(error, ValueError | OSError | MemoryError)
    return Outcome("failed", said if expected else f"unexpected {type(error).__name__}: {said}", stage)


def _is_of_machine(error: OSError) -> bool:
    """By its number, or by the system's words where a library in C++ has passed on no number."""
    if error.errno is not None:
        return error.errno in OF_MACHINE
    return any(os.strerror(number) in str(error) for number in OF_MACHINE)


def _log_to(path: Path) -> None:
    """From here on everything printed, by libraries written in C too, goes to the end of a file."""
    sys.stdout.flush()
    sys.stderr.flush()
    path.parent.mkdir(parents=True, exist_ok=True)
    log = descriptor_of_our_own(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr] # who reads it must not wait for the next task
    faulthandler.enable(sys.__stderr__)  # type: ignore[arg-type]
