"""Claims about curves as figures and tables: every knob and every point has its place."""

import math
import re
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest

from novags.testbed.report.charts import DISC, label
from novags.testbed.report.curves import figure as module
from novags.testbed.report.curves import page
from novags.testbed.report.curves.figure import DIAMOND, _panel, _series, figure
from novags.testbed.report.curves.table import heading, joined, said, tables

SVG = "{http://www.w3.org/2000/svg}"
KNOBS = ("nova.steps", "nova.way", "nova.lone", "other.size")


def point(knob: str, setting: Any, seconds: float, error: float, **more: Any) -> dict[str, Any]:
    return {"knob": knob, "setting": setting, "seconds": 2 * seconds, "cpu_seconds": seconds, "error": error,
            "error_sd": 0.1 * error, "error_unit": "codes", "default": False, "front": True, "of": "a call",
            "why": "it is", "repeats": 3, "workload": {"scene": knob.partition(".")[0]}, "db_lost": None,
            "hardware": {"processor": "P", "cores": 2}, **more}  # fmt: skip


@pytest.fixture
def points() -> list[dict[str, Any]]:
    """Four points a knob; the default is the third, and off the front for the last knob of each subject."""
    return [
        point(knob, f"s{k}", (1.0, 8.0, 2.0, 4.0)[k], (9.0, 1.0, 6.0, 5.0)[k], default=k == 2,
              front=not (k == 2 and knob in KNOBS[2:]), repeats=2 + k)
        for knob in KNOBS for k in range(4)
    ]  # fmt: skip


def test_every_knob_has_a_panel_with_all_its_points(points: list[dict[str, Any]]) -> None:
    root = ElementTree.fromstring(figure(points, "a & b"))
    marks = [path for path in root.iter(f"{SVG}path") if path.get("class", "").startswith("mark")]
    texts = [text.text for text in root.iter(f"{SVG}text")]
    assert len(marks) == len(points)
    assert [texts.count(f"s{k}") for k in range(4)] == [len(KNOBS)] * 4
    assert [text for text in texts if text in {knob.partition(".")[2] for knob in KNOBS}] == [
        knob.partition(".")[2] for knob in KNOBS
    ]
    places = [group.get("transform") for group in root.iter(f"{SVG}g") if "translate" in (group.get("transform") or "")]
    assert len(set(places)) == len(KNOBS)


