"""Claims about study.json: all runs are in it, and results that the study would not have are not replaced."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.study.cells.grid import Study
from novags.testbed.study.session import describe, refuse_other

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
