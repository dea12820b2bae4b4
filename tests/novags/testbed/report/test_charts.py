"""Charts: what is drawn lies where its value is, and is all there."""

import html
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from novags.testbed.report.blocks.training import losses
from novags.testbed.report.charts import MARKS, Axis, Chart, Point, Series, alone, log_ticks, ticks

SVG = "{http://www.w3.org/2000/svg}"
LINEAR, LOG = Axis("x", 0.0, 10.0), Axis("x", 0.0, 2.0, logarithmic=True)


def drawn(*series: Series, x: Axis = LINEAR, y: Axis = LINEAR, **more: Any) -> str:
    return Chart("t", x, y, series, **more).svg()


def numbers(path: str | None) -> list[list[float]]:
    """The points of a path of straight lines."""
    return [[float(v) for v in point.split(",")] for point in re.split("[MLVHm]", path or "") if "," in point]


def lines(svg: str) -> list[ElementTree.Element]:
    found = [each for each in ElementTree.fromstring(svg).iter() if each.tag.removeprefix(SVG) == "path"]
    return [each for each in found if (each.get("class") or "").startswith("line")]


def test_a_chart_is_well_formed_and_draws_every_series_with_a_pattern_of_its_own() -> None:
    svg = losses({"nova": [(10, 0.5), (20, 0.1)], "a<b": [(10, 0.4)]}, {"nova": "m0", "a<b": "m1"})
    assert [line.get("class") for line in lines(svg)] == ["line dash0 m0", "line dash1 m1"]
    points = [point for line in lines(svg) for point in numbers(line.get("d"))]
    assert len(points) == 3
    assert all(0 <= x <= 640 and 0 <= y <= 300 for x, y in points)


@pytest.mark.parametrize("logarithmic", [False, True])
def test_equal_steps_or_factors_are_equal_distances_and_more_lies_right_and_up(logarithmic: bool) -> None:
    values = (1.0, 10.0, 100.0) if logarithmic else (0.0, 5.0, 10.0)
    axis = LOG if logarithmic else LINEAR
    points = [Point(value, value, low=value, high=values[-1]) for value in values]
    svg = drawn(Series("n", "m0", points, mark=MARKS[0]), x=axis, y=axis)
    (x0, y0), (x1, y1), (x2, y2) = numbers(lines(svg)[0].get("d"))
    assert x1 - x0 == pytest.approx(x2 - x1, abs=0.11)
    assert y0 - y1 == pytest.approx(y1 - y2, abs=0.11)
    assert x0 < x1
    assert y0 > y1
    bars, marks = (re.findall(rf'class="{kind} [^"]*" d="([^"]*)"', svg) for kind in ("spread", "mark"))
    assert [numbers(mark)[0] for mark in marks] == [[x0, y0], [x1, y1], [x2, y2]]
    assert bars == [f"M{x0},{y0}V{y2}M{x1},{y1}V{y2}"]  # none where a bar has no length


def test_numbers_at_the_axes_stand_where_their_values_are() -> None:
    svg = drawn(Series("n", "m0", [Point(5.0, 4.0)], mark=MARKS[0]))
    (x, y), *_ = numbers(re.findall('class="mark m0" d="([^"]*)"', svg)[0])
    told = re.findall(r'class="tick" x="([\d.]+)" y="([\d.]+)" text-anchor="(\w+)">([^<]*)<', svg)
    up = {text: float(b) for _, b, anchor, text in told if anchor == "end"}
    across = {text: float(a) for a, _, anchor, text in told if anchor == "middle"}
    assert list(up) == list(across) == ["0", "2", "4", "6", "8", "10"]
    assert up["4"] == y + 4  # under whose middle a letter's foot is
    assert (across["4"] + across["6"]) / 2 == pytest.approx(x, abs=0.11)


def test_a_line_has_a_gap_where_a_logarithm_has_no_value_and_such_points_are_not_told() -> None:
    points = [(10, 0.5), (20, 0.1), (20, math.nan), (30, 0.2), (40, 0.0), (50, 0.3), (60, 0.4)]
    svg = losses({"a": points}, {"a": "m0"})
    assert re.sub(r"[\d.,]+", "p", lines(svg)[0].get("d") or "") == "MpLpMpMpLp"
    plot = json.loads(html.unescape(re.findall('data-plot="([^"]*)"', svg)[0]))
    assert [text for *_, text in plot["lines"][0]["points"]] == ["0.5", "0.1", "0.2", "0.3", "0.4"]


