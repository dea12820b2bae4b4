"""Claims about study.json: all runs are in it, and results that the study would not have are not replaced."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.ledger.code import Code
from novags.testbed.study import session
from novags.testbed.study.cells.grid import Study
from novags.testbed.study.session import again, describe, refuse_other

VALUES = [{"scene": scene, "method": method} for scene in "st" for method in ("a", "b")]


def plan(folder: Path, *left_out: int, **table: Any) -> Any:
    cells = [(SimpleNamespace(values=values), f"k{k}") for k, values in enumerate(VALUES) if k not in left_out]
    tasks = {f"k{k}": SimpleNamespace(kind="run", name=f"run-{k}", folder=lambda store, k=k: store / "run" / f"run-{k}")
             for k in range(len(VALUES))}  # fmt: skip
    axes: Any = {"scene": ("s", "t"), "method": ("a", "b")}
    return SimpleNamespace(study=Study(folder / "study.toml", axes, (), 0, table), runs=cells, tasks=tasks)


def finished(folder: Path, *numbers: int) -> None:
    rows = [{**VALUES[k], "state": "done" if k in numbers else "failed", "folder": "x"} for k in range(len(VALUES))]
    (folder / "results.json").write_text(json.dumps({"axes": {"scene": [], "method": []}, "rows": rows}))


def test_every_run_is_described_with_its_values_and_its_folder(tmp_path: Path) -> None:
    describe(plan(tmp_path), tmp_path, tmp_path / "store")
    found = json.loads((tmp_path / "study.json").read_text())
    assert found["runs"] == [
        {"values": values, "key": f"k{k}", "folder": f"store/run/run-{k}"} for k, values in enumerate(VALUES)
    ]


@pytest.mark.parametrize("lost", range(4))
def test_a_study_that_lacks_any_finished_run_replaces_nothing(tmp_path: Path, lost: int) -> None:
    describe(plan(tmp_path), tmp_path, tmp_path / "store")
    finished(tmp_path, 0, 1, 2, 3)
    refuse_other(plan(tmp_path), tmp_path)
    with pytest.raises(ValueError, match="holds 1 finished runs"):
        refuse_other(plan(tmp_path, lost), tmp_path)
    finished(tmp_path, *({0, 1, 2, 3} - {lost}))
    refuse_other(plan(tmp_path, lost), tmp_path)


@pytest.mark.parametrize("part", ["preset", "override", "rig", "variant", "method"])
def test_every_part_of_the_file_makes_it_another_study(tmp_path: Path, part: str) -> None:
    describe(plan(tmp_path, **{part: {"x": 1}}), tmp_path, tmp_path / "store")
    finished(tmp_path, 2)
    refuse_other(plan(tmp_path, **{part: {"x": 1}}), tmp_path)
    with pytest.raises(ValueError, match=rf"another study \(it differs in {part}\)"):
        refuse_other(plan(tmp_path, **{part: {"x": 2}}), tmp_path)


@pytest.mark.parametrize(
    "name", ["results.json", "results.csv", "experiment.json", "run.json", "set.json", "capture.json"]
)
def test_results_of_something_else_are_not_replaced(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("{}")
    with pytest.raises(ValueError, match=f"already holds {name}, and no study wrote that"):
        refuse_other(plan(tmp_path), tmp_path)


def run_of(out: Path, name: str, *, code: dict[str, str], **config: Any) -> str:
    """A finished run of another code or configuration, below a store; its folder from the study's."""
    folder = out / "store" / "run" / name
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps({"stage": {"config": config}}))
    made = {"date": "2026-11-30T10:00:00+00:00", "code": code, "texts": {}}
    (folder / ".run.json").write_text(json.dumps(made))
    return f"store/run/{name}"


def test_finished_runs_that_have_to_be_made_again_are_counted_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: "0/48 runs" beside an hour of results looked as if they were lost."""
    monkeypatch.setattr(session, "code_of", lambda *roots: Code({"a.py": "new"}, {}, roots))
    found, store = plan(tmp_path), tmp_path / "store"
    for task in found.tasks.values():
        task.roots, task.config = ("a",), SimpleNamespace(resolved=lambda: {"points": (1, 2)})
    assert again(found, tmp_path, store) == ""  # nothing is there
    same = run_of(tmp_path, "run-0", code={"a.py": "new"}, points=[1, 2])
    other = run_of(tmp_path, "old-1", code={"a.py": "old"}, points=[1, 2])
    places = [("done", same), ("done", other), ("failed", other), ("done", "gone")]
    rows = [{**VALUES[k], "state": state, "folder": folder} for k, (state, folder) in enumerate(places)]
    (tmp_path / "results.json").write_text(json.dumps({"axes": {"scene": [], "method": []}, "rows": rows}))
    assert again(found, tmp_path, store).startswith("1 of 3: a.py has changed since 30 November")
    rows[2] = {**VALUES[2], "state": "done", "folder": run_of(tmp_path, "old-2", code={"a.py": "new"}, points=[1, 3])}
    (tmp_path / "results.json").write_text(json.dumps({"axes": {"scene": [], "method": []}, "rows": rows}))
    assert again(found, tmp_path, store).startswith("2 of 4: a.py has changed")
    (store / "run" / "run-1").mkdir()
    (store / "run" / "run-1" / ".sealed.json").write_text("{}")  # another study has made it since
    assert again(found, tmp_path, store) == "1 of 4: points was [1, 3], is [1, 2]"
    (store / "run" / "old-2" / "run.json").write_text(json.dumps({"stage": {"config": {"points": [1, 2]}}}))
    assert again(found, tmp_path, store) == "1 of 4: their set or capture is made again"
