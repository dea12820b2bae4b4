"""Many jobs on one machine: worker processes side by side, as many as cores and memory allow."""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from typing import Any, Protocol

from novags.testbed.machine.memory import available_bytes
from novags.testbed.study.engines.processes import Worker
from novags.testbed.study.engines.worker import Outcome

LOOK = 0.5  # s between two looks at what is free
AGAIN = 2.0  # s until a job that another process is at work on is tried again
LATE, LATE_SECONDS = 10.0, 300.0  # beyond so many times its predicted seconds, and so many, a job is said to be late
STOP = 10.0  # s that workers get to mark how far they are
MARGIN = 1.2  # times the predicted memory is kept free for a job


class Job(Protocol):
    """Something to do once others are done."""

    @property
    def key(self) -> str:
        """What it is called here."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Jobs that come before it."""


@dataclass(frozen=True)
class Limits:
    """What a pool may use, and what it knows of jobs by their keys.

    Attributes:
        workers: Processes at a time.
        memory: Bytes that a job will take at its peak.
        seconds: That it will take.
        order: Of the jobs that can start, the one with the largest goes first.
    """

    workers: int
    memory: Callable[[str], float] = lambda key: 0.0
    seconds: Callable[[str], float] = lambda key: 0.0
    order: Callable[[str], float] = lambda key: 0.0


class Watcher(Protocol):
    """Who is told what happens."""

    def started(self, key: str) -> None:
        """A job has begun."""

    def progress(self, key: str, stage: str, done: int, total: int, what: str) -> None:
        """How far it is."""

    def ended(self, key: str, outcome: Outcome) -> None:
        """It is over; as "skipped" if one that it needs has failed."""

    def note(self, text: str) -> None:
        """Something that a user should know."""

    def tick(self) -> None:
        """Some time has passed."""


