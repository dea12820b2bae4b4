"""A worker process as its parent sees it."""

import os
import subprocess
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from signal import Signals
from typing import Any

from novags.testbed.console.cores import cores_here
from novags.testbed.console.memory import resident_bytes
from sensor_model.files import outside
from sensor_model.files.python import python

TASKS = "novags.testbed.study.steps:make"  # the code of the workers of a study
# Ctrl-C on a terminal reaches all its processes: the parent decides on the fate of its workers.
PROGRAM = """import signal
signal.signal(signal.SIGINT, signal.SIG_IGN)
from novags.testbed.study.engines.worker import main
main()"""


def threads_of(workers: int) -> int:
    """Threads of each, where so many processes share the cores."""
    return max(1, cores_here() // workers)


def threads_environment(threads: int) -> dict[str, str]:
    """Variables that limit the threads of a process from its start. Dr.Jit reads none of these: renders share all
    cores.
    """
    names = ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR")
    return {f"{name}_NUM_THREADS": str(threads) for name in names}


@dataclass
class Worker:
    """A process, and the job that it is at."""

    process: "subprocess.Popen[bytes]"
    connection: Connection
    key: str | None = None
    since: float = 0.0  # of the monotonic clock
    late: bool = False  # that was said
    ready: bool = False  # it has begun to listen
    environment: Mapping[str, str] = field(default_factory=dict)  # that it was started with

    @staticmethod
    def start(place: str, environment: Mapping[str, str]) -> "Worker":
        """Start one that does jobs by the function MODULE:FUNCTION, which it loads meanwhile."""
        ours, theirs = Pipe()
        variables = {**os.environ, **outside.environment(), **environment}
        process = subprocess.Popen(
            python(PROGRAM, str(theirs.fileno()), place), pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, env=variables,
        )  # fmt: skip
        theirs.close()
        return Worker(process, ours, environment=environment)

    def give(self, key: str, request: Mapping[str, Any], now: float) -> None:
        """Give it a job."""
        self.key, self.since, self.late = key, now, False
        with suppress(OSError):  # it died while it waited, which the next look at its pipe shows
            self.connection.send(request)

    @property
    def resident(self) -> int:
        """Bytes that it holds now."""
        return resident_bytes(self.process.pid)

    def death(self) -> str:
        """How the process ended."""
        code = self.process.wait()
        if code >= 0:
            return f"its process ended with exit code {code}"
        name = Signals(-code).name if -code in set(Signals) else f"signal {-code}"
        hint = ", as the system does when memory runs out" if name == "SIGKILL" else ""
        return f"its process was ended by {name}{hint}"

    def ask_to_stop(self) -> None:
        """Let it mark how far it is and end; one without a job has nothing to mark."""
        if self.key is None:
            self.process.kill()
        else:
            self.process.terminate()

    def stop(self, seconds: float) -> None:
        """Wait for it so long, then end it."""
        try:
            self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.connection.close()


@contextmanager
def started_ahead(workers: int | None) -> Iterator[list[Worker]]:
    """A worker for a study that is yet to be read, if a core is free for it: both take seconds to load libraries.

    Args:
        workers: As many as the study will have; None: one for each core.
    """
    count = workers or cores_here()
    ahead = [Worker.start(TASKS, threads_environment(threads_of(count)))] if count > 0 and cores_here() > 1 else []
    try:
        yield ahead
    finally:
        for worker in ahead:
            worker.ask_to_stop()
            worker.stop(0.0)
