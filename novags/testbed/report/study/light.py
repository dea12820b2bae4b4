"""A study over the light: curves, where each method breaks, and the same as JSON, CSV and pictures beside the page.

light.json   light.csv (every point of every curve)   light-knees.csv
light-MEASURE.svg      light-MEASURE-PLACE.svg  (where other axes than light, method and seed have several values)
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.methods import METHODS, chosen, with_variants
from novags.methods.variant import STATISTICS, Variant, dotted, sees_statistics
from novags.settings import changed, has_setting
from novags.testbed.csv_text import as_csv
from novags.testbed.ledger.contents import write_json
from novags.testbed.report.level_chart import Line, alone, level_chart
from novags.testbed.report.rows import OTHER, distinct
from novags.testbed.study.light import ELECTRONS, Curve, Measure, light_curves
from sensor_model.files.atomic import write_text

DATA, POINTS, KNEES = "light.json", "light.csv", "light-knees.csv"
HEADINGS = {  # columns of KNEES in the words of the page
    "measure": "score", "rule": "breaks at", "bright": "value at the most light", "electrons": "electrons, mean",
    "low": "least of the seeds", "high": "most of the seeds", "broken": "seeds that break",
    "unknown": "seeds without a value at the most light",
    "slope_per_doubling": "change per doubling there",
}  # fmt: skip


@dataclass(frozen=True)
class Chart:
    """Curves of one score in one place.

    Attributes:
        title: Score, and place if there are several.
        file: Name of the picture.
        curves: One a method.
    """

    title: str
    file: str
    curves: list[Curve]

    @property
    def measure(self) -> Measure:
        """The score."""
        return self.curves[0].measure


def light_report(folder: Path, rows: Sequence[Mapping[str, Any]], axes: Mapping[str, Sequence[Any]],
                 looks: Mapping[str, "Look"]) -> dict[str, Any] | None:  # fmt: skip
    """What the page shows of a study over the light; its pictures and numbers are written into `folder`.

    Args:
        folder: Of the page.
        rows: Of the study's table.
        axes: Its axes and their values.
        looks: How its methods are drawn.

    Returns:
        None where the light was not varied, or nothing is done.
    """
    if not _varies_light(axes) or not (curves := light_curves(rows, axes)):
        return None
    charts = charts_of(curves)
    drawn = {chart.file: draw(chart, looks) for chart in charts}
    for file, svg in drawn.items():
        write_text(folder / file, alone(svg, {look.key: look.color for look in looks.values()}))
    write_json(folder / DATA, {"curves": [as_record(curve) for curve in curves]})
    write_text(folder / POINTS, as_csv(point_rows(curves)))
    knees = knee_rows(curves)
    write_text(folder / KNEES, as_csv(knees))
    labels = {curve.measure.key: curve.measure.label for curve in curves}
    shown = [{HEADINGS.get(key, key): _in_words(key, row, labels) for key in row} for row in knees]
    return {"charts": charts, "drawn": drawn, "knees": shown,
            "files": {"points": POINTS, "knees": KNEES, "data": DATA}}  # fmt: skip


def light_files(folder: Path, rows: Sequence[Mapping[str, Any]], axes: Mapping[str, Sequence[Any]]) -> list[Path]:
    """The files that `light_report` would write."""
    curves = light_curves(rows, axes) if _varies_light(axes) else ()
    names = [*(chart.file for chart in charts_of(curves)), DATA, POINTS, KNEES] if curves else []
    return [folder / name for name in names]


def _in_words(column: str, row: Mapping[str, Any], labels: Mapping[str, str]) -> Any:
    """A value of KNEES as the page shows it."""
    if column == "measure":
        return labels[row[column]]
    if row[column] is None and column in ("electrons", "low", "high"):
        return "unknown" if row["unknown"] == row["seeds"] else "not reached"
    return row[column]


@dataclass(frozen=True)
class Look:
    """How a method is drawn."""

    key: str
    color: str
    bound: bool  # it sees truth

    @property
    def competes(self) -> bool:
        """Whether it may be the best."""
        return not self.bound


def looks_of(names: Iterable[str], study: Mapping[str, Any]) -> dict[str, Look]:
    """How each method of a study is drawn.

    Args:
        names: Of methods, variants and programs, in order.
        study: The content of the study file: the tables of its own variants and programs, and what it sets for all.
    """
    own, programs = study.get("variant", {}), study.get("method", {})
    variants = with_variants(
        Variant(name=name, method=str(table["method"]),
                settings={key: value for key, value in dotted(table).items() if key != "method"})
        for name, table in own.items()
    )  # fmt: skip
    shared = dotted(study.get("override", {}))
    found: dict[str, Look] = {}
    for name in names:
        variant = None if name in programs else chosen(name, variants)
        color = OTHER if variant is None else METHODS[variant.method].color
        color = distinct(color, [look.color for look in found.values()])
        found[name] = Look(f"m{len(found)}", color, variant is not None and _sees_truth(variant, shared))
    return found


def _sees_truth(variant: Variant, shared: Mapping[str, Any]) -> bool:
    """Whether a variant, under what the study sets for all, sees any truth."""
    method = METHODS[variant.method]
    told = {key: value for key, value in {**shared, **variant.settings}.items() if key == STATISTICS}
    config = method.config()
    own = changed(config, told) if has_setting(config, STATISTICS) else config
    return method.sees_clean or method.sees_surface or sees_statistics(own)


def charts_of(curves: Sequence[Curve]) -> list[Chart]:
    """The charts that show something: one for each score and place."""
    varied = [name for name in curves[0].place if len({str(curve.place[name]) for curve in curves}) > 1]
    groups: dict[tuple[str, str], list[Curve]] = {}
    for curve in curves:
        place = ", ".join(f"{name} {curve.place[name]}" for name in varied)
        groups.setdefault((curve.measure.key, place), []).append(curve)
    order = list(dict.fromkeys(place for _, place in groups))
    found = list[Chart]()
    for (key, place), members in sorted(groups.items(), key=lambda item: order.index(item[0][1])):
        if key == "registered" and not varies(members):
            continue  # cameras were given
        ending = f"-{slug}" if (slug := re.sub(r"[^A-Za-z0-9.]+", "-", place).strip("-").lower()) else ""
        label = members[0].measure.label
        file = _unused(f"light-{key}{ending}", [chart.file for chart in found])
        found.append(Chart(f"{label}: {place}" if place else label, file, members))
    return found


def _unused(stem: str, used: Collection[str]) -> str:
    """The name of a picture that no other has: "Küche" and "köche" are alike without their capitals and umlauts."""
    names = (f"{stem}{number}.svg" for number in ("", *(f"-{k}" for k in range(2, len(used) + 3))))
    return next(name for name in names if name not in used)


def varies(curves: Sequence[Curve]) -> bool:
    """Whether there are different values."""
    return len({value for curve in curves for level in curve.levels for value in level.values}) > 1


def draw(chart: Chart, looks: Mapping[str, Look]) -> str:
    """The chart as SVG."""
    lines = []
    for curve in chart.curves:
        look = looks[curve.method]
        points = [(level.electrons, level.mean, min(level.values), max(level.values))
                  for level in curve.levels if level.mean is not None]  # fmt: skip
        knee = curve.knee.electrons if curve.knee else None
        lines.append(Line(curve.method, look.key, points, dashed=look.bound, knee=knee))
    measure = chart.measure
    unit = f" ({measure.unit})" if measure.unit else ""
    short = measure.label.partition(" against ")[0]  # the title says against what
    return level_chart(lines, x_label="electrons per green pixel", y_label=f"{short}{unit}", title=chart.title)


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


def files_in(folder: Path, axes: Mapping[str, Sequence[Any]]) -> list[Path]:
    """The files of a folder that the report on a study with these axes would write over."""
    names = (DATA, POINTS, KNEES, "light-*.svg") if _varies_light(axes) else ()
    return sorted(path for name in names for path in folder.glob(name))


def _varies_light(axes: Mapping[str, Sequence[Any]]) -> bool:
    return len(axes.get(ELECTRONS, ())) > 1
