"""Claims about the pool of worker processes: order, limits, failures, deaths."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from novags.testbed.console import cores, groups
from novags.testbed.console.provenance import hardware
from novags.testbed.study import conduct
from novags.testbed.study.engines import choice, local, processes, queue
from sensor_model.files.atomic import atomic


def times_made(tmp_path: Path, key: str) -> int:
    count = tmp_path / "run" / f".{key}.count"
    return len(count.read_text()) if count.exists() else 0


def test_jobs_come_after_those_they_need_side_by_side_and_the_longest_first(
    pool: Callable[..., Any], fake: ModuleType, diary: Any, tmp_path: Path
) -> None:
    tasks = [fake.task("a", seconds=0.3), fake.task("b", seconds=0.3), fake.task("c", "a"), fake.task("d", "c")]
    order = {"a": 1.0, "b": 9.0, "c": 5.0, "d": 5.0}
    found = pool(tasks, order=order.__getitem__).run(tasks)
    assert {key: outcome.state for key, outcome in found.items()} == dict.fromkeys("abcd", "done")
    started = [key for event, key, *_ in diary.events if event == "started"]
    assert started[0] == "b"
    assert diary.events.index(("done", "a")) < diary.events.index(("started", "c"))
    assert diary.events.index(("done", "c")) < diary.events.index(("started", "d"))
    assert diary.most_at_once() == 2
    assert "c0(a0()" in (tmp_path / "run" / "d" / "0.txt").read_text()
    assert ("progress", "a", "write") in diary.events
    assert (tmp_path / "logs" / "a.log").read_text() == "making a\n"


def test_failures_of_two_studies_on_one_store_at_once_stop_neither(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fake: ModuleType
) -> None:
    """Rationale: both tried the disk by a file of one name, which one removed while the other was about to."""

    def failed(name: str) -> dict[str, Any]:
        task, failures = fake.task(name), dict[str, Any]()
        (tmp_path / name).mkdir()
        table = SimpleNamespace(store=tmp_path, out=tmp_path / name)
        watch: Any = SimpleNamespace(plan=SimpleNamespace(tasks={task.key: task}), table=table, failures=failures,
                                     note=lambda text: None)  # fmt: skip
        conduct._Watch._failed(watch, task.key, "no lamp", "render")
        return failures

    @contextmanager
    def interrupted(path: Path) -> Iterator[Path]:
        with atomic(path) as temporary:
            yield temporary
        if path.name.startswith(".probe"):  # and then the other study writes and removes its own
            with monkeypatch.context() as other:
                other.setattr(conduct, "atomic", atomic)
                other.setattr(os, "getpid", lambda: 1)
                seen.append(failed("b"))

    seen: list[dict[str, Any]] = []
    monkeypatch.setattr(conduct, "atomic", interrupted)
    assert [len(found) for found in (failed("a"), *seen)] == [1, 1]
    assert not list(tmp_path.glob(".probe*"))


def test_a_worker_imports_modules_in_one_thread_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two threads met modules half made: the one that listened ended, and the study waited for ever."""
    (tmp_path / "doing.py").write_text("def make(task, console):\n    return task['of'].name\n")
    (tmp_path / "asking.py").write_text(
        "import threading\nfrom dataclasses import dataclass\n"
        "if threading.current_thread() is not threading.main_thread():\n    raise ImportError('half made')\n"
        "@dataclass\nclass Thing:\n    name: str\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    from asking import Thing  # type: ignore[import-not-found]

    worker = processes.Worker.start("doing:make", {})
    try:
        worker.give("a", {"task": {"of": Thing("it")}, "log": str(tmp_path / "log")}, 0.0)
        said = [worker.connection.recv() for _ in range(2) if worker.connection.poll(60)]
        assert [(outcome.state, outcome.said) for outcome in said] == [("ready", None), ("done", "it")]
    finally:
        worker.ask_to_stop()
        worker.stop(0.0)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("refused", "it does not suit me"),
        ("crashed", "its process was ended by SIGSEGV"),
        ("unforeseen", "unexpected KeyError: 'what'"),
        ("left", "its process ended with exit code 3"),
        ("too_large", "memory is not enough"),
    ],
)
def test_a_failure_costs_what_needs_it_and_nothing_else(
    pool: Callable[..., Any], fake: ModuleType, tmp_path: Path, how: str, said: str
) -> None:
    tasks = [fake.task("a", fails=how), fake.task("b", "a"), fake.task("c", "b"), fake.task("d"), fake.task("e", "d")]
    found = pool(tasks, workers=1).run(tasks)
    states = {key: outcome.state for key, outcome in found.items()}
    assert states == {"a": "failed", "b": "skipped", "c": "skipped", "d": "done", "e": "done"}
    assert said in found["a"].said
    assert found["c"].said == found["a"].said
    assert found["c"].cause == "a"
    assert "making a" in (tmp_path / "logs" / "a.log").read_text()
    if how == "unforeseen":
        assert "Traceback" in (tmp_path / "logs" / "a.log").read_text()


