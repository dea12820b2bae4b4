"""Charts of a report as inline SVG. Colours and fonts come from the page's style, so light and dark mode both fit."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby

LEFT, TOP, BOTTOM = 96, 14, 46  # room for the larger letters that telephones get

DASHES = 4  # patterns of lines, one after the other: colours alone do not tell lines apart for everybody
Series = Mapping[str, Sequence[tuple[float, float]]]
# Name, CSS class, and points of a line: x and y in the picture, then their values as text.
Told = tuple[str, str, Sequence[tuple[float, float, str, str]]]
Ticks = Iterable[tuple[float, str]]  # values, and their labels


def scale(low: float, high: float, of: Callable[[float], float] = float) -> Callable[[float], float]:
    """What makes a share of the way from `low` to `high` of a value, or of its logarithm, say."""
    return lambda value: (of(value) - low) / (high - low)


@dataclass(frozen=True)
class Frame:
    """Where values lie in a picture."""

    x: Callable[[float], float]  # from a value to the share of the way to the right
    y: Callable[[float], float]  # or upwards
    width: int = 640  # of the picture, px
    height: int = 300
    right: int = 16  # px that are left free there

    def at(self, x: float, y: float) -> tuple[float, float]:
        """A point in the picture."""
        floor = self.height - BOTTOM
        return LEFT + (self.width - LEFT - self.right) * self.x(x), floor - (floor - TOP) * self.y(y)

    def drawn(
        self, parts: Iterable[str], lines: Iterable[Told], across: Ticks, up: Ticks, *, x_label: str, y_label: str,
        title: str, rules: bool = True,
    ) -> str:  # fmt: skip
        """The picture of these parts, with axes, and with the lines' values for a script that shows them."""
        told = [{"name": name, "key": key, "points": [[round(x, 1), round(y, 1), a, b] for x, y, a, b in points]}
                for name, key, points in lines]  # fmt: skip
        data = json.dumps({"x": x_label, "lines": told}, separators=(",", ":"), ensure_ascii=False)
        end, floor = self.width - self.right, self.height - BOTTOM
        found = [f'<svg class="chart" viewBox="0 0 {self.width} {self.height}" role="img" aria-label="{escape(title)}" '
                 f'data-plot="{escape(data)}">']  # fmt: skip
        for value, text in up:
            y = floor - (floor - TOP) * self.y(value)
            if rules:
                found.append(f'<line class="rule" x1="{LEFT}" x2="{end}" y1="{y:.1f}" y2="{y:.1f}"/>')
            below = 4 if rules else 10
            found.append(f'<text class="tick" x="{LEFT - 8}" y="{y + below:.1f}" text-anchor="end">{text}</text>')
        for value, text in across:
            x = LEFT + (end - LEFT) * self.x(value)
            found.append(f'<text class="tick" x="{x:.1f}" y="{floor + 18}" text-anchor="middle">{text}</text>')
        middle, turned = (LEFT + end) / 2, f'transform="translate(20 {(TOP + floor) / 2}) rotate(-90)"'
        label = f'x="{middle}" y="{self.height - 6}" text-anchor="middle"'
        found += [*parts, f'<text class="axis" {label}>{escape(x_label)}</text>',
                  f'<text class="axis" {turned} text-anchor="middle">{escape(y_label)}</text>', "</svg>"]  # fmt: skip
        return "".join(found)


def line_chart(series: Series, keys: Mapping[str, str], *, x_label: str, y_label: str, title: str) -> str:
    """Lines over x, y logarithmic; the CSS class of a series is `line KEY`. A y that is not positive leaves a gap.

    Raises:
        ValueError: If there is nothing to draw.
    """
    points = [p for line in series.values() for p in line if p[1] > 0]
    if not points:
        raise ValueError("a line chart needs at least one point with y > 0")
    x_max, logs = max(x for x, _ in points) or 1.0, [math.log10(y) for _, y in points]
    pad = max(0.05 * (max(logs) - min(logs)), 0.02)  # a constant line still needs a height
    low, high = min(logs) - pad, max(logs) + pad
    frame, parts, told = Frame(scale(0.0, x_max), scale(low, high, math.log10)), list[str](), list[Told]()
    for number, (name, line) in enumerate(series.items()):
        pieces = [list(piece) for drawn, piece in groupby(line, lambda point: point[1] > 0) if drawn]
        path = "".join(f"M{'L'.join('{:.1f},{:.1f}'.format(*frame.at(*point)) for point in piece)}" for piece in pieces)
        style = f"line dash{number % DASHES} {escape(keys[name])}"
        parts.append(f'<path class="{style}" d="{path}"><title>{escape(name)}</title></path>')
        told.append((name, keys[name], [(*frame.at(x, y), f"{x:g}", f"{y:.4g}") for x, y in line if y > 0]))
    across, up = ([(tick, f"{tick:g}") for tick in found] for found in (ticks(0.0, x_max), log_ticks(low, high)))
    return frame.drawn(parts, told, across, up, x_label=x_label, y_label=y_label, title=title)


def log_ticks(low: float, high: float) -> list[float]:
    """Ticks at 1, 2 and 5 times powers of ten between 10**low and 10**high; finer ones where fewer than three fit."""
    decades = range(math.floor(low), math.ceil(high) + 1)
    for steps in ((1, 2, 5), (1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9), tuple(1 + k / 10 for k in range(90))):
        ticks = [step * 10.0**decade for decade in decades for step in steps]
        fitting = [round(tick, 12) for tick in ticks if low <= math.log10(tick) <= high]
        if len(fitting) >= 3:
            return fitting[:: math.ceil(len(fitting) / 7)]
    return fitting


def ticks(low: float, high: float) -> list[float]:
    """About five round numbers between two values."""
    rough = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    first = math.ceil(low / step - 1e-9)
    return [round(step * k, 12) for k in range(first, math.floor(high / step + 1e-9) + 1)]
