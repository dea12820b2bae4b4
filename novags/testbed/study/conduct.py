"""A study from its file to its tables: plan, do the missing tasks, keep the known failures, write the rows."""

import os
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.ledger.contents import read_json, write_json
from novags.testbed.ledger.store import SEAL, costs, read_seal
from novags.testbed.study.costs import Costs, longest_after, time_left
from novags.testbed.study.elsewhere.nodes import keep_scores
from novags.testbed.study.engines.choice import Engine, Work, log_of
from novags.testbed.study.engines.progress import At, StudyProgress
from novags.testbed.study.engines.worker import Outcome
from novags.testbed.study.plan import StudyPlan
from novags.testbed.study.results import State, StudyTable, rows_before
from sensor_model.files.atomic import atomic

FAILURES = "failures.json"
KEPT = 0.05  # s; to compare a finished entry with its checksums
TABLES_EVERY = 10.0  # s; at least, between two writings of the tables while runs end


def there(plan: StudyPlan, store: Path) -> set[str]:
    """The entries that a store has, by their seals; whether their files have changed is seen when they are used."""
    return {key for key, task in plan.tasks.items() if _is_sealed(task.folder(store), key if task.place else None)}


def _is_sealed(folder: Path, key: str | None) -> bool:
    """Whether an entry has a seal; of this key where its name does not hold it."""
    if key is None:
        return (folder / SEAL).exists()
    with suppress(ValueError):  # a damaged one, which the entry itself says
        return (seal := read_seal(folder)) is not None and seal.key == key
    return False


