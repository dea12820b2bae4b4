"""One self-contained HTML file on runs: what was done, how it looks, what it scores, what it cost.

Runs of one capture get the whole report; those of several captures a table for each.
"""

import os
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from shlex import quote
from typing import Any

from novags.testbed.console import Console, Update
from novags.testbed.folders import shapes
from novags.testbed.folders.experiment import EXPERIMENT, REPORT, experiments_in, find_runs
from novags.testbed.folders.linear_photographs import LinearPhotographs
from novags.testbed.folders.run import METRICS
from novags.testbed.ledger.contents import digest, jsonable, read_json
from novags.testbed.ledger.dry import planned
from novags.testbed.report.comparison import comparison_context
from novags.testbed.report.facts import (
    camera_table,
    configurations,
    costs,
    departures,
    duration,
    geometry_table,
    loss_chart,
    noise_table,
    number,
    photographs_text,
    placed_in,
    plans,
    signed,
    size,
    title,
    training_table,
    what_was_done,
)
from novags.testbed.report.look.album import Album, files_of
from novags.testbed.report.look.maps import ERROR_CEILING
from novags.testbed.report.material import Material
from novags.testbed.report.pictures import pick_views, view_tiles
from novags.testbed.report.signal_chart import signal
from novags.testbed.report.tables import COLUMNS, GEOMETRY, NOISE, per_view, score_table
from novags.testbed.report.verdict import cards, compared, verdict
from novags.testbed.results.again import run_again, score_again
from novags.testbed.results.comparison import MAIN, Group, deltas_of, groups_of
from novags.testbed.results.mixed import mixed
from novags.testbed.stages.scoring import bounds_of
from sensor_model.files.atomic import write_text
from sensor_model.files.door import read_bytes, resolved
from sensor_model.files.lock import locked


def read_material(folder: Path, console: Console) -> Material:
    """Read a scored experiment or run.

    Raises:
        ValueError: If it is not there or not scored, or its runs were made from different captures or not from those
            that are there now.
    """
    runs = find_runs(folder)
    if not (folder / METRICS).exists():
        raise ValueError(f"{folder} has no {METRICS}: run novags score {quote(str(folder))} first")
    metrics = read_json(folder / METRICS, shapes.METRICS)
    inputs = {captured.path: (captured, lit) for captured, lit in (run.inputs(console) for run in runs.values())}
    if len(inputs) > 1:
        raise ValueError(f"the runs in {folder} were made from different captures: {', '.join(map(str, inputs))}")
    scored = metrics["methods"]
    if old := [name for name, run in runs.items() if name not in scored or run.scores() != scored[name]]:
        raise ValueError(f"{folder / METRICS} has no scores of {', '.join(old)} as of now: run novags score "
                         f"{quote(str(folder))}")  # fmt: skip
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


def write_reports(
    folders: Sequence[Path], console: Console, *, out: Path | None = None, overwrite: bool = False
) -> Path:
    """Write one report on the runs of several folders and return its path.

    Args:
        folders: Runs, experiments, or folders that hold such.
        console: Where progress goes.
        out: The file. None: `folder`/report.html of a single folder, else comparison.html where all of them lie.
        overwrite: Replace `out` even if it is there and no report on the same runs.

    Raises:
        ValueError: If a folder holds nothing scored, what it refers to is gone, or `out` is something else.
        BlockingIOError: If another process is writing there.
    """
    if len(folders) == 1 and out is None and experiments_in(folders[0]) == [folders[0]]:
        return write_report(folders[0], console)
    path = out or report_path(folders)
    groups = groups_of(folders, console)
    identity = digest(sorted(str(resolved(run.path)) for group in groups for run in group.runs.values()))
    if path.exists() and not overwrite and identity_of(path) != identity:
        raise ValueError(
            f"{path} already exists and is not a report on these runs: choose another --out, or add --overwrite"
        )
    with locked(path.parent):
        if len(groups) == 1:
            group = groups[0]
            material = Material(path.parent, {}, group.runs, group.metrics, group.capture, group.lit)
            return _fill_report(path, material, console, identity)
        return _fill_comparison(path, groups, console, identity)


def report_path(folders: Sequence[Path]) -> Path:
    """Where the report on several folders goes by default: beside them, under a name that no stage uses."""
    if len(folders) == 1:
        return folders[0] / REPORT
    return Path(os.path.commonpath([resolved(folder).parent for folder in folders])) / "comparison.html"


def identity_of(path: Path) -> str | None:
    """Which runs, or which study, an earlier report is about; None if it does not say."""
    found = re.search(r'<meta name="novags-runs" content="([^"]*)">', read_bytes(path).decode("utf-8", "replace"))
    return found and found[1]


def _write_report(folder: Path, console: Console) -> Path:
    return _fill_report(folder / REPORT, read_material(folder, console), console)


def _fill_report(path: Path, material: Material, console: Console, identity: str = "") -> Path:
    planned(console, "report", written(path))
    album = Album(path)
    with console.progress("report") as progress:
        context = report_context(material, album, progress)
    album.settle()
    return fill_page("report.html", path, {**context, "identity": identity})


