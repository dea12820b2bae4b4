"""One self-contained HTML file on an experiment or a run: what was done, how it looks, what it scores, what it cost."""

from pathlib import Path
from typing import Any

from novags.testbed.cache import read_json, write_text
from novags.testbed.console import Console, Update
from novags.testbed.folders import shapes
from novags.testbed.folders.experiment import EXPERIMENT, REPORT, find_runs
from novags.testbed.folders.linear_photographs import LinearPhotographs
from novags.testbed.folders.run import METRICS
from novags.testbed.report.facts import (
    COLUMNS,
    GEOMETRY,
    Material,
    camera_table,
    cards,
    configurations,
    costs,
    departures,
    duration,
    geometry_table,
    loss_chart,
    number,
    plans,
    score_table,
    signed,
    size,
    title,
    training_table,
    verdict,
    what_was_done,
)
from novags.testbed.report.pictures import ERROR_CEILING, pick_views, view_tiles
from sensor_model.files.lock import locked


def read_material(folder: Path, console: Console) -> Material:
    """Read a scored experiment or run.

    Raises:
        ValueError: If it is not there or not scored, or its runs were made from different captures or not from those
            that are there now.
    """
    runs = find_runs(folder)
    if not (folder / METRICS).exists():
        raise ValueError(f"{folder} has no {METRICS}: run novags score {folder} first")
    metrics = read_json(folder / METRICS, shapes.METRICS)
    inputs = {captured.path: (captured, lit) for captured, lit in (run.inputs(console) for run in runs.values())}
    if len(inputs) > 1:
        raise ValueError(f"the runs in {folder} were made from different captures: {', '.join(map(str, inputs))}")
    scored = metrics["methods"]
    if old := [name for name, run in runs.items() if name not in scored or run.scores() != scored[name]]:
        raise ValueError(f"{folder / METRICS} has no scores of {', '.join(old)} as of now: run novags score {folder}")
    capture, lit = next(iter(inputs.values()))
    experiment = read_json(folder / EXPERIMENT, shapes.EXPERIMENT) if (folder / EXPERIMENT).exists() else {}
    return Material(folder, experiment, runs, metrics, capture, lit)


def write_report(folder: Path, console: Console) -> Path:
    """Write `folder`/report.html and return its path.

    Raises:
        ValueError: If the folder holds nothing scored, or what it refers to is gone.
        BlockingIOError: If another process is writing there.
    """
    with locked(folder, make=False):
        return _write_report(folder, console)


def _write_report(folder: Path, console: Console) -> Path:
    import jinja2

    material = read_material(folder, console)
    loader = jinja2.PackageLoader("novags.testbed.report", "")
    templates = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
                                   lstrip_blocks=True)  # fmt: skip
    templates.filters.update(number=number, duration=duration, size=size, signed=signed)
    with console.progress("report") as progress:
        context = report_context(material, progress)
    path = folder / REPORT
    write_text(path, templates.get_template("report.html").render(context))
    return path


def report_context(material: Material, progress: Update) -> dict[str, Any]:
    """What the template shows."""
    competes = {name: row.competes for name, row in material.rows.items()}
    picked = pick_views(material.capture)
    views = []
    for done, i in enumerate(picked):
        views.append(view_tiles(i, material.runs, material.main, material.capture, material.lit, material.metrics))
        progress(done + 1, len(picked), f"view {views[-1].name}")
    return {
        "title": title(material),
        "what": what_was_done(material),
        "verdict": verdict(material),
        "cards": cards(material),
        "views": views,
        "main": material.main,
        "compared": {"left": material.bound("floor") or material.main, "right": material.main},
        "error_ceiling": ERROR_CEILING,
        "rows": material.rows,
        "tables": {kind: score_table(material.metrics, kind, competes) for kind in COLUMNS},
        "columns": COLUMNS,
        "geometry": geometry_table(material),
        "geometry_columns": GEOMETRY,
        "cameras": camera_table(material),
        "recovered": {
            "enhanced": material.metrics["recovered"],
            "lit": material.metrics.get("recovered_lit", {}),
            "linear": {},
        },
        "bounds": [material.bound("floor"), material.bound("ceiling")],
        "training_2d": training_table(material),
        "departures": departures(material),
        "loss_chart": loss_chart(material.runs, material.rows),
        "costs": costs(material),
        "plans": plans(material),
        "kind": material.lit.views.kind,
        "linear": isinstance(material.lit.views, LinearPhotographs),
        "record": material.capture.record,
        "background": material.capture.record["set"].get("background"),
        "unregistered": material.lit.views.unregistered,
        "unavailable": material.metrics["unavailable"],
        "configurations": configurations(material),
        "command": material.experiment.get("command"),
        "environment": material.runs[material.main].record["stage"],
    }
