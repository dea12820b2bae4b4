"""Claims about the nodes of a cluster as a study uses them, and about what all processes are limited by."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from novags.testbed.study.engines import choice, cluster
from novags.testbed.study.engines.choice import Nodes
from novags.testbed.study.engines.cluster import Cluster
from novags.testbed.study.engines.needs import Needs
from novags.testbed.study.engines.processes import threads_environment
from novags.testbed.study.engines.progress import StudyProgress
from novags.testbed.study.engines.worker import Outcome


def test_nodes_get_the_plugins_of_all_modules_of_all_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = dict[str, Any]()

    def environment(roots: Any) -> dict[str, str]:
        seen["roots"] = list(roots)
        return {"PLUGINS": "x"}

    def made(place: str, request: Any, terms: Any, watcher: Any) -> Any:
        seen.update(request=request, terms=terms)
        return SimpleNamespace(run=lambda tasks, known: seen.update(tasks=list(tasks), known=known))

    monkeypatch.setattr(choice.outside, "environment", environment)
    monkeypatch.setattr(choice, "Cluster", made)
    tasks = {key: SimpleNamespace(key=key, kind=kind, roots=(f"{key}.x", f"{key}.y"), place="", name=key)
             for key, kind in (("a", "set"), ("b", "run"))}  # fmt: skip
    work: Any = SimpleNamespace(
        plan=SimpleNamespace(tasks=tasks), memory=lambda key: 10.0, seconds=lambda key: 1.0,
        longest={"a": 2.0, "b": 1.0},
        store=tmp_path, watcher=None, known={}, order=lambda key, results, threads: (key, threads),
        log=lambda task: f"{task.key}.log",
    )  # fmt: skip
    Nodes({"set": Needs(3), "run": Needs(5, memory=7.0)}).run(work)
    assert seen["roots"] == ["a.x", "a.y", "b.x", "b.y"]
    assert seen["terms"].environment == {"PLUGINS": "x"}
    assert [task.key for task in seen["tasks"]] == ["a", "b"]
    assert [seen["request"](key, {})["task"] for key in "ab"] == [("a", 3), ("b", 5)]
    assert seen["terms"].resources("b") == {"CPU": 5.0, "GPU": 0.0, "memory": 7.0}


def test_a_cluster_is_given_all_jobs_and_stops_all_that_run(monkeypatch: pytest.MonkeyPatch) -> None:
    terms: Any = SimpleNamespace(order=lambda key: 0.0, address=None, retries=1)
    made = Cluster("p:m", lambda *_: {}, terms, Mock())
    jobs: Any = [SimpleNamespace(key=key, needs=("a",) if key == "c" else ()) for key in "abc"]
    known = {key: Outcome("done", key, "s") for key in "abc"}
    assert set(made.run(jobs, known)) == set("abc")  # nothing is left to be done on any node
    assert made._needs == {"a": (), "b": (), "c": ("a",)}
    cancelled = list[tuple[str, bool]]()
    ray = SimpleNamespace(
        exceptions=SimpleNamespace(RayError=ValueError),
        cancel=lambda ref, force=False: cancelled.append((ref, force)),
        wait=lambda refs, num_returns, timeout: (refs[:1], refs[1:]),
    )
    made._refs = {"r1": ("a", ""), "r2": ("b", ""), "r3": ("c", "")}  # type: ignore[assignment, dict-item]
    made._stop(ray)
    assert cancelled == [("r1", False), ("r2", False), ("r3", False), ("r2", True), ("r3", True)]
    assert cluster.Board().said == []


def test_every_library_of_threads_is_limited() -> None:
    assert threads_environment(3) == {
        f"{name}_NUM_THREADS": "3" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA", "VECLIB_MAXIMUM", "NUMEXPR")
    }


def test_the_bar_of_every_task_that_is_over_goes() -> None:
    bars = Mock()
    bars.add_task.side_effect = list(range(10))
    progress = StudyProgress(SimpleNamespace(live=True, bars=lambda *_: bars), 4)  # type: ignore[arg-type]
    at = ("fit", 3, 10, "")
    progress.show(0, 0, {key: (key, at) for key in "abc"}, 5.0)
    assert set(progress.lines) == set("abc")
    progress.show(2, 0, {"c": ("c", at), "d": ("d", at)}, 5.0)
    assert set(progress.lines) == set("cd")
    assert [call.args[0] for call in bars.remove_task.call_args_list] == [1, 2]
