"""Claims about a study of one place: what is refused before any work, what a failure costs, and who may do the work."""

import io
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import numpy as np
import pytest

from novags.methods import METHODS
from novags.methods.inputs import LacksInput
from novags.methods.variant import Variant
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.runs import runs_in
from novags.testbed.ledger.contents import read_json, write_json
from novags.testbed.report.page import write_report
from novags.testbed.report.verdict import limits_so_far
from novags.testbed.study import place, steps
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.engines.choice import OneMachine
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

QUIET = Console(quiet=True)


@pytest.mark.parametrize("name", ["set", "capture", "report.html"])
def test_a_variant_is_not_called_as_something_else_in_the_folder_of_an_experiment(tmp_path: Path, name: str) -> None:
    """Rationale: after the render and the capture its run was refused, or written into the set."""
    preset = replace(EXPERIMENTS["demo"], methods=(name,), variants=(Variant(name=name, method="naive"),))
    with pytest.raises(ValueError, match=f"a variant must not be called {name}"):
        place.run(preset, tmp_path / "out", QUIET)
    assert not (tmp_path / "out").exists()


def test_a_name_that_no_folder_can_have_is_refused_at_once() -> None:
    """Rationale: the file system refused it after the render and the capture."""
    Variant(name="a" * 100, method="naive")
    with pytest.raises(ValueError, match=r"must be letters.*, at most 100, .* got 'aaa"):
        Variant(name="a" * 300, method="naive")