def test_losses_next_to_nothing_have_an_axis() -> None:
    """Rationale: ticks were rounded to twelve decimals, and the logarithm of the 0 that was left ended the report."""
    svg = losses({"a": [(1, 3e-14), (2, 1e-15)]}, {"a": "m0"})
    assert {"1e-15", "1e-14"} <= set(re.findall(r'class="tick"[^>]*>([^<]*)<', svg))
    assert len(lines(losses({"a": [(0, 1e-45)]}, {"a": "m0"}))) == 1  # a single one


def test_bins_are_steps_between_their_edges() -> None:
    svg = drawn(Series("n", "m0", [Point(1.0, 10.0), Point(6.0, 5.0)], edges=(0.0, 2.0, 10.0)))
    left, right = Chart("t", LINEAR, LINEAR, ()).at(0.0, 10.0), Chart("t", LINEAR, LINEAR, ()).at(10.0, 5.0)
    end = Chart("t", LINEAR, LINEAR, ()).at(2.0, 0.0)
    assert lines(svg)[0].get("d") == (
        f"M{left[0]:.1f},{end[1]}V{left[1]:.1f}H{end[0]:.1f}V{right[1]:.1f}H{right[0]:.1f}"
    )


def test_a_ring_lies_on_its_line_and_beyond_it_at_the_end() -> None:
    points = [Point(1.0, 2.0), Point(100.0, 8.0)]
    for x, y in ((10.0, 5.0), (1.0, 2.0), (0.1, 2.0)):
        svg = drawn(Series("n", "m0", points, ring=(x, "breaks <here>")), x=LOG)
        ring = re.search(r'<circle class="line m0" cx="([\d.]+)" cy="([\d.]+)"', svg)
        assert ring is not None
        wanted = Chart("t", LOG, LINEAR, ()).at(x, y)
        assert (float(ring[1]), float(ring[2])) == pytest.approx(wanted, abs=0.11)
    assert "<title>breaks &lt;here&gt;</title>" in svg


def test_every_series_of_many_is_in_the_legend() -> None:
    """Rationale: the edge of the picture cut all after the fifteenth."""
    svg = drawn(*(Series(f"n{k}", f"m{k}", [Point(1.0, 2.0)]) for k in range(27)), legend=True, width=720)
    height = int(re.findall(r'viewBox="0 0 720 (\d+)"', svg)[0])
    places = [float(y) for y in re.findall(r'class="name" x="[\d.]+" y="([\d.]+)"', svg)]
    assert len(places) == 27
    assert max(places) < height


def test_long_names_in_a_legend_keep_both_ends() -> None:
    """Rationale: the edge of the picture cut them, and variants often differ at their ends."""
    names = ["nova-fast", "nova-plus-without-averages", "nova-plus-without-denoiser"]
    svg = drawn(*(Series(name, "m0", [Point(1.0, 2.0)]) for name in names), legend=True)
    shown = re.findall(r'<text class="name"[^>]*><title>([^<]*)</title>([^<]*)</text>', svg)
    assert shown == list(zip(names, ["nova-fast", "nova-plu…averages", "nova-plu…denoiser"], strict=True))


def test_each_name_stands_beside_the_last_point_of_its_series_and_on_no_other() -> None:
    """Places that names avoid are the points of all series, of those drawn later, too."""
    ends = {"first": (2.0, 5.0), "second": (2.6, 5.0), "third": (2.6, 5.8), "fourth": (8.0, 1.0), "fifth": (1.4, 5.0)}
    series = [Series(name, "m0", [Point(1.0, 9.0), Point(*end)]) for name, end in ends.items()]
    svg = drawn(*series, named=True)
    found = {text: (float(x), float(y)) for x, y, text in
             re.findall(r'<text class="label" x="([\d.]+)" y="([\d.]+)">([^<]*)<', svg)}  # fmt: skip
    assert list(found) == list(ends)
    chart = Chart("t", LINEAR, LINEAR, ())
    places = {name: chart.at(*end) for name, end in ends.items()}
    boxes = {name: (x, x + 6.2 * len(name), y - 9, y) for name, (x, y) in found.items()}
    for name, (left, right, top, bottom) in boxes.items():
        x, y = places[name]
        assert left - 14 < x < right + 14
        assert top - 14 < y < bottom + 14
        assert not [other for other, (a, b) in places.items() if left < a < right and top < b < bottom]
        assert not [other for other, (a, b, c, d) in boxes.items()
                    if other != name and a < right and left < b and c < bottom and top < d]  # fmt: skip


