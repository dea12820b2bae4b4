"""How much light the pixels got: a histogram in electrons, or in codes where they are not known; shares of many."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from novags.testbed.folders.capture import Capture
from novags.testbed.report.charts import Axis, Chart, Point, Series
from novags.testbed.report.grid import by_place
from novags.testbed.report.material import Material
from novags.testbed.report.parts import Page, Table, TableRow, heads, num

HEIGHT = 260  # px
CHANNELS = ("red", "green", "blue")
BINS = 60
SHARES = {"0.01": "1 % get less", "0.25": "a quarter", "0.5": "half", "0.75": "three quarters", "0.99": "99 %"}


def signal(material: Material, page: Page) -> dict[str, Any] | None:
    """The histogram of one place, a row for each of many."""
    if (place := material.one) is not None:
        found = histogram(place.capture, place.views)
        return found and {**found, "table": None}
    rows, columns = list[TableRow](), "Where | Camera"
    for members in by_place(material.lines).values():
        here = [each.captured for line in members for each in material.of(line)]
        if here and (electrons := here[0].get("signal_quantiles_e")):
            known = [key for key in SHARES if key in electrons]
            columns = " | ".join(["Where | Camera", *(f"#{SHARES[key]} [e⁻]" for key in known)])
            cells = [members[0].where, here[0].get("sensor_name") or "", *(num(electrons[key]) for key in known)]
            rows.append(TableRow(cells))
    text = "How many electrons a pixel collects on average: the share in the heading gets less."
    table = Table("signal", "Signal of every combination", heads(columns), rows, "short")
    return {"text": text, "table": table} if rows else None


def histogram(capture: Capture, indices: Sequence[int]) -> dict[str, str] | None:
    """The histogram of these views with a sentence on it; None where there is nothing to draw."""
    if capture.imported or capture.sensor is None:
        if not (indices := [i for i in indices if capture.is_dark(i)]):
            return None
        codes = np.concatenate([255 * capture.srgb8(i).reshape(-1, 3) for i in indices])
        edges = np.linspace(0.0, 256.0, 65)
        text = f"How bright the pixels of the {len(indices)} views shown are, in 8-bit codes (sRGB)."
        return {"text": text, "chart": _chart(_shares(codes, edges), edges, "8-bit code", logarithmic=False)}
    sensor = capture.sensor
    electrons = np.concatenate(
        [by_filter((capture.truth(i, "clean") - sensor.black_level) / sensor.gain, sensor.cfa) for i in indices]
    )
    seen = electrons[np.isfinite(electrons) & (electrons > 0)]
    if not seen.size:
        return None
    low, high = np.quantile(seen, 0.001), seen.max()
    edges = np.geomspace(min(low, high / 10), high * 1.001, BINS + 1)
    below = float((electrons < edges[0]).sum() / np.isfinite(electrons).sum())
    text = (
        f"How many electrons the pixels of the {len(indices)} views shown collect on average, by the colour of their "
        f"filter; read noise alone is {sensor.sigma_d:.2g} electrons. {below:.1%} of the pixels get less than the "
        "chart shows."
    )
    return {"text": text, "chart": _chart(_shares(electrons, edges), edges, "electrons per pixel", logarithmic=True)}


def by_filter(values: np.ndarray, cfa: str | None) -> np.ndarray:
    """[n,3] of three chips; of a mosaic each pixel is in the column of its filter, and NaN in the others."""
    if values.ndim == 3:
        return values.reshape(-1, 3)
    found = np.full((*values.shape, 3), np.nan, np.float32)
    for place, letter in enumerate(cfa or "GGGG"):
        row, column = divmod(place, 2)
        found[row::2, column::2, "RGB".index(letter)] = values[row::2, column::2]
    return found.reshape(-1, 3)


def _shares(values: np.ndarray, edges: np.ndarray) -> dict[str, np.ndarray]:
    """The share of each channel's pixels in each bin."""
    found = {}
    for channel, name in enumerate(CHANNELS):
        known = values[np.isfinite(values[:, channel]), channel]
        if known.size:
            found[name] = np.histogram(known, edges)[0] / known.size
    return found


def _chart(shares: dict[str, np.ndarray], edges: np.ndarray, label: str, *, logarithmic: bool) -> str:
    centres = np.sqrt(edges[1:] * edges[:-1]) if logarithmic else edges[1:] / 2 + edges[:-1] / 2
    series = []
    for place, (name, share) in enumerate(shares.items()):
        points = [Point(float(f"{c:.3g}"), 100 * part, f"{part:.2%}") for c, part in zip(centres, share, strict=True)]
        series.append(Series(name, name, points, f"dash{place}", edges=edges.tolist()))
    low, high = np.log10(edges[[0, -1]]) if logarithmic else edges[[0, -1]]
    x = Axis(label, low, high, logarithmic, () if logarithmic else (0, 64, 128, 192, 255))
    y = Axis("share of the pixels [%]", 0.0, 100 * max(share.max() for share in shares.values()) or 100.0)
    return Chart(f"Histogram of {label}", x, y, series, height=HEIGHT).svg()