def test_a_capture_of_a_given_set_is_refused_before_another_set_is_rendered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: who left out --scene SET waited for a render, and was refused after it."""
    views, rng = tmp_path / "views", np.random.default_rng(0)
    names = [f"{i:04d}" for i in range(3)]
    write_cameras(views, names, orbit_rig(3, 24, 24, 50.0, radius=3.0))
    for name in names:
        write_png(views / "images" / f"{name}.png", rng.integers(20, 250, (24, 24, 3)).astype(np.uint8))
    preset = EXPERIMENTS["demo"]
    stages.capture(views, tmp_path / "out" / "capture", preset.capture, QUIET, for_runs=True)
    monkeypatch.setattr(steps, "make_set", lambda *_, **__: pytest.fail("rendered"))
    with pytest.raises(ValueError, match=r"is a finished capture of the set .*views, which this request does not name"):
        place.run(preset, tmp_path / "out", QUIET)


@pytest.mark.parametrize("overwrite", [False, True])
def test_the_tables_of_a_study_of_many_places_are_not_replaced_by_an_experiment(
    tmp_path: Path, overwrite: bool
) -> None:
    """Rationale: with the methods of the study its table of all scenes became one of a single scene."""
    done = [{"state": "done", "folder": "../store/run/a", "method": "naive", "scene": name} for name in ("a", "b")]
    write_json(tmp_path / "results.json", {"axes": {"scene": ["a", "b"], "method": ["naive"]}, "rows": done})
    write_json(tmp_path / "study.json", {})
    before = files(tmp_path, ".json")
    with pytest.raises(ValueError, match=r"holds study\.json: its tables are of a study of many places"):
        place.run(adapted(EXPERIMENTS["demo"], methods=("naive",)), tmp_path, QUIET, overwrite=overwrite)
    assert files(tmp_path, ".json") == before


def test_every_folder_of_an_experiment_is_asked_whether_it_holds_other_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = dict[str, Any]()
    monkeypatch.setattr(place, "refuse_other", lambda folder, _, request: asked.update({folder.name: request}))
    preset = adapted(EXPERIMENTS["demo"], methods=("naive", "oracle", "nova"))
    place._refuse_other(preset, tmp_path)
    runs = {name: preset.reconstruct(name).resolved() for name in preset.methods}
    assert asked == {"set": preset.render.resolved(), "capture": preset.capture.resolved(), **runs}


TINY = {"scene": "cornell", "n_views": 9, "width": 24, "height": 24, "spp": 4, "points": 60, "iterations": 6}


def files(folder: Path, *suffixes: str) -> dict[str, bytes]:
    """Content of the files of these kinds."""
    found = sorted(path for path in folder.rglob("*") if path.suffix in suffixes and path.name != "report.html")
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def test_processes_side_by_side_make_the_files_that_one_makes(tmp_path: Path) -> None:
    preset = adapted(EXPERIMENTS["demo"], **TINY, methods=("oracle", "naive"))
    place.run(preset, tmp_path / "one", QUIET)
    place.run(preset, tmp_path / "two", QUIET, engine=OneMachine.shared(2, 2))
    made = files(tmp_path / "one", ".png", ".exr", ".ply", ".dng")
    assert len(made) > 50
    assert made == files(tmp_path / "two", ".png", ".exr", ".ply", ".dng")
    tables = [read_json(tmp_path / name / "results.json")["rows"] for name in ("one", "two")]
    scores = [
        [{k: v for k, v in row.items() if k.startswith(("lit.", "enhanced."))} for row in rows] for rows in tables
    ]
    assert scores[0] == scores[1]
    assert [row["method"] for row in tables[1]] == ["oracle", "naive"]


def test_the_ends_of_the_scale_come_first_and_what_they_say_is_said_before_the_rest(tmp_path: Path) -> None:
    preset = adapted(EXPERIMENTS["demo"], **TINY, methods=("naive-l1", "naive", "oracle"))
    screen, seen = io.StringIO(), list[list[str]]()

    def doubt(runs: list[Path]) -> str:
        seen.append([run.name for run in runs])
        return limits_so_far(runs)

    place.run(preset, tmp_path, Console(stream=screen), doubt=doubt)
    assert seen == [["naive"], ["naive", "oracle"], ["naive", "oracle", "naive-l1"]]
    (said,) = [line for line in screen.getvalue().splitlines() if "The fit limits here, not the noise: oracle" in line]
    assert said.startswith("note: ")
    assert screen.getvalue().index(said) < screen.getvalue().index("naive-l1")
    assert said.removeprefix("note: ") == limits_so_far([tmp_path])
    assert [row["method"] for row in read_json(tmp_path / "results.json")["rows"]] == ["naive-l1", "naive", "oracle"]


@pytest.mark.parametrize("methods", [("naive", "naive-l1", "oracle"), ("naive-l1", "oracle", "nova", "naive")])
def test_the_ends_of_the_scale_are_planned_first_wherever_they_are_named(
    tmp_path: Path, methods: tuple[str, ...]
) -> None:
    plan = place._planned(adapted(EXPERIMENTS["demo"], **TINY, methods=methods), tmp_path, QUIET, False)
    places = [task.place for task in plan.tasks.values() if task.kind == "run"]
    ends = [name for name in methods if name in ("naive", "oracle")]
    assert places == ends + [name for name in methods if name not in ends]


@pytest.mark.parametrize("done", [0, 1, 2])
def test_one_run_that_is_done_is_enough_for_a_report(
    done: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [{"state": "done" if k == done else "failed", "reason": "no light"} for k in range(3)]
    monkeypatch.setattr(place, "_planned", lambda *_: None)
    monkeypatch.setattr(place, "conduct", lambda *_, **__: rows)
    reported = list[Path]()

    def report(out: Path, console: Console) -> Path:
        reported.append(out)
        return out

    with pytest.raises(ValueError, match="no light"):
        place.run(EXPERIMENTS["demo"], tmp_path, QUIET, report=report)
    assert reported == [tmp_path]
    assert read_json(tmp_path / "experiment.json")["preset"]["methods"] == list(EXPERIMENTS["demo"].methods)


def test_a_dry_run_names_every_stage_and_says_of_what_was_made_that_it_may_stay(tmp_path: Path) -> None:
    def said(**more: bool) -> list[str]:
        screen = io.StringIO()
        preset = adapted(EXPERIMENTS["demo"], **TINY, methods=("naive", "oracle"))
        place.said(preset, tmp_path, Console(stream=screen), **more)
        return [line.partition(" (dry run")[0] for line in screen.getvalue().splitlines()]

    first = said()
    assert first[0] == f"render: to be made in {tmp_path / 'set'}"
    assert first[1:5] == ["capture: to be made", "naive: to be made", "score naive: to be made", "oracle: to be made"]
    assert not list(tmp_path.iterdir())
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture" / "capture.json").touch()
    assert said(overwrite=True)[1] == "capture: to be made, unless the set comes out as before"


def test_a_method_that_fails_costs_no_other_and_is_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses(*_: Any, **__: Any) -> NoReturn:
        raise LacksInput("nothing to learn from")

    with monkeypatch.context() as patch:
        patch.setitem(METHODS, "broken", replace(METHODS["naive"], train=refuses))
        preset = adapted(EXPERIMENTS["demo"], **TINY, methods=("broken", "naive"))
        with pytest.raises(LacksInput, match="nothing to learn from"):
            place.run(preset, tmp_path, QUIET, report=write_report)
    rows = read_json(tmp_path / "results.json")["rows"]
    assert [(row["state"], row["reason"], row["stage"]) for row in rows] == [
        ("failed", "nothing to learn from", "reconstruct"), ("done", None, None)
    ]  # fmt: skip
    assert "Rendered by naive" in (tmp_path / "report.html").read_text()
    done = files(tmp_path / "naive", ".json")
    with monkeypatch.context() as patch:
        patch.setitem(METHODS, "broken", METHODS["naive"])
        place.run(preset, tmp_path, QUIET, report=write_report)
    assert [row["state"] for row in read_json(tmp_path / "results.json")["rows"]] == ["done", "done"]
    assert files(tmp_path / "naive", ".json") == done
    assert list(runs_in([tmp_path])) == ["broken", "naive"]


def test_all_runs_of_a_folder_are_scored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scored: list[Path] = []
    monkeypatch.setattr(stages, "score", lambda run, console: scored.append(run))
    runs: Any = [SimpleNamespace(path=tmp_path / name) for name in ("a", "b", "c")]
    place.score_all(tmp_path, runs, QUIET)
    assert scored == [tmp_path / name for name in ("a", "b", "c")]