def test_a_file_of_its_own_has_size_and_colours_and_needs_no_page() -> None:
    svg = alone(drawn(Series("n", "m7", [Point(1.0, 2.0)])), {"m7": "#123456"})
    root = ElementTree.fromstring(svg)
    assert (root.get("width"), root.get("height"), root.get("data-plot")) == ("640", "300", None)
    style = root.findtext(f"{SVG}style") or ""
    assert ".m7 { color: #123456; }" in style
    assert "stroke: currentColor" in style
    assert "var(" not in style


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize("values", [[3.0], [0.02, 0.020001], [1e-30, 1e20]])
def test_an_axis_around_values_holds_them_with_room(values: list[float], log: bool) -> None:
    axis = Axis.around("x", values, log=log)
    shares = [axis.share(value) for value in values]
    assert 0 < min(shares) <= max(shares) < 1
    assert len(list(axis.written(300, across=False))) >= 2


@pytest.mark.parametrize("values", [[0.0], [0.0, 1.0], [5.0, 5.1]])
def test_what_is_never_negative_has_no_number_below_zero(values: list[float]) -> None:
    assert min(ticks((axis := Axis.around("x", values)).low, axis.high)) >= 0


def test_an_axis_of_nothing_and_a_logarithm_of_nothing_are_refused() -> None:
    with pytest.raises(ValueError, match="a chart needs light, got nothing"):
        Axis.around("light", [])
    with pytest.raises(ValueError, match="a chart needs light > 0, got 0"):
        Axis.around("light", [1.0, 0.0], log=True)


def test_numbers_beside_each_other_have_room() -> None:
    """Rationale: numbers of four digits touched on telephones, whose letters are larger."""
    axis = Axis.around("x", [1.0, 1000.0], log=True, ticks=[1, 1.25, 2, 400, 800, 1000])
    assert [text for _, text in axis.written(300, across=True)] == ["1", "2", "400"]


@pytest.mark.parametrize(("low", "high"), [(-3.0, 1.0), (-1.2, -1.0), (0.0, 0.3), (-2.0, -1.99), (-45.0, 3.0)])
def test_logarithmic_ticks_lie_inside_and_are_neither_few_nor_many(low: float, high: float) -> None:
    found = log_ticks(low, high)
    assert 3 <= len(found) <= 8
    assert all(10**low * 0.999 <= tick <= 10**high * 1.001 for tick in found)


def test_logarithmic_ticks_begin_with_the_first_round_value_and_end_with_the_last() -> None:
    assert log_ticks(-1.5, 0.2) == [0.05, 0.1, 0.2, 0.5, 1.0]
    assert log_ticks(0.0, 0.7) == [1.0, 2.0, 5.0]


@pytest.mark.parametrize("largest", [1e-14, 1.0, 30.0, 999.0, 30_000.0])
def test_linear_ticks_are_round_and_reach_the_end(largest: float) -> None:
    found = ticks(0.0, largest)
    assert 3 <= len(found) <= 7
    assert found[0] == 0
    assert 0.7 * largest <= found[-1] <= largest * (1 + 1e-9)


def test_curves_show_their_values_to_pointer_and_keys(visit: Callable[..., Any], experiment: Path, psnr: dict) -> None:
    tab = visit(experiment / "report.html")
    chart = tab.locator("section[aria-labelledby=training] svg.chart")
    chart.focus()
    for _ in range(2):
        chart.press("ArrowRight")
    note = tab.locator("section[aria-labelledby=training] .plot-note")
    assert note.locator("strong").text_content() == "2 iteration"
    lines = {text.split()[0]: float(text.split()[1]) for text in note.locator("div").all_text_contents()}
    assert lines == {name: pytest.approx(value / 4, rel=1e-3) for name, value in psnr.items()}
    assert chart.locator(".plot-point").count() == len(psnr)
    box, rule = chart.bounding_box(), chart.locator(".plot-rule").bounding_box()
    assert box["height"] / 2 < rule["height"] < box["height"]
    tab.mouse.move(box["x"] + box["width"] * 0.97, box["y"] + 30)
    assert note.locator("strong").text_content() == "5 iteration"
    tab.mouse.move(0, 0)
    assert not note.is_visible()