@pytest.mark.parametrize("how", ["full", "full_said_in_words"])
def test_a_fault_of_the_machine_stops_everything_and_is_no_failure(
    pool: Callable[..., Any], fake: ModuleType, diary: Any, how: str
) -> None:
    tasks = [fake.task("a", fails=how), fake.task("b", "a")]
    with pytest.raises(OSError, match=r"No space left on device.*finished work is kept"):
        pool(tasks).run(tasks)
    assert not [event for event, *_ in diary.events if event in ("failed", "skipped")]


def test_what_failed_before_is_not_tried(pool: Callable[..., Any], fake: ModuleType, tmp_path: Path) -> None:
    tasks = [fake.task("a"), fake.task("b", "a"), fake.task("c")]
    found = pool(tasks).run(tasks, {"a": local.Outcome("failed", "as before")})
    assert [found[key].state for key in "abc"] == ["failed", "skipped", "done"]
    assert [times_made(tmp_path, key) for key in "abc"] == [0, 0, 1]


def test_memory_keeps_jobs_apart_and_one_always_runs(
    pool: Callable[..., Any], fake: ModuleType, diary: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local, "available_bytes", lambda: 10e9)
    tasks = [fake.task(key, seconds=0.2) for key in "abc"]
    memory = {"a": 7e9, "b": 99e9, "c": 7e9}
    found = pool(tasks, workers=3, memory=memory.__getitem__).run(tasks)
    assert {outcome.state for outcome in found.values()} == {"done"}
    assert diary.most_at_once() == 1
    assert diary.notes[0].startswith("memory allows 1 of 3 tasks at a time")


