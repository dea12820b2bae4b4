"""A study over the light: curves, where each method breaks, and the same as JSON, CSV and pictures beside the page.

light.json   light.csv (every point of every curve)   light-knees.csv
light-MEASURE.svg      light-MEASURE-PLACE.svg  (where other axes than light, method and seed have several values)
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.testbed.console.csv_text import as_csv
from novags.testbed.ledger.contents import write_json
from novags.testbed.report.charts import MARKS, Axis, Chart, Point, Series, alone, few
from novags.testbed.report.material import Material
from novags.testbed.report.parts import Page, Table, TableRow, heads, num
from novags.testbed.report.rows import Row
from novags.testbed.study.light import ELECTRONS, Curve, light_curves
from sensor_model.files.atomic import write_text

DATA, POINTS, KNEES = "light.json", "light.csv", "light-knees.csv"
HEADINGS = {  # columns of KNEES in the words of the page
    "measure": "score", "rule": "breaks at", "bright": "value at the most light", "electrons": "electrons, mean",
    "low": "least of the seeds", "high": "most of the seeds", "broken": "seeds that break",
    "unknown": "seeds without a value at the most light",
    "slope_per_doubling": "change per doubling there",
}  # fmt: skip


@dataclass(frozen=True)
class CurvePicture:
    """Curves of one score in one place, and where they are drawn."""

    title: str  # score, and place if there are several
    file: str  # name of the picture
    curves: list[Curve]  # one a method

    @property
    def key(self) -> str:
        """Of its score."""
        return self.curves[0].measure.key


def light(material: Material, page: Page) -> dict[str, Any] | None:
    """The charts and the knees, where the light was varied; pictures and numbers are written beside the page."""
    if not (curves := _curves(material)):
        return None
    folder, charts, knees = page.path.parent, charts_of(curves), knee_rows(curves)
    of = {key: [chart for chart in charts if chart.key == key] for key in dict.fromkeys(chart.key for chart in charts)}
    for chart in charts:
        svg = draw(chart, material.looks, of[chart.key])
        write_text(folder / chart.file, alone(svg, {look.key: look.color for look in material.looks.values()}))
    write_json(folder / DATA, {"curves": [as_record(curve) for curve in curves]})
    write_text(folder / POINTS, as_csv(point_rows(curves)))
    write_text(folder / KNEES, as_csv(knees))
    measures = [(like[0].curves[0].measure.label, [(chart, draw(chart, material.looks, like, small=len(like) > 1))
                                                   for chart in like]) for like in of.values()]  # fmt: skip
    marks = {curve.method: MARKS[k % len(MARKS)] for chart in charts for k, curve in enumerate(chart.curves)}
    key = [(name, material.looks[name].key, mark) for name, mark in marks.items()]
    return {
        "measures": measures,
        "key": key if len(charts) > len(of) else [],
        "knees": _table(knees, curves),
        "points": POINTS,
        "breaks": KNEES,
        "record": DATA,
    }


def light_files(material: Material) -> list[Path]:
    """The files that `light` would write."""
    curves = _curves(material)
    names = [*(chart.file for chart in charts_of(curves)), DATA, POINTS, KNEES] if curves else []
    return [material.path.parent / name for name in names]


def files_in(folder: Path, axes: Mapping[str, Sequence[Any]]) -> list[Path]:
    """The files of a folder that the report on a study with these axes would write over."""
    names = (DATA, POINTS, KNEES, "light-*.svg") if _varies_light(axes) else ()
    return sorted(path for name in names for path in folder.glob(name))


def _curves(material: Material) -> Sequence[Curve]:
    return light_curves(material.rows, material.axes) if _varies_light(material.axes) else ()


def _varies_light(axes: Mapping[str, Sequence[Any]]) -> bool:
    return len(axes.get(ELECTRONS, ())) > 1


def _table(knees: Sequence[Mapping[str, Any]], curves: Sequence[Curve]) -> Table | None:
    """Where each curve breaks, in the words of the page."""
    rows, labels = list[TableRow](), {curve.measure.key: curve.measure.label for curve in curves}
    for row in knees:
        missing = "unknown" if row["unknown"] == row["seeds"] else "not reached"
        said = {**row, "measure": labels[row["measure"]]}
        said |= {name: missing for name in ("electrons", "low", "high") if row[name] is None}
        rows.append(TableRow([
            num(value, f"{value:.3g}" if isinstance(value, float) else str(value)) if isinstance(value, int | float)
            else "" if value is None else str(value) for value in said.values()
        ]))  # fmt: skip
    columns = heads(" | ".join(HEADINGS.get(name, name) for name in knees[0])) if knees else []
    return Table("knees", "Where each curve breaks", columns, rows, "scores short") if knees else None


def charts_of(curves: Sequence[Curve]) -> list[CurvePicture]:
    """The charts that show something: one for each score and place."""
    varied = [name for name in curves[0].place if len({str(curve.place[name]) for curve in curves}) > 1]
    groups: dict[tuple[str, str], list[Curve]] = {}
    for curve in curves:
        place = ", ".join(f"{name} {curve.place[name]}" for name in varied)
        groups.setdefault((curve.measure.key, place), []).append(curve)
    order = list(dict.fromkeys(place for _, place in groups))
    found = list[CurvePicture]()
    for (key, place), members in sorted(groups.items(), key=lambda item: order.index(item[0][1])):
        if key == "registered" and not varies(members):
            continue  # cameras were given
        ending = f"-{slug}" if (slug := re.sub(r"[^A-Za-z0-9.]+", "-", place).strip("-").lower()) else ""
        label = members[0].measure.label
        file = _unused(f"light-{key}{ending}", [chart.file for chart in found])
        found.append(CurvePicture(f"{label}: {place}" if place else label, file, members))
    return found


def _unused(stem: str, used: Collection[str]) -> str:
    """The name of a picture that no other has: "Küche" and "köche" are alike without their capitals and umlauts."""
    names = (f"{stem}{number}.svg" for number in ("", *(f"-{k}" for k in range(2, len(used) + 3))))
    return next(name for name in names if name not in used)


def varies(curves: Sequence[Curve]) -> bool:
    """Whether there are different values."""
    return len({value for curve in curves for level in curve.levels for value in level.values}) > 1


def draw(
    picture: CurvePicture, looks: Mapping[str, Row], like: Sequence[CurvePicture] = (), *, small: bool = False
) -> str:
    """Means over the light, from the worst to the best of the seeds, and a ring where a curve breaks.

    `like`: pictures of the same score in other places, which share the axes; `small`: for standing beside them.
    """
    lines = []
    for place, curve in enumerate(picture.curves):
        look, knee = looks[curve.method], curve.knee.electrons if curve.knee else None
        points = _points(curve)
        ring = None if knee is None or not points else (knee, f"{curve.method} breaks at {knee:.3g}")
        lines.append(Series(curve.method, look.key, points, "" if look.competes else "bound",
                            MARKS[place % len(MARKS)], ring=ring))  # fmt: skip
    measure = picture.curves[0].measure
    unit = f" ({measure.unit})" if measure.unit else ""
    short = measure.label.partition(" against ")[0]  # the title says against what
    shown = [point for each in like or (picture,) for curve in each.curves for point in _points(curve)]
    levels = sorted({point.x for point in shown})
    ends = [end for point in shown for end in (point.low, point.high) if end is not None]
    x = Axis.around("electrons per green pixel", levels, log=True, ticks=few(levels))
    y, size = Axis.around(f"{short}{unit}", ends), (420, 260) if small else (720, 340)
    return Chart(picture.title, x, y, lines, *size, left=56 if small else 88, legend=not small).svg()


def _points(curve: Curve) -> list[Point]:
    return [_point(level.electrons, level.mean, level.values) for level in curve.levels if level.mean is not None]


def _point(electrons: float, mean: float, values: Sequence[float]) -> Point:
    least, largest = min(values), max(values)
    spread = f" ({least:.4g} to {largest:.4g})" if largest > least else ""
    return Point(electrons, mean, f"{mean:.4g}{spread}", least, largest)


def as_record(curve: Curve) -> dict[str, Any]:
    """A curve for JSON."""
    return {
        "measure": curve.measure.key, "column": curve.measure.column, "unit": curve.measure.unit, **curve.place,
        "method": curve.method,
        "levels": [{"electrons": level.electrons, "mean": level.mean, "sd": level.sd, "values": list(level.values),
                    "failed": level.failed} for level in curve.levels],
        "rule": curve.measure.rule, "knee": None if curve.knee is None else vars(curve.knee),
        "slope_per_doubling": curve.slope,
    }  # fmt: skip


def point_rows(curves: Sequence[Curve]) -> list[dict[str, Any]]:
    """A row for each point."""
    return [
        {"measure": curve.measure.key, **curve.place, "method": curve.method, "electrons": level.electrons,
         "mean": level.mean, "sd": level.sd, "least": min(level.values, default=None),
         "largest": max(level.values, default=None), "seeds": len(level.values), "failed": level.failed}
        for curve in curves for level in curve.levels
    ]  # fmt: skip


def knee_rows(curves: Sequence[Curve]) -> list[dict[str, Any]]:
    """A row for each curve that can break."""
    found = []
    for curve in curves:
        if (knee := curve.knee) is None or (curve.measure.key == "registered" and not varies([curve])):
            continue
        found.append(
            {"measure": curve.measure.key, **curve.place, "method": curve.method, "rule": curve.measure.rule,
             "bright": curve.bright, **vars(knee), "slope_per_doubling": curve.slope}
        )  # fmt: skip
    return found