def test_a_line_without_a_point_near_the_pointer_is_not_told(visit: Callable[..., Any], experiment: Path) -> None:
    tab = visit(experiment / "report.html")
    chart = tab.locator("section[aria-labelledby=training] svg.chart")
    told = """(chart, x) => {
        const lines = [["<a>", 100], ["b", 200], ["c", 106]].map(
            ([name, x], k) => ({name, key: `m${k}`, points: [[x, 50, "1", "2"]]}));
        novags.plots.show(chart, {x: "u", top: 34, floor: 200, step: 8, lines: [...lines, {name: "d", points: []}]}, x);
        return [...chart.nextElementSibling.querySelectorAll("div")].map(row => row.textContent);
    }"""
    assert chart.evaluate(told, 90) == ["<a> 2", "c 2"]
    assert chart.evaluate(told, 190) == ["b 2"]


@pytest.mark.parametrize("width", [390, 1300])
def test_no_two_texts_of_a_chart_overlap_and_none_leaves_it(
    visit: Callable[..., Any], experiment: Path, width: int
) -> None:
    """Rationale: "57.6%" was cut to ".6%" on a telephone, under the name of its axis."""
    tab = visit(experiment / "report.html", width=width)
    found = tab.eval_on_selector_all(
        "svg.chart",
        """charts => charts.map(chart => {
            const box = chart.getBoundingClientRect(), texts = [...chart.querySelectorAll("text")];
            const boxes = texts.map(text => [text.textContent, text.getBoundingClientRect()]);
            const beyond = boxes.filter(([, b]) => b.left < box.left - 1 || b.right > box.right + 1).map(([t]) => t);
            const over = boxes.flatMap(([t, a], i) => boxes.slice(i + 1).filter(([, b]) => a.left < b.right - 1 &&
                b.left < a.right - 1 && a.top < b.bottom - 2 && b.top < a.bottom - 2).map(([u]) => [t, u]));
            return {texts: texts.length, beyond, over};
        })""",
    )
    assert len(found) >= 2
    assert all(chart["texts"] > 5 for chart in found)
    assert [(chart["beyond"], chart["over"]) for chart in found] == [([], [])] * len(found)


@pytest.mark.parametrize("ends", [{"low": 2.0}, {"high": 8.0}, {}])
def test_a_point_that_lacks_an_end_of_its_bar_has_none(ends: dict[str, float]) -> None:
    points = [Point(2.0, 5.0, low=3.0, high=7.0), Point(6.0, 5.0, **ends)]
    svg = drawn(Series("n", "m0", points, mark=MARKS[0]))
    (bars,) = re.findall(r'class="spread [^"]*" d="([^"]*)"', svg)
    assert bars.count("V") == 1


@pytest.mark.parametrize("axis", [Axis("x", 2.0, 6.0), Axis("x", 2.0, 6.0, logarithmic=True)])
def test_values_beyond_an_end_are_drawn_there_and_what_has_no_logarithm_at_the_beginning(axis: Axis) -> None:
    values = [1e-9, 100.0, 1e4, 1e9] if axis.logarithmic else [-5.0, 2.0, 4.0, 9.0]
    assert [axis.share(value) for value in values] == [0.0, 0.0, 0.5, 1.0]
    assert axis.share(0.0) == axis.share(-1.0) == 0.0


@pytest.mark.parametrize("values", [[-4.0, -1.0, -2.0], [3.0, 9.0, 6.0], [0.5, 0.25, 10.0]])
def test_the_room_beside_the_values_is_a_twentieth_of_their_range(values: list[float]) -> None:
    axis = Axis.around("x", values)
    room = 0.05 * (max(values) - min(values))
    assert axis.high == pytest.approx(max(values) + room)
    assert axis.low == pytest.approx(max(min(values) - room, -0.05 * (max(values) + room)) if min(values) > 0
                                     else min(values) - room)  # fmt: skip
