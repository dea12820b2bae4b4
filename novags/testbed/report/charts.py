"""Charts of a report as inline SVG. Colours and fonts come from the page's style, so light and dark mode both fit."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import groupby

WIDTH, HEIGHT = 640, 300
LEFT, RIGHT, TOP, BOTTOM = 96, 16, 14, 46  # room for the larger letters that telephones get

DASHES = 4  # patterns of lines, one after the other: colours alone do not tell lines apart for everybody
Series = Mapping[str, Sequence[tuple[float, float]]]


def line_chart(series: Series, keys: Mapping[str, str], *, x_label: str, y_label: str, title: str) -> str:
    """Lines over x, y logarithmic; the CSS class of a series is `line KEY`. A y that is not positive leaves a gap.

    Raises:
        ValueError: If there is nothing to draw.
    """
    points = [p for line in series.values() for p in line if p[1] > 0]
    if not points:
        raise ValueError("a line chart needs at least one point with y > 0")
    x_max = max(x for x, _ in points) or 1.0
    y_low, y_high = _log_range([y for _, y in points])

    def place(x: float, y: float) -> tuple[float, float]:
        along = LEFT + (WIDTH - LEFT - RIGHT) * x / x_max
        share = (math.log10(y) - y_low) / (y_high - y_low)
        return along, HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * share

    placed = [(name, keys[name], [(*place(x, y), f"{x:g}", f"{y:.4g}") for x, y in line if y > 0])
              for name, line in series.items()]  # fmt: skip
    parts = [f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}" '
             f"{plot_data(placed, x_label)}>"]  # fmt: skip
    for tick in log_ticks(y_low, y_high):
        _, y = place(0, tick)
        parts.append(f'<line class="rule" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    for tick in linear_ticks(x_max):
        x, _ = place(tick, 10**y_low)
        parts.append(f'<text class="tick" x="{x:.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{tick:g}</text>')
    for number, (name, line) in enumerate(series.items()):
        pieces = [list(piece) for drawn, piece in groupby(line, lambda point: point[1] > 0) if drawn]
        path = "".join(f"M{'L'.join('{:.1f},{:.1f}'.format(*place(*point)) for point in piece)}" for piece in pieces)
        parts.append(
            f'<path class="line dash{number % DASHES} {escape(keys[name])}" d="{path}">'
            f"<title>{escape(name)}</title></path>"
        )
    middle, centre = (LEFT + WIDTH - RIGHT) / 2, (TOP + HEIGHT - BOTTOM) / 2
    parts.append(f'<text class="axis" x="{middle}" y="{HEIGHT - 6}" text-anchor="middle">{escape(x_label)}</text>')
    turned = f'transform="translate(20 {centre}) rotate(-90)"'
    parts.append(f'<text class="axis" {turned} text-anchor="middle">{escape(y_label)}</text>')
    return "".join([*parts, "</svg>"])


def plot_data(series: Iterable[tuple[str, str, Sequence[tuple[float, float, str, str]]]], x_label: str) -> str:
    """The attribute by which a script shows the values of a chart where one points at it.

    Args:
        series: Name, CSS class, and points: x and y in the picture, then their values as text.
        x_label: What the x axis is.
    """
    lines = [{"name": name, "key": key, "points": [[round(x, 1), round(y, 1), a, b] for x, y, a, b in points]}
             for name, key, points in series]  # fmt: skip
    found = json.dumps({"x": x_label, "lines": lines}, separators=(",", ":"), ensure_ascii=False)
    return f'data-plot="{escape(found)}"'


def _log_range(values: Sequence[float]) -> tuple[float, float]:
    low, high = math.log10(min(values)), math.log10(max(values))
    pad = max(0.05 * (high - low), 0.02)  # a constant line still needs a height
    return low - pad, high + pad


def log_ticks(low: float, high: float) -> list[float]:
    """Ticks at 1, 2 and 5 times powers of ten between 10**low and 10**high; finer ones where fewer than three fit."""
    decades = range(math.floor(low), math.ceil(high) + 1)
    for steps in ((1, 2, 5), (1, 1.5, 2, 3, 4, 5, 6, 7, 8, 9), tuple(1 + k / 10 for k in range(90))):
        ticks = [step * 10.0**decade for decade in decades for step in steps]
        fitting = [round(tick, 12) for tick in ticks if low <= math.log10(tick) <= high]
        if len(fitting) >= 3:
            return fitting[:: math.ceil(len(fitting) / 7)]
    return fitting


def linear_ticks(largest: float) -> list[float]:
    """About five round numbers from 0 to `largest`."""
    rough = largest / 5
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    return [step * k for k in range(int(largest / step + 1e-9) + 1)]
