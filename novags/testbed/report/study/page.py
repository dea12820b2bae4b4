"""The page on a study."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from novags.testbed.cache import read_json
from novags.testbed.folders.experiment import REPORT
from novags.testbed.report.look.album import Album
from novags.testbed.report.look.maps import ERROR_CEILING
from novags.testbed.report.page import fill_page
from novags.testbed.report.study.grid import SCALES, Line, lines_of, main_column, shown_columns, verdict
from novags.testbed.report.study.light import Look, light_report, looks_of
from novags.testbed.report.study.pictures import study_views
from novags.testbed.report.study.records import Records, read_records
from novags.testbed.study.conduct import STUDY
from novags.testbed.study.light import METHOD
from novags.testbed.study.results import CSV, JSON, counted

RESULTS: Any = {"axes": {"*": list}, "rows": [{"state": str, "method": str, "run": int}]}
TABLE: Any = {"file": str, "table": dict}


def is_study(folder: Path) -> bool:
    """Whether a folder holds the tables of a study."""
    return (folder / STUDY).is_file() and (folder / JSON).is_file()


def write_study(folder: Path, out: Path | None = None) -> Path:
    """Write the report on a study and return its path.

    Args:
        folder: Of the study.
        out: The HTML file; None: report.html in the folder. The other files go beside it.

    Raises:
        ValueError: If its tables cannot be read, or nothing is done yet.
    """
    results, study = read_json(folder / JSON, RESULTS), read_json(folder / STUDY, TABLE)
    rows, axes = results["rows"], results["axes"]
    if not any(row["state"] == "done" for row in rows):
        raise ValueError(f"{folder} has no finished run to show: run its study first, or with --retry-failed")
    path = out or folder / REPORT
    looks = looks_of(dict.fromkeys(str(row[METHOD]) for row in rows), study["table"])
    competes = {name: look.competes for name, look in looks.items()}
    lines, records = lines_of(rows, axes, competes), read_records(folder, rows)
    album = Album(path)
    views = study_views(lines, records, album)
    album.settle()
    light = light_report(path.parent, rows, axes, looks)
    context = {
        **_tables(lines, rows, axes, records, path),
        "title": f"{study['file']}: {len(rows)} runs",
        "verdict": verdict(lines, competes), "states": counted(rows), "light": light, "looks": looks,
        "views": views, "error_ceiling": ERROR_CEILING, "data": _data(lines, looks),
        "failed": [row for row in rows if row["state"] == "failed"], "costs": records.costs(),
        "effects": records.effects(), "departures": records.departures(), "lost": len(records.lost),
        "configuration": json.dumps(study["table"], indent=2, ensure_ascii=False), "csv": CSV,
        "beside": path.parent.resolve() == folder.resolve(),
    }  # fmt: skip
    return fill_page("study.html", path, context)


def _data(lines: Sequence[Line], looks: Mapping[str, Look]) -> dict[str, Any]:
    """What the scripts need: which pictures are compared first."""
    rivals = [line.method for line in lines if looks[line.method].competes] or [lines[0].method]
    return {"left": ["truth-lit", "dark"], "right": [f"render-{rivals[0]}"]}


def _tables(
    lines: Sequence[Line], rows: Sequence[Mapping[str, Any]], axes: Mapping[str, Any], records: Records, path: Path
) -> dict[str, Any]:
    """The tables of combinations and of single runs."""
    columns, commands = shown_columns(lines), records.commands(path)
    varied = [name for name in axes if name != METHOD and len({str(row[name]) for row in rows}) > 1]
    combined = []
    for line in lines:
        cells = [{"spread": line.spread.get(column), "rank": line.places.get(column), "digits": digits}
                 for column, _, _, _, digits in columns]  # fmt: skip
        found = [commands[int(row["run"])] for row in line.runs if int(row["run"]) in commands]
        done = sum(row["state"] == "done" for row in line.runs)
        combined.append({"line": line, "cells": cells, "command": "\n".join(found), "done": done})
    main = main_column(lines)
    return {
        "columns": columns, "scales": SCALES, "combined": combined, "rows": rows, "varied": varied,
        "run_commands": commands,
        "main": next((k for k, column in enumerate(columns) if column[0] == main), 0),
        "axes": [name for name in varied if name in (lines[0].place if lines else {})],
    }  # fmt: skip
