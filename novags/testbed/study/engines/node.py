"""Code on the nodes of a Ray cluster: each Ray worker hands its tasks to a process as `local` has them.

That process has its threads limited from its start, its output goes to the log of the task, and a library that crashes
takes it alone. It stays for the next task with the same environment, and ends with the Ray worker.
"""

import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from signal import SIGKILL, SIGTERM
from typing import Any

from novags.testbed.study.engines.processes import Worker
from novags.testbed.study.engines.worker import Outcome
from sensor_model.files.door import read_text

LOOK = 0.5  # s between two looks whether the task has been cancelled
STOP = 10.0  # s that a task gets to mark how far it is
LOG = 200_000  # bytes of a task's output that are kept

Tell = Callable[[tuple[Any, ...]], None]


class Lost(Exception):
    """The process of a task was killed from outside: Ray tries it again.

    Args:
        said: How it ended.
        log: Its output so far.
    """

    def __init__(self, said: str, log: str) -> None:
        super().__init__(said, log)  # both, because exceptions travel as their arguments
        self.said, self.log = said, log


@dataclass(frozen=True)
class Done:
    """The answer of a node: how a task ended, its output, and where it was done."""

    outcome: Outcome
    log: str
    node: str


_kept: dict[tuple[Any, ...], Worker] = {}  # at most one, by its settings


def do(place: str, request: Mapping[str, Any], environment: Mapping[str, str], tell: Tell) -> tuple[Outcome, str]:
    """Do a task; returns how it ended and its output.

    Args:
        place: MODULE:FUNCTION that does it, see `worker`.
        request: The task; "marker" is a file that must hold a text, or None.
        environment: Variables of its process.
        tell: Is told how far it is.

    Raises:
        Lost: If its process was killed.
    """
    if (reason := _unseen(request["marker"])) is not None:
        return Outcome("machine", reason), ""
    handle, log = tempfile.mkstemp(prefix="novags-log-", suffix=".txt")
    os.close(handle)
    try:
        worker = _worker(place, environment)
        worker.give("task", {"task": request["task"], "log": log}, 0.0)
        outcome = _outcome(worker, tell)
        worker.key = None
        if outcome is not None:
            return outcome, _end_of(log)
        _kept.clear()
        return _death(worker, log), _end_of(log)
    except KeyboardInterrupt:  # cancelled
        _end_kept()
        raise
    finally:
        with suppress(OSError):
            os.unlink(log)


def _unseen(marker: tuple[str, str] | None) -> str | None:
    """Why this node does not see the store that all share; None if it does."""
    if marker is None:
        return None
    path, text = Path(marker[0]), marker[1]
    with suppress(OSError):
        if read_text(path) == text:
            return None
    return f"{os.uname().nodename} does not see the store {path.parent}: give --store a folder of all nodes, or a URL"


def _worker(place: str, environment: Mapping[str, str]) -> Worker:
    kind = (place, *sorted(environment.items()), os.environ.get("CUDA_VISIBLE_DEVICES"))
    if kind not in _kept:
        _end_kept()
        _kept[kind] = Worker.start(place, environment)
    return _kept[kind]


def _end_kept() -> None:
    for worker in _kept.values():
        worker.ask_to_stop()
        worker.stop(STOP)
    _kept.clear()


def _outcome(worker: Worker, tell: Tell) -> Outcome | None:
    """Pass on the reports of a process until its task is over; None if the process ends first."""
    while True:
        if not worker.connection.poll(LOOK):
            continue
        try:
            message = worker.connection.recv()
        except (EOFError, OSError):
            return None
        if not isinstance(message, Outcome):
            tell(message)
        elif message.state != "ready":
            return message
        else:
            worker.ready = True


def _death(worker: Worker, log: str) -> Outcome:
    worker.connection.close()
    said = worker.death()
    if worker.process.returncode in (-SIGKILL, -SIGTERM):
        raise Lost(said, _end_of(log))
    return Outcome("failed" if worker.ready else "machine", said)


def _end_of(log: str) -> str:
    with open(log, "rb") as file:
        file.seek(max(0, os.path.getsize(log) - LOG))
        return file.read().decode("utf-8", "replace")
