"""The page on a study."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from novags.testbed.console import Console
from novags.testbed.folders import shapes
from novags.testbed.folders.experiment import REPORT
from novags.testbed.ledger.contents import digest
from novags.testbed.ledger.dry import planned
from novags.testbed.report.look.album import Album
from novags.testbed.report.look.maps import ERROR_CEILING
from novags.testbed.report.page import fill_page, identity_of, written
from novags.testbed.report.pictures import ViewTiles
from novags.testbed.report.rows import enhancement_of
from novags.testbed.report.study.grid import (
    COLUMNS,
    SCALES,
    Line,
    lines_of,
    main_column,
    shown_columns,
    verdict,
)
from novags.testbed.report.study.light import Look, files_in, light_files, light_report, looks_of
from novags.testbed.report.study.pictures import place_of, study_views
from novags.testbed.report.study.records import Records, read_records, signals
from novags.testbed.study.conduct import STUDY
from novags.testbed.study.light import MEASURES, METHOD
from novags.testbed.study.results import CSV, JSON, counted
from sensor_model.files.door import resolved
from sensor_model.files.records import check_shape, read_record

AGAIN = "run the study again: what is done is kept"
LPIPS = "lit.lpips"
VALUE = (str, float, bool)  # of an axis
RESULTS: Any = {"axes": {"*": [VALUE]}, "rows": list}
TABLE: Any = {"file": str, "table": {"variant?": {"*": {"method": str}}, "method?": dict, "override?": dict}}
ROW: Any = {
    "state": str,
    "method": str,
    "run": int,
    **{f"{name}?": (str, None) for name in ("reason", "stage", "folder")},
}


def is_study(folder: Path) -> bool:
    """Whether a folder holds the tables of a study."""
    return (folder / STUDY).is_file() and (folder / JSON).is_file()


def write_study(folder: Path, out: Path | None = None, *, overwrite: bool = False) -> Path:
    """Write the report on a study and return its path.

    Args:
        folder: Of the study.
        out: The HTML file; None: report.html in the folder. The other files go beside it.
        overwrite: Replace `out`, and files beside it, even if they are no report on this study.

    Raises:
        ValueError: If its tables cannot be read, nothing is done yet, or `out` is something else.
    """
    rows, axes = read_rows(folder / JSON)
    study = read_record(folder / STUDY, TABLE, AGAIN)
    if not any(row["state"] == "done" for row in rows):
        raise ValueError(f"{folder} has no finished run to show: run its study first, or with --retry-failed")
    path, identity = out or folder / REPORT, digest(["study", str(resolved(folder))])
    if resolved(path) != resolved(folder / REPORT) and not overwrite:
        _refuse_foreign(path, identity, folder, axes)
    looks = looks_of(dict.fromkeys(str(row[METHOD]) for row in rows), study["table"])
    competes = {name: look.competes for name, look in looks.items()}
    records = read_records(folder, rows)
    lines = lines_of(rows, axes, competes, {number: enhancement_of(run) for number, run in records.runs.items()})
    planned(Console(), "report", [*written(path), *light_files(path.parent, rows, axes)])
    album = Album(path)
    views, unseen = study_views(lines, records, album)
    album.settle()
    light = light_report(path.parent, rows, axes, looks)
    context = {
        **_tables(lines, rows, axes, records, path, views),
        "title": f"{study['file']}: {len(rows)} runs", "identity": identity,
        "in_linear_light": list(dict.fromkeys(line.method for line in lines if line.in_linear_light)),
        "alike": all(line.alike for line in lines), "no_lpips": not any(LPIPS in line.spread for line in lines),
        "verdict": verdict(lines, competes), "states": counted(rows), "light": light, "looks": looks,
        "views": list(views.values()), "unseen": unseen, "signals": signals(lines, records),
        "error_ceiling": ERROR_CEILING, "data": _data(lines, looks),
        "failed": [row for row in rows if row["state"] in ("failed", "skipped")], "costs": records.costs(),
        "effects": records.effects(), "departures": records.departures(), "lost": len(records.lost),
        "configuration": json.dumps(study["table"], indent=2, ensure_ascii=False), "csv": CSV,
        "beside": resolved(path.parent) == resolved(folder),
    }  # fmt: skip
    return fill_page("study.html", path, context)


def _refuse_foreign(path: Path, identity: str, study: Path, axes: Mapping[str, Sequence[Any]]) -> None:
    """Refuse to write over a file that no report on this study has left."""
    if path.exists() and identity_of(path) == identity:
        return
    beside = [] if resolved(path.parent) == resolved(study) else files_in(path.parent, axes)
    if found := [file for file in (path, *beside) if file.exists()]:
        raise ValueError(
            f"{found[0]} already exists and is not of a report on this study: choose another --out, or add --overwrite"
        )


def read_rows(path: Path) -> tuple[list[dict[str, Any]], dict[str, list[Any]]]:
    """The rows of a study's table, and the values of its axes.

    Raises:
        ValueError: If it cannot be read, or a row lacks an axis or has no number where a score belongs.
    """
    results = read_record(path, RESULTS, AGAIN)
    if METHOD not in results["axes"]:
        raise ValueError(f"{path.parent} is the work on a data set, which has no runs to report on: see its README.md")
    scores = {column for column, *_ in COLUMNS} | {measure.column for measure in MEASURES}
    row = {**ROW, **dict.fromkeys(results["axes"], VALUE), **{f"{column}?": shapes.MEASURED for column in scores}}
    check_shape(results["rows"], [row], f"{path}: rows", AGAIN)
    return results["rows"], results["axes"]


def _data(lines: Sequence[Line], looks: Mapping[str, Look]) -> dict[str, Any]:
    """What the scripts need: which pictures are compared first."""
    rivals = [line.method for line in lines if looks[line.method].competes] or [lines[0].method]
    return {"left": ["truth-lit", "dark"], "right": [f"render-{rivals[0]}"]}


def _tables(
    lines: Sequence[Line], rows: Sequence[Mapping[str, Any]], axes: Mapping[str, Any], records: Records, path: Path,
    views: Mapping[str, ViewTiles],
) -> dict[str, Any]:  # fmt: skip
    """The tables of combinations and of single runs."""
    columns, commands = shown_columns(lines), records.commands(path)
    varied = [name for name in axes if name != METHOD and len({str(row[name]) for row in rows}) > 1]
    combined = []
    for line in lines:
        cells = [{"spread": line.spread.get(column), "rank": line.places.get(column), "digits": digits}
                 for column, _, _, _, digits in columns]  # fmt: skip
        found = [commands[int(row["run"])] for row in line.runs if int(row["run"]) in commands]
        done = sum(row["state"] == "done" for row in line.runs)
        place = place_of(line)
        shown = views.get(place)
        seen = shown is not None and any(tile.key == f"render-{line.method}" for tile in shown.tiles)
        combined.append({"line": line, "place": place, "cells": cells, "command": "\n".join(found), "done": done,
                         "view": shown.name if shown is not None and seen else None})  # fmt: skip
    main = main_column(lines)
    return {
        "columns": columns, "scales": SCALES, "combined": combined, "rows": rows, "varied": varied,
        "run_commands": commands,
        "main": next((k for k, column in enumerate(columns) if column[0] == main), 0),
        "axes": [name for name in varied if name in (lines[0].place if lines else {})],
    }  # fmt: skip
