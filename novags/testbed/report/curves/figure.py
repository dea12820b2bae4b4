"""Curves as one SVG: a panel a knob, error over processor seconds, bars of one standard deviation.

Nothing is told by colour alone: the default is a diamond, other points are discs, and points off the front are hollow.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from novags.testbed.report.charts import log_ticks, ticks

WIDTH, HEIGHT = 360, 260  # of a panel
LEFT, RIGHT, TOP, BOTTOM = 62, 24, 44, 44
COLUMNS = 3
FEW = 3.0  # errors within this factor are drawn on a linear scale, as is an error of 0
STYLE = """
svg { background: #fff; font-family: system-ui, sans-serif; }
text { fill: #3b3e44; font-size: 11px; } .title { font-size: 14px; font-weight: 600; fill: #1c1e21; }
.rule { stroke: #e2e2df; } .bar { stroke: #0072b2; stroke-width: 1.2; } .front { fill: none; stroke: #0072b2; }
.point { fill: #0072b2; stroke: #0072b2; stroke-width: 1.5; } .off { fill: #fff; }
.default { fill: #d55e00; stroke: #d55e00; stroke-width: 1.5; } .default.off { fill: #fff; } .label { fill: #1c1e21; }
"""
Point = Mapping[str, Any]


def figure(points: Sequence[Point], title: str) -> str:
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
    rows = -(-len(knobs) // columns)
    width, height = columns * WIDTH, 40 + rows * HEIGHT
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        f'role="img" aria-label="{escape(title)}"><style>{STYLE}</style>',
        f'<text class="title" x="12" y="24">{escape(title)}</text>',
    ]
    for place, knob in enumerate(knobs):
        x, y = place % columns * WIDTH, 40 + place // columns * HEIGHT
        own = [point for point in points if point["knob"] == knob]
        parts += [f'<g transform="translate({x} {y})">', *_panel(knob, own), "</g>"]
    return "\n".join([*parts, "</svg>"]) + "\n"


@dataclass(frozen=True)
class Axis:
    """Values along one side of a panel."""

    low: float
    high: float
    logarithmic: bool
    start: float  # px
    end: float

    @staticmethod
    def around(values: Sequence[float], logarithmic: bool, start: float, end: float) -> "Axis":
        """With some room on both sides; a single value lies in the middle."""
        scaled = [math.log10(value) for value in values] if logarithmic else list(values)
        low, high = min(scaled), max(scaled)
        least = 0.1 if logarithmic else 0.02 * abs(high) or 1.0  # equal values would leave no axis
        room = max(0.1 * (high - low), least)
        bottom = low - room if logarithmic else max(low - room, -0.05 * (high + room))  # nothing is below zero
        return Axis(bottom, high + room, logarithmic, start, end)

    def at(self, value: float) -> float:
        """Where a value lies, px; a logarithm of nothing is at the low end."""
        if self.logarithmic:
            value = math.log10(value) if value > 0 else self.low
        share = (max(value, self.low) - self.low) / (self.high - self.low)
        return self.start + (self.end - self.start) * share

    def ticks(self) -> list[float]:
        """A few round values."""
        if not self.logarithmic:
            return ticks(max(self.low, 0.0), self.high)
        found = log_ticks(self.low, self.high)
        if len(found) < 2:
            found = ticks(10**self.low, 10**self.high)
        return found[:: math.ceil(len(found) / 4)]


def _panel(knob: str, points: Sequence[Point]) -> list[str]:
    errors = [point["error"] for point in points]
    logarithmic = min(errors) > 0 and max(errors) > FEW * min(errors)
    ends = [e for p in points for e in (max(p["error"] - p["error_sd"], 0.0), p["error"] + p["error_sd"])]
    shown = errors + [end for end in ends if end > 0 or not logarithmic]
    if logarithmic:  # a bar that reaches far below its point would squeeze the rest
        shown = [value for value in shown if value > 0.5 * min(errors)]
    x = Axis.around([point["cpu_seconds"] for point in points], True, LEFT, WIDTH - RIGHT)
    y = Axis.around(shown, logarithmic, HEIGHT - BOTTOM, TOP)
    return [*_frame(knob, points[0], x, y), *_line(points, x, y), *_points(points, x, y)]


def _frame(knob: str, point: Point, x: Axis, y: Axis) -> list[str]:
    parts = [f'<text class="title" x="{LEFT}" y="16">{escape(knob.partition(".")[2])}</text>',
             f'<text x="{LEFT}" y="32">error: {escape(point["error_unit"])}</text>']  # fmt: skip
    for tick in y.ticks():
        at = y.at(tick)
        parts.append(f'<line class="rule" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{at:.1f}" y2="{at:.1f}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{at + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for tick in x.ticks():
        parts.append(f'<text x="{x.at(tick):.1f}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{tick:g}</text>')
    what = f"processor seconds of {point['of']}"
    middle = (LEFT + WIDTH - RIGHT) / 2
    return [*parts, f'<text x="{middle}" y="{HEIGHT - 10}" text-anchor="middle">{escape(what)}</text>']


def _line(points: Sequence[Point], x: Axis, y: Axis) -> list[str]:
    best = sorted((p for p in points if p["front"]), key=lambda p: (p["cpu_seconds"], p["error"]))
    path = " ".join(f"{x.at(p['cpu_seconds']):.1f},{y.at(p['error']):.1f}" for p in best)
    return [f'<polyline class="front" points="{path}"/>']


def _points(points: Sequence[Point], x: Axis, y: Axis) -> list[str]:
    parts, taken = [], [(x.at(p["cpu_seconds"]) - 8, y.at(p["error"]) - 8, 16.0) for p in points]
    for point in points:
        across, up = x.at(point["cpu_seconds"]), y.at(point["error"])
        least = max(point["error"] - point["error_sd"], 0.0)
        above, below = y.at(point["error"] + point["error_sd"]), y.at(least)
        kind = f"{'default' if point['default'] else 'point'}{'' if point['front'] else ' off'}"
        said = f"{setting_text(point['setting'])}: {with_spread(point['error'], point['error_sd'], point['repeats'])}"
        parts.append(f'<line class="bar" x1="{across:.1f}" x2="{across:.1f}" y1="{above:.1f}" y2="{below:.1f}"/>')
        mark = f'<path class="{kind}" d="M{across:.1f} {up - 7:.1f}l7 7l-7 7l-7 -7z">'
        disc = f'<circle class="{kind}" cx="{across:.1f}" cy="{up:.1f}" r="4">'
        end = "path" if point["default"] else "circle"
        parts.append(f"{mark if point['default'] else disc}<title>{escape(said)}</title></{end}>")
        parts.append(_label(setting_text(point["setting"]), across, up, taken))
    return parts


def _label(text: str, x: float, y: float, taken: list[tuple[float, float, float]]) -> str:
    """Beside its point where no other label or point is; `taken` are (left, top, width) of the labels there already."""
    wide = 6.2 * len(text) + 2
    places = [(x + 9, y + 4), (x - 9 - wide, y + 4), (x - wide / 2, y - 11), (x - wide / 2, y + 20), (x + 7, y - 9),
              (x + 7, y + 16), (x - 7 - wide, y - 9), (x - 7 - wide, y + 16)]  # fmt: skip

    def cost(place: tuple[float, float]) -> float:
        left, top = place[0], place[1] - 10
        outside = left < LEFT - 20 or left + wide > WIDTH or top < TOP - 12 or top + 12 > HEIGHT - BOTTOM + 4
        hits = sum(left < a + w and a < left + wide and abs(top - b) < 11 for a, b, w in taken)
        return hits + 10 * outside

    left, base = min(places, key=cost)
    taken.append((left, base - 10, wide))
    return f'<text class="label" x="{left:.1f}" y="{base:.1f}">{escape(text)}</text>'


def with_spread(value: float, spread: float, repeats: int) -> str:
    """A number with its standard deviation, of which a single measurement says nothing."""
    return f"{value:.3g}" if repeats < 2 else f"{value:.3g} ± {spread:.2g}"


def setting_text(setting: Any) -> str:
    """A setting in few characters."""
    return "none" if setting is None else f"{setting:.3g}" if isinstance(setting, float) else str(setting)
