"""Claims about the ranking that a page begins with: means over scenes, errors, ties, and charts on common axes."""

import json
import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.metrics.differences import Estimate
from novags.testbed.report.blocks import ranking as module
from novags.testbed.report.blocks.ranking import multiples, pivot, pivot_table, ranking
from novags.testbed.report.material import Material
from novags.testbed.report.rows import Row

COLUMN = "enhanced.aligned_psnr"
SECONDS = {"a": 10.0, "b": 40.0, "oracle": 20.0}


def material(values: dict[tuple[str, float, str], float], *, study: bool = True) -> Material:
    """A study of these scores by scene, electrons and method, a run each."""
    rows = [{"run": n, "scene": scene, "electrons": electrons, "method": method, "seed": 0, "state": "done",
             COLUMN: value, "seconds.reconstruct": SECONDS[method]}
            for n, ((scene, electrons, method), value) in enumerate(values.items(), 1)]  # fmt: skip
    axes = {name: list(dict.fromkeys(row[name] for row in rows)) for name in ("scene", "electrons", "method", "seed")}
    looks = {name: Row(name, f"m-{name}", name, "", "", "#123456", None, name != "oracle", "") for name in SECONDS
             if name in axes["method"]}  # fmt: skip
    return Material(Path("r.html"), rows, axes, looks, {}, {}, study=(Path("f"), {"file": "s.toml"}) if study else None)


def texts(table: Any) -> list[list[str]]:
    return [[re.sub("<.*?>", "", str(cell.text)) for cell in row.cells] for row in table.rows]


def classes(table: Any) -> list[list[str]]:
    """Of each cell "best", or its place."""
    attributes = [[str(cell.attributes) for cell in row.cells[1:]] for row in table.rows]
    return [["best" if "best" in each else (re.search(r'data-rank="(\d)"', each) or " ")[0] for each in row]
            for row in attributes]  # fmt: skip


SCENES = {("one", 5.0, "a"): 20.0, ("two", 5.0, "a"): 22.0, ("three", 5.0, "a"): 24.0,
          ("one", 5.0, "b"): 21.0, ("two", 5.0, "b"): 23.1, ("three", 5.0, "b"): 24.9,
          ("one", 5.0, "oracle"): 30.0, ("two", 5.0, "oracle"): 30.0, ("three", 5.0, "oracle"): 30.0}  # fmt: skip


def test_of_one_condition_the_mean_over_the_scenes_stands_before_each_of_them() -> None:
    found = pivot(material(SCENES))
    assert found is not None
    table = pivot_table(found, material(SCENES))
    assert [column.heading for column in table.columns] == ["#", "Method", "Mean of 3 scenes", "one", "two", "three"]
    assert texts(table) == [
        ["†", "oracle†", "30.00 ± 0.00", "30.00", "30.00", "30.00"],
        ["1", "b", "23.00 ± 1.13", "21.00", "23.10", "24.90"],
        ["2", "a", "22.00 ± 1.15", "20.00", "22.00", "24.00"],
    ]
    assert [row[1] for row in classes(table)] == [" ", "best", 'data-rank="2"']


def test_where_less_is_better_the_least_stands_first_and_is_best() -> None:
    found = pivot(material(SCENES))
    assert found is not None
    ranked = {"a": 1, "b": 2}
    table = pivot_table(replace(found, more=False, ranked=dict.fromkeys(found.values, ranked)), material(SCENES))
    assert [row[1] for row in texts(table)] == ["a", "b", "oracle†"]
    assert [row[1:] for row in classes(table)] == [
        ["best", *["best"] * 3], ['data-rank="2"', *['data-rank="2"'] * 3], [" "] * 4
    ]  # fmt: skip


