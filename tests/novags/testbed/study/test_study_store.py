"""Claims about entries of the store and the folder of a study: nothing half-written, damaged or foreign is believed."""

import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.folders.runs import STUDY
from novags.testbed.ledger.contents import write_json
from novags.testbed.ledger.store import SEAL, read_seal
from novags.testbed.study.cells.grid import read_study
from novags.testbed.study.conduct import FAILURES, read_failures
from novags.testbed.study.entry import Order
from novags.testbed.study.plan import StudyPlan, plan_of
from novags.testbed.study.session import describe, refuse_other

QUIET = Console(quiet=True)


@pytest.fixture
def made(fake: ModuleType, tmp_path: Path) -> Callable[..., dict[str, Any]]:
    """Make the entry `a`, or find it."""

    def make(key: str = "a", **made_of: str) -> dict[str, Any]:
        task = fake.task("a")
        order = Order(type(task)(**{**vars(task), "key": key}), tmp_path / "run" / "a", None, made_of, 1)
        return dict(fake.make(order, QUIET))

    return make


def count(tmp_path: Path) -> int:
    return len((tmp_path / "run" / ".a.count").read_text())


def test_a_finished_entry_is_believed_and_files_that_came_later_do_not_matter(
    made: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    first = made()
    (tmp_path / "run" / "a" / "report.html").write_text("later")
    again = made()
    assert (first["made"], again["made"], count(tmp_path)) == (True, False, 1)
    assert (first["content"], first["cost"]) == (again["content"], again["cost"])


@pytest.mark.parametrize("harm", ["changed", "cut", "gone", "record", "seal", "other key"])
def test_a_damaged_entry_is_made_again(made: Callable[..., dict[str, Any]], tmp_path: Path, harm: str) -> None:
    made()
    folder = tmp_path / "run" / "a"
    true = {path.name: path.read_bytes() for path in folder.glob("*.txt")}
    if harm == "changed":
        stat = (folder / "1.txt").stat()
        (folder / "1.txt").write_bytes(true["1.txt"].swapcase())  # of the same length and age
        import os

        os.utime(folder / "1.txt", ns=(stat.st_atime_ns, stat.st_mtime_ns))
    elif harm == "cut":
        (folder / "2.txt").write_bytes(b"")
    elif harm == "gone":
        (folder / "3.txt").unlink()
    elif harm == "record":
        (folder / "made.json").write_text((folder / "made.json").read_text().replace('"seconds": ', '"seconds": 9'))
    elif harm == "seal":
        (folder / SEAL).write_text('{"key": ')
    assert made("another" if harm == "other key" else "a")["made"]
    assert {path.name: path.read_bytes() for path in folder.glob("*.txt")} == true
    assert count(tmp_path) == 2
    assert not made("another" if harm == "other key" else "a")["made"]


def test_an_entry_is_looked_at_again_when_what_it_was_made_from_is_another(
    made: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    made(parent="x")
    assert not made(parent="x")["made"]
    assert made(parent="y")["made"]
    assert count(tmp_path) == 1  # its stage found the same content
    seal = read_seal(tmp_path / "run" / "a")
    assert seal is not None
    assert seal.made_of == {"parent": "y"}


def test_a_clock_that_goes_back_changes_nothing(
    made: Callable[..., dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now - 1e8)
    monkeypatch.setattr(time, "time_ns", lambda: int((now - 1e8) * 1e9))
    assert made()["made"]
    (tmp_path / "run" / "a" / "0.txt").write_text("wrong")
    assert made()["made"]
    assert not made()["made"]


def plan(tmp_path: Path, text: str) -> StudyPlan:
    (tmp_path / "study.toml").write_text(text)
    return plan_of(read_study(tmp_path / "study.toml"), tmp_path / "store", QUIET)


def finished(tmp_path: Path, text: str) -> Path:
    out = tmp_path / "out"
    found = plan(tmp_path, text)
    describe(found, out, tmp_path / "store")
    rows = [{**cell.values, "state": "done", "folder": found.tasks[key].name} for cell, key in found.runs]
    write_json(out / "results.json", {"axes": found.study.axes, "rows": rows})
    return out


def test_more_runs_may_join_a_study_and_finished_ones_are_not_dropped(tmp_path: Path) -> None:
    grid = "[grid]\nmethod = 'naive'\nelectrons = [5, 20]"
    out = finished(tmp_path, grid)
    refuse_other(plan(tmp_path, grid), out)
    refuse_other(plan(tmp_path, f"{grid}\nseed = [0, 1]"), out)
    with pytest.raises(
        ValueError, match=r"holds 1 finished runs \(method naive, electrons 20, seed 0\) that .* not have"
    ):
        refuse_other(plan(tmp_path, "[grid]\nmethod = 'naive'\nelectrons = [5]"), out)
    describe(plan(tmp_path, f"{grid}\nseed = [0, 1]"), out, tmp_path / "store")  # killed before it wrote its tables
    refuse_other(plan(tmp_path, grid), out)
    program = '[method.mine]\ncommand = "true {capture} {out}"'
    with pytest.raises(ValueError, match="2 finished runs of another study .it differs in method."):
        refuse_other(plan(tmp_path, f"{grid}\n{program}"), out)
    with pytest.raises(ValueError, match="2 finished runs of another study .it differs in override.: .*--overwrite"):
        refuse_other(plan(tmp_path, f"{grid}\n[override]\nspp = 8"), out)


def test_a_folder_that_holds_something_else_is_refused(tmp_path: Path) -> None:
    found = plan(tmp_path, "[grid]\nmethod = 'naive'")
    (tmp_path / "experiment.json").write_text("{}")
    with pytest.raises(ValueError, match=r"already holds experiment.json, and no study wrote that"):
        refuse_other(found, tmp_path)
    assert not (tmp_path / STUDY).exists()


def test_failures_are_kept_for_the_entries_that_are_asked_for(tmp_path: Path) -> None:
    failure = {"reason": "no", "stage": "score", "log": "logs/x"}
    write_json(tmp_path / FAILURES, {"a": failure, "b": failure})
    assert read_failures(tmp_path, {"a", "c"}) == {"a": failure}
    assert read_failures(tmp_path / "none", {"a"}) == {}