def test_small_jobs_run_side_by_side_in_the_memory_there_is(
    pool: Callable[..., Any], fake: ModuleType, diary: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(local, "available_bytes", lambda: 10e9)
    tasks = [fake.task(key, seconds=0.3) for key in "abc"]
    pool(tasks, workers=3, memory=lambda key: 4e9).run(tasks)
    assert diary.most_at_once() == 2


def test_what_another_process_is_at_work_on_waits_while_other_work_goes_on(
    pool: Callable[..., Any], fake: ModuleType, diary: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from sensor_model.files.lock import locked

    monkeypatch.setattr(queue, "AGAIN", 0.2)
    tasks = [fake.task("a"), fake.task("b", seconds=0.1)]
    held = locked(tmp_path / "run" / "a")
    held.__enter__()

    def free_it() -> None:
        if ("done", "b") in diary.events and held is not None:
            held.__exit__(None, None, None)
            diary.on_tick = lambda: None

    diary.on_tick = free_it
    found = pool(tasks, workers=1, order={"a": 2.0, "b": 1.0}.__getitem__).run(tasks)
    assert [found[key].state for key in "ab"] == ["done", "done"]
    assert diary.events.index(("done", "b")) < diary.events.index(("done", "a"))
    assert "in use by" in diary.notes[0]


def test_a_late_job_is_said_to_be_late_and_goes_on(
    pool: Callable[..., Any], fake: ModuleType, diary: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(queue, "LATE_SECONDS", 0.01)
    tasks = [fake.task("a", seconds=0.8)]
    found = pool(tasks, seconds=lambda key: 0.001).run(tasks)
    assert found["a"].state == "done"
    assert len(diary.notes) == 1
    assert "it goes on" in diary.notes[0]


def test_a_worker_that_cannot_start_is_no_failure_of_a_job(
    pool: Callable[..., Any], fake: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "PROGRAM", "raise SystemExit(1)")
    tasks = [fake.task("a")]
    with pytest.raises(OSError, match="a worker could not start: its process ended with exit code 1"):
        pool(tasks).run(tasks)


def test_a_worker_started_ahead_loads_what_it_needs_and_does_the_first_job(
    pool: Callable[..., Any], fake: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stages_that_tell.py").write_text(
        f"from fake_stages import make\nfrom pathlib import Path\nPath({str(tmp_path / 'loaded')!r}).touch()\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(processes, "TASKS", "stages_that_tell:make")
    monkeypatch.setattr(processes, "cores_here", lambda: 8)
    tasks = [fake.task("a"), fake.task("b")]
    with processes.started_ahead(4) as ahead:
        (worker,) = ahead
        until = time.monotonic() + 60
        while not (tmp_path / "loaded").exists() and time.monotonic() < until:
            time.sleep(0.01)
        assert (tmp_path / "loaded").exists()  # without a job
        assert worker.environment == processes.threads_environment(2)
        has_it = pool(tasks, workers=1)
        has_it.workers = list(ahead)
        assert {outcome.state for outcome in has_it.run(tasks).values()} == {"done"}
        assert worker.process.poll() is not None
    assert {(tmp_path / "run" / f".{key}.process").read_text() for key in "ab"} == {str(worker.process.pid)}
    assert '"threads": "2"' in (tmp_path / "run" / "a" / "made.json").read_text()


@pytest.mark.parametrize(
    ("files", "count"),
    [({}, 8), ({"cpu.max": "max 100000\n"}, 8), ({"cpu.max": "150000 100000\n"}, 2), ({"cpu.max": "9900000 100000"}, 8),
     ({"cpu/cpu.cfs_quota_us": "300000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 3),
     ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 8)],
)  # fmt: skip
def test_a_container_has_the_cores_whose_time_it_may_take(
    files: dict[str, str], count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(groups, "ROOT", tmp_path)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: set(range(8)), raising=False)
    assert cores.cores_here() == count == hardware()["cores"]


def test_a_worker_that_nobody_needs_ends_at_once_and_one_core_has_none(
    fake: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "TASKS", "fake_stages:make")
    monkeypatch.setattr(processes, "cores_here", lambda: 2)
    with pytest.raises(ValueError, match="unknown scene"), processes.started_ahead(None) as ahead:
        raise ValueError("unknown scene")
    assert [worker.process.poll() for worker in ahead] == [-signal.SIGKILL]
    monkeypatch.setattr(processes, "cores_here", lambda: 1)
    with processes.started_ahead(None) as none:
        assert none == []


def test_a_worker_with_other_threads_than_the_study_turned_out_to_need_is_not_used(
    fake: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[list[Any]] = []

    class Recorder:
        def __init__(self, *told: Any) -> None:
            given.append(told[-1])

        def run(self, *told: Any) -> None:
            pass

    monkeypatch.setattr(choice, "Pool", Recorder)
    monkeypatch.setattr(processes, "TASKS", "fake_stages:make")
    monkeypatch.setattr(processes, "cores_here", lambda: 4)
    monkeypatch.setattr(choice, "cores_here", lambda: 4)
    work = SimpleNamespace(
        plan=SimpleNamespace(tasks={}), memory=None, seconds=None, longest={}, watcher=None, known={}
    )
    with processes.started_ahead(None) as ahead:
        for runs in (4, 1):
            choice.OneMachine.shared(runs, None, ahead).run(work)  # type: ignore[arg-type]  # what `run` reads of it
    assert given == [ahead, []]


def test_a_place_that_cannot_be_loaded_is_said_with_the_job(
    pool: Callable[..., Any], fake: ModuleType, tmp_path: Path
) -> None:
    tasks = [fake.task("a")]
    lost = pool(tasks)
    lost.place = "nowhere_at_all:make"
    found = lost.run(tasks)["a"]
    assert (found.state, found.said) == ("failed", "unexpected ModuleNotFoundError: No module named 'nowhere_at_all'")
    assert "Traceback" in (tmp_path / "logs" / "a.log").read_text()


# A parent process with a pool, as `novags study` is one: it makes eight entries, some from others.
PARENT = """
import sys
from pathlib import Path
import pytest
import conftest, fake_stages as fake
store = Path(sys.argv[1])
tasks = [fake.task("a", seconds=0.4), fake.task("b", seconds=0.4)]
tasks += [fake.task(f"{k}{n}", k, seconds=0.2) for k in "ab" for n in range(3)]
pool = conftest.pool.__wrapped__(fake, conftest.Diary(), store)(tasks)
found = pool.run(tasks)
print(sorted((key, outcome.state) for key, outcome in found.items()))
"""


def parent(store: Path) -> "subprocess.Popen[str]":
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, sys.path)]),
    }
    command = [sys.executable, "-c", textwrap.dedent(PARENT), str(store)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)


def contents(store: Path) -> dict[str, bytes]:
    import json

    found = {}
    for path in sorted((store / "run").rglob("*")):
        if path.name.startswith("."):
            continue  # half-written: it may have its name by the time it is read
        if path.is_file() and path.suffix == ".txt":
            found[path.relative_to(store).as_posix()] = path.read_bytes()
        elif path.name == "made.json":
            found[path.relative_to(store).as_posix()] = json.loads(path.read_text())["stage"]["key"].encode()
    return found


def children(process: int) -> list[int]:
    return [int(word) for path in Path(f"/proc/{process}/task").glob("*/children") for word in path.read_text().split()]


# Only Linux lists the children of a process as files; the pool itself needs no /proc.
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds the children of a process in /proc, which is missing")
def test_a_pool_killed_at_any_moment_ends_the_same_and_leaves_no_worker(tmp_path: Path) -> None:
    whole = parent(tmp_path / "whole")
    assert "('b2', 'done')" in whole.communicate(timeout=400)[0]
    store = tmp_path / "killed"
    for moment in (3, 14):  # files written by then
        process = parent(store)
        give_up = time.monotonic() + 300
        while len(contents(store)) < moment and time.monotonic() < give_up:
            time.sleep(0.01)
        workers = children(process.pid)
        process.kill()
        process.communicate()
        assert len(workers) in (1, 2)
        while any(alive(worker) for worker in workers) and time.monotonic() < give_up:
            time.sleep(0.01)
        assert not any(alive(worker) for worker in workers)
    last = parent(store)
    assert "('b2', 'done')" in last.communicate(timeout=400)[0]
    assert contents(store) == contents(tmp_path / "whole")
    assert not list(store.rglob("*.partial*")) + list(store.rglob("unfinished.json"))


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_two_pools_on_one_store_make_each_entry_once(tmp_path: Path) -> None:
    both = [parent(tmp_path), parent(tmp_path)]
    for process in both:
        assert process.communicate(timeout=400)[0].count("done") == 8
    assert [times_made(tmp_path, f"{k}{n}") for k in "ab" for n in ("", 0, 1, 2)] == [1] * 8


def test_an_interruption_stops_the_workers_and_keeps_what_is_done(
    pool: Callable[..., Any], fake: ModuleType, diary: Any, tmp_path: Path
) -> None:
    tasks = [fake.task("a"), fake.task("b", "a", seconds=30.0)]

    def interrupt() -> None:
        if (tmp_path / "run" / "b" / "0.txt").exists() or ("progress", "b", "write") in diary.events:
            raise KeyboardInterrupt

    diary.on_tick = interrupt
    stopped = pool(tasks)
    with pytest.raises(KeyboardInterrupt):
        stopped.run(tasks)
    assert stopped.workers == []
    assert (tmp_path / "run" / "b" / "unfinished.json").exists()
    assert '"seconds"' in (tmp_path / "run" / "b" / "unfinished.json").read_text()
    assert (tmp_path / "run" / "a" / ".sealed.json").exists()
    assert signal.getsignal(signal.SIGINT) is not signal.SIG_IGN
