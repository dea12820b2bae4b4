"""Engines for studies: this machine, or a Ray cluster."""

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from novags.testbed.console.cores import cores_here
from novags.testbed.ledger.store import KINDS
from novags.testbed.study.costs import Costs
from novags.testbed.study.elsewhere import nodes
from novags.testbed.study.engines.cluster import Cluster, Terms
from novags.testbed.study.engines.local import MARGIN, Pool, PoolLimits
from novags.testbed.study.engines.needs import Needs, resources
from novags.testbed.study.engines.processes import TASKS, Worker, threads_environment, threads_of
from novags.testbed.study.engines.queue import Watcher
from novags.testbed.study.engines.worker import Outcome
from novags.testbed.study.entry import Order, Task
from novags.testbed.study.plan import StudyPlan
from sensor_model.files import outside
from sensor_model.files.atomic import write_text
from sensor_model.files.door import read_text

MARKER = ".novags-store"  # in a store that nodes share: all must see the same folder


@dataclass(frozen=True)
class Work:
    """A study and the predictions of its tasks.

    Attributes:
        plan: The study.
        out: Its folder.
        store: The store; of one at a URL, a folder for seals and scores.
        costs: The predicted costs of tasks.
        longest: Seconds from the start of each task to the end of the longest chain that begins with it, by key.
        watcher: Hears when tasks start, proceed and end.
        known: How some tasks have ended before.
    """

    plan: StudyPlan
    out: Path
    store: Path
    costs: Costs
    longest: Mapping[str, float]
    watcher: Watcher
    known: Mapping[str, Outcome]

    def memory(self, key: str) -> float:
        """Bytes that a task will take."""
        return self.costs.predicted(self.plan.tasks[key]).memory

    def seconds(self, key: str) -> float:
        """That it will take."""
        return self.costs.predicted(self.plan.tasks[key]).seconds

    def log(self, task: Task) -> str:
        """Where its output goes."""
        return str((self.out / log_of(task)).absolute())

    def order(self, key: str, results: Mapping[str, Any], threads: int) -> Order:
        """The message to a worker."""
        task = self.plan.tasks[key]
        source = self.plan.tasks[task.needs[0]].folder(self.store) if task.needs else task.source
        made_of = {need: result["content"] for need, result in results.items()}
        return Order(task, task.folder(self.store).absolute(), source and source.absolute(), made_of, threads)


class Engine(Protocol):
    """Does the tasks of a study."""

    @property
    def places(self) -> int:
        """Tasks at a time, as far as is known before it starts."""

    @property
    def threads(self) -> Mapping[str, int]:
        """Threads of a task, by its kind."""

    def run(self, work: Work) -> None:
        """Do them all; errors as `Pool.run`."""


@dataclass(frozen=True)
class OneMachine:
    """Processes on this machine.

    Attributes:
        places: Processes at a time.
        cores: Threads of each.
        ahead: Workers that have been started already; workers with another number of threads are not used.
    """

    places: int
    cores: int
    ahead: Sequence[Worker] = field(default=(), compare=False)

    @staticmethod
    def shared(runs: int, wanted: int | None, ahead: Sequence[Worker] = ()) -> "OneMachine":
        """All cores, divided among processes. Finished work does not change their number, so that bits stay the same.

        Args:
            runs: Of the study.
            wanted: Processes; None: as many as cores, or runs if these are fewer.
            ahead: See `OneMachine`.

        Raises:
            ValueError: If fewer than one process is wanted.
        """
        if wanted is not None and wanted < 1:
            raise ValueError(f"workers must be >= 1, got {wanted}")
        workers = wanted or max(1, min(cores_here(), runs))
        return OneMachine(workers, threads_of(workers), ahead)

    @staticmethod
    def whole(ahead: Sequence[Worker] = ()) -> "OneMachine":
        """One process at a time, with all cores: other work beside a measurement would be measured too."""
        return OneMachine(1, cores_here(), ahead)

    @property
    def threads(self) -> Mapping[str, int]:
        """The same for all."""
        return dict.fromkeys(KINDS, self.cores)

    def run(self, work: Work) -> None:
        """Do all tasks."""

        def request(key: str, results: Mapping[str, Any]) -> dict[str, Any]:
            return {"task": work.order(key, results, self.cores), "log": work.log(work.plan.tasks[key])}

        limits = PoolLimits(self.places, memory=work.memory, seconds=work.seconds, order=work.longest.__getitem__)
        environment = threads_environment(self.cores)
        ahead = [worker for worker in self.ahead if worker.environment == environment]
        Pool(TASKS, request, limits, work.watcher, environment, ahead).run(work.plan.tasks.values(), work.known)


@dataclass(frozen=True)
class Nodes:
    """The nodes of a Ray cluster.

    Attributes:
        needs: Of each kind of task.
        address: Of the cluster, see `Terms`.
        retries: See `Terms`.
        url: The store, where it is not a folder that all nodes see.
        scratch: Folder on each node for a store at a URL, see `nodes.Away`.
    """

    needs: Mapping[str, Needs]
    address: str | None = None
    retries: int = 3
    url: str | None = None
    scratch: str | None = None

    @property
    def places(self) -> int:
        """On a node like this machine; the cluster says how many there are when the study starts."""
        return max(1, cores_here() // max(self.threads.values()))

    @property
    def threads(self) -> Mapping[str, int]:
        """As many as cores are asked for."""
        return {kind: needs.cpus for kind, needs in self.needs.items()}

    def run(self, work: Work) -> None:
        """Do all tasks."""
        terms = Terms(
            resources=lambda key: resources(self.needs[work.plan.tasks[key].kind]),
            memory=lambda key: MARGIN * work.memory(key), seconds=work.seconds, order=work.longest.__getitem__,
            retries=self.retries, address=self.address,
            environment=outside.environment(root for task in work.plan.tasks.values() for root in task.roots),
        )  # fmt: skip
        marker = None if self.url else _mark(work.store)

        def request(key: str, results: Mapping[str, Any]) -> dict[str, Any]:
            task = work.plan.tasks[key]
            ordered = work.order(key, results, self.threads[task.kind]) if self.url is None else self._away(work, key)
            return {"task": ordered, "log": work.log(task), "marker": marker}

        place = TASKS if self.url is None else nodes.PLACE
        Cluster(place, request, terms, work.watcher).run(work.plan.tasks.values(), work.known)

    def _away(self, work: Work, key: str) -> nodes.Away:
        assert self.url is not None
        chain = tuple({task.key: task for task in work.plan.above(key)}.values())
        threads = tuple(self.threads[task.kind] for task in chain)
        return nodes.Away(chain, threads, self.url, self.scratch, TASKS)


def log_of(task: Task) -> str:
    """The log of a task, relative to the study."""
    return f"logs/{task.place or f'{task.kind}-{task.name}'}.log"


def _mark(store: Path) -> tuple[str, str]:
    """Write the files that nodes must find in the store."""
    path = (store / MARKER).absolute()
    text = read_text(path) if path.exists() else ""
    if not text:
        text = uuid.uuid4().hex
        write_text(path, text)
    return str(path), text
