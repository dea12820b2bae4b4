"""Scores along a fit: which length suits a method, and what the length of all does to their order."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from novags.testbed.folders.run import Run
from novags.testbed.report.charts import DASHES, Axis, Chart, Point, Series
from novags.testbed.report.material import Material
from novags.testbed.report.parts import Page, Table, TableRow, heads, num
from novags.testbed.stages.scores.lengths import Stops, curve, lengths_of

SHOWN = (("enhanced", "aligned_psnr", "PSNR aligned [dB]"), ("lit", "tone_aligned_psnr", "PSNR tone-aligned [dB]"))


def length(material: Material, page: Page) -> dict[str, Any] | None:
    """Charts and tables of scores over iterations; None where no run was shown along its fit."""
    runs: dict[str, list[Run]] = {}
    for each in material.made.values():
        runs.setdefault(material.called(each), []).append(each.run)
    kinds, drawn = [], set[str]()
    for kind, score, label in SHOWN:
        curves = {name: found for name, of in runs.items() if len(found := mean_curve(of, kind, score)) > 1}
        if curves:
            drawn |= curves.keys()
            keys = {name: material.looks[name].key for name in curves}
            three = {name: fits for name, of in runs.items() if (fits := stops_of(of, kind, score))}
            kinds.append({
                "chart": chart(curves, keys, label), "table": table(curves, kind, label), "kind": kind,
                "three": three_table(three, kind, label) if three else None,
            })  # fmt: skip
    key = [(name, material.looks[name].key) for name in runs if name in drawn]
    return {"kinds": kinds, "key": key} if kinds else None


def mean_curve(runs: list[Run], kind: str, score: str) -> dict[int, float]:
    """Mean score of the runs by iterations, at the lengths that all of them have; the last is the end of the fit."""
    curves = [found for run in runs if len(found := curve_of(run, kind, score)) > 1]
    lengths = set.intersection(*map(set, curves)) if curves else set()
    return {at: float(np.mean([curve[at] for curve in curves])) for at in sorted(lengths)}


def curve_of(run: Run, kind: str, score: str) -> dict[int, float]:
    """The score of one run by iterations, its end included; {} where it was not shown along its fit."""
    scores = run.scores()
    return curve(scores, run.iterations, kind, score) if run.along() and scores is not None else {}


def stops_of(runs: list[Run], kind: str, score: str) -> list[Stops]:
    """The three lengths of each run that held views out."""
    scores = [found for run in runs if (found := run.scores()) is not None]
    return [three for each in scores if (three := lengths_of(each, kind, score)) is not None]


def chart(curves: Mapping[str, Mapping[int, float]], keys: Mapping[str, str], label: str) -> str:
    """Scores over iterations, logarithmic: fits are doubled, not prolonged."""
    drawn = [Series(name, keys[name], [Point(at, y, f"{y:.2f} dB") for at, y in curve.items()], f"dash{place % DASHES}")
             for place, (name, curve) in enumerate(curves.items())]  # fmt: skip
    lengths = sorted({at for curve in curves.values() for at in curve})
    values = [point.y for each in drawn for point in each.points]
    x = Axis.around("iterations of the fit", lengths, log=True, ticks=lengths)
    return Chart(f"{label} over iterations", x, Axis.around(label, values), drawn).svg()


def table(curves: Mapping[str, Mapping[int, float]], kind: str, label: str) -> Table:
    """A row for each method: its score at each length, and its best length."""
    lengths = sorted({at for curve in curves.values() for at in curve})
    rows = [TableRow([name, *(num(curve.get(at)) for at in lengths), num(best := max(curve, key=curve.__getitem__), 0),
                      num(curve[best] - curve[max(curve)])]) for name, curve in curves.items()]  # fmt: skip
    columns = heads(" | ".join(["Method", *(f"#{at}" for at in lengths), "#Best length", "#There above the end [dB]"]))
    return Table(f"length-{kind}", f"{label} after so many iterations", columns, rows)


def three_table(runs: Mapping[str, list[Stops]], kind: str, label: str) -> Table:
    """A row for each method: its mean score at the end of its fits, at their own stops and at their best lengths."""
    rows = []
    for name, fits in runs.items():
        loss = float(np.median([each.highest - each.stopped for each in fits]))
        means = [float(np.mean(values)) for values in zip(*((f.end, f.stopped, f.highest) for f in fits), strict=True)]
        stops = sorted(each.stop for each in fits)
        said = f"{stops[0]}" if stops[0] == stops[-1] else f"{stops[0]} to {stops[-1]}"
        rows.append(TableRow([name, num(len(fits), 0), *map(num, means), said, num(loss)]))
    columns = heads("Method | #Fits | #At the end | #At its own stop | #At its best | Own stop | #Median loss [dB]")
    return Table(f"stops-{kind}", f"{label} at the end, at the fit's own stop and at its best length", columns, rows)
