"""Many jobs on the nodes of a Ray cluster. Ray schedules, retries and moves results; the choice of jobs to start is
made here.
"""

import logging
import os
import pickle
import signal
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from novags.testbed.study.engines import node
from novags.testbed.study.engines.needs import fits
from novags.testbed.study.engines.processes import threads_environment
from novags.testbed.study.engines.queue import Job, Queue, Watcher, lateness
from novags.testbed.study.engines.worker import Outcome
from sensor_model.files.atomic import appending
from sensor_model.files.reading import brief

LOOK = 0.5  # s between two looks at the nodes' messages
AHEAD = 2  # tasks handed to Ray for each that can run: nodes do not wait, and urgent tasks do not queue for long
NODES_EVERY = 10.0  # s between two looks at which nodes there are
TELL_EVERY = 2.0  # s between two reports of a task


@dataclass(frozen=True)
class Terms:
    """The resources that jobs ask for.

    Attributes:
        resources: Of a job by its key, as Ray calls them: CPU, GPU, and memory in bytes if the user said how much.
        memory: Bytes that it will take at its peak, where the user did not.
        seconds: That it will take.
        order: Of the jobs that can start, the job with the largest number goes first.
        retries: Times that a job is tried again after its process or its node was lost.
        address: Of the cluster; None: `RAY_ADDRESS`, one that runs on this machine, or else one started here.
        environment: Further variables of the process that does a job.
    """

    resources: Callable[[str], Mapping[str, float]]
    memory: Callable[[str], float] = lambda key: 0.0
    seconds: Callable[[str], float] = lambda key: 0.0
    order: Callable[[str], float] = lambda key: 0.0
    retries: int = 3
    address: str | None = None
    environment: Mapping[str, str] = field(default_factory=dict)


