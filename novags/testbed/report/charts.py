"""Charts as SVG: series over two axes, each linear or logarithmic, for pages and for files of their own.

Colours and fonts come from style/chart.css, so that light and dark pages both fit; scripts/plots.js shows the values
where one points. No JavaScript library draws them instead: pictures beside a page and of `novags pareto` are written
without a browser, and need all of this. uPlot, tried with the losses, adds 51 kB to each page (plots.js: 3 kB) and
wants one x for all lines, or gaps between fits are lost. Chart.js adds 210 kB, Observable Plot with d3 490.
"""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

TOP, BOTTOM, RIGHT = 34, 46, 28  # room for the larger letters that telephones get, px
LETTER = 11.5  # width of one on telephones, px
LEGEND, LINE = 205, 22  # width of a legend, and between two of its lines, px
NAME = 17  # letters of a name that fit into a legend, on telephones, too
DASHES = 4  # patterns of lines, CSS classes "dash0" to "dash3": colours alone do not tell lines apart for everybody
DISC = "m-4 0a4 4 0 1 0 8 0a4 4 0 1 0-8 0"
MARKS = ("m-4-4h8v8h-8z", "m0-5l5 9h-10z", "m0-5.5l5.5 5.5l-5.5 5.5l-5.5-5.5z", DISC, "m0 5l5-9h-10z",
         "m-5-1.5h3.5v-3.5h3v3.5h3.5v3h-3.5v3.5h-3v-3.5h-3.5z")  # fmt: skip
STYLE = Path(__file__).parent / "style" / "chart.css"
PAPER = {"bg": "#fff", "fg": "#1c1d20", "muted": "#5d6067", "line": "#e2e2df", "shown": "currentColor"}


class Point(NamedTuple):
    """A value, with the ends of its bar where it has one."""

    x: float
    y: float
    said: str = ""  # y as text
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Series:
    """Points that belong together."""

    name: str
    key: str  # CSS class that gives its colour
    points: Sequence[Point]  # from left to right
    line: str | None = ""  # further CSS class of the line through the points; None: there is no line
    mark: str = ""  # at each point: a path that begins there
    edges: Sequence[float] = ()  # of bins, one more than points: the line goes in steps
    ring: tuple[float, str] | None = None  # on the line: where, x, and its text


@dataclass(frozen=True)
class Axis:
    """The values along one side."""

    label: str
    low: float  # where it begins; if logarithmic, a power of ten
    high: float
    logarithmic: bool = False
    ticks: Sequence[float] = ()  # values that are written; none: round ones

    @classmethod
    def around(cls, label: str, values: Sequence[float], *, log: bool = False, ticks: Sequence[float] = ()) -> "Axis":
        """With some room on both sides, but not below zero where no value is.

        Raises:
            ValueError: If there are no values, or one of a logarithmic axis is not positive.
        """
        if not values or (log and min(values) <= 0):
            raise ValueError(f"a chart needs {label or 'values'}{' > 0' * log}, got {min(values, default='nothing')}")
        low, high = (math.log10(end) if log else end for end in (min(values), max(values)))
        room = max(0.05 * (high - low), 0.02 if log else 1e-3 * abs(high) or 1.0)  # equal values need an axis, too
        begin = low - room if log or low < 0 else max(low - room, -0.05 * (high + room))
        return cls(label, begin, high + room, log, ticks)

    def holds(self, value: float) -> bool:
        """Whether a value has a place on it."""
        return math.isfinite(value) and (value > 0 or not self.logarithmic)

    def share(self, value: float) -> float:
        """Of the way from its beginning to its end; values beyond an end are drawn there."""
        scaled = value if not self.logarithmic else math.log10(value) if value > 0 else self.low
        return min(max((scaled - self.low) / (self.high - self.low), 0.0), 1.0)

    def written(self, length: float, across: bool) -> Iterator[tuple[float, str]]:
        """Shares of the way and texts of the ticks that have room, on an axis of so many px."""
        last, before = -math.inf, ""
        for value in self.ticks or (log_ticks if self.logarithmic else ticks)(self.low, self.high):
            at, text = length * self.share(value), f"{value:g}"
            if at - last >= (LETTER * (len(before) + len(text)) / 2 + 8 if across else 30):
                yield at / length, text
                last, before = at, text