def _fill_comparison(path: Path, groups: Sequence[Group], console: Console, identity: str) -> Path:
    planned(console, "report", written(path))
    album = Album(path)
    with console.progress("report") as progress:
        context = comparison_context(groups, path.parent, album, progress)
    album.settle()
    return fill_page("comparison.html", path, {**context, "identity": identity})


def written(path: Path) -> list[Path]:
    """A page, and the folder beside it if there is one; whether a page needs one is seen when it is made."""
    beside = files_of(path)
    return [path, beside] if beside.exists() else [path]


def fill_page(template: str, path: Path, context: dict[str, Any]) -> Path:
    """Write a page and return its path."""
    import jinja2

    loader = jinja2.PackageLoader("novags.testbed.report", "templates")
    templates = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
                                   lstrip_blocks=True)  # fmt: skip
    templates.filters.update(number=number, duration=duration, size=size, signed=signed, json=_embedded)
    templates.globals.update(asset=_asset)
    known = {"files": files_of(path).name, "looks": {}, "identity": "", "data": {}}
    write_text(path, templates.get_template(template).render({**known, **context}))
    return path


def _asset(name: str) -> Any:
    """A script or a style as it is."""
    import markupsafe

    return markupsafe.Markup((files("novags.testbed.report") / name).read_text(encoding="utf-8"))


def _embedded(value: Any) -> Any:
    """JSON that neither ends a script nor an attribute."""
    import jinja2.utils

    return jinja2.utils.htmlsafe_json_dumps(jsonable(value), separators=(",", ":"), allow_nan=False)


def commands(material: Material) -> dict[str, str]:
    """What makes the results again in the folder of the report: one command of an experiment, else one of each run."""
    if (command := material.experiment.get("command")) is not None:
        return {"": str(command)}
    found = {name: run_again(run, material.folder, name) for name, run in material.runs.items()}
    return {name: command for name, command in found.items() if command is not None}


def report_context(material: Material, album: Album, progress: Update) -> dict[str, Any]:
    """What the template shows; its pictures go into `album`."""
    picked = pick_views(material.capture)
    views = []
    for done, i in enumerate(picked):
        shown = view_tiles(i, material, album)
        views.append(shown)
        progress(done + 1, len(picked), f"view {shown.name}")
    left, right = compared(material)
    scores = score_context(material)
    looks = {name: {"key": row.key, "competes": row.competes} for name, row in material.rows.items()}
    data = {"left": [left, "enhanced"], "right": [right, "truth-lit"],
            "views": scores["per_view"], "looks": looks}  # fmt: skip
    return {
        **scores,
        "title": title(material),
        "what": what_was_done(material),
        "verdict": verdict(material),
        "cards": cards(material),
        "views": views,
        "main": material.main,
        "data": data,
        "error_ceiling": ERROR_CEILING,
        "looks": material.rows,
        "departures": departures(material),
        "loss_chart": loss_chart(material.runs, material.rows),
        "costs": costs(material),
        "plans": plans(material),
        "signal": signal(material.capture, picked),
        "kind": material.lit.views.kind,
        "photographs": photographs_text(material) if material.capture.imported else None,
        "linear": isinstance(material.lit.views, LinearPhotographs),
        "record": material.capture.record,
        "unregistered": material.lit.views.unregistered,
        "unavailable": material.metrics["unavailable"],
        "configurations": configurations(material),
        "commands": commands(material),
        "environment": material.runs[material.main].record["stage"],
        "mixed": mixed(material.runs),
    }


def score_context(material: Material) -> dict[str, Any]:
    """What the tables of scores show."""
    competes = {name: row.competes for name, row in material.rows.items()}
    methods = {name: run.method for name, run in material.runs.items()}
    ends = bounds_of(methods)
    recovered = {"enhanced": material.metrics["recovered"], "lit": material.metrics.get("recovered_lit", {})}
    return {
        "tables": {kind: score_table(material.metrics, kind, competes, placed_in(material, kind)) for kind in COLUMNS},
        "one_reference": material.one_reference,
        "columns": COLUMNS,
        "per_view": {kind: per_view(material.metrics, kind) for kind in COLUMNS},
        "geometry": geometry_table(material),
        "geometry_columns": GEOMETRY,
        "noise": noise_table(material),
        "noise_columns": NOISE,
        "cameras": camera_table(material),
        "recovered": {**dict.fromkeys(COLUMNS, {}), **recovered},
        "bounds": [_of_runs(ends.get(end, []), methods) for end in ("floor", "ceiling")],
        "in_linear_light": list(material.exposures),
        "training_2d": training_table(material),
        "commands_of": {name: score_again(run, material.folder, name) for name, run in material.runs.items()},
        "deltas": {kind: deltas_of(material.metrics, methods, kind) if kind in MAIN else ({}, "") for kind in COLUMNS},
    }


def _of_runs(names: Sequence[str], methods: Mapping[str, str]) -> str:
    """One end of the scale of what is recovered, in words; "" where it has no run."""
    if len(names) < 2:
        return "".join(names)
    return f"the mean of {len(names)} runs of {methods[names[0]]}"