@dataclass
class Pool:
    """Jobs done by worker processes.

    Attributes:
        place: MODULE:FUNCTION that does a job, see `worker`.
        request: What a worker is sent for a job, from its key and the results of those that it needs.
        limits: What may be used.
        watcher: Who is told.
        environment: Variables of the workers, beside those of this process.
    """

    place: str
    request: Callable[[str, Mapping[str, Any]], Mapping[str, Any]]
    limits: Limits
    watcher: Watcher
    environment: Mapping[str, str] = field(default_factory=dict)
    workers: list[Worker] = field(default_factory=list)
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    _jobs: dict[str, Job] = field(default_factory=dict)
    _todo: dict[str, float] = field(default_factory=dict)  # when a job may start, by the monotonic clock
    _said: set[str] = field(default_factory=set)

    def run(self, jobs: Iterable[Job], known: Mapping[str, Outcome] | None = None) -> dict[str, Outcome]:
        """Do all jobs, each after those that it needs; returns how each ended.

        Args:
            jobs: The jobs.
            known: How some of them have ended before; they are not tried.

        Raises:
            OSError: If the machine cannot go on, because a disk is full, say. What is finished is kept.
        """
        self._jobs = {job.key: job for job in jobs}
        self._todo = dict.fromkeys(self._jobs, 0.0)
        try:
            for key, outcome in (known or {}).items():
                if key in self._todo:
                    self._end(key, outcome)
            while self._todo or self._busy:
                self._start_what_fits()
                self._hear()
                self.watcher.tick()
            return self.outcomes
        finally:
            self._stop()

    @property
    def _busy(self) -> list[Worker]:
        return [worker for worker in self.workers if worker.key is not None]

    def _start_what_fits(self) -> None:
        now = time.monotonic()
        ready = [key for key, since in self._todo.items()
                 if since <= now and all(need in self.outcomes for need in self._jobs[key].needs)]  # fmt: skip
        for key in sorted(ready, key=self.limits.order, reverse=True):
            if len(self._busy) >= self.limits.workers:
                return
            if self._fits(key):  # if not, a smaller one may
                self._start(key, now)

    def _start(self, key: str, now: float) -> None:
        idle = next((worker for worker in self.workers if worker.key is None), None)
        if idle is None:
            idle = Worker.start(self.place, self.environment)
            self.workers.append(idle)
        results = {need: self.outcomes[need].said for need in self._jobs[key].needs}
        del self._todo[key]
        self.watcher.started(key)
        idle.give(key, self.request(key, results), now)

    def _fits(self, key: str) -> bool:
        """Whether memory holds one more job: what the others will still take counts as taken."""
        if not self._busy:
            return True  # waiting would not make more room
        needed = self._memory(key) - max((w.resident for w in self.workers if w.key is None), default=0)
        needed += sum(max(0.0, self._memory(w.key) - w.resident) for w in self._busy if w.key is not None)
        if needed <= (free := available_bytes()):
            return True
        self._say_once("memory", f"memory allows {len(self._busy)} of {self.limits.workers} tasks at a time: the next "
                       f"needs {needed / 1e9:.1f} GB with those under way, {free / 1e9:.1f} GB are free")  # fmt: skip
        return False

    def _memory(self, key: str) -> float:
        return MARGIN * self.limits.memory(key)

    def _hear(self) -> None:
        """Wait a little for messages, and take those that came."""
        if not self.workers:
            time.sleep(LOOK)  # another process is at work on all that is left
        told = wait([worker.connection for worker in self.workers], LOOK)
        for worker in [worker for worker in self.workers if worker.connection in told]:
            try:
                message = worker.connection.recv()
            except (EOFError, OSError):
                self._died(worker)
                continue
            if isinstance(message, Outcome) and message.state == "ready":
                worker.ready = True
            elif isinstance(message, Outcome) and worker.key is not None:
                self._answered(worker, worker.key, message)
            elif worker.key is not None:
                self.watcher.progress(worker.key, *message)
        for worker in self._busy:
            self._look_at_clock(worker)

    def _answered(self, worker: Worker, key: str, outcome: Outcome) -> None:
        worker.key = None
        if outcome.state == "machine":
            raise OSError(f"{outcome.said}: what is finished is kept; mend that and run the same command again")
        if outcome.state == "busy":
            self._todo[key] = time.monotonic() + AGAIN
            self._say_once(f"busy {key}", f"{outcome.said}; other work goes on meanwhile")
        else:
            self._end(key, outcome)

    def _died(self, worker: Worker) -> None:
        self.workers.remove(worker)
        worker.connection.close()
        said = worker.death()
        if not worker.ready:
            raise OSError(f"a worker could not start: {said}; what it printed stands above")
        if worker.key is not None:
            self._end(worker.key, Outcome("failed", said))

    def _end(self, key: str, outcome: Outcome) -> None:
        """Note the end of a job, and of all that need it if it failed."""
        self._todo.pop(key, None)
        self.outcomes[key] = outcome
        self.watcher.ended(key, outcome)
        if outcome.state != "done":
            for other in [other for other in self._todo if key in self._jobs[other].needs]:
                if other in self._todo:  # it may have ended with another one by now
                    self._end(other, Outcome("skipped", outcome.said, outcome.stage, outcome.cause or key))

    def _look_at_clock(self, worker: Worker) -> None:
        assert worker.key is not None
        expected = self.limits.seconds(worker.key)
        taken = time.monotonic() - worker.since
        if not worker.late and taken > max(LATE_SECONDS, LATE * expected):
            worker.late = True
            self.watcher.note(f"a task has run for {taken / 60:.0f} min, {taken / max(expected, 1e-9):.0f} times what "
                              f"was predicted (process {worker.process.pid}); it goes on")  # fmt: skip

    def _say_once(self, what: str, text: str) -> None:
        if what not in self._said:
            self._said.add(what)
            self.watcher.note(text)

    def _stop(self) -> None:
        for worker in self.workers:
            worker.ask_to_stop()
        until = time.monotonic() + STOP
        for worker in self.workers:
            worker.stop(max(0.0, until - time.monotonic()))
        self.workers.clear()
