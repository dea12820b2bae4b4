"""Claims about the curves of a page over the light, their pictures and the files beside it."""

import csv
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.report.blocks import light
from novags.testbed.report.blocks import light as module
from novags.testbed.report.blocks.light import (
    as_record,
    charts_of,
    draw,
    files_in,
    knee_rows,
    light_files,
    point_rows,
    varies,
)  # fmt: skip
from novags.testbed.study.light import Curve, light_curves

LEVELS, METHODS, SCENES = (1.0, 4.0, 16.0), ("a", "b"), ("one", "two")
FALL = {1.0: 10.0, 4.0: 24.0, 16.0: 30.0}


def test_every_curve_that_breaks_has_a_row_in_words() -> None:
    knees = [{"method": name, "measure": "psnr", "electrons": 3.0, "low": None, "high": None, "seeds": 2, "unknown": k}
             for k, name in enumerate(("a", "b", "c"))]  # fmt: skip
    curve: Any = SimpleNamespace(measure=SimpleNamespace(key="psnr", label="PSNR"))
    table = light._table(knees, [curve])
    assert table is not None
    assert [str(row.cells[0]) for row in table.rows] == ["a", "b", "c"]
    assert {str(row.cells[1]) for row in table.rows} == {"PSNR"}
    assert [str(row.cells[3]) for row in table.rows] == ["not reached", "not reached", "unknown"]


def rows() -> list[dict[str, Any]]:
    """Two methods in two scenes at three lights by three seeds; `b` is 1 better, scene `two` 2, seed 1 a half, seed 2 a
    quarter; the share of registered views falls in scene `two` alone.
    """
    return [
        {"scene": scene, "electrons": electrons, "method": method, "seed": seed, "state": "done", "run": 1,
         "enhanced.aligned_psnr": FALL[electrons] + (method == "b") + 2 * (scene == "two") + (0, 0.5, 0.25)[seed],
         "cameras.registered_share": 1.0 - 0.5 * (scene == "two" and electrons == 1.0)}
        for scene in SCENES for electrons in LEVELS for method in METHODS for seed in range(3)
    ]  # fmt: skip


AXES: dict[str, Any] = {"scene": SCENES, "electrons": LEVELS, "method": METHODS, "seed": (0, 1, 2)}
LOOKS: dict[str, Any] = {
    name: SimpleNamespace(key=f"key-{name}", color="#102030", competes=name == "a") for name in METHODS
}


@pytest.fixture
def curves() -> list[Curve]:
    return light_curves(rows(), AXES)


def test_every_level_of_every_curve_is_a_point_with_its_least_and_its_largest_value(curves: list[Curve]) -> None:
    found = [row for row in point_rows(curves) if row["measure"] == "psnr"]
    assert [(r["scene"], r["method"], r["electrons"]) for r in found] == [
        (scene, method, electrons) for scene in SCENES for method in METHODS for electrons in LEVELS
    ]
    for row in found:
        value = FALL[row["electrons"]] + (row["method"] == "b") + 2 * (row["scene"] == "two")
        assert (row["least"], row["mean"], row["largest"], row["seeds"]) == (value, value + 0.25, value + 0.5, 3)


def test_every_curve_that_can_break_has_a_row(curves: list[Curve]) -> None:
    found = knee_rows(curves)
    assert [(row["scene"], row["method"]) for row in found if row["measure"] == "psnr"] == [
        (scene, method) for scene in SCENES for method in METHODS
    ]
    assert [row["scene"] for row in found if row["measure"] == "registered"] == ["two", "two"]  # of "one" all are alike
    assert all(1.0 < row["electrons"] < 16.0 for row in found)


def test_each_score_and_place_has_a_chart_of_all_its_curves(curves: list[Curve]) -> None:
    found = charts_of(curves)
    assert [(chart.file, [curve.method for curve in chart.curves]) for chart in found] == [
        ("light-psnr-scene-one.svg", ["a", "b"]), ("light-psnr-scene-two.svg", ["a", "b"]),
        ("light-registered-scene-two.svg", ["a", "b"]),
    ]  # fmt: skip
    alone = [curve for curve in curves if curve.place["scene"] == "two"]
    assert [chart.file for chart in charts_of(alone)] == ["light-psnr.svg", "light-registered.svg"]
    lone = [curve for curve in curves if (curve.measure.key, curve.method) == ("psnr", "a")]  # one in each place
    assert [chart.file for chart in charts_of(lone)] == ["light-psnr-scene-one.svg", "light-psnr-scene-two.svg"]


def test_places_that_are_alike_without_their_umlauts_have_pictures_of_their_own() -> None:
    table = [
        row | {"scene": name}
        for name in ("K\u00fcche", "k\u00f6che", "k che")
        for row in rows()
        if row["scene"] == "one"
    ]
    found = charts_of(light_curves(table, AXES | {"scene": ("K\u00fcche", "k\u00f6che", "k che")}))
    assert len({chart.file for chart in found}) == len(found) == 3


def test_values_vary_if_any_of_any_curve_is_another(curves: list[Curve]) -> None:
    registered = {curve.place["scene"]: curve for curve in curves if curve.measure.key == "registered"}
    assert not varies([registered["one"]])
    assert varies([registered["two"]])
    assert varies([registered["one"], registered["two"]])
    assert varies([registered["two"], registered["one"]])
    for seed in AXES["seed"]:
        table = [row | {"cameras.registered_share": 1.0 - 0.5 * (row["seed"] == seed)} for row in rows()]
        (first, *_) = [curve for curve in light_curves(table, AXES) if curve.measure.key == "registered"]
        assert varies([first])  # from seed to seed


