"""Claims about blocks: pages of one place and of many are made of the same ones, and none has what is taken out."""

import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.metrics.differences import Estimate
from novags.testbed.report import material as module
from novags.testbed.report import page
from novags.testbed.report.blocks.absent import absent
from novags.testbed.report.blocks.cost import costs
from novags.testbed.report.material import Material, material_of, spread, titles
from novags.testbed.report.place import Place, places_in
from novags.testbed.report.study import study_material
from novags.testbed.stages.scores.scoring import score

QUIET = Console(quiet=True)
NAMES = [block.name for block in page.BLOCKS]
SCORES = {("naive", 5): 20.0, ("better", 5): 23.0, ("naive", 50): 26.0, ("better", 50): 25.0}

CAMERAS = {"source": "sfm", "unregistered": ["0003"], "registered_share": 0.9, "mean_rotation_deg": 1.0,
           "mean_centre_error": 0.1, "depth_scale": 1.0}  # fmt: skip


@pytest.fixture(scope="module")
def study(experiment: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of two methods at two light levels by two seeds, whose runs are those of the made report; one failed."""
    folder = tmp_path_factory.mktemp("study")
    axes = {"scene": ["a"], "electrons": [5, 50], "method": ["naive", "better"], "seed": [0, 1]}
    rows = [{"run": 2 * n + seed, "scene": "a", "electrons": electrons, "method": method, "seed": seed, "state": "done",
             "folder": os.path.relpath(experiment / method, folder), "enhanced.aligned_psnr": value + seed}
            for n, ((method, electrons), value) in enumerate(SCORES.items()) for seed in (0, 1)]  # fmt: skip
    rows[-1] |= {"state": "failed", "reason": "the <disk> broke"}
    (folder / "results.json").write_text(json.dumps({"axes": axes, "columns": [], "rows": rows}))
    table = {"variant": {"better": {"method": "naive"}}, "grid": axes}
    (folder / "study.json").write_text(json.dumps({"file": "l.toml", "table": table}))
    return folder


@pytest.fixture(scope="module")
def copy(experiment: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The made report's runs once more, in other folders."""
    return Path(shutil.copytree(experiment, tmp_path_factory.mktemp("copy") / "page"))


def renamed(place: Place) -> Place:
    """A place with names of runs that no other has."""
    runs = {f"other/{name}": run for name, run in place.runs.items()}
    scores = {f"other/{name}": found for name, found in place.metrics["methods"].items()}
    return replace(place, runs=runs, metrics={**place.metrics, "methods": scores})


Kind = Callable[[Path], Material]


@pytest.fixture(params=["one", "several", "study"])
def kind(request: pytest.FixtureRequest, experiment: Path, copy: Path, study: Path) -> Kind:
    """What makes the material of a page of one place, of several captures, or of a study."""

    def make(path: Path) -> Material:
        if request.param == "study":
            return study_material(study, path)
        (place,), (other,) = places_in([experiment], QUIET), places_in([copy], QUIET)
        for run in place.runs.values():
            run.record["cameras"] = CAMERAS  # so that their block has something to show, too
        return material_of([place] if request.param == "one" else [place, renamed(other)], path)

    return make


def blocks_of(made: Path) -> list[str]:
    return re.findall(r'<(?:section|header) data-block="([^"]+)"', made.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", NAMES)
def test_a_block_that_is_taken_out_is_on_no_page(
    name: str, kind: Kind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = blocks_of(page.build(kind(tmp_path / "whole.html"), QUIET))
    monkeypatch.setattr(page, "BLOCKS", tuple(block for block in page.BLOCKS if block.name != name))
    left = blocks_of(page.build(kind(tmp_path / "less.html"), QUIET))
    assert left == [each for each in whole if each != name]
    assert whole == [each for each in NAMES if each in whole]


SEVERAL = {"header", "look", "scores", "cost", "signal", "simulated", "departures", "configuration"}


def test_a_page_of_one_place_and_one_of_many_have_the_same_blocks(
    kind: Kind, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    found = set(blocks_of(page.build(kind(tmp_path / "page.html"), QUIET)))
    assert found >= SEVERAL
    own = {"one": {"cameras", "training"}, "several": set(), "study": {"light", "failed"}}
    assert found - SEVERAL >= own[request.node.callspec.params["kind"]]


def material(study: Path) -> Material:
    return study_material(study, study / "report.html")


def test_shared_stages_count_once(study: Path) -> None:
    found = {row["label"]: row for row in costs(material(study))}
    assert {label: row["count"] for label, row in found.items()} == {
        "render": 1, "capture": 1, "reconstruct: naive": 1, "reconstruct: better": 1
    }  # fmt: skip
    assert found["reconstruct: naive"]["seconds"] == 2.0


def test_the_costs_of_a_program_are_its_own_memory(study: Path) -> None:
    found = material(study)
    for each in found.made.values():
        each.run.record["peak_bytes"] = 7_000_000_000
    assert {row["label"]: row["peak"] for row in costs(found)}["reconstruct: naive"] == 7_000_000_000


def without_rows(folder: Path) -> None:
    """Runs of `naive` as if its rows had been of a package that is gone: method, enhancer, cameras and metric."""
    record = json.loads((folder / "naive" / "run.json").read_text())
    record |= {
        "method": "theirs",
        "title": "their method (from their-package 1.2)",
        "sees_truth": True,
        "cameras": {**CAMERAS, "source": "carousel:step_deg=3"},
    }
    record["enhancement"]["enhancer"] = "times"
    record["stage"]["config"]["cameras"] = "carousel:step_deg=3"
    (folder / "naive" / "run.json").write_text(json.dumps(record))
    metrics = json.loads((folder / "naive" / "metrics.json").read_text())
    metrics["methods"]["naive"]["mean"]["lit"]["crispness"] = 0.5
    (folder / "naive" / "metrics.json").write_text(json.dumps(metrics))


def absent_rows(page: Path) -> list[str]:
    section = page.read_text(encoding="utf-8").partition('data-block="absent"')[2].partition("</section>")[0]
    return re.findall(r"<dt>(.*?)</dt>", section)


def test_results_whose_rows_are_gone_are_reported_on_and_the_rows_are_named(experiment: Path, tmp_path: Path) -> None:
    """Rationale: a page of finished runs could not be written once the package of an enhancer was gone."""
    folder = Path(shutil.copytree(experiment, tmp_path / "page"))
    without_rows(folder)
    found = page.write_report(folder, QUIET)
    assert absent_rows(found) == ["method theirs", "enhancer times", "cameras carousel", "metric crispness"]
    assert 'alt="Rendered by naive' in found.read_text(encoding="utf-8")
    (place,) = places_in([folder], QUIET)
    assert not place.rows["naive"].competes  # it saw the truth, as its record says
    assert place.rows["better"].competes
    with pytest.raises(ValueError, match="naive cannot be scored: unknown enhancer 'times'; available: "):
        score(folder / "naive", QUIET)


def test_a_study_whose_variant_is_of_a_method_that_is_gone_is_reported_on(
    experiment: Path, study: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(experiment, tmp_path / "page"))
    without_rows(folder)
    shutil.copy(study / "study.json", folder)
    table = json.loads((study / "results.json").read_text())
    for row in table["rows"]:
        row |= {"folder": row["method"], "lit.crispness": 0.5}
    (folder / "results.json").write_text(json.dumps(table))
    told = json.loads((study / "study.json").read_text())
    told["table"]["variant"] |= {"soft": {"method": "theirs", "gain": 2}}
    (folder / "study.json").write_text(json.dumps(told))
    found = page.write_study(folder)
    assert absent_rows(found) == ["method theirs", "enhancer times", "cameras carousel", "metric crispness"]
    # The titles that the runs recorded, for want of rows.
    assert "their method (from their-package 1.2)</dd>" in found.read_text(encoding="utf-8")


def test_of_results_whose_rows_are_here_nothing_is_said_to_be_gone(experiment: Path) -> None:
    assert absent_rows(experiment / "report.html") == []


def test_a_reference_that_is_not_known_is_no_metric_that_is_gone() -> None:
    material: Any = SimpleNamespace(made={}, rows=[{"enhanced": None, "lit.psnr": 20.0}])
    assert absent(material, cast(Any, None)) is None
    material.rows[0]["enhanced.crispness"] = 0.5
    assert list((absent(material, cast(Any, None)) or {})["facts"]) == ["metric crispness"]


def test_places_of_the_same_title_are_told_apart_by_their_folders_whichever_they_are(tmp_path: Path) -> None:
    def place(title: str, folder: str) -> Any:
        return SimpleNamespace(title=title, capture=SimpleNamespace(path=tmp_path / folder))

    places = [place("one", "a"), place("two", "b"), place("one", "c"), place("two", "d/e"), place("three", "f")]
    assert titles(places, tmp_path) == ["one (a)", "two (b)", "one (c)", "two (d/e)", "three"]
    assert titles(places[:1], tmp_path) == [""]


def test_of_many_views_some_are_shown_evenly() -> None:
    assert spread([3, 5, 7, 9, 11, 13, 15, 17, 19], 3) == [3, 11, 19]
    assert spread([4, 2], 3) == [4, 2]


def test_every_run_of_every_place_is_a_row_with_all_its_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def place(title: str, *names: str) -> Any:
        values = {name: float(k) for k, name in enumerate(names, 1)}
        methods = {name: {"mean": {"lit": {"psnr": 10 * value}}} for name, value in values.items()}
        known = {name: Estimate(value, 0.5, 2.0, "views", 1, 1, 3) for name, value in values.items()}
        metrics = {"methods": methods, "recovered": known, "recovered_lit": {}, "unavailable": {f"x-{title}": "why"}}
        lit = SimpleNamespace(views=SimpleNamespace(unregistered=[f"{title}.png"]))
        runs = {name: SimpleNamespace(name=name) for name in names}
        record = SimpleNamespace(views=10 + len(names))
        return SimpleNamespace(title=title, runs=runs, metrics=metrics, deltas=lambda kind: (known, "base"), lit=lit,
                               capture=SimpleNamespace(path=tmp_path / title, record=record))  # fmt: skip

    monkeypatch.setattr(module, "flat_scores", lambda scores: {"lit.psnr": scores["mean"]["lit"]["psnr"]})
    monkeypatch.setattr(module, "_by_method", lambda runs: {})
    monkeypatch.setattr(module, "made_of", lambda run, name, known: name)
    found = material_of([place("s", "a", "b"), place("t", "c", "d", "e")], tmp_path / "report.html")
    assert [(row["run"], row["capture"], row["method"]) for row in found.rows] == [
        (1, "s", "a"), (2, "s", "b"), (3, "t", "c"), (4, "t", "d"), (5, "t", "e")
    ]  # fmt: skip
    assert [row["lit.psnr"] for row in found.rows] == [10.0, 20.0, 10.0, 20.0, 30.0]
    assert [row["recovered"] for row in found.rows] == [row["over.lit"] for row in found.rows] == [1, 2, 1, 2, 3]
    assert {row["recovered_error"] for row in found.rows} == {row["over.lit_error"] for row in found.rows} == {0.5}
    assert found.made == dict(enumerate("abcde", 1))
    assert list(found.places) == ["s", "t"]
    assert found.unavailable == {"s: x-s": "why", "t: x-t": "why"}
    assert found.unregistered == {"s": (["s.png"], 12), "t": (["t.png"], 13)}


def test_what_differs_from_any_row_to_another_is_varied() -> None:
    nothing: Any = {}
    axes: dict[str, Any] = dict.fromkeys(("level", "scene", "method", "seed"), ())
    for other in range(3):
        rows = [{"scene": "a", "level": 1, "seed": 0, "method": name} for name in "xyz"]
        rows[other] |= {"level": 2, "seed": 1}
        assert Material(Path("r.html"), rows, axes, nothing, nothing, {}).varied == ["level", "seed"]


def test_the_title_of_a_study_counts_the_values_of_all_its_runs() -> None:
    rows = [{"electrons": light, "method": name} for light, name in zip((5.0, 20.0, 20.0), "xyz", strict=True)]
    axes: dict[str, Any] = dict.fromkeys(("electrons", "method"), ())
    found = Material(Path("r.html"), rows, axes, {}, {}, {}, study=(Path("f"), {"file": "s.toml"}))
    assert found.title == "s: 2 light levels (5, 20 electrons) × 3 methods"
