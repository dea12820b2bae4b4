"""Curves as lines of JSON, as a figure and as tables."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from novags.testbed.report.charts import DISC
from novags.testbed.report.curves import page
from novags.testbed.report.curves.figure import DIAMOND, _series, figure
from novags.testbed.report.curves.table import heading, said, tables
from novags.testbed.study.curves.curve import curves, read_curves, write_curves
from novags.testbed.study.knobs.knob import Knob, Reading, Subject

CONTRACT = {"knob": str, "setting": (int, float, str, type(None)), "seconds": float, "error": float,
            "error_unit": str, "error_sd": float, "default": bool}  # fmt: skip
SVG = "{http://www.w3.org/2000/svg}"


def marks(root: ElementTree.Element) -> list[tuple[str, float, float, str]]:
    """Class, place and shape of every mark."""
    found = [(path.get("class", ""), re.match(r"M([\d.]+),([\d.]+)(.*)", path.get("d", "")))
             for path in root.iter(f"{SVG}path")]  # fmt: skip
    return [(kind, float(at[1]), float(at[2]), at[3]) for kind, at in found if at and kind.startswith("mark")]


def test_every_line_keeps_the_contract_and_says_what_was_measured(made: Any, tmp_path: Path) -> None:
    page.write(made.subject(8), made.measure(repeats=2), tmp_path)
    lines = [json.loads(line) for line in (tmp_path / "curves.jsonl").read_text().splitlines()]
    wanted = [("made.steps", 1), ("made.steps", 10), ("made.steps", 100), ("made.way", "a"), ("made.way", "bb"),
              ("made.way", None), ("made.lone", 1.5), ("made.lone", 22.75)]  # fmt: skip
    assert [(line["knob"], line["setting"]) for line in lines] == wanted
    for line in lines:
        assert all(isinstance(line[key], kind) for key, kind in CONTRACT.items())
        assert line["workload"] == {"scene": "a wall", "size": 8}
        assert line["hardware"]["cores"] >= 1
        assert line["repeats"] == 2
    assert [line["setting"] for line in lines if line["default"]] == [10, "a", 22.75]


def test_points_are_medians_means_and_paired_decibels(made: Any, tmp_path: Path) -> None:
    rows, subject = list[Any](), Subject("s", {}, (made.subject(8).knobs[2],))
    for seed, (seconds, cpu, error, default) in enumerate(
        ((1.0, 5.0, 2.0, 1.0), (3.0, 6.0, 8.0, 2.0), (2.0, 9.0, 20.0, 2.0))
    ):
        rows.append(made.row("lone", 1.5, seed, Reading(seconds, cpu, error, {"fit": cpu, "denoiser": 1.0})))
        rows.append(made.row("lone", 22.75, seed, Reading(10.0, 20.0, default)))
    fast, default = curves(subject, rows)
    assert (fast["seconds"], fast["cpu_seconds"], fast["error"], fast["parts"]) == (2.0, 6.0, 10.0, {"fit": 6.0})
    assert fast["error_sd"] == pytest.approx(math.sqrt((64 + 4 + 100) / 2))
    decibels = [20 * math.log10(ratio) for ratio in (2.0, 4.0, 10.0)]  # each beside the default of its own seed
    mean = sum(decibels) / 3
    assert fast["db_lost"] == pytest.approx(mean)
    assert fast["db_lost_sd"] == pytest.approx(math.sqrt(sum((d - mean) ** 2 for d in decibels) / 2))
    assert (default["db_lost"], default["db_lost_sd"]) == (0.0, 0.0)
    assert (fast["front"], default["front"]) == (True, True)


def test_an_error_of_nothing_has_no_decibels_and_one_repetition_no_spread(made: Any, tmp_path: Path) -> None:
    rows = [made.row("lone", 1.5, 0, Reading(3.0, 3.0, 1.0)), made.row("lone", 22.75, 0, Reading(2.0, 2.0, 0.0))]
    slow, default = curves(Subject("s", {}, (made.subject(8).knobs[2],)), rows)
    assert slow["db_lost"] is None
    assert slow["error_sd"] == 0.0
    assert (slow["front"], default["front"]) == (False, True)  # slower and worse


@pytest.mark.parametrize("errors", [(2.0, 0.0), (0.0, 2.0)])
def test_one_error_of_nothing_in_any_repetition_leaves_no_decibels(made: Any, errors: tuple[float, float]) -> None:
    rows = [made.row("lone", setting, seed, Reading(1.0, 1.0, error))
            for setting, own in ((1.5, errors), (22.75, (1.0, 1.0))) for seed, error in enumerate(own)]  # fmt: skip
    fast, _ = curves(Subject("s", {}, (made.subject(8).knobs[2],)), rows)
    assert fast["db_lost"] is None


def test_every_part_that_a_knob_acts_on_has_its_time(made: Any) -> None:
    knob = replace(made.subject(8).knobs[2], parts=("fit", "denoiser"))
    rows = [made.row("lone", setting, 0, Reading(1.0, 1.0, 1.0, {"fit": 2.0, "denoiser": 3.0}))
            for setting in knob.settings]  # fmt: skip
    for point in curves(Subject("s", {}, (knob,)), rows):
        assert point["parts"] == {"fit": 2.0, "denoiser": 3.0}


@pytest.mark.parametrize("lacking", [0, 1])
def test_a_part_that_any_repetition_lacks_has_no_time(made: Any, lacking: int) -> None:
    knob = replace(made.subject(8).knobs[2], parts=("fit", "denoiser"))
    parts = [{"fit": 2.0 + 2 * seed} | ({} if seed == lacking else {"denoiser": 3.0}) for seed in (0, 1)]
    rows = [made.row("lone", setting, seed, Reading(1.0, 1.0, 1.0, parts[seed]))
            for setting in knob.settings for seed in (0, 1)]  # fmt: skip
    for point in curves(Subject("s", {}, (knob,)), rows):
        assert point["parts"] == {"fit": 3.0}


def test_the_curves_of_other_subjects_stay_in_the_file(made: Any, tmp_path: Path) -> None:
    points = made.curves(1)
    other = [{**point, "knob": point["knob"].replace("made", "other")} for point in points]
    write_curves(tmp_path, points)
    write_curves(tmp_path, other)
    for count in (3, 1):
        write_curves(tmp_path, points[:count])
        assert read_curves(tmp_path) == other + points[:count]
    write_curves(tmp_path, points + other)  # of two subjects, both of which are there
    assert read_curves(tmp_path) == points + other


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda line: line[:-9], "line 2 is not valid JSON"),
        (lambda line: line.replace('"default": true', '"default": 1'), "line 2: default must be true or false"),
        (
            lambda line: re.sub(r'"seconds": [\d.]+', '"seconds": "fast"', line),
            "line 2: seconds must be a finite number",
        ),
    ],
)
def test_a_damaged_line_is_refused_with_its_place(made: Any, tmp_path: Path, damage: Any, message: str) -> None:
    path = write_curves(tmp_path, made.curves(1))
    lines = path.read_text().splitlines()
    lines[1] = damage(lines[1])
    path.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=message):
        read_curves(path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\xff\xfe\n", "curves.jsonl is not UTF-8"),
        (b"[" * 100_000, "curves.jsonl, line 1.*nested"),
        (b'{"seconds": 1' + b"0" * 400 + b"}", "curves.jsonl, line 1.*whole numbers"),
        (b'{"seconds": 1, "seconds": 2}', "curves.jsonl, line 1.*twice"),
        (b'{"seconds": NaN}', "curves.jsonl, line 1.*NaN"),
    ],
)
def test_a_file_of_curves_that_cannot_be_read_is_named(tmp_path: Path, content: bytes, said: str) -> None:
    (tmp_path / "curves.jsonl").write_bytes(content)
    with pytest.raises(ValueError, match=said) as error:
        read_curves(tmp_path)
    assert len(str(error.value)) < 400 + len(str(tmp_path))


def test_no_curves_is_one_line_that_says_how_to_get_them(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="novags pareto makes them"):
        read_curves(tmp_path)


def test_the_figure_shows_every_point_with_its_bar_and_the_default_by_its_shape(made: Any, tmp_path: Path) -> None:
    points = made.curves(2)
    root = ElementTree.fromstring(figure(points, "a & b"))
    assert [shape for *_, shape in marks(root)].count(DIAMOND) == sum(point["default"] for point in points) == 3
    assert [shape for *_, shape in marks(root)].count(DISC) == 5
    bars = [path.get("d", "") for path in root.iter(f"{SVG}path") if path.get("class", "").startswith("spread")]
    ends = [[float(number) for number in re.findall("[0-9.]+", bar)[1:]] for bar in bars]
    assert len(ends) == len(points)
    assert all(high < y < low for (low, high), (_, _, y, _) in zip(ends, marks(root), strict=True))
    texts = [text.text for text in root.iter(f"{SVG}text")]
    assert {"1", "10", "100", "bb", "none", "22.8", "a & b", "error: codes"} <= set(texts)
    assert sum(kind.endswith(" off") for kind, *_ in marks(root)) == sum(not point["front"] for point in points)


def test_a_longer_time_lies_further_right_and_a_larger_error_higher(made: Any, tmp_path: Path) -> None:
    points = [p for p in made.curves(1) if p["knob"] == "made.steps"]
    root = ElementTree.fromstring(figure([{**point, "default": False} for point in points], "t"))
    at = [(x, y) for _, x, y, _ in marks(root)]
    assert sorted(at, key=lambda p: p[0]) == sorted(at, key=lambda p: -p[1])[::-1]
    order = sorted(range(3), key=lambda i: points[i]["cpu_seconds"])
    assert [at[i][0] for i in order] == sorted(x for x, _ in at)


@pytest.mark.parametrize("apart", [0.0, 1e-9, 0.01, 3.0])
def test_points_close_together_have_axes_with_numbers(made: Any, tmp_path: Path, apart: float) -> None:
    points = [p for p in made.curves(1) if p["knob"] == "made.steps"]
    near = [{**p, "cpu_seconds": 0.028 * (1 + i * apart), "error": 7 * (1 + i * apart)} for i, p in enumerate(points)]
    root = ElementTree.fromstring(figure(near, "t"))
    numbers = [text for text in root.iter(f"{SVG}text") if re.fullmatch(r"[\d.]+", text.text or "")]
    below = [text for text in numbers if text.get("text-anchor") == "middle"]
    beside = [text for text in numbers if text.get("text-anchor") == "end"]
    for axis in (below, beside):
        assert len({text.text for text in axis}) == len(axis) >= 2
        assert all(math.isfinite(float(text.get("x", "nan")) * float(text.get("y", "nan"))) for text in axis)


def test_errors_of_zero_are_drawn_too(made: Any, tmp_path: Path) -> None:
    points = made.curves(1)
    points[0] = {**points[0], "error": 0.0}
    assert "nan" not in figure(points, "zero")


def test_a_default_off_the_front_is_said_to_be(made: Any) -> None:
    def point(setting: str, cpu: float, error: float, sd: float, front: bool) -> dict[str, Any]:
        return {"setting": setting, "cpu_seconds": cpu, "error": error, "error_sd": sd, "front": front,
                "default": setting == "own", "why": "habit", "repeats": 3}  # fmt: skip

    assert said([point("own", 1, 1, 0, True)]) == "The default, own, is on the front: habit."
    near = [point("own", 2, 1.0, 0.3, False), point("x", 1, 0.9, 0.3, True)]
    unclear = "off the front, but nothing is both faster and more accurate beyond the spread"
    assert unclear in said(near)
    assert unclear in said([point("own", 2, 1.0, 0.1, False), point("x", 1, 1.0, 0.1, True)])  # faster, as accurate
    clear = [point("own", 2, 1.0, 0.1, False), point("x", 1, 0.2, 0.1, True)]
    assert "off the front (x: faster and more accurate beyond the spread)" in said(clear)
    once = [{**each, "error_sd": 0.0, "repeats": 1} for each in near]
    assert "off the front; a single measurement has no known spread" in said(once)
    assert "not measured" in said([{**clear[1]}])


def test_sizes_in_a_page_are_replaced_between_their_marks_alone(made: Any, tmp_path: Path) -> None:
    points = made.curves(2)
    begin, end = page.marks("made")
    other = page.marks("other")[0]
    text = page.embedded(f"# head\n{begin}\nold\n{end}\n{other}\nkept\n{end}\ntail\n", points)
    assert "old" not in text
    assert text.startswith("# head\n")
    assert text.endswith(f"{other}\nkept\n{end}\ntail\n")
    assert heading(points) in text
    assert page.embedded(text, points) == text


def test_a_unit_with_bars_leaves_the_table_its_columns(made: Any, tmp_path: Path) -> None:
    points = made.curves(1)[:3]
    rows = tables([{**point, "error_unit": "mean |DN|"} for point in points]).splitlines()[2:7]
    assert {len(re.findall(r"(?<!\\)\|", row)) for row in rows} == {6}


def test_settings_must_differ_and_hold_the_default() -> None:
    def knob(settings: tuple[Any, ...]) -> Knob:
        return Knob(
            name="k", settings=settings, default=2, unit="", of="", why="", measure=lambda s, i, c: Reading(0, 0, 0)
        )

    assert knob((1, 2)).default == 2
    for settings in ((1, 3), (2, 2)):
        with pytest.raises(ValueError, match="hold the default 2"):
            knob(settings)


def test_every_knob_has_a_table_and_says_where_its_default_lies_wherever_that_stands(made: Any) -> None:
    points = made.curves(2)
    found = tables(points)
    knobs = list(dict.fromkeys(point["knob"] for point in points))
    assert re.findall(r"^#### (.*)$", found, re.M) == knobs
    assert "not measured" not in found
    for knob in knobs:
        own = [point for point in points if point["knob"] == knob]
        (default,) = [point for point in own if point["default"]]
        others = [point for point in own if not point["default"]]
        assert said([*others, default]) == said([default, *others])
        assert said(others) == "The default is not measured yet."


def test_the_default_and_the_others_are_drawn_in_their_own_colours(made: Any) -> None:
    points = made.curves(2)
    own = [point for point in points if point["knob"] == points[0]["knob"]]
    drawn = [each.key.partition(" ")[0] for each in _series(own)[1:]]
    assert drawn == ["other"] * (len(own) - 1) + ["default"]
