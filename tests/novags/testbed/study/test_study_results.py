"""Claims about the table of a study: which rows are kept, and what is recovered where."""

import csv
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.folders.run import METRICS
from novags.testbed.study import results
from novags.testbed.study.differences import ALL, DIFFERENCES
from novags.testbed.study.results import State, StudyTable, _write, counted, flat_scores, rows_before

SCORES = {"naive": 20.0, "mine": 24.0, "oracle": 30.0}


def study(tmp_path: Path) -> Any:
    """Three methods in two scenes by two seeds."""
    runs, tasks = list[Any](), dict[str, Any]()
    for scene in "st":
        for seed in (0, 1):
            for method in SCORES:
                key = f"{scene}{seed}{method}"
                cell = SimpleNamespace(values={"scene": scene, "method": method, "seed": seed},
                                       preset=SimpleNamespace(methods=(method,)))  # fmt: skip
                runs.append((cell, key))
                variant = SimpleNamespace(method="naive" if method == "mine" else method)
                tasks[key] = SimpleNamespace(kind="run", name=key, config=SimpleNamespace(variant=variant),
                                             folder=lambda store, key=key: store / "run" / key)  # fmt: skip
    axes = {"scene": ("s", "t"), "method": tuple(SCORES), "seed": (0, 1)}
    return SimpleNamespace(runs=runs, tasks=tasks, study=SimpleNamespace(ends="run", axes=axes))


def table(tmp_path: Path, **more: Any) -> StudyTable:
    """With known scores; `mine` is 1 better in the second seed, and 2 in scene t."""
    plan = study(tmp_path)
    scores, runs = {}, {}
    for cell, key in plan.runs:
        own = cell.values
        better = (own["seed"] + 2 * (own["scene"] == "t")) * (own["method"] == "mine")
        psnr = SCORES[own["method"]] + better
        scores[key] = {"enhanced.aligned_psnr": psnr, "lit.tone_aligned_psnr": psnr}
        mean = {"enhanced": {"aligned_psnr": psnr}, "lit": {"tone_aligned_psnr": psnr}}
        off = {f"{k:04d}": {kind: {name: value + k for name, value in own.items()} for kind, own in mean.items()}
               for k in (-1, 0, 1)}  # fmt: skip
        runs[key] = {"mean": mean, "views": off}
    return StudyTable(plan, tmp_path / "out", tmp_path / "store", _scores=scores, _runs=runs, **more)


def test_every_method_recovers_its_share_between_the_bounds_of_its_own_place(tmp_path: Path) -> None:
    made = table(tmp_path)
    rows = made.rows({key: State("done") for _, key in made.plan.runs})
    shares = [(row["scene"], row["seed"], row["recovered"]) for row in rows if row["method"] == "mine"]
    assert shares == [("s", 0, pytest.approx(0.4)), ("s", 1, pytest.approx(0.5)), ("t", 0, pytest.approx(0.6)),
                      ("t", 1, pytest.approx(0.7))]  # fmt: skip
    assert [row["run"] for row in rows] == list(range(1, 13))
    assert not any("recovered" in row for row in rows if row["method"] != "mine")
    states = {key: State("done") for _, key in made.plan.runs if key != "s1oracle"}
    again = {(row["scene"], row["seed"]): row.get("recovered") for row in made.rows(states) if row["method"] == "mine"}
    assert again["s", 1] is None
    assert again["t", 1] == pytest.approx(0.7)


def test_a_run_of_another_enhancement_recovers_nothing_of_a_reference_that_is_not_its_own(tmp_path: Path) -> None:
    made = table(tmp_path)
    (tmp_path / "store" / "run" / "s0mine").mkdir(parents=True)
    record = json.dumps({"enhancement": {"enhancer": "darker", "config": {}}})
    (tmp_path / "store" / "run" / "s0mine" / "run.json").write_text(record, "utf-8")
    rows = made.rows({key: State("done") for _, key in made.plan.runs})
    found = {(row["scene"], row["seed"]): row for row in rows if row["method"] == "mine"}
    assert "recovered" not in found["s", 0]
    assert found["s", 0]["recovered_lit"] == pytest.approx(0.4)
    assert found["s", 1]["recovered"] == pytest.approx(0.5)


