"""Claims about the engine for clusters, on a Ray cluster of two nodes on this machine."""

import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ray = pytest.importorskip("ray")
pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore:::ray")]
HERE = Path(__file__).resolve().parent
OBJECTS = 80 << 20  # bytes of shared memory for results on each node; Ray asks for 75 MB at least
SMALL, LARGE = 1_000_000_000, 3_000_000_000  # bytes that Ray may give to tasks


class Nodes:
    """Two nodes: the first with one core, the second with two, more memory and what Ray takes for a GPU."""

    def __init__(self) -> None:
        from ray.cluster_utils import Cluster

        common = {"object_store_memory": OBJECTS, "include_dashboard": False}
        self.ray = Cluster(initialize_head=True, head_node_args={**common, "num_cpus": 1, "memory": SMALL})
        self.ray.add_node(object_store_memory=OBJECTS, num_cpus=2, num_gpus=1, memory=LARGE)
        self.first, self.second = (node.node_id for node in self.ray.list_all_nodes())
        self.address = self.ray.address


@pytest.fixture(scope="module")
def nodes() -> Iterator[Nodes]:
    environment = {
        "PYTHONPATH": os.pathsep.join([str(HERE), *filter(None, sys.path)]), "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    }  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        found = started()
        try:
            yield found
        finally:
            found.ray.shutdown()


def started(tries: int = 4) -> Nodes:
    """The nodes; Ray gives each 30 s to start, which a busy machine does not always hold."""
    for _ in range(tries - 1):
        with suppress(Exception):  # Ray raises no other
            return Nodes()
    return Nodes()


@pytest.fixture
def cluster(nodes: Nodes, fake: ModuleType, diary: Any, tmp_path: Path) -> Callable[..., Any]:
    """Make an engine for a list of tasks, with entries in `tmp_path`."""
    from novags.testbed.study.engines.cluster import Cluster, Terms
    from novags.testbed.study.entry import Order

    def make(tasks: list[Any], asked: Any = None, marker: Any = None, **terms: Any) -> Any:
        by_key = {task.key: task for task in tasks}

        def request(key: str, results: Any) -> dict[str, Any]:
            task = by_key[key]
            source = by_key[task.needs[0]].folder(tmp_path) if task.needs else None
            made_of = {need: result["content"] for need, result in results.items()}
            order = Order(task, task.folder(tmp_path), source, made_of, 1)
            return {"task": order, "log": str(tmp_path / "logs" / f"{key}.log"), "marker": marker}

        def resources(key: str) -> dict[str, float]:
            return {"CPU": 1.0, "GPU": 0.0, **(asked or {}).get(key, {})}

        return Cluster("fake_stages:make", request, Terms(resources, address=nodes.address, **terms), diary)

    return make


def times_made(tmp_path: Path, key: str) -> int:
    return len((tmp_path / "run" / f".{key}.count").read_text())


def record(tmp_path: Path, key: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((tmp_path / "run" / key / "made.json").read_text())
    return found


def test_two_nodes_make_what_one_machine_makes_near_what_it_is_made_from(
    cluster: Callable[..., Any], pool: Callable[..., Any], fake: ModuleType, diary: Any, tmp_path: Path, nodes: Nodes
) -> None:
    chains = [[fake.task(k, seconds=0.5), fake.task(f"{k}1", k), fake.task(f"{k}2", f"{k}1")] for k in "abc"]
    tasks = [task for chain in chains for task in chain]
    engine = cluster(tasks)
    found = engine.run(tasks)
    assert {outcome.state for outcome in found.values()} == {"done"}
    assert set(engine.where.values()) == {nodes.first, nodes.second}
    assert [engine.where[f"{k}{n}"] for k in "abc" for n in (1, 2)] == [engine.where[k] for k in "abc" for _ in (1, 2)]
    assert (tmp_path / "logs" / "a1.log").read_text() == "making a1\n"
    assert ("progress", "a", "write") in diary.events
    on_cluster = {path.name: (path / "3.txt").read_bytes() for path in (tmp_path / "run").iterdir() if path.is_dir()}
    contents = {key: outcome.said["content"] for key, outcome in pool(tasks).run(tasks).items()}
    assert contents == {key: outcome.said["content"] for key, outcome in found.items()}  # as it was: nothing to do
    shutil.rmtree(tmp_path / "run")
    assert {outcome.said["made"] for outcome in pool(tasks).run(tasks).values()} == {True}
    assert {key: (tmp_path / "run" / key / "3.txt").read_bytes() for key in found} == on_cluster


@pytest.mark.parametrize("how", ["killed_once", "parent_killed_once"])
def test_a_worker_killed_in_the_middle_costs_its_task_which_is_tried_again(
    cluster: Callable[..., Any], fake: ModuleType, diary: Any, tmp_path: Path, how: str
) -> None:
    tasks = [fake.task("a", fails=how), fake.task("b", "a"), fake.task("c", seconds=0.5)]
    found = cluster(tasks).run(tasks)
    assert {outcome.state for outcome in found.values()} == {"done"}
    assert [times_made(tmp_path, key) for key in "abc"] == [2, 1, 1]
    assert [note for note in diary.notes if note.startswith("a task is tried again on ")] == diary.notes[:1]


def test_what_fails_is_no_reason_to_try_again_and_what_is_killed_is_so_often(
    cluster: Callable[..., Any], fake: ModuleType, tmp_path: Path
) -> None:
    tasks = [fake.task("a", fails="killed_always"), fake.task("b", "a"), fake.task("c", fails="crashed"),
             fake.task("d", fails="refused"), fake.task("e")]  # fmt: skip
    found = cluster(tasks, retries=1).run(tasks)
    states = {key: outcome.state for key, outcome in found.items()}
    assert states == {"a": "failed", "b": "skipped", "c": "failed", "d": "failed", "e": "done"}
    assert found["a"].said.startswith("its process was ended by SIGKILL")
    assert found["a"].said.endswith("(tried 2 times)")
    assert found["c"].said == "its process was ended by SIGSEGV"
    assert found["d"].said == "it does not suit me"
    assert [times_made(tmp_path, key) for key in "acde"] == [2, 1, 1, 1]
    assert "making a" in (tmp_path / "logs" / "a.log").read_text()


def test_tasks_go_where_what_they_ask_for_is_and_see_no_more_of_it(
    cluster: Callable[..., Any], fake: ModuleType, nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = {"cores": {"CPU": 2.0}, "gpu": {"GPU": 1.0}, "memory": {"memory": 2e9}}
    tasks = [fake.task(key) for key in (*asked, "much")]
    engine = cluster(tasks, asked, memory=lambda key: 1e12 if key == "much" else 0.0)
    engine.run(tasks)
    assert engine.where == dict.fromkeys([*asked, "much"], nodes.second)
    assert {key: record(tmp_path, key)["threads"] for key in asked} == {"cores": "2", "gpu": "1", "memory": "1"}
    assert {key: record(tmp_path, key)["gpus"] for key in asked} == {"cores": "", "gpu": "0", "memory": ""}


def test_what_no_node_has_is_said_and_an_interruption_marks_how_far_tasks_are(
    cluster: Callable[..., Any], fake: ModuleType, diary: Any, tmp_path: Path
) -> None:
    tasks = [fake.task("a", seconds=60.0), fake.task("b")]
    began = tmp_path / "run" / "a" / "unfinished.json"

    def interrupt() -> None:
        if diary.notes and began.exists():
            raise KeyboardInterrupt

    diary.on_tick = interrupt
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        cluster(tasks, {"b": {"CPU": 7.0}}).run(tasks)
    assert diary.notes[0].startswith("no node has 7 CPUs, 0 GPUs, 0.0 GB, which a task asks for")
    assert 0 < json.loads(began.read_text())["seconds"] < 60
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_fault_of_a_node_stops_everything_and_is_no_failure(
    cluster: Callable[..., Any], fake: ModuleType, diary: Any, tmp_path: Path
) -> None:
    tasks = [fake.task("a", fails="full"), fake.task("b", "a")]
    with pytest.raises(OSError, match=r"No space left on device.*finished work is kept"):
        cluster(tasks).run(tasks)
    (tmp_path / "marker").write_text("one store")
    with pytest.raises(OSError, match=r"does not see the store .*: give --store a folder of all nodes, or a URL"):
        cluster(tasks, marker=(str(tmp_path / "marker"), "another store")).run(tasks)
    assert not [event for event, *_ in diary.events if event in ("failed", "skipped", "done")]


def test_no_cluster_is_one_line(fake: ModuleType, diary: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from novags.testbed.study.engines.cluster import Cluster, Terms

    monkeypatch.setenv("RAY_ADDRESS", "")
    engine = Cluster("fake_stages:make", lambda *_: {}, Terms(lambda key: {}, address="no port"), diary)
    with pytest.raises(OSError, match="no Ray cluster can be reached at no port: "):
        engine.run([fake.task("a")])
    assert engine.run([]) == {}


@pytest.mark.slow
def test_a_node_lost_in_the_middle_costs_what_ran_there(
    cluster: Callable[..., Any], fake: ModuleType, nodes: Nodes, diary: Any, tmp_path: Path
) -> None:
    third = nodes.ray.add_node(object_store_memory=OBJECTS, num_cpus=1, resources={"third": 1.0}, memory=SMALL)
    tasks = [fake.task("a", seconds=8.0), fake.task("b", "a"), fake.task("c")]
    gone: list[float] = []

    def lose() -> None:
        if not gone and (tmp_path / "run" / "a" / "0.txt").exists():
            nodes.ray.remove_node(third, allow_graceful=False)
            os.kill(int((tmp_path / "run" / ".a.process").read_text()), signal.SIGKILL)  # Ray leaves it alone
            nodes.ray.add_node(object_store_memory=OBJECTS, num_cpus=1, resources={"third": 1.0}, memory=SMALL)
            gone.append(time.monotonic())

    diary.on_tick = lose
    found = cluster(tasks, {"a": {"third": 1.0}}).run(tasks)
    assert {outcome.state for outcome in found.values()} == {"done"}
    assert gone
    assert [times_made(tmp_path, key) for key in "abc"] == [2, 1, 1]


def test_no_worker_of_ray_imports_from_the_working_directory(
    nodes: Nodes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: Ray puts it first in `sys.path` of its workers, which then import what our functions are made of."""
    from novags.testbed.study.engines.cluster import connected

    def path() -> list[str]:
        return [os.path.realpath(folder) for folder in sys.path]

    monkeypatch.chdir(tmp_path)
    with connected(nodes.address) as ray:
        assert os.path.realpath(tmp_path) not in ray.get(ray.remote(path).remote())
