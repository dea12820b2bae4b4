"""A chart over the light as inline SVG: lines through means, bars for the spread, a mark where a curve breaks."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from novags.testbed.report.charts import plot_data

WIDTH, HEIGHT = 720, 340  # higher where the legend needs it
LEFT, RIGHT, TOP, BOTTOM = 96, 205, 14, 46  # room for the larger letters that telephones get
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
    """One curve.

    Attributes:
        name: In the legend.
        key: CSS class that gives it its colour.
        points: (x, mean, least, largest) from left to right.
        dashed: Whether it is a bound.
        knee: Where it breaks, x; None if it does not.
    """

    name: str
    key: str
    points: Sequence[tuple[float, float, float, float]]
    dashed: bool = False
    knee: float | None = None


def level_chart(lines: Sequence[Line], *, x_label: str, y_label: str, title: str) -> str:
    """Lines over a logarithmic x, which must be > 0; y is linear.

    Raises:
        ValueError: If there is nothing to draw, or an x is not positive.
    """
    points = [point for line in lines for point in line.points]
    if not points or min(x for x, *_ in points) <= 0:
        raise ValueError("a chart over the light needs at least one point, and light > 0 at every one")
    frame = _Frame.around(points, max(HEIGHT, TOP + 10 + LEGEND * len(lines)))
    opened = f'<svg class="chart" viewBox="0 0 {WIDTH} {frame.height}" role="img" aria-label="{escape(title)}"'
    parts = [f"{opened} {plot_data([frame.placed(line) for line in lines], x_label)}>"]
    parts += frame.axes(sorted({x for x, *_ in points}), x_label, y_label)
    for place, line in enumerate(lines):
        parts += frame.line(line, MARKS[place % len(MARKS)])
        parts += _legend(line, place)
    return "".join([*parts, "</svg>"])


def alone(chart: str, colors: Mapping[str, str]) -> str:
    """A chart as a file of its own.

    Args:
        chart: Of `level_chart`.
        colors: "#rrggbb" by key of its lines.
    """
    own = "".join(f".{key} {{ --own: {color}; }}\n" for key, color in colors.items())
    size = re.sub(r'.*? viewBox="0 0 (\d+) (\d+)".*', r'width="\1" height="\2"', chart, flags=re.DOTALL)
    opened = f'<svg xmlns="http://www.w3.org/2000/svg" {size} '
    chart = re.sub(r' data-plot="[^"]*"', "", chart, count=1)  # which only the script of the page reads
    return chart.replace("<svg ", opened, 1).replace(">", f"><style>{ALONE}{own}</style>", 1) + "\n"


@dataclass(frozen=True)
class _Frame:
    """Where values lie in the picture."""

    left: float  # logarithms
    right: float
    bottom: float
    top: float
    height: int  # of the picture, px

    @staticmethod
    def around(points: Sequence[tuple[float, float, float, float]], height: int) -> "_Frame":
        xs = [math.log(x) for x, *_ in points]
        low, high = min(least for _, _, least, _ in points), max(largest for *_, largest in points)
        pad = max(0.05 * (high - low), 1e-3 * abs(high), 1e-6)  # a constant line still needs a height
        wide = max(0.03 * (max(xs) - min(xs)), 1e-3)
        return _Frame(min(xs) - wide, max(xs) + wide, low - pad, high + pad, height)

    def x(self, value: float) -> float:
        share = (math.log(value) - self.left) / (self.right - self.left)
        return LEFT + (WIDTH - LEFT - RIGHT) * share

    def y(self, value: float) -> float:
        floor = self.height - BOTTOM
        return floor - (floor - TOP) * (value - self.bottom) / (self.top - self.bottom)

    def placed(self, line: Line) -> tuple[str, str, list[tuple[float, float, str, str]]]:
        """A line as `plot_data` takes it."""
        told = [f"{mean:.4g}" + (f" ({least:.4g} to {largest:.4g})" if largest > least else "")
                for _, mean, least, largest in line.points]  # fmt: skip
        return line.name, line.key, [(self.x(x), self.y(mean), f"{x:g}", text)
                                     for (x, mean, *_), text in zip(line.points, told, strict=True)]  # fmt: skip

    def axes(self, levels: Sequence[float], x_label: str, y_label: str) -> list[str]:
        end, parts = WIDTH - RIGHT, []
        for tick in ticks(self.bottom, self.top):
            y = self.y(tick)
            parts.append(f'<line class="rule" x1="{LEFT}" x2="{end}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(f'<text class="tick" x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
        last = -math.inf
        for level in levels:
            if self.x(level) - last >= 40:  # px; closer numbers would touch
                last, below = self.x(level), self.height - BOTTOM + 18
                parts.append(f'<text class="tick" x="{last:.1f}" y="{below}" text-anchor="middle">{level:g}</text>')
        middle, centre, low = (LEFT + end) / 2, (TOP + self.height - BOTTOM) / 2, self.height - 6
        parts.append(f'<text class="axis" x="{middle}" y="{low}" text-anchor="middle">{escape(x_label)}</text>')
        turned = f'transform="translate(20 {centre}) rotate(-90)"'
        parts.append(f'<text class="axis" {turned} text-anchor="middle">{escape(y_label)}</text>')
        return parts

    def line(self, line: Line, mark: str) -> list[str]:
        if not line.points:
            return []
        path = " ".join(f"{self.x(x):.1f},{self.y(mean):.1f}" for x, mean, *_ in line.points)
        parts = [_stroke(line, f'<polyline points="{path}"', f"<title>{escape(line.name)}</title></polyline>")]
        for x, mean, least, largest in line.points:
            parts.append(_mark(line, mark, self.x(x), self.y(mean)))
            if largest > least:
                bar = f'x1="{self.x(x):.1f}" x2="{self.x(x):.1f}" y1="{self.y(least):.1f}" y2="{self.y(largest):.1f}"'
                parts.append(_stroke(line, f"<line {bar}", "</line>"))
        if line.knee is not None:
            x, y = self.x(line.knee), self.y(_between(line, line.knee))
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


def ticks(low: float, high: float) -> list[float]:
    """About five round numbers between two values."""
    rough = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    first = math.ceil(low / step - 1e-9)
    return [round(step * k, 12) for k in range(first, math.floor(high / step + 1e-9) + 1)]