def test_methods_that_are_not_seen_to_differ_share_place_and_colour_and_none_is_best() -> None:
    close = SCENES | {("one", 5.0, "b"): 19.0, ("two", 5.0, "b"): 24.0, ("three", 5.0, "b"): 24.5}
    found = pivot(material(close))
    assert found is not None
    table = pivot_table(found, material(close))
    assert {row[1]: row[0] for row in texts(table)} == {"oracle†": "†", "b": "1=", "a": "1="}
    assert not any("best" in row[1] for row in classes(table))


def test_conditions_stand_side_by_side_each_with_the_mean_over_its_scenes() -> None:
    both = SCENES | {(scene, 50.0, name): value + 5 + (name == "a") * 2 for (scene, _, name), value in SCENES.items()}
    found = pivot(material(both))
    assert found is not None
    table = pivot_table(found, material(both))
    assert [column.heading for column in table.columns] == ["Method", "electrons 5", "electrons 50"]
    assert dict((row[0], row[1:]) for row in texts(table)) == {
        "oracle†": ["30.00 ± 0.00", "35.00 ± 0.00"], "a": ["22.00 ± 1.15", "29.00 ± 1.15"],
        "b": ["23.00 ± 1.13", "28.00 ± 1.13"],
    }  # fmt: skip
    assert {row[0]: marks for row, marks in zip(texts(table), classes(table), strict=True)} == {
        "oracle†": [" ", " "], "a": ['data-rank="2"', "best"], "b": ["best", 'data-rank="2"'],
    }  # fmt: skip


def test_a_method_that_lacks_a_scene_says_so() -> None:
    some = {key: value for key, value in SCENES.items() if key != ("three", 5.0, "b")}
    found = pivot(material(some))
    assert found is not None
    cells = {row[1]: row[2] for row in texts(pivot_table(found, material(some)))}
    assert cells["b"] == "22.05 ± 1.05 (2 of 3 scenes)"
    assert cells["a"] == "22.00 ± 1.15"
    table = pivot_table(found, material(some))
    kept = {row[1]: str(own.cells[2].attributes) for row, own in zip(texts(table), table.rows, strict=True)}
    assert 'data-scenes="2 of 3"' in kept["b"]  # for the CSV of the page
    assert "data-scenes" not in kept["a"]
    assert re.search(r'data-error="1\.15', kept["a"])


def test_a_scene_that_one_method_alone_has_is_among_the_scenes() -> None:
    some = material({("one", 5.0, "a"): 20.0, ("two", 5.0, "a"): 22.0, ("two", 5.0, "b"): 23.0})
    found = pivot(some)
    assert found is not None
    table = pivot_table(found, some)
    assert [column.heading for column in table.columns][2:] == ["Mean of 2 scenes", "one", "two"]
    assert {row[1]: row[3:] for row in texts(table)} == {"a": ["20.00", "22.00"], "b": ["", "23.00"]}


def test_a_method_that_fails_where_all_do_badly_stands_behind_one_that_beats_it() -> None:
    """b has the larger mean: its scenes are the bright ones, on which a is above it."""
    some = SCENES | {("one", 5.0, "a"): 2.0, ("two", 5.0, "a"): 23.5, ("three", 5.0, "a"): 25.3}
    del some["one", 5.0, "b"]
    found = pivot(material(some))
    assert found is not None
    assert [row[1] for row in texts(pivot_table(found, material(some)))] == ["oracle†", "a", "b"]


def test_runs_of_one_name_share_a_row_over_captures_and_none_within_one() -> None:
    def made(name: str) -> Any:
        return SimpleNamespace(run=SimpleNamespace(name=name))

    lines: list[Any] = [SimpleNamespace(where=where, method=f"{folder}/naive") for where, folder in
                        (("dark", "one"), ("bright", "two"), ("bright", "three"), ("dim", "four"))]  # fmt: skip
    page: Any = SimpleNamespace(study=None, one=None, lines=lines, of=lambda line: [made("naive")],
                                called=lambda each: each.run.name)  # fmt: skip
    assert [module.method_of(line, page) for line in lines] == ["naive", "two/naive", "three/naive", "naive"]