def test_points_are_joined_along_the_front_and_told_apart(points: list[dict[str, Any]]) -> None:
    own = points[8:12]  # the default is off the front
    front, *each = _series(own)
    assert [(p.x, p.y) for p in front.points] == [(1.0, 9.0), (4.0, 5.0), (8.0, 1.0)]
    assert [(one.key, one.mark) for one in each] == [("other", DISC)] * 3 + [("default off", DIAMOND)]
    assert [(one.points[0].low, one.points[0].high) for one in each][0] == pytest.approx((8.1, 9.9))
    others = [{**one, "front": False} for one in own]
    assert [one.key for one in _series(others)[1:]] == ["other off"] * 3 + ["default off"]
    assert [one.key for one in _series(points[:4])[1:]] == ["other"] * 3 + ["default"]


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (2, 3, 0, 1), (1, 0, 3, 2)])
def test_the_axes_of_a_panel_hold_all_points_and_their_bars(
    points: list[dict[str, Any]], order: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = list[Any]()
    chart = SimpleNamespace(at=lambda x, y: (x, y), inside=lambda: "", box=(0, 0, 1, 1), width=1)
    monkeypatch.setattr(module, "Chart", lambda *a, **b: drawn.append(a) or chart)
    for errors, spread, logarithmic in (((9.0, 1.0, 6.0, 5.0), 0.4, True), ((9.0, 8.0, 8.5, 8.25), 2.0, False)):
        _panel("nova.steps", [{**points[k], "error": errors[k], "error_sd": spread} for k in order])
        _, x, y, series, *_ = drawn[-1]
        assert y.logarithmic == logarithmic
        low, high = (10**end if logarithmic else end for end in (y.low, y.high))
        assert (low <= min(errors) - spread, high >= max(errors) + spread) == (True, True)
        assert (x.low <= math.log10(0.8), x.high >= math.log10(10.0)) == (True, True)
        assert len(series) == 5


def test_a_label_lies_on_no_other_label_and_on_no_point() -> None:
    """Every place but one beside the point is taken, whichever that is."""
    chart: Any = SimpleNamespace(box=(0, 0, 400, 300), width=360)
    taken = list[tuple[float, float, float]]()
    found = [label("s", (150.0, 100.0), chart, taken) for _ in range(4)]
    places = [tuple(map(float, re.findall(r'[xy]="([\d.]+)"', each))) for each in found]
    for i, (x, y) in enumerate(places):
        for a, b in places[:i]:
            assert abs(x - a) >= 8.2 or abs(y - b) >= 11


def test_every_point_is_in_the_way_of_labels(points: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    blocked = list[int]()
    monkeypatch.setattr(module, "label", lambda text, beside, chart, taken: blocked.append(len(taken)) or "")
    _panel("nova.steps", points[:4])
    assert blocked == [4] * 4


def test_every_subject_in_a_page_says_how_it_was_measured(points: list[dict[str, Any]]) -> None:
    points = [point("lone.size", "s0", 1.0, 1.0, repeats=7), *points]
    ends = {name: page.marks(name) for name in ("nova", "other", "third", "lone")}
    text = "\n".join(f"# {name}\n{begin}\nold {name}\n{end}" for name, (begin, end) in ends.items())
    found = page.embedded(text, points)  # type: ignore[arg-type]
    for name in ("nova", "other", "lone"):
        own = [one for one in points if one["knob"].startswith(f"{name}.")]
        part = found[found.index(f"# {name}") :].partition("<!-- end")[0]
        assert heading(own) in part
        assert f"old {name}" not in found
    assert "old third" in found
    assert page.embedded(found, points) == found  # type: ignore[arg-type]


def test_every_point_has_a_row_and_decibels_where_any_has_them(points: list[dict[str, Any]]) -> None:
    text = tables(points)
    assert re.findall(r"^#### (.*)$", text, re.M) == list(KNOBS)
    assert [text.count(f"| s{k} |") + text.count(f"| **s{k}** (default) |") for k in range(4)] == [4] * 4
    assert text.count("The default, s2, is on the front") == 2
    own = [{**one, "error_unit": "RMSE of held-out views"} for one in points[:4]]
    assert "lost to the default" not in tables(own)
    for k in (0, 1, 3):
        some = [one | {"db_lost": 1.25, "db_lost_sd": 0.5} if one is own[k] else one for one in own]
        assert "lost to the default" in tables(some)
        assert "1.25 ± 0.5 dB" in tables(some)


def ended(points: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """With a knob of one point, which is its default, before and after all others."""
    lone = [point(knob, "only", 1.0, 1.0, default=True) for knob in ("nova.begin", "other.end")]
    return [lone[0], *points, lone[1]]


def test_a_knob_of_one_point_has_a_table_that_tells_its_default(points: list[dict[str, Any]]) -> None:
    text = tables(ended(points))
    assert re.findall(r"^#### (.*)$", text, re.M) == ["nova.begin", *KNOBS, "other.end"]
    assert text.count("The default, only, is on the front: it is.") == 2


def test_one_table_of_all_knobs_has_a_row_for_every_setting(points: list[dict[str, Any]]) -> None:
    head, *found = joined(ended(points))
    assert (head[:3], head[-1]) == (["knob", "setting", "default"], "reason")
    default = {"only": "yes", "s2": "yes"}
    settings = [(knob, f"s{k}") for knob in KNOBS for k in range(4)]
    assert [tuple(row[:3]) for row in found] == [
        (knob, setting, default.get(setting, ""))
        for knob, setting in [("nova.begin", "only"), *settings, ("other.end", "only")]
    ]
    for row in found:
        own = [one for one in ended(points) if one["knob"] == row[0]]
        assert row[-1] == (said(own) if row[2] else "")


@pytest.mark.parametrize("k", [0, 1, 3])
def test_a_default_that_any_point_beats_clearly_is_said_to_be(points: list[dict[str, Any]], k: int) -> None:
    own = [{**one, "error_sd": 0.01} for one in points[8:12]]
    own[k] |= {"cpu_seconds": 0.5, "error": 0.5}
    assert f"is off the front (s{k}: faster and more accurate" in said(own)
    own[k]["repeats"] = 1
    assert "a single measurement has no known spread" in said(own)


def test_the_heading_says_how_often_the_points_were_measured(points: list[dict[str, Any]]) -> None:
    assert "Repetitions: 2 to 5. Machine: P, 2 cores." in heading(points)
    assert "Repetitions: 2 to 5." in heading(points[:4])
    assert "Repetitions: 4." in heading([{**one, "repeats": 4} for one in points])
