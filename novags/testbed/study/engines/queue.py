"""Which jobs of an engine can start, in which order, and how each has ended."""

import heapq
import time
from bisect import insort
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from novags.testbed.study.engines.worker import Outcome

AGAIN = 2.0  # s until a job that another process is at work on is tried again
LATE, LATE_SECONDS = 10.0, 300.0  # beyond so many times its predicted seconds, and so many, a job is said to be late


class Job(Protocol):
    """Something to do once others are done."""

    @property
    def key(self) -> str:
        """Its name here."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Jobs that come before it."""


class Watcher(Protocol):
    """Hears when tasks start, proceed and end."""

    def places(self, count: int) -> None:
        """So many jobs can run at a time now."""

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
class Queue:
    """Jobs between their wait for others and their end. No step looks at all jobs: there may be a hundred thousand.

    Attributes:
        watcher: Hears when tasks start, proceed and end.
        order: Of the jobs that can start, the job with the largest number comes first.
        outcomes: How jobs ended, by key.
    """

    watcher: Watcher
    order: Callable[[str], float]
    outcomes: dict[str, Outcome] = field(default_factory=dict)
    _jobs: dict[str, Job] = field(default_factory=dict)
    _users: dict[str, list[str]] = field(default_factory=dict)  # jobs that need one
    _missing: dict[str, int] = field(default_factory=dict)  # needs that are not done, of the jobs that wait for others
    _ready: list[tuple[float, str]] = field(default_factory=list)  # sorted
    _later: list[tuple[float, str]] = field(default_factory=list)  # a heap: when to try again, by the monotonic clock
    _said: set[str] = field(default_factory=set)

    def fill(self, jobs: Iterable[Job], known: Mapping[str, Outcome]) -> None:
        """Take jobs, some of which have ended before."""
        self._jobs = {job.key: job for job in jobs}
        for key, job in self._jobs.items():
            for need in dict.fromkeys(job.needs):
                self._users.setdefault(need, []).append(key)
            self._missing[key] = len(set(job.needs))
        for key, missing in self._missing.items():
            if not missing and key not in known:
                insort(self._ready, (-self.order(key), key))
        for key in [key for key in self._jobs if key in known]:
            if key not in self.outcomes:  # it may have been skipped because of another one
                self.end(key, known[key])

    def __bool__(self) -> bool:
        """Whether any job has not ended."""
        return len(self.outcomes) < len(self._jobs)

    def ready(self) -> list[str]:
        """The jobs that can start now, in order; `take` the started ones."""
        while self._later and self._later[0][0] <= time.monotonic():
            _, key = heapq.heappop(self._later)
            insort(self._ready, (-self.order(key), key))
        return [key for _, key in self._ready]

    def take(self, key: str) -> dict[str, Any]:
        """A job starts; returns the results of the jobs it needs."""
        self._ready.remove((-self.order(key), key))
        return {need: self.outcomes[need].said for need in self._jobs[key].needs}

    def busy(self, key: str, said: str) -> None:
        """Another process is at work on a job that was to start: try it again later."""
        heapq.heappush(self._later, (time.monotonic() + AGAIN, key))
        self.say_once(f"busy {key}", f"{said}; other work goes on meanwhile")

    def end(self, key: str, outcome: Outcome) -> None:
        """Note the end of a job, and of all that need it if it failed."""
        self.outcomes[key] = outcome
        self.watcher.ended(key, outcome)
        for user in self._users.get(key, []):
            if user in self.outcomes:
                continue
            if outcome.state != "done":
                self.end(user, Outcome("skipped", outcome.said, outcome.stage, outcome.cause or key))
                continue
            self._missing[user] -= 1
            if not self._missing[user]:
                insort(self._ready, (-self.order(user), user))

    def say_once(self, what: str, text: str) -> None:
        """Tell the watcher, unless that was told before."""
        if what not in self._said:
            self._said.add(what)
            self.watcher.note(text)


def lateness(taken: float, expected: float) -> str | None:
    """A note on a job that takes much longer than predicted; None for any other."""
    if taken <= max(LATE_SECONDS, LATE * expected):
        return None
    return (f"a task has run for {taken / 60:.0f} min, {taken / max(expected, 1e-9):.0f} times the prediction; "
            "it goes on")  # fmt: skip
