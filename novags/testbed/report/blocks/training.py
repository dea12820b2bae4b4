"""What led to the scores of one place: its cameras, its training pictures, its losses."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from novags.testbed.report.charts import DASHES, Axis, Chart, Point, Series
from novags.testbed.report.material import Material
from novags.testbed.report.parts import Page, Table, TableRow, heads, num
from novags.testbed.report.words import named, share

SMALLEST = 1e-45  # a loss of 32 bits above 0
EXACT = 1e-4  # degrees or extents; camera files round, and smaller errors are invisible


def cameras(material: Material, page: Page) -> dict[str, Any] | None:
    """Where each run's cameras came from and how far off they are; nothing where all were exact."""
    place = material.one
    known = {name: run.record.get("cameras") for name, run in (place.runs if place else {}).items()}
    found = {name: told for name, told in known.items() if told and (
             told["unregistered"] or max(told["mean_rotation_deg"], told["mean_centre_error"]) > EXACT)}  # fmt: skip
    if place is None or not found:
        return None
    rows = [TableRow([named(place.rows[name]), told["source"],
                      num(told["registered_share"], share(told["registered_share"])), num(told["mean_rotation_deg"], 3),
                      num(told["mean_centre_error"], 4), num(told["depth_scale"], 4)])
            for name, told in found.items()]  # fmt: skip
    columns = heads("Method | Source | #Registered | #Rotation error [°] | #Centre error [extents] | #Scale")
    without = {name: ", ".join(told["unregistered"]) for name, told in found.items() if told["unregistered"]}
    return {"table": Table("cameras", "Errors of the cameras", columns, rows), "without": without}


def flat(material: Material, page: Page) -> dict[str, Any] | None:
    """2D scores of the training images of the main method, best last."""
    place = material.one
    scores = None if place is None else place.metrics["methods"][place.main]["training_2d"]
    if place is None or scores is None:
        return None
    labels = {"enhanced": "enhanced, not denoised", "blur": f"Gaussian blur, sigma {scores['blur']['sigma']:.1f} px"}
    if "best_blur" in scores:  # not where nothing can be aligned
        sigma = scores["best_blur"]["sigma"]
        labels["best_blur"] = f"Gaussian blur, the best sigma for these images ({sigma:.1f} px)"
    labels["denoised"] = f"denoised by {place.main}"
    rows = [TableRow([label, num(scores[key]["aligned_psnr"]), num(scores[key]["psnr"])])
            for key, label in labels.items() if key in scores]  # fmt: skip
    columns = heads("Training images | #PSNR aligned [dB] | #PSNR [dB]")
    return {"table": Table("training-images", "Scores of the training images", columns, rows), "main": place.main}


def training(material: Material, page: Page) -> dict[str, Any] | None:
    """Photometric loss over the iterations, one line for each run, and what stands for which; None without a log.

    The fits of a run stand one after the other, with a gap between them: each has targets of its own.
    """
    if (place := material.one) is None:
        return None
    series = {}
    for name, run in place.runs.items():
        points = [(e["iteration"], _drawn(e["photometric"])) for e in run.events() if "photometric" in e]
        series[name] = [point for fit in fits(points) for point in ((fit[0][0], math.nan), *smoothed(fit))]
    if not any(loss > 0 for points in series.values() for _, loss in points):
        return None
    series = {name: points for name, points in series.items() if points}
    key = [(name, place.rows[name].key) for name in series]
    return {"chart": losses(series, dict(key)), "key": key}


def losses(series: Mapping[str, Sequence[tuple[float, float]]], keys: Mapping[str, str]) -> str:
    """Losses, logarithmic, over iterations: points and the CSS class of the colour by run; NaN leaves a gap."""
    drawn = [Series(name, keys[name], [Point(x, y, f"{y:.4g}") for x, y in points], f"dash{place % DASHES}")
             for place, (name, points) in enumerate(series.items())]  # fmt: skip
    known = [point for each in drawn for point in each.points if 0 < point.y < math.inf]
    x = Axis("iteration", 0.0, max(point.x for point in known) or 1.0)
    y = Axis.around("photometric loss", [point.y for point in known], log=True)
    return Chart("Photometric loss over iterations", x, y, drawn).svg()


def _drawn(loss: float | str | None) -> float:
    """A loss as drawn: a gap where there is none above 0, or it was not finite, which is text in JSON."""
    return loss if isinstance(loss, int | float) and loss >= SMALLEST else math.nan


def fits(points: Sequence[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """The losses of each fit of a run, over the iterations of all of them: where the count falls back, a fit begins."""
    found: list[list[tuple[float, float]]] = []
    before = last = 0.0
    for iteration, loss in points:
        if not found or iteration <= last:
            before, found = before + last, [*found, []]
        last = iteration
        found[-1].append((before + iteration, loss))
    return found


def smoothed(points: list[tuple[float, float]], count: int = 50) -> list[tuple[float, float]]:
    """Means of consecutive groups, at most `count` of them: single views scatter, and files should stay small."""
    group = max(1, -(-len(points) // count))
    groups = [points[k : k + group] for k in range(0, len(points), group)]
    return [(g[-1][0], sum(y for _, y in g) / len(g)) for g in groups]
