"""A study of stages that compute nothing."""

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from novags.testbed.ledger import stage


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module `fake_stages`, which workers find too."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    monkeypatch.setattr(stage, "environment", dict)
    yield importlib.import_module("fake_stages")
    sys.modules.pop("fake_stages", None)


class Diary:
    """Writes down what a pool says."""

    def __init__(self) -> None:
        self.events: list[tuple[str, ...]] = []
        self.notes: list[str] = []
        self.on_tick: Callable[[], Any] = lambda: None

    def places(self, count: int) -> None:
        pass

    def started(self, key: str) -> None:
        self.events.append(("started", key))

    def progress(self, key: str, stage: str, done: int, total: int, what: str) -> None:
        self.events.append(("progress", key, stage))

    def ended(self, key: str, outcome: Any) -> None:
        self.events.append((outcome.state, key))

    def note(self, text: str) -> None:
        self.notes.append(text)

    def tick(self) -> None:
        self.on_tick()

    def most_at_once(self) -> int:
        under_way, most = set(), 0
        for event, key, *_ in self.events:
            under_way = (
                under_way | {key} if event == "started" else under_way - {key} if event != "progress" else under_way
            )
            most = max(most, len(under_way))
        return most


@pytest.fixture
def diary() -> Diary:
    return Diary()


@pytest.fixture
def pool(fake: ModuleType, diary: Diary, tmp_path: Path) -> Callable[..., Any]:
    """Make a pool for a list of tasks, with entries in `tmp_path`."""
    from novags.testbed.study.engines.local import Pool, PoolLimits
    from novags.testbed.study.engines.processes import threads_environment
    from novags.testbed.study.entry import Order

    def make(tasks: list[Any], workers: int = 2, **limits: Any) -> Any:
        by_key = {task.key: task for task in tasks}

        def request(key: str, results: Any) -> dict[str, Any]:
            task = by_key[key]
            source = by_key[task.needs[0]].folder(tmp_path) if task.needs else None
            made_of = {need: result["content"] for need, result in results.items()}
            order = Order(task, task.folder(tmp_path), source, made_of, threads=1)
            return {"task": order, "log": str(tmp_path / "logs" / f"{key}.log")}

        return Pool("fake_stages:make", request, PoolLimits(workers, **limits), diary, threads_environment(1))

    return make