def conduct(
    plan: StudyPlan, out: Path, store: Path, console: Console, engine: Engine, *, retry_failed: bool = False,
    known: Mapping[str, Outcome] | None = None, url: str | None = None,
    after: Callable[[list[Path]], None] | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Do the missing tasks of a study and write its tables; returns their rows.

    Args:
        plan: The study.
        out: Its folder, locked by the caller.
        store: The store.
        console: Where progress goes.
        engine: Where the work is done.
        retry_failed: Try failed tasks again.
        known: Entries that need not be looked at.
        url: Where the store is, if `store` holds only this machine's part of it.
        after: Called with the folders of all runs that are done, whenever one is.

    Raises:
        OSError: If the disk is full or may not be written to.
        KeyboardInterrupt: If it is interrupted; finished work is kept.
    """
    store.mkdir(parents=True, exist_ok=True)
    sealed = there(plan, store)
    table = StudyTable(plan, out, store, url, rows_before(plan, out, store, url, sealed))
    predicted = Costs.of(costs(store), engine.threads)
    watch = _Watch(plan, table, predicted, engine.places, StudyProgress(console, len(plan.ends)), known=sealed,
                   after=after)  # fmt: skip
    watch.failures = {} if retry_failed else read_failures(out, set(plan.tasks) - watch.known)
    if watch.failures or (out / FAILURES).exists():
        write_json(out / FAILURES, watch.failures)
    longest = longest_after(plan, watch.seconds_left())
    if plan.study.ends == "measurement":  # in turn, seeds last: other load on the machine meets all settings alike
        longest = {key: -float(place) for place, key in enumerate(plan.tasks)}
    failed = {key: Outcome("failed", f["reason"], f["stage"]) for key, f in watch.failures.items()}
    try:
        engine.run(Work(plan, out, store, predicted, longest, watch, {**failed, **(known or {})}))
    except BaseException:
        with suppress(OSError):  # a full disk: said by the first error
            table.write(watch.states)
        raise
    finally:
        watch.shown.close()
    return table.write(watch.states)


def read_failures(out: Path, keys: set[str]) -> dict[str, dict[str, str]]:
    """Which of these failed in earlier starts, and why."""
    path = out / FAILURES
    if not path.exists():
        return {}
    found = read_json(path, {"*": {"reason": str, "stage": str, "log": str}})
    return {key: failure for key, failure in found.items() if key in keys}


@dataclass
class _Watch:
    """Keeps the tables, the failures and the progress of a study up to date."""

    plan: StudyPlan
    table: StudyTable
    costs: Costs
    workers: int
    shown: StudyProgress
    known: set[str]  # entries that are there already, as far as one knows
    states: dict[str, State] = field(default_factory=dict)  # of runs
    failures: dict[str, dict[str, str]] = field(default_factory=dict)
    after: Callable[[list[Path]], None] | None = None
    over: set[str] = field(default_factory=set)
    under_way: dict[str, tuple[float, At]] = field(default_factory=dict)
    pace: dict[str, "Pace"] = field(default_factory=dict)  # of the stage that a task is at
    _write_at: float = 0.0
    _left: tuple[float, float] = (0.0, 0.0)  # seconds left, and when to count again

    def places(self, count: int) -> None:
        self.workers = count

    def started(self, key: str) -> None:
        self.under_way[key] = (time.monotonic(), ("starting", 0, 0, ""))

    def progress(self, key: str, stage: str, done: int, total: int, what: str) -> None:
        since, _ = self.under_way[key]
        self.under_way[key] = (since, (stage, done, total, what))
        pace = self.pace.get(key)
        if pace is None or (pace.stage, pace.total) != (stage, total) or done < pace.first:
            self.pace[key] = Pace(stage, total, done, time.monotonic())

    def ended(self, key: str, outcome: Outcome) -> None:
        task = self.plan.tasks[key]
        _, (stage, *_) = self.under_way.pop(key, (0.0, ("", 0, 0, "")))
        self.pace.pop(key, None)
        self.over.add(key)
        if outcome.state == "done" and outcome.said["made"]:
            self.costs.add(task.kind, outcome.said["cost"])
        if outcome.state == "done" and outcome.said.get("scores") is not None:
            keep_scores(task.folder(self.table.store), outcome.said["scores"])
        if outcome.state == "failed" and key not in self.failures:
            self._failed(key, outcome.said, outcome.stage or stage)
        if key in self.plan.ends:
            failure = self.failures.get(outcome.cause or key, {})
            self.states[key] = State(outcome.state, failure.get("reason"), failure.get("stage"), failure.get("log"))
            if outcome.state == "done" and self.after is not None:
                done = [each for each, state in self.states.items() if state.name == "done"]
                self.after([self.plan.tasks[each].folder(self.table.store) for each in done])
            if (start := time.monotonic()) >= self._write_at:
                self.table.write(self.states)
                now = time.monotonic()
                self._write_at = now + max(TABLES_EVERY, 50 * (now - start))  # at most 2 % of the time goes into this

    def _failed(self, key: str, reason: str, stage: str) -> None:
        """Keep a failure, unless it is the disk's."""
        probe = self.table.store / f".probe-{os.getpid()}"  # studies beside each other share the store
        with atomic(probe) as temporary:
            temporary.write_bytes(bytes(1 << 16))
        probe.unlink(missing_ok=True)
        task = self.plan.tasks[key]
        self.failures[key] = {"reason": reason, "stage": stage, "log": log_of(task)}
        write_json(self.table.out / FAILURES, self.failures)
        self.note(
            f"failed: {stage or 'start'} of {task.place or task.name}: {reason} (log: {log_of(task)}); the rest goes on"
        )

    def note(self, text: str) -> None:
        self.shown.note(text)

    def tick(self) -> None:
        done = list(self.states.values())
        failed = sum(state.name != "done" for state in done)
        names = {key: self.plan.tasks[key].title for key in self.under_way}
        under_way = {key: (names[key], at) for key, (_, at) in self.under_way.items()}
        start = time.monotonic()
        if start >= self._left[1]:
            left = time_left(self.plan, self.seconds_left(), self.workers)
            now = time.monotonic()
            self._left = left, now + max(2.0, 100 * (now - start))  # at most 1 % of the time goes into this
        self.shown.show(len(done), failed, under_way, self._left[0])

    def seconds_left(self) -> dict[str, float]:
        """Predicted seconds of every task that is not over; of one under way at least what its own pace says."""
        found, now = {}, time.monotonic()
        for key, task in self.plan.tasks.items():
            if key not in self.over:
                found[key] = KEPT if key in self.known else self.costs.predicted(task).seconds
                if key in self.under_way:
                    since, (_, done, _, _) = self.under_way[key]
                    measured = self.pace[key].left(done, now) if key in self.pace else 0.0
                    found[key] = max(found[key] - (now - since), measured, 0.0)
        return found


@dataclass(frozen=True)
class Pace:
    """When a stage of a task began, as its progress told."""

    stage: str
    total: int  # steps in all
    first: int  # steps done when it was first heard of
    since: float  # s, `time.monotonic`

    def left(self, done: int, now: float) -> float:
        """Seconds that the rest of the stage takes at the pace so far; 0 before a step is done."""
        return (now - self.since) / (done - self.first) * max(self.total - done, 0) if done > self.first else 0.0