def test_a_chart_holds_all_levels_and_the_ends_of_all_bars(
    curves: list[Curve], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = list[Any]()
    monkeypatch.setattr(module, "Chart", lambda *a, **b: drawn.append(a) or SimpleNamespace(svg=lambda: "svg"))
    assert draw(charts_of(curves)[1], LOOKS) == "svg"  # psnr of scene two
    ((_, x, y, lines, *_),) = drawn
    assert [(line.name, line.key, [p.x for p in line.points]) for line in lines] == [
        (name, f"key-{name}", list(LEVELS)) for name in METHODS
    ]
    assert [(line.points[0].low, line.points[0].high) for line in lines] == [(12.0, 12.5), (13.0, 13.5)]
    room = 0.05 * (33.5 - 12.0)
    assert (y.low, y.high) == (pytest.approx(12.0 - room), pytest.approx(33.5 + room))
    assert tuple(x.ticks) == LEVELS
    assert [line.ring[0] for line in lines] == [
        curve.knee.electrons for curve in charts_of(curves)[1].curves if curve.knee
    ]


def test_places_of_one_score_are_drawn_small_and_on_common_axes(
    curves: list[Curve], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = list[Any]()

    def chart(title: str, x: Any, y: Any, *rest: Any, **more: Any) -> Any:
        drawn.append((title.partition(": ")[0], x, y, more["legend"]))
        return SimpleNamespace(svg=lambda: "<svg >")

    monkeypatch.setattr(module, "Chart", chart)
    material: Any = SimpleNamespace(rows=rows(), axes=AXES, looks=LOOKS, path=tmp_path / "report.html")
    found = module.light(material, SimpleNamespace(path=tmp_path / "report.html"))  # type: ignore[arg-type]
    assert found is not None
    several = [charts for _, charts in found["measures"] if len(charts) > 1]
    assert several
    for charts in several:
        own = [(x, y) for title, x, y, _ in drawn if title == charts[0][0].title.partition(": ")[0]]
        assert len({(x.low, x.high, y.low, y.high) for x, y in own}) == 1
    assert sum(not legend for *_, legend in drawn) == sum(len(charts) for charts in several)
    assert [name for name, *_ in found["key"]] == list(METHODS)


@pytest.mark.parametrize("scene", SCENES)
def test_a_method_that_some_charts_lack_is_in_the_key_of_all(scene: str, tmp_path: Path) -> None:
    some = [row for row in rows() if (row["scene"], row["method"]) != (scene, "b")]
    material: Any = SimpleNamespace(rows=some, axes=AXES, looks=LOOKS, path=tmp_path / "report.html")
    found = module.light(material, SimpleNamespace(path=tmp_path / "report.html"))  # type: ignore[arg-type]
    assert found is not None
    assert [name for name, *_ in found["key"]] == ["a", "b"]
    assert [key for _, key, _ in found["key"]] == ["key-a", "key-b"]


def test_every_score_of_a_single_place_is_on_the_page(tmp_path: Path) -> None:
    some, page = [row for row in rows() if row["scene"] == "two"], tmp_path / "report.html"
    material: Any = SimpleNamespace(rows=some, axes=AXES, looks=LOOKS, path=page)
    found = module.light(material, SimpleNamespace(path=page))  # type: ignore[arg-type]
    assert found is not None
    files = [chart.file for _, charts in found["measures"] for chart, _ in charts]
    assert files == ["light-psnr.svg", "light-registered.svg"]
    assert found["key"] == []  # each chart has a legend


def test_a_record_has_all_levels_of_a_curve(curves: list[Curve]) -> None:
    found = as_record(curves[0])
    assert [(level["electrons"], level["values"]) for level in found["levels"]] == [
        (electrons, [value, value + 0.5, value + 0.25]) for electrons, value in FALL.items()
    ]


def test_all_files_are_written_and_foretold(tmp_path: Path) -> None:
    material: Any = SimpleNamespace(rows=rows(), axes=AXES, looks=LOOKS, path=tmp_path / "report.html")
    page: Any = SimpleNamespace(path=tmp_path / "report.html")
    found = module.light(material, page)
    assert found is not None
    there = sorted(tmp_path.iterdir())
    assert sorted(light_files(material)) == there == files_in(tmp_path, AXES)
    assert len(there) == 3 + 3
    drawn = [chart.file for _, charts in found["measures"] for chart, _ in charts]
    assert drawn == [path.name for path in there if path.suffix == ".svg"]
    assert len(json.loads((tmp_path / "light.json").read_text())["curves"]) == 8
    assert len(list(csv.DictReader((tmp_path / "light.csv").read_text().splitlines()))) == 8 * len(LEVELS)
    assert len(list(found["knees"].rows)) == len(
        list(csv.DictReader((tmp_path / "light-knees.csv").read_text().splitlines()))
    )
    assert files_in(tmp_path, AXES | {"electrons": (1.0,)}) == []
    assert light_files(SimpleNamespace(rows=[], axes={}, path=tmp_path)) == []  # type: ignore[arg-type]