@dataclass
class Cluster:
    """Jobs done on a Ray cluster.

    Attributes:
        place: MODULE:FUNCTION that does a job, see `worker`.
        request: The message to a node for a job, from its key and the results of the jobs it needs: "task", "marker"
            (see `node.do`), and "log", where its output goes on this machine.
        terms: The resources that jobs ask for.
        watcher: Hears when tasks start, proceed and end.
    """

    place: str
    request: Callable[[str, Mapping[str, Any]], Mapping[str, Any]]
    terms: Terms
    watcher: Watcher
    queue: Queue = field(init=False)
    where: dict[str, str] = field(default_factory=dict)  # the node that did a job
    _refs: dict[Any, tuple[str, str]] = field(default_factory=dict)  # job and log by the future result
    _needs: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _since: dict[str, float] = field(default_factory=dict)  # when a job began, by the monotonic clock
    _nodes: tuple[float, list[dict[str, Any]]] = (-1e9, [])  # when they were looked at

    def __post_init__(self) -> None:
        self.queue = Queue(self.watcher, self.terms.order)

    def run(self, jobs: Iterable[Job], known: Mapping[str, Outcome] | None = None) -> dict[str, Outcome]:
        """Do all jobs, each after the jobs it needs; returns how each ended.

        Args:
            jobs: The jobs.
            known: How some of them have ended before; they are not tried.

        Raises:
            OSError: If no cluster is found, or a node cannot go on, for example because a disk is full. Finished work
                is kept.
        """
        jobs = list(jobs)
        self._needs = {job.key: job.needs for job in jobs}
        self.queue.fill(jobs, known or {})
        if not self.queue:
            return self.queue.outcomes
        with connected(self.terms.address) as ray:
            board = ray.remote(num_cpus=0, max_restarts=-1)(Board).remote()
            try:
                while self.queue:
                    self._submit(ray, board)
                    self._hear(ray, board)
                    self.watcher.tick()
            finally:
                self._stop(ray)
        return self.queue.outcomes

    def _submit(self, ray: Any, board: Any) -> None:
        """Hand to Ray the tasks that the nodes can do soon."""
        for key in self.queue.ready():
            self._alive(ray)
            if len(self._refs) >= AHEAD * self._places:
                return
            asked = self._asked(ray, key)
            self._say_if_too_large(ray, asked)
            request = dict(self.request(key, self.queue.take(key)))
            log = request.pop("log")
            request["task"] = pickle.dumps(request["task"])  # the process of Ray knows no classes of plugins
            environment = {**threads_environment(int(asked["CPU"])), **self.terms.environment}
            if not asked["GPU"]:
                environment["CUDA_VISIBLE_DEVICES"] = ""  # Ray leaves all GPUs visible to tasks that ask for none
            task = ray.remote(on_node).options(
                num_cpus=asked["CPU"], num_gpus=asked["GPU"], memory=asked["memory"], max_retries=self.terms.retries,
                retry_exceptions=[node.Lost], scheduling_strategy=self._strategy(key),
            )  # fmt: skip
            self._refs[task.remote(self.place, key, request, environment, board)] = (key, log)

    def _asked(self, ray: Any, key: str) -> dict[str, float]:
        """The resources that a job takes of its node. A prediction of memory keeps it from no node: the largest will
        do.
        """
        largest = max((resources.get("memory", 0.0) for resources in self._alive(ray)), default=0.0)
        return {"memory": float(int(min(self.terms.memory(key), largest))), **self.terms.resources(key)}

    def _strategy(self, key: str) -> Any:
        """Near the inputs of a job: they are in the memory or on the disk of the node that made them."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        for need in self._needs[key]:
            if need in self.where:
                return NodeAffinitySchedulingStrategy(self.where[need], soft=True, _spill_on_unavailable=True)
        return "DEFAULT"

    def _alive(self, ray: Any) -> list[dict[str, Any]]:
        """The resources of each node, with its name."""
        if time.monotonic() - self._nodes[0] > NODES_EVERY:
            self._nodes = time.monotonic(), [entry["Resources"] for entry in ray.nodes() if entry["Alive"]]
            self.watcher.places(self._places)
        return self._nodes[1]

    @property
    def _places(self) -> int:
        """Cores of all nodes: as many jobs of one core can run."""
        return max(1, int(sum(resources.get("CPU", 0.0) for resources in self._nodes[1])))

    def _say_if_too_large(self, ray: Any, asked: Mapping[str, float]) -> None:
        if not any(fits(asked, resources) for resources in self._alive(ray)):
            wanted = f"{asked['CPU']:g} CPUs, {asked['GPU']:g} GPUs, {asked['memory'] / 1e9:.1f} GB"
            self.queue.say_once(
                f"large {wanted}",
                f"no node has {wanted}, which a task asks for: it waits for one that joins, or see --needs",
            )

    def _hear(self, ray: Any, board: Any) -> None:
        """Wait a little for results, and take all that came."""
        if not self._refs:
            time.sleep(LOOK)  # another process is at work on all remaining tasks
        else:
            done, _ = ray.wait(list(self._refs), num_returns=1, timeout=LOOK)
            if done:
                done, _ = ray.wait(list(self._refs), num_returns=len(self._refs), timeout=0)
            self._take_notes(ray, board)
            for ref in done:
                self._answered(ray, ref)
        for key in list(self._since):
            late = lateness(time.monotonic() - self._since[key], self.terms.seconds(key))
            if late is not None:
                self.queue.say_once(f"late {key}", late)

    def _take_notes(self, ray: Any, board: Any) -> None:
        """How far the jobs are."""
        under_way = {key for key, _ in self._refs.values()}
        with suppress(ray.exceptions.RayError):  # the board is being started again on another node
            for key, where, message in ray.get(board.take.remote(), timeout=30):
                if key not in under_way:
                    continue
                if message is None:
                    if key in self._since:
                        self.watcher.note(f"a task is tried again on {where}: its process or its node was lost")
                    self._since[key] = time.monotonic()
                    self.watcher.started(key)
                elif key in self._since:
                    self.watcher.progress(key, *message)

    def _answered(self, ray: Any, ref: Any) -> None:
        key, log = self._refs.pop(ref)
        self._since.pop(key, None)
        done = _result(ray, ref, self.terms.retries)
        _append(Path(log), done.log)
        if done.outcome.state == "machine":
            raise OSError(f"{done.outcome.said}: finished work is kept; fix that and run the same command again")
        if done.outcome.state == "busy":
            self.queue.busy(key, done.outcome.said)
            return
        if done.outcome.state == "done":
            self.where[key] = done.node
        self.queue.end(key, done.outcome)

    def _stop(self, ray: Any) -> None:
        """Let running tasks mark their progress and end."""
        refs = list(self._refs)
        with suppress(ray.exceptions.RayError):
            for ref in refs:
                ray.cancel(ref)
            _, left = ray.wait(refs, num_returns=len(refs), timeout=node.STOP + 5.0) if refs else ([], [])
            for ref in left:
                ray.cancel(ref, force=True)
        self._refs.clear()


class Board:
    """Where tasks say how far they are; an actor, which the study reads."""

    def __init__(self) -> None:
        self.said: list[tuple[str, str, Any]] = []

    def put(self, key: str, where: str, message: Any) -> None:
        """Say something: None when a task begins, then stage, steps done, steps in all, what."""
        self.said.append((key, where, message))

    def take(self) -> list[tuple[str, str, Any]]:
        """The new output since."""
        said, self.said = self.said, []
        return said


def on_node(place: str, key: str, request: Mapping[str, Any], environment: Mapping[str, str], board: Any) -> node.Done:
    """A Ray task: does a job, see `node.do`."""
    import ray

    here, last = os.uname().nodename, 0.0

    def tell(message: tuple[Any, ...] | None) -> None:
        nonlocal last
        if message is None or message[1] == 0 or time.monotonic() - last >= TELL_EVERY:
            last = time.monotonic()
            board.put.remote(key, here, message)

    tell(None)
    outcome, log = node.do(place, request, environment, tell)
    return node.Done(outcome, log, ray.get_runtime_context().get_node_id())


def _result(ray: Any, ref: Any, retries: int) -> node.Done:
    """The answer of a task; if it could give none, how it ended as far as Ray knows."""
    tried = f" (tried {retries + 1} times)"
    try:
        done: node.Done = ray.get(ref)
        return done
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, node.Lost):
            return node.Done(Outcome("failed", error.cause.said + tried), error.cause.log, "")
        return node.Done(Outcome("machine", f"a node cannot do tasks: {brief(error.cause, 300)}"), str(error), "")
    except (ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError,
            ray.exceptions.ObjectLostError, ray.exceptions.LocalRayletDiedError) as error:  # fmt: skip
        return node.Done(Outcome("failed", f"its node or Ray worker was lost{tried}: {_first(error)}"), str(error), "")
    except ray.exceptions.RayError as error:  # novags is not installed there, say
        return node.Done(Outcome("machine", f"a node cannot do tasks: {_first(error)}"), str(error), "")


def _first(error: BaseException) -> str:
    return brief((str(error).strip().splitlines() or [type(error).__name__])[0], 300)


def _append(log: Path, text: str) -> None:
    log.parent.mkdir(parents=True, exist_ok=True)
    with appending(log) as file:
        file.write(text.encode("utf-8", "replace"))


@contextmanager
def connected(address: str | None) -> Iterator[Any]:
    """Ray, connected to a cluster.

    Raises:
        ValueError: If Ray is not installed.
        OSError: If no cluster answers at the address, or it runs another version of Ray or Python than this machine.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent to anybody
    try:
        import ray
    except ImportError as error:
        raise ValueError(f"engine ray needs the package ray ({error}): pip install 'novags[cluster]'") from error
    handlers = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        with _elsewhere():
            ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError) as error:
        where = address or os.environ.get("RAY_ADDRESS") or "this machine"
        raise OSError(f"no Ray cluster can be reached at {where}: {brief(error, 300)}") from error
    try:
        for number, handler in handlers.items():  # Ray takes SIGTERM over
            signal.signal(number, handler)
        yield ray
    finally:
        ray.shutdown()


@contextmanager
def _elsewhere() -> Iterator[None]:
    """Away from the working directory: Ray lets its workers import from there first, and starts nodes there."""
    here = os.open(os.curdir, os.O_RDONLY)
    try:
        os.chdir(os.sep)  # which root alone can fill
        yield
    finally:
        os.fchdir(here)
        os.close(here)
