"""Costs of tasks: seconds, memory, disk, predicted from the costs of finished ones in the store.

Seconds grow with the work, memory and disk with the pixels of all views, each from a constant. `DEFAULTS` are rough
guesses, for a store that is still empty. The entries of the store correct them: a prediction is multiplied by the
median ratio of measured to predicted over the entries most like the task.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from novags.testbed.study.plan import StudyPlan, Task

UNITS = {"set": "pixels x samples", "capture": "pixels", "run": "iterations x (pixels of a view + points)"}
NEAREST = 5  # entries that a ratio is taken from


@dataclass(frozen=True)
class Cost:
    """The cost of one task."""

    seconds: float
    memory: float  # bytes, at the peak
    disk: float  # bytes

    def times(self, other: "Cost") -> "Cost":
        """Each number multiplied by the other's."""
        return Cost(self.seconds * other.seconds, self.memory * other.memory, self.disk * other.disk)


@dataclass(frozen=True)
class LinearCost:
    """A cost that grows from a constant."""

    constant: float
    slope: float

    def at(self, x: float) -> float:
        """Its value."""
        return self.constant + self.slope * x


# Seconds over work, memory and disk over pixels: guesses of the right order, of a thread of a laptop.
DEFAULTS: dict[str, tuple[LinearCost, LinearCost, LinearCost]] = {
    "set": (LinearCost(3.0, 2.5e-7), LinearCost(6e8, 60.0), LinearCost(3e4, 45.0)),
    "capture": (LinearCost(0.5, 4e-6), LinearCost(8.2e8, 300.0), LinearCost(3e4, 45.0)),
    "run": (LinearCost(4.0, 1.5e-6), LinearCost(9e8, 400.0), LinearCost(1e6, 60.0)),
    "measurement": (
        LinearCost(10.0, 0.0),
        LinearCost(1e9, 0.0),
        LinearCost(3e3, 0.0),
    ),  # its cost is known of its like alone
}


def default(kind: str, work: float, pixels: float, peak: float = 0.0, held: float = 0.0) -> Cost:
    """The cost of a task as `DEFAULTS` has it; `peak`: `Task.memory`, `held`: `Task.disk`."""
    seconds, memory, disk = DEFAULTS[kind]
    return Cost(seconds.at(work), peak or memory.at(pixels), held or disk.at(pixels))


@dataclass
class Costs:
    """Measured costs, and predictions from them."""

    measured: dict[str, list[tuple[str, int, float, Cost]]] = field(default_factory=dict)  # by kind
    threads: Mapping[str, int] = field(default_factory=dict)  # of each task of this study, by kind; 1 if it is missing
    _ratios: dict[tuple[str, str, float], Cost] = field(default_factory=dict)

    @staticmethod
    def of(entries: Iterable[Mapping[str, Any]], threads: Mapping[str, int]) -> "Costs":
        """The costs of the entries of a store, as `store.costs` gives them."""
        costs = Costs(threads=threads)
        for entry in entries:
            costs.add(entry["kind"], entry)
        return costs

    def add(self, kind: str, cost: Mapping[str, Any]) -> None:
        """Take a finished task into account; `cost` as in its seal."""
        expected = default(kind, cost["work"], cost["pixels"], cost.get("memory", 0.0), cost.get("disk", 0.0))
        ratio = Cost(
            sum(cost["seconds"].values()) / expected.seconds, cost["peak_bytes"] / expected.memory,
            cost["bytes"] / expected.disk,
        )  # fmt: skip
        self.measured.setdefault(kind, []).append((cost["group"], cost["threads"], cost["work"], ratio))
        self._ratios.clear()

    def predicted(self, task: Task) -> Cost:
        """The predicted cost of a task."""
        expected = default(task.kind, task.work, task.pixels, task.memory, task.disk)
        place = (task.kind, task.group, task.work)
        if place not in self._ratios:
            self._ratios[place] = self._ratio(*place)
        return expected.times(self._ratios[place])

    def known(self, task: Task) -> bool:
        """Whether anything of its kind was measured."""
        return bool(self.measured.get(task.kind))

    def _ratio(self, kind: str, group: str, work: float) -> Cost:
        rows = self.measured.get(kind, [])
        if not rows:
            return Cost(1.0, 1.0, 1.0)

        threads = self.threads.get(kind, 1)

        def unlike(row: tuple[str, int, float, Cost]) -> tuple[bool, bool, bool, float]:
            kin = row[0].partition(":")[0] == group.partition(":")[0]
            return row[0] != group, not kin, row[1] != threads, abs(math.log(max(row[2], 1.0) / max(work, 1.0)))

        alike = sorted(rows, key=unlike)
        first = unlike(alike[0])[:3]
        near = [row[3] for row in alike[:NEAREST] if unlike(row)[:3] == first]
        return Cost(*(median(getattr(ratio, name) for ratio in near) for name in ("seconds", "memory", "disk")))


def longest_after(plan: StudyPlan, seconds: Mapping[str, float]) -> dict[str, float]:
    """Seconds from the start of each task to the end of the longest chain of tasks that begins with it."""
    after = dict(seconds)
    for key, task in reversed(plan.tasks.items()):  # each comes after the tasks it needs
        for need in task.needs:
            after[need] = max(after[need], seconds[need] + after[key])
    return after


def time_left(plan: StudyPlan, seconds: Mapping[str, float], workers: int) -> float:
    """Seconds until all of these tasks are done: shared by the workers, but no less than the longest chain.

    Args:
        plan: The plan.
        seconds: Of each task that is not done yet; the others count as 0.
        workers: Tasks at a time.
    """
    every = {key: seconds.get(key, 0.0) for key in plan.tasks}
    return max(sum(every.values()) / workers, max(longest_after(plan, every).values(), default=0.0))
