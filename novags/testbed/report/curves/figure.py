"""Curves as one SVG: a panel a knob, error over processor seconds, bars of one standard deviation.

Nothing is told by colour alone: the default is a diamond, other points are discs, and points off the front are hollow.
"""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from novags.testbed.report.charts import DISC, Axis, Chart, Point, Series, alone, label

WIDTH, HEIGHT = 360, 270  # of a panel
COLUMNS = 3
FEW = 3.0  # errors within this factor are drawn on a linear scale, as is an error of 0
DIAMOND = "m0-7l7 7l-7 7l-7-7z"  # larger than other marks
COLORS = {"other": "#0072b2", "default": "#d55e00"}
Measured = Mapping[str, Any]


def figure(points: Sequence[Measured], title: str) -> str:
    """An SVG file of all curves.

    Args:
        points: Of one subject, as `read_curves` gives them.
        title: Above the panels.

    Raises:
        ValueError: If `points` is empty.
    """
    if not points:
        raise ValueError("there are no points to draw: measure some first")
    knobs = list(dict.fromkeys(point["knob"] for point in points))
    columns = min(COLUMNS, len(knobs))
    width, height = columns * WIDTH, 40 + -(-len(knobs) // columns) * HEIGHT
    parts = [f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(title)}">',
             f'<text class="heading" x="8" y="24">{escape(title)}</text>']  # fmt: skip
    for place, knob in enumerate(knobs):
        x, y = place % columns * WIDTH, 40 + place // columns * HEIGHT
        panel = _panel(knob, [point for point in points if point["knob"] == knob])
        parts.append(f'<g transform="translate({x} {y})">{panel}</g>')
    return alone("\n".join([*parts, "</svg>"]), COLORS)


def _panel(knob: str, points: Sequence[Measured]) -> str:
    errors = [point["error"] for point in points]
    logarithmic = min(errors) > 0 and max(errors) > FEW * min(errors)
    ends = [e for p in points for e in (max(p["error"] - p["error_sd"], 0.0), p["error"] + p["error_sd"])]
    shown = errors + ends
    if logarithmic:  # a bar that reaches far below its point would squeeze the rest
        shown = [value for value in shown if value > 0.5 * min(errors)]
    shown += [0.98 * min(shown), 1.02 * max(shown)]  # differences of less are small
    seconds = [room * point["cpu_seconds"] for point in points for room in (0.8, 1.25)]  # for labels beside points
    x = Axis.around(f"processor seconds of {points[0]['of']}", seconds, log=True)
    y = Axis.around(f"error: {points[0]['error_unit']}", shown, log=logarithmic)
    name = knob.partition(".")[2]
    chart = Chart(name, x, y, _series(points), WIDTH, HEIGHT, left=62, heading=name)
    taken = [(x - 8, y - 8, 16.0) for x, y in (chart.at(p["cpu_seconds"], p["error"]) for p in points)]
    texts = ((setting_text(p["setting"]), chart.at(p["cpu_seconds"], p["error"])) for p in points)
    return chart.inside() + "".join(label(text, place, chart, taken) for text, place in texts)


def _series(points: Sequence[Measured]) -> list[Series]:
    """The line of the front, then each point with its bar."""
    best = sorted((p for p in points if p["front"]), key=lambda p: (p["cpu_seconds"], p["error"]))
    found = [Series("front", "other", [Point(p["cpu_seconds"], p["error"]) for p in best], "front")]
    for point in sorted(points, key=lambda p: bool(p["default"])):  # which is drawn over the others
        error, spread = point["error"], point["error_sd"]
        said = f"{setting_text(point['setting'])}: {with_spread(error, spread, point['repeats'])}"
        key = ("default" if point["default"] else "other") + " off" * (not point["front"])
        drawn = Point(point["cpu_seconds"], error, said, max(error - spread, 0.0), error + spread)
        found.append(Series("", key, [drawn], None, DIAMOND if point["default"] else DISC))
    return found


def with_spread(value: float, spread: float, repeats: int) -> str:
    """A number with its standard deviation, of which a single measurement says nothing."""
    return f"{value:.3g}" if repeats < 2 else f"{value:.3g} ± {spread:.2g}"


def setting_text(setting: Any) -> str:
    """A setting in few characters."""
    return "none" if setting is None else f"{setting:.3g}" if isinstance(setting, float) else str(setting)