@dataclass(frozen=True)
class Chart:
    """Series over two axes."""

    title: str  # for readers who do not see it
    x: Axis
    y: Axis
    series: Sequence[Series]
    width: int = 640  # px
    height: int = 300  # more where the legend needs it
    left: int = 88  # room for the numbers
    heading: str = ""  # above it
    legend: bool = False  # whether there is one at the right
    named: bool = False  # whether each series has its name beside its last point

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and lower end of the space for points."""
        height = max(self.height, TOP + LINE * len(self.series) * self.legend)
        top, right = TOP + 18 * bool(self.heading), self.width - (LEGEND if self.legend else RIGHT)
        return self.left, top, right, height - BOTTOM

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Where a point lies, px."""
        left, top, right, floor = self.box
        return left + (right - left) * self.x.share(x), floor - (floor - top) * self.y.share(y)

    def svg(self) -> str:
        """The picture, with its values for the script that shows them."""
        _, top, _, floor = self.box
        lines = [{"name": each.name, "key": each.key,
                  "points": [[*(round(place, 1) for place in self.at(p.x, p.y)), f"{p.x:g}", p.said]
                             for p in self._held(each)]} for each in self.series]  # fmt: skip
        data = {"x": self.x.label, "top": top, "floor": floor, "lines": lines}
        plot = escape(json.dumps(data, separators=(",", ":"), ensure_ascii=False))
        return (f'<svg class="chart" viewBox="0 0 {self.width} {floor + BOTTOM}" role="img" '
                f'aria-label="{escape(self.title)}" data-plot="{plot}">{self.inside()}</svg>')  # fmt: skip

    def inside(self) -> str:
        """The content of the picture."""
        left, top, right, floor = self.box
        parts = [f'<text class="heading" x="8" y="16">{escape(self.heading)}</text>'] if self.heading else []
        parts.append(f'<text class="axis" x="8" y="{top - 18}">{escape(self.y.label)}</text>')
        for share, text in self.y.written(floor - top, across=False):
            y = floor - (floor - top) * share
            parts.append(f'<line class="rule" x1="{left}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(f'<text class="tick" x="{left - 8}" y="{y + 4:.1f}" text-anchor="end">{text}</text>')
        for share, text in self.x.written(right - left, across=True):
            x = left + (right - left) * share
            parts.append(f'<text class="tick" x="{x:.1f}" y="{floor + 18}" text-anchor="middle">{text}</text>')
        parts.append(f'<text class="axis" x="{(left + right) / 2}" y="{floor + 40}" text-anchor="middle">'
                     f"{escape(self.x.label)}</text>")  # fmt: skip
        for place, each in enumerate(self.series):
            parts += self._drawn(each)
            parts += self._named(each, right + 14, top + LINE * place - 10) if self.legend else []
        if self.named:
            ends = [(each.name, self.at(held[-1].x, held[-1].y)) for each in self.series if (held := self._held(each))]
            taken = [(x - 8, y - 8, 16.0) for _, (x, y) in ends]
            parts += [label(shortened(name), end, self, taken) for name, end in ends]
        return "\n".join(parts)

    def _held(self, series: Series) -> list[Point]:
        return [point for point in series.points if self.y.holds(point.y)]

    def _drawn(self, series: Series) -> Iterator[str]:
        """A line with gaps where there is no value, bars, marks, and a ring."""
        key, places = escape(series.key), [self.at(point.x, point.y) for point in series.points]
        if series.line is not None and places:
            told = f"<title>{escape(series.name)}</title></path>"
            yield f'<path class="line {series.line} {key}" d="{self._path(series, places)}">{told}'
        bars = [(self.at(p.x, p.low), self.at(p.x, p.high)[1]) for p in self._held(series)
                if p.low is not None and p.high is not None and p.high > p.low]  # fmt: skip
        if bars:
            path = "".join(f"M{x:.1f},{y:.1f}V{end:.1f}" for (x, y), end in bars)
            yield f'<path class="spread line {key}" d="{path}"/>'
        for point, place in zip(series.points, places, strict=True):
            if series.mark and self.y.holds(point.y):
                yield _mark(series, *place, point.said)
        if series.ring:
            x, said = self.at(series.ring[0], 1.0)[0], series.ring[1]
            xs, ys = np.array(places).T
            y = np.interp(x, xs, ys)
            yield f'<circle class="line {key}" cx="{x:.1f}" cy="{y:.1f}" r="5"><title>{escape(said)}</title></circle>'

    def _path(self, series: Series, places: Sequence[tuple[float, float]]) -> str:
        if series.edges:
            x, floor = self.at(series.edges[0], 0.0)
            ends = (self.at(edge, 0.0)[0] for edge in series.edges[1:])
            return f"M{x:.1f},{floor}" + "".join(f"V{y:.1f}H{x:.1f}" for x, (_, y) in zip(ends, places, strict=True))
        both = zip(series.points, places, strict=True)
        pieces = [list(piece) for held, piece in groupby(both, lambda each: self.y.holds(each[0].y)) if held]
        return "".join("M" + "L".join(f"{x:.1f},{y:.1f}" for _, (x, y) in piece) for piece in pieces)

    def _named(self, series: Series, x: float, y: float) -> Iterator[str]:
        """A line of the legend."""
        yield f'<line class="line {series.line or ""} {escape(series.key)}" x1="{x}" x2="{x + 24}" y1="{y}" y2="{y}"/>'
        if series.mark:
            yield _mark(series, x + 12, y)
        yield (f'<text class="name" x="{x + 30}" y="{y + 4}"><title>{escape(series.name)}</title>'
               f"{escape(shortened(series.name))}</text>")  # fmt: skip


def _mark(series: Series, x: float, y: float, said: str = "") -> str:
    told = f"<title>{escape(said)}</title>" if said else ""
    return f'<path class="mark {escape(series.key)}" d="M{x:.1f},{y:.1f}{series.mark}">{told}</path>'


def label(text: str, beside: tuple[float, float], chart: Chart, taken: list[tuple[float, float, float]]) -> str:
    """Text beside its point where nothing else is; `taken` are (left, top, width) of labels and points."""
    x, y = beside
    wide, (begin, ceiling, _, floor) = 6.2 * len(text) + 2, chart.box
    places = [(x + 9, y + 4), (x - 9 - wide, y + 4), (x - wide / 2, y - 11), (x - wide / 2, y + 20), (x + 7, y - 9),
              (x + 7, y + 16), (x - 7 - wide, y - 9), (x - 7 - wide, y + 16)]  # fmt: skip

    def cost(place: tuple[float, float]) -> float:
        left, top = place[0], place[1] - 10
        outside = left < begin - 20 or left + wide > chart.width or top < ceiling - 12 or top + 12 > floor + 4
        hits = sum(left < a + w and a < left + wide and abs(top - b) < 11 for a, b, w in taken)
        return hits + 10 * outside

    left, base = min(places, key=cost)
    taken.append((left, base - 10, wide))
    return f'<text class="label" x="{left:.1f}" y="{base:.1f}">{escape(text)}</text>'


def shortened(name: str) -> str:
    """Long names are cut in the middle: names of variants differ at their beginnings or at their ends."""
    half = (NAME - 1) // 2
    return name if len(name) <= NAME else f"{name[: NAME - 1 - half]}…{name[-half:]}"


def alone(svg: str, colors: Mapping[str, str]) -> str:
    """A picture of charts as a file of its own, with a colour, "#rrggbb", for each key of its series.

    It holds no variables of CSS: many programs that show SVG know none.
    """
    style = re.sub(r"var\(--(\w+)\)", lambda found: PAPER[found[1]], STYLE.read_text(encoding="utf-8"))
    own = "".join(f".{key} {{ color: {color}; }}\n" for key, color in colors.items())
    size = re.sub(r'.*? viewBox="0 0 (\d+) (\d+)".*', r'width="\1" height="\2"', svg, flags=re.DOTALL)
    svg = re.sub(r' data-plot="[^"]*"', "", svg)  # which only the script of a page reads
    opened = f'<svg xmlns="http://www.w3.org/2000/svg" {size} '
    look = f"svg {{ background: {PAPER['bg']}; font-family: system-ui, sans-serif; }}\n"
    return svg.replace("<svg ", opened, 1).replace(">", f"><style>\n{look}{style}{own}</style>", 1) + "\n"


def few(levels: Sequence[float]) -> Sequence[float]:
    """Levels that can be written at an axis as they are; of many, none: round values stand there instead."""
    return sorted(set(levels)) if len(set(levels)) <= 8 else ()


def log_ticks(low: float, high: float) -> list[float]:
    """Round values between 10**low and 10**high: 1, 2 and 5 times powers of ten; finer where fewer than three fit."""
    decades = range(math.floor(low), math.ceil(high) + 1)
    for steps in ((1, 2, 5), (1, 1.5, 2, 3, 5, 7)):
        found = [float(f"{step}e{decade}") for decade in decades for step in steps]
        fitting = [tick for tick in found if tick > 0 and low <= math.log10(tick) <= high]
        if len(fitting) >= 3:
            return fitting[:: math.ceil(len(fitting) / 7)]
    return ticks(10.0**low, 10.0**high)


def ticks(low: float, high: float) -> list[float]:
    """About five round numbers between two values."""
    rough = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    first = math.ceil(low / step - 1e-9)
    return [float(f"{step * k:.12g}") for k in range(first, math.floor(high / step + 1e-9) + 1)]
