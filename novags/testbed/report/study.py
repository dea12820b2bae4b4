"""A study as material of its report: its tables, and what its folders hold of each place."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console, warnings_as_notes
from novags.testbed.folders import shapes
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.run import Run, open_run
from novags.testbed.folders.runs import STUDY, TABLE
from novags.testbed.folders.set import Source
from novags.testbed.report.grid import Line, by_place, columns
from novags.testbed.report.material import Material, RunRecords, made_of
from novags.testbed.report.place import Place
from novags.testbed.report.rows import looks_of
from novags.testbed.study.light import MEASURES, METHOD
from novags.testbed.study.results import flat_scores
from sensor_model.files.records import check_shape, read_record

AGAIN = "run the study again: finished work is kept"
VALUE = (str, float, bool)  # of an axis
RESULTS: Any = {"axes": {"*": [VALUE]}, "rows": list}
FILE: Any = {"file": str, "table": {"variant?": {"*": {"method": str}}, "method?": dict, "override?": dict}}
ROW: Any = {"state": str, "method": str, "run": int, "reason?": (str, None), "stage?": (str, None),
            "folder?": (str, None)}  # fmt: skip
QUIET = Console(quiet=True)


def is_study(folder: Path) -> bool:
    """Whether a folder holds the tables of a study."""
    return (folder / STUDY).is_file() and (folder / TABLE).is_file()


def study_material(folder: Path, path: Path) -> Material:
    """What the page at `path` on a study is made of.

    Raises:
        ValueError: If its tables cannot be read, or nothing is done yet.
    """
    rows, axes = read_rows(folder / TABLE)
    study = read_record(folder / STUDY, FILE, AGAIN)
    if not any(row["state"] == "done" for row in rows):
        raise ValueError(f"{folder} has no finished run to show: run its study first, or with --retry-failed")
    made, lost = read_made(folder, rows)
    runs = {each.run.name: each.run for each in made.values()}
    looks = looks_of(dict.fromkeys(str(row[METHOD]) for row in rows), study["table"], runs)
    found = Material(path, rows, axes, looks, made, places={}, study=(folder, study), unseen={}, lost=len(lost),
                     other=other_scores(rows, made))  # fmt: skip
    opened = lru_cache(maxsize=1)(_opened)  # neighbours often share a capture, with all that was computed from it
    for members in by_place(found.lines).values():
        capture, runs = chosen(members, found)
        if capture is None:
            continue
        found.places[members[0].where] = partial(_place, partial(opened, capture), runs)
        for method in sorted({line.method for line in members if found.of(line)} - set(runs)):
            why = "no finished run of it is from the same capture as the others"
            found.unseen[f"{members[0].where}, {method}"] = why
    return found


def read_rows(path: Path) -> tuple[list[dict[str, Any]], dict[str, list[Any]]]:
    """The rows of a study's table, and the values of its axes.

    Raises:
        ValueError: If it cannot be read, or a row lacks an axis or has no number where a score belongs.
    """
    results = read_record(path, RESULTS, AGAIN)
    if METHOD not in results["axes"]:
        raise ValueError(f"{path.parent} is the work on a data set, which has no runs to report on: see its README.md")
    scores = {column for column, *_ in columns()} | {measure.column for measure in MEASURES}
    row = {**ROW, **dict.fromkeys(results["axes"], VALUE), **{f"{column}?": shapes.MEASURED for column in scores}}
    check_shape(results["rows"], [row], f"{path}: rows", AGAIN)
    return results["rows"], results["axes"]


def read_made(folder: Path, rows: Sequence[Mapping[str, Any]]) -> tuple[dict[int, RunRecords], list[int]]:
    """Every finished run whose folder is here, by number; and the numbers of runs whose folder is not here, or cannot
    be read.
    """
    found, lost, known = dict[int, RunRecords](), list[int](), dict[Path, Any]()
    for row in rows:
        if row["state"] != "done":
            continue
        number = int(row["run"])
        try:
            run = open_run(folder / str(row.get("folder")))
            found[number] = made_of(run, f"{run.name}-{number}", known)
        except (ValueError, OSError):
            lost.append(number)
    return found, lost


def other_scores(rows: Sequence[Mapping[str, Any]], made: Mapping[int, RunRecords]) -> tuple[int, ...]:
    """The numbers of rows with other scores than their runs have: scored again since, or changed by hand."""

    def differs(row: Mapping[str, Any]) -> bool:
        each = made.get(int(row["run"]))
        own = each.run.scores() if each else None
        scores = flat_scores(own) if own else {}
        return any(row[name] != value for name, value in scores.items() if name in row)

    return tuple(int(row["run"]) for row in rows if differs(row))


def chosen(members: Sequence[Line], material: Material) -> tuple[Path | None, dict[str, Run]]:
    """The capture that most methods of a place have a run of, the first of several; and the first run of each."""
    captures = Counter[Path]()
    for line in members:
        captures.update(dict.fromkeys(each.capture for each in material.of(line)).keys())
    if not captures:
        return None, {}
    capture = max(captures, key=lambda path: captures[path])
    runs: dict[str, Run] = {}
    for line in members:
        for each in material.of(line):
            if each.capture == capture:
                runs.setdefault(line.method, each.run)
    return capture, runs


def _place(opened: Callable[[], tuple[Capture, Source]], runs: Mapping[str, Run]) -> Place | None:
    """A place with the first held-out view that runs of it have rendered; None where there is none."""
    capture, lit = opened()
    for i in capture.cameras.test_indices:
        file = f"{capture.names[i]}.png"
        if here := {method: run for method, run in runs.items() if (run.path / "renders" / file).is_file()}:
            for run in here.values():
                run.capture()  # which refuses one that has changed
            scores = {name: run.scores() or {"mean": {}, "views": {}} for name, run in here.items()}
            return Place(capture, lit, here, {"methods": scores}, [i])
    return None


def _opened(path: Path) -> tuple[Capture, Source]:
    """A capture and its set; where that is gone, the capture's own cameras without any truth in good light."""
    with warnings_as_notes(QUIET):  # a picture that is missing has its place in the page
        capture = open_capture(path)
    if capture.record.imported or capture.set_path is not None:
        return capture, capture.source(QUIET)
    views = replace(capture.cameras, kind="photographs", meta={})
    return capture, Source(views=views, rig=views.rig, console=QUIET, lit_views=frozenset())