def test_rows_of_finished_runs_that_are_still_there_stand(tmp_path: Path) -> None:
    plan = study(tmp_path)
    (tmp_path / "out").mkdir()
    keys = [key for _, key in plan.runs]
    rows = [{"state": "failed" if k == 4 else "done", "folder": f"../store/run/{key}", "x": k}
            for k, key in enumerate(keys[:8])]  # fmt: skip
    (tmp_path / "out" / "results.json").write_text(json.dumps({"axes": {}, "rows": rows}))
    found = rows_before(plan, tmp_path / "out", tmp_path / "store", None, {*keys} - {keys[1]})
    assert {key: row["x"] for key, row in found.items()} == {keys[k]: k for k in (0, 2, 3, 5, 6, 7)}


def test_every_run_with_scores_on_this_machine_counts_in_the_differences(tmp_path: Path) -> None:
    made, states = table(tmp_path), dict[str, State]()
    (tmp_path / "out").mkdir()
    for _, key in made.plan.runs:
        folder, states[key] = tmp_path / "store" / "run" / key, State("done")
        folder.mkdir(parents=True)
        (folder / METRICS).touch()

    def seeds() -> dict[tuple[str, str, str], str]:
        made.write(states)
        with (tmp_path / "out" / DIFFERENCES).open() as file:
            rows = [row for row in csv.DictReader(file) if row["score"] == "lit.tone_aligned_psnr"]
        return {(row["scene"], row["method"], row["than"]): row["seeds"] for row in rows}

    pairs = [("mine", "naive"), ("oracle", "naive"), ("oracle", "mine")]
    whole = {(scene, *pair): "2" for scene in ("s", "t", ALL) for pair in pairs}
    assert seeds() == whole
    (tmp_path / "store" / "run" / "t1oracle" / METRICS).unlink()  # it lies elsewhere
    assert seeds() == whole | {("t", *pair): "1" for pair in pairs[1:]}


def test_the_table_has_every_column_that_any_row_has_and_costs_come_last(tmp_path: Path) -> None:
    rows = [{"run": 1, "seconds.fit": 2.0}, {"run": 2, "lit.psnr": 3.0, "peak_bytes": 4}, {"run": 3, "extra": 5}]
    _write(tmp_path, {"method": ("a",)}, rows)
    columns = ["run", "lit.psnr", "extra", "seconds.fit", "peak_bytes"]
    assert json.loads((tmp_path / "results.json").read_text())["columns"] == columns
    assert (tmp_path / "results.csv").read_text().splitlines()[0].split(",") == columns
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 4


def test_runs_are_counted_by_their_state() -> None:
    states = ["waiting", "done", "failed", "done", "skipped", "done"]
    assert counted([{"state": state} for state in states]) == {"done": 3, "failed": 1, "skipped": 1, "waiting": 1}


def test_all_scores_and_costs_are_columns() -> None:
    method = {"mean": {"lit": {"psnr": 1.0, "flip": 2.0}, "gone": None}, "geometry": {"abs_rel": 3.0}, "noise": None,
              "cameras": {"registered_share": 1.0, "mean_centre_error": 0.5, "source": "known"},
              "seconds": {"render": 4.0, "fit": 5.0}, "peak_bytes": 6,
              "frames_per_second": {"160": 7.0, "device": "cpu"}}  # fmt: skip
    assert flat_scores(method) == {
        "lit.psnr": 1.0, "lit.flip": 2.0, "gone": None, "geometry.abs_rel": 3.0, "cameras.registered_share": 1.0,
        "cameras.mean_centre_error": 0.5, "seconds.render": 4.0, "seconds.fit": 5.0, "peak_bytes": 6,
        "frames_per_second.160": 7.0, "frames_per_second.device": "cpu",
    }  # fmt: skip
    assert results.COSTS == ("seconds.", "frames_per_second.", "peak_bytes")
