"""Many jobs on one machine: worker processes side by side, as many as cores and memory allow."""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from typing import Any

from novags.testbed.console.memory import available_bytes
from novags.testbed.study.engines.processes import Worker
from novags.testbed.study.engines.queue import Job, Queue, Watcher, lateness
from novags.testbed.study.engines.worker import Outcome

LOOK = 0.5  # s between two looks at the free memory
STOP = 10.0  # s that workers get to mark how far they are
MARGIN = 1.2  # times the predicted memory is kept free for a job


@dataclass(frozen=True)
class PoolLimits:
    """What a pool may use, and its knowledge of jobs by their keys.

    Attributes:
        workers: Processes at a time.
        memory: Bytes that a job will take at its peak.
        seconds: That it will take.
        order: Of the jobs that can start, the job with the largest number goes first.
    """

    workers: int
    memory: Callable[[str], float] = lambda key: 0.0
    seconds: Callable[[str], float] = lambda key: 0.0
    order: Callable[[str], float] = lambda key: 0.0


@dataclass
class Pool:
    """Jobs done by worker processes.

    Attributes:
        place: MODULE:FUNCTION that does a job, see `worker`.
        request: The message to a worker for a job, from its key and the results of the jobs it needs.
        limits: The memory that may be used.
        watcher: Hears when tasks start, proceed and end.
        environment: Variables of the workers, beside this process's own.
        workers: The present workers; they end with the pool.
    """

    place: str
    request: Callable[[str, Mapping[str, Any]], Mapping[str, Any]]
    limits: PoolLimits
    watcher: Watcher
    environment: Mapping[str, str] = field(default_factory=dict)
    workers: list[Worker] = field(default_factory=list)
    queue: Queue = field(init=False)

    def __post_init__(self) -> None:
        self.queue = Queue(self.watcher, self.limits.order)

    def run(self, jobs: Iterable[Job], known: Mapping[str, Outcome] | None = None) -> dict[str, Outcome]:
        """Do all jobs, each after the jobs it needs; returns how each ended.

        Args:
            jobs: The jobs.
            known: How some of them have ended before; they are not tried.

        Raises:
            OSError: If the machine cannot go on, because a disk is full, say. Finished work is kept.
        """
        try:
            self.queue.fill(jobs, known or {})
            while self.queue:
                self._start_what_fits()
                self._hear()
                self.watcher.tick()
            return self.queue.outcomes
        finally:
            self._stop()

    @property
    def _busy(self) -> list[Worker]:
        return [worker for worker in self.workers if worker.key is not None]

    def _start_what_fits(self) -> None:
        for key in self.queue.ready():
            if len(self._busy) >= self.limits.workers:
                return
            if self._fits(key):  # if not, a smaller one may
                self._start(key)

    def _start(self, key: str) -> None:
        # the one whose memory `_fits` counts as the job's already
        idle = max((w for w in self.workers if w.key is None), key=lambda w: w.resident, default=None)
        if idle is None:
            idle = Worker.start(self.place, self.environment)
            self.workers.append(idle)
        request = self.request(key, self.queue.take(key))
        self.watcher.started(key)
        idle.give(key, request, time.monotonic())

    def _fits(self, key: str) -> bool:
        """Whether memory holds one more job: the predicted growth of the others counts as taken."""
        if not self._busy:
            return True  # waiting would not make more room
        needed = self._memory(key) - max((w.resident for w in self.workers if w.key is None), default=0)
        needed += sum(max(0.0, self._memory(w.key) - w.resident) for w in self._busy if w.key is not None)
        if needed <= (free := available_bytes()):
            return True
        self.queue.say_once(
            "memory",
            f"memory allows {len(self._busy)} of {self.limits.workers} tasks at a time: the next needs "
            f"{needed / 1e9:.1f} GB with those under way, {free / 1e9:.1f} GB are free",
        )
        return False

    def _memory(self, key: str) -> float:
        return MARGIN * self.limits.memory(key)

    def _hear(self) -> None:
        """Wait a little for messages, and take all that came."""
        if not self.workers:
            time.sleep(LOOK)  # another process is at work on all remaining tasks
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
            raise OSError(f"{outcome.said}: finished work is kept; fix that and run the same command again")
        if outcome.state == "busy":
            self.queue.busy(key, outcome.said)
        else:
            self.queue.end(key, outcome)

    def _died(self, worker: Worker) -> None:
        self.workers.remove(worker)
        worker.connection.close()
        said = worker.death()
        if not worker.ready:
            raise OSError(f"a worker could not start: {said}; its output stands above")
        if worker.key is not None:
            self.queue.end(worker.key, Outcome("failed", said))

    def _look_at_clock(self, worker: Worker) -> None:
        assert worker.key is not None
        said = lateness(time.monotonic() - worker.since, self.limits.seconds(worker.key))
        if said is not None and not worker.late:
            worker.late = True
            self.watcher.note(f"{said} (process {worker.process.pid})")

    def _stop(self) -> None:
        for worker in self.workers:
            worker.ask_to_stop()
        until = time.monotonic() + STOP
        for worker in self.workers:
            worker.stop(max(0.0, until - time.monotonic()))
        self.workers.clear()
