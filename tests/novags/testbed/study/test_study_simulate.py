"""Claims about simulated nodes: the schedule is the one that a hand finds, and no shorter than any can be."""

from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from novags.testbed.study import simulate
from novags.testbed.study.cells.grid import read_study
from novags.testbed.study.costs import Cost, longest_after
from novags.testbed.study.engines.choice import OneMachine
from novags.testbed.study.plan import StudyPlan
from novags.testbed.study.simulate import at_least, makespan, said_threads, simulated

# a (3 s) -> c (2 s), d (4 s);  b (2 s) -> e (3 s);  f (1 s)
SECONDS = {"a": 3.0, "b": 2.0, "c": 2.0, "d": 4.0, "e": 3.0, "f": 1.0}
NEEDS = {"c": ("a",), "d": ("a",), "e": ("b",)}


@pytest.fixture
def plan(fake: ModuleType, tmp_path: Path) -> StudyPlan:
    (tmp_path / "study.toml").write_text("")
    tasks = {key: fake.task(key, *NEEDS.get(key, ())) for key in SECONDS}
    return StudyPlan(read_study(tmp_path / "study.toml"), tasks, ())


def test_the_longest_chain_goes_first_and_each_task_as_soon_as_it_can(plan: StudyPlan) -> None:
    # Two places: a 0-3, b 0-2, e 2-5, d 3-7, c 5-7, f 7-8; the shortest first would take 9.
    assert [makespan(plan, SECONDS, places) for places in (1, 2, 3, 6)] == [15, 8, 7, 7]


def test_a_chain_begins_with_every_task_that_its_next_one_needs(fake: ModuleType, tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text("")
    tasks = {"a": fake.task("a"), "b": fake.task("b"), "c": fake.task("c", "a", "b")}
    plan = StudyPlan(read_study(tmp_path / "study.toml"), tasks, ())
    assert longest_after(plan, {"a": 1.0, "b": 2.0, "c": 4.0}) == {"a": 5.0, "b": 6.0, "c": 4.0}


def test_no_schedule_is_shorter_than_the_work_shared_or_the_longest_chain(plan: StudyPlan) -> None:
    assert [at_least(plan, SECONDS, places) for places in (1, 2, 3, 6)] == [15, 7.5, 7, 7]
    for places in range(1, 8):
        taken, bound = makespan(plan, SECONDS, places), at_least(plan, SECONDS, places)
        assert bound <= taken <= (2 - 1 / places) * bound  # Graham's bound, of list scheduling in any order


def test_the_table_counts_node_hours_and_what_memory_holds(plan: StudyPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    hours = {key: 3600 * value for key, value in SECONDS.items()}

    def table(memory: float, places: int) -> list[list[str]]:
        monkeypatch.setattr(simulate, "available_bytes", lambda: 10e9)
        costs: Any = {key: Cost(value, memory, 0.0) for key, value in hours.items()}
        return [line.split() for line in simulated(plan, costs, hours, OneMachine(places, 1), [1, 2, 3])[3:]]

    expected = [
        ["1", "15.0", "h", "15.0", "h", "15.00", "100%"],
        ["2", "8.0", "h", "7.5", "h", "16.00", "94%"],
        ["3", "7.0", "h", "7.0", "h", "21.00", "71%"],
    ]
    assert table(1e9, places=1) == expected
    assert table(6e9, places=2) == expected  # two would need 14.4 GB
    assert table(4e9, places=2)[0] == ["1", "8.0", "h", "7.5", "h", "8.00", "94%"]
    with pytest.raises(ValueError, match="nodes must be >= 1, got 0"):
        simulated(plan, {}, hours, OneMachine(1, 1), [1, 0])
    assert simulated(plan, {}, hours, OneMachine(1, 1), []) == []


def test_the_threads_of_every_kind_of_task_are_said() -> None:
    assert said_threads({"set": 2, "capture": 2, "run": 2}) == "2 threads"
    assert said_threads({"set": 1}) == "1 thread"
    assert said_threads({"set": 2, "capture": 2, "run": 4}) == "2 (set) and 2 (capture) and 4 (run) threads"
