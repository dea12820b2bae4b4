"""A chart over the light as inline SVG: lines through means, bars for the spread, a mark where a curve breaks."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from novags.testbed.report.charts import TOP, Frame, Told, scale, ticks

WIDTH, HEIGHT = 720, 340  # higher where the legend needs it
RIGHT = 205  # room for the legend
MARKS = (  # of lines one after the other: not by colour alone
    "M-4,-4h8v8h-8z",
    "M0,-5L5,4H-5z",
    "M0,-5.5L5.5,0L0,5.5L-5.5,0z",
    "M-4,0a4,4 0 1,0 8,0a4,4 0 1,0 -8,0",
    "M0,5L5,-4H-5z",
    "M-5,-1.5h3.5v-3.5h3v3.5h3.5v3h-3.5v3.5h-3v-3.5h-3.5z",
)
LEGEND = 22  # px between two lines of it
NAME = 17  # letters of a name in it, which `RIGHT` has room for on telephones, too
ALONE = """
svg { background: #fff; font-family: system-ui, sans-serif; --line: #e2e2df; --muted: #63666d; }
.chart .rule { stroke: var(--line); stroke-width: 1; }
.chart text { fill: var(--muted); font-size: 12px; }
.chart .line { fill: none; stroke: var(--own); stroke-width: 2; stroke-linejoin: round; }
.chart .mark { fill: var(--own); }
"""  # what the page's style says where the chart stands in one


@dataclass(frozen=True)
class Line:
    """One curve."""

    name: str  # in the legend
    key: str  # CSS class that gives it its colour
    points: Sequence[tuple[float, float, float, float]]  # (x, mean, least, largest) from left to right
    dashed: bool = False  # whether it is a bound
    knee: float | None = None  # where it breaks, x; None if it does not


def level_chart(lines: Sequence[Line], *, x_label: str, y_label: str, title: str) -> str:
    """Lines over a logarithmic x, which must be > 0; y is linear.

    Raises:
        ValueError: If there is nothing to draw, or an x is not positive.
    """
    points = [point for line in lines for point in line.points]
    if not points or min(x for x, *_ in points) <= 0:
        raise ValueError("a chart over the light needs at least one point, and light > 0 at every one")
    xs, low, high = [math.log(x) for x, *_ in points], min(p[2] for p in points), max(p[3] for p in points)
    pad = max(0.05 * (high - low), 1e-3 * abs(high), 1e-6)  # a constant line still needs a height
    low, high, wide = low - pad, high + pad, max(0.03 * (max(xs) - min(xs)), 1e-3)
    height = max(HEIGHT, TOP + 10 + LEGEND * len(lines))
    frame = Frame(scale(min(xs) - wide, max(xs) + wide, math.log), scale(low, high), WIDTH, height, RIGHT)
    parts = [part for place, line in enumerate(lines) for part in (*_line(frame, line, place), *_legend(line, place))]
    up, across, last = [(tick, f"{tick:g}") for tick in ticks(low, high)], list[tuple[float, str]](), -math.inf
    for level in sorted({x for x, *_ in points}):
        if frame.at(level, low)[0] - last >= 40:  # px; closer numbers would touch
            last = frame.at(level, low)[0]
            across.append((level, f"{level:g}"))
    told = [_told(frame, line) for line in lines]
    return frame.drawn(parts, told, across, up, x_label=x_label, y_label=y_label, title=title)


def alone(chart: str, colors: Mapping[str, str]) -> str:
    """A chart of `level_chart` as a file of its own, with a colour, "#rrggbb", for each key of its lines."""
    own = "".join(f".{key} {{ --own: {color}; }}\n" for key, color in colors.items())
    size = re.sub(r'.*? viewBox="0 0 (\d+) (\d+)".*', r'width="\1" height="\2"', chart, flags=re.DOTALL)
    opened = f'<svg xmlns="http://www.w3.org/2000/svg" {size} '
    chart = re.sub(r' data-plot="[^"]*"', "", chart, count=1)  # which only the script of the page reads
    return chart.replace("<svg ", opened, 1).replace(">", f"><style>{ALONE}{own}</style>", 1) + "\n"


def _told(frame: Frame, line: Line) -> Told:
    said = [f"{mean:.4g}" + (f" ({least:.4g} to {largest:.4g})" if largest > least else "")
            for _, mean, least, largest in line.points]  # fmt: skip
    return line.name, line.key, [(*frame.at(x, mean), f"{x:g}", text)
                                 for (x, mean, *_), text in zip(line.points, said, strict=True)]  # fmt: skip


def _line(frame: Frame, line: Line, place: int) -> list[str]:
    if not line.points:
        return []
    places = [frame.at(x, mean) for x, mean, *_ in line.points]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    parts = [_stroke(line, f'<polyline points="{path}"', f"<title>{escape(line.name)}</title></polyline>")]
    for (x, y), (value, _, least, largest) in zip(places, line.points, strict=True):
        parts.append(_mark(line, MARKS[place % len(MARKS)], x, y))
        if largest > least:
            ends = " ".join(f'y{k}="{frame.at(value, end)[1]:.1f}"' for k, end in enumerate((least, largest), 1))
            parts.append(_stroke(line, f'<line x1="{x:.1f}" x2="{x:.1f}" {ends}', "</line>"))
    if line.knee is not None:
        x, y = frame.at(line.knee, _between(line, line.knee))
        told = f"<title>{escape(line.name)} breaks at {line.knee:.3g}</title></circle>"
        parts.append(_stroke(line, f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5"', told))
    return parts


def _stroke(line: Line, opened: str, closed: str) -> str:
    dashes = ' stroke-dasharray="6 4"' if line.dashed and opened.startswith("<polyline") else ""
    return f'{opened} class="line {escape(line.key)}"{dashes}>{closed}'


def _mark(line: Line, mark: str, x: float, y: float) -> str:
    return f'<path class="mark {escape(line.key)}" transform="translate({x:.1f} {y:.1f})" d="{mark}"/>'


def _legend(line: Line, place: int) -> list[str]:
    x, y = WIDTH - RIGHT + 14, TOP + 10 + LEGEND * place
    dashes = ' stroke-dasharray="6 4"' if line.dashed else ""
    return [f'<line class="line {escape(line.key)}"{dashes} x1="{x}" x2="{x + 24}" y1="{y}" y2="{y}"/>',
            _mark(line, MARKS[place % len(MARKS)], x + 12, y),
            f'<text class="name" x="{x + 30}" y="{y + 4}"><title>{escape(line.name)}</title>'
            f"{escape(_shortened(line.name))}</text>"]  # fmt: skip


def _shortened(name: str) -> str:
    """What does not fit is cut out of the middle: names of variants differ at their beginnings or at their ends."""
    half = (NAME - 1) // 2
    return name if len(name) <= NAME else f"{name[: NAME - 1 - half]}…{name[-half:]}"


def _between(line: Line, x: float) -> float:
    """The mean at x, linear in the logarithm between two points; the end's beyond them."""
    points = line.points
    for (left, low, *_), (right, high, *_) in zip(points, points[1:], strict=False):
        if left <= x <= right:
            return low + (high - low) * math.log(x / left) / math.log(right / left)
    return points[0][1] if x < points[0][0] else points[-1][1]