def test_scores_that_are_not_finite_draw_no_chart() -> None:
    inf = {("one", electrons, name): float("inf") for electrons in (5.0, 50.0) for name in "ab"}
    assert ranking(material(inf))["chart"] == ""
    assert ranking(material({key: value for key, value in inf.items() if key[1] == 5.0}))["chart"] == ""


def charts(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    drawn = list[Any]()

    def chart(title: str, x: Any, y: Any, series: Any, *size: Any, **more: Any) -> Any:
        drawn.append(SimpleNamespace(title=title, x=x, y=y, series={each.name: each.points for each in series}))
        return SimpleNamespace(svg=lambda: title)

    monkeypatch.setattr(module, "Chart", chart)
    return drawn


def test_the_chart_is_over_the_light_where_that_varies_and_over_the_time_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn = charts(monkeypatch)
    ranking(material(SCENES))
    both = SCENES | {(scene, 50.0, name): value + 5 for (scene, _, name), value in SCENES.items()}
    ranking(material(both))
    time, light = drawn
    assert time.x.label == "seconds to reconstruct"
    assert {name: (points[0].x, round(points[0].y, 9)) for name, points in time.series.items()} == {
        "a": (10.0, 22.0), "b": (40.0, 23.0), "oracle": (20.0, 30.0)
    }  # fmt: skip
    (point,) = time.series["a"]
    assert (point.low, point.high) == (pytest.approx(22 - 2 / 3**0.5), pytest.approx(22 + 2 / 3**0.5))
    assert light.x.label == "electrons per green pixel"
    assert tuple(light.x.ticks) == (5.0, 50.0)
    assert [(point.x, round(point.y, 9)) for point in light.series["b"]] == [(5.0, 23.0), (50.0, 28.0)]


def test_the_error_in_the_chart_over_time_is_over_scenes_and_not_over_conditions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of one scene with two conditions 5 dB apart no error is known."""
    drawn = charts(monkeypatch)
    monkeypatch.setattr(module, "ELECTRONS", "another axis")
    ranking(material({("one", electrons, name): 20.0 + electrons / 10 for electrons in (5.0, 55.0) for name in "ab"}))
    (time,) = drawn
    assert time.x.label == "seconds to reconstruct"
    assert [(point.y, point.low, point.high) for point in time.series["a"]] == [(23.0, 23.0, 23.0)]


def test_the_time_of_a_method_is_the_mean_over_all_its_runs() -> None:
    found = material(SCENES)
    for row in found.rows:
        row["seconds.reconstruct"] += {"one": 0.0, "two": 1.0, "three": 5.0}[row["scene"]]
    assert module.seconds_of(found) == {name: pytest.approx(value + 2) for name, value in SECONDS.items()}


def test_the_chart_over_the_light_has_a_level_that_one_method_alone_has(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = charts(monkeypatch)
    ranking(material({("one", 5.0, "a"): 20.0, ("one", 50.0, "a"): 25.0, ("one", 50.0, "b"): 26.0}))
    (light,) = drawn
    assert {name: [(point.x, point.y) for point in points] for name, points in light.series.items()} == {
        "a": [(5.0, 20.0), (50.0, 25.0)], "b": [(50.0, 26.0)]
    }  # fmt: skip
    assert tuple(light.x.ticks) == (5.0, 50.0)


def test_the_axes_of_a_chart_hold_the_bars_of_every_method_and_leave_room_for_names(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn = charts(monkeypatch)
    points = {name: (x, Estimate(value, 6.0, 2.0, "views", 1, 1, 3)) for name, x, value in
              (("a", 10.0, 20.0), ("b", 40.0, 21.0))}  # fmt: skip
    module.over_time([("dB", points)], material(SCENES).looks)
    (one,) = drawn
    assert one.y.low <= 14
    assert one.y.high >= 27
    assert 10**one.x.low <= 8
    assert 10**one.x.high >= 50


def test_the_axes_of_a_chart_over_the_light_hold_every_point_and_its_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = charts(monkeypatch)
    gains = {5.0: 0.0, 20.0: -9.0, 50.0: 9.0}
    ranking(material({(scene, level, name): value + gain for level, gain in gains.items()
                      for (scene, _, name), value in SCENES.items() if name != "oracle"}))  # fmt: skip
    (one,) = drawn
    assert one.y.low < 22 - 9 - 2 / 3**0.5
    assert one.y.high > 23 + 9 + 1.95 / 3**0.5
    assert 10**one.x.low < 5
    assert 10**one.x.high > 50


def test_every_place_of_a_study_has_a_chart_and_all_share_their_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn, page = charts(monkeypatch), SimpleNamespace()
    found = multiples(material(SCENES), page)  # type: ignore[arg-type]
    assert found is not None
    assert [place for place, _ in found["panels"]] == [f"scene {name}, electrons 5" for name in ("one", "two", "three")]
    assert len({(each.x.low, each.x.high, each.y.low, each.y.high) for each in drawn}) == 1
    assert [each.series["a"][0].y for each in drawn] == [20.0, 22.0, 24.0]
    assert [sorted(each.series) for each in drawn] == [["a", "b", "oracle"]] * 3
    one = {key: value for key, value in SCENES.items() if key[0] == "one"}
    assert multiples(material(one), page) is None  # type: ignore[arg-type]
    assert multiples(material(SCENES, study=False), page) is None  # type: ignore[arg-type]
    light = SCENES | {(scene, 50.0, name): value for (scene, _, name), value in SCENES.items()}
    assert multiples(material(light), page) is None  # type: ignore[arg-type]


def test_the_ranking_of_one_place_has_gains_with_errors_and_their_chart(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = charts(monkeypatch)
    seen = list[Any]()
    monkeypatch.setattr(module, "leading", lambda place: ("enhanced", "aligned_psnr", ""))

    def table(kind: str, place: Any, commands: Any, more: Any, **given: Any) -> str:
        seen.append((more, given))
        return "table"

    monkeypatch.setattr(module, "ranked_table", table)
    monkeypatch.setattr(module, "seconds_of", lambda material: SECONDS)
    gains = {"b": Estimate(1.5, 0.25, 2.0, "views", 1, 1, 3), "oracle": Estimate(8.0, 0.5, 2.0, "views", 1, 1, 3)}
    looks = material(SCENES).looks
    place: Any = SimpleNamespace(deltas=lambda kind: (gains, "a"), metrics={"recovered": {}}, rows=looks)
    found = ranking(SimpleNamespace(one=place, made={}, commands={}))  # type: ignore[arg-type]
    assert found["table"] == "table"
    ((more, given),) = seen
    assert [column.heading for column, *_ in more] == ["Over a"]
    assert given == {"count": 1, "name": "ranking"}
    ((points,),) = [[each.series for each in drawn]]
    assert {name: (own[0].y, own[0].low, own[0].high) for name, own in points.items()} == {
        "a": (0.0, 0.0, 0.0), "b": (1.5, 1.25, 1.75), "oracle": (8.0, 7.5, 8.5)
    }  # fmt: skip
    assert found["said"].endswith("† sees the truth: a bound and no rival.")
    place.rows = {name: row for name, row in looks.items() if row.competes}
    del gains["oracle"]
    left = {name: SECONDS[name] for name in place.rows}
    monkeypatch.setattr(module, "seconds_of", lambda material: left)
    assert "†" not in ranking(SimpleNamespace(one=place, made={}, commands={}))["said"]  # type: ignore[arg-type]
    monkeypatch.setattr(module, "leading", lambda place: None)
    assert ranking(SimpleNamespace(one=place)) == {}  # type: ignore[arg-type]


def test_the_title_of_a_study_names_its_axes_with_their_counts() -> None:
    assert material(SCENES).title == "s: 3 scenes × 3 methods"
    one = {("one", 5.0, "a"): 20.0}
    assert material(one).title == "s: 1 run"


def test_the_title_of_a_study_says_the_light_and_the_views(monkeypatch: pytest.MonkeyPatch) -> None:
    def titled(levels: Sequence[float], *captured: dict[str, Any]) -> str:
        found = material({("one", level, "a"): 20.0 for level in levels})
        made = {number: SimpleNamespace(captured=record) for number, record in enumerate(captured, 1)}
        return replace(found, made=made).title  # type: ignore[arg-type]

    assert titled([20.0], {"views": 20, "electrons": 20.0}) == "s: 1 run, 20 views, 20 electrons"
    two = {"views": 20, "electrons": 5.0}, {"views": 20, "electrons": 20.0}
    assert titled([20.0, 5.0], *two) == "s: 2 light levels (5, 20 electrons), 20 views"
    assert titled([1.0, 2.0, 4.0, 8.0, 0.5]) == "s: 5 light levels (0.5 to 8 electrons)"
    assert titled([5.0, 20.0], two[0], two[1] | {"views": 12}) == "s: 2 light levels (5, 20 electrons)"


RANKED = {"†": "oracle†", "1": "better", "2": "naive"}


def lines_said(text: str) -> dict[str, str]:
    """The places and names of a ranking among other lines."""
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("#  Method"))
    return dict(line.split()[:2] for line in lines[start + 1 : start + 4])


def test_a_run_ends_with_the_ranking_and_the_next_command(
    experiment: Path, tmp_path: Path, call: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(experiment, tmp_path / "done")
    monkeypatch.setattr(
        "novags.testbed.study.place.run", lambda preset, out, console, *, report, **more: report(out, console)
    )
    assert call("run", "--out", str(folder)) == 0
    said = capsys.readouterr()
    assert lines_said(said.out) == RANKED
    assert "+3.50 ± " in said.out
    assert said.out.splitlines()[-1].startswith("open it in a browser: file:")
    assert said.err.splitlines()[-1].startswith(f"next: novags view {folder}, ")


def test_a_study_ends_with_the_ranking_and_the_next_command(
    experiment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from novags.commands import study

    out = tmp_path / "study"
    out.mkdir()
    rows = [{"run": n, "method": name, "seed": 0, "state": "done", COLUMN: value,
             "folder": os.path.relpath(experiment / name, out)}
            for n, (name, value) in enumerate((("naive", 20.25), ("better", 23.75), ("oracle", 30.5)), 1)]  # fmt: skip
    axes = {"method": ["naive", "better", "oracle"], "seed": [0]}
    (out / "results.json").write_text(json.dumps({"axes": axes, "rows": rows}))
    table = {"variant": {"better": {"method": "naive"}}}
    (out / "study.json").write_text(json.dumps({"file": "s.toml", "table": table}))
    monkeypatch.setattr("novags.testbed.study.conduct.conduct", lambda *a, **b: rows)
    for name in ("refuse_other", "describe"):
        monkeypatch.setattr(f"novags.testbed.study.session.{name}", lambda *a: None)
    plan: Any = SimpleNamespace(study=SimpleNamespace(axes=axes, ends="run"), runs=())
    study._conduct(plan, out, tmp_path / "store", None, None, False, False, False)  # type: ignore[arg-type]
    said = capsys.readouterr()
    assert lines_said(said.out) == RANKED
    assert said.out.splitlines()[-2].startswith("PSNR aligned, noise-free, mean over seeds and views; ± is ")
    assert said.out.splitlines()[-2].endswith(" † sees the truth: a bound and no rival.")
    assert said.err.splitlines()[-1] == f"next: novags report {out}"
