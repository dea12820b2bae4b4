"""Curves: the points of a subject's knobs, from the table of its study, as lines of JSON."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import mean, median, stdev
from typing import Any

from novags.testbed.console.provenance import environment
from novags.testbed.ledger.contents import jsonable
from novags.testbed.study.curves.front import front
from novags.testbed.study.knobs.knob import Knob, Setting, Subject
from sensor_model.files.atomic import write_text
from sensor_model.files.door import read_text
from sensor_model.files.records import check_shape, parse_json

CURVES = "curves.jsonl"
NUMBER = (str, float, None)  # a setting
LINE = {
    "knob": str, "setting": NUMBER, "seconds": float, "error": float, "error_unit": str, "error_sd": float,
    "default": bool, "cpu_seconds": float, "front": bool, "repeats": int, "of": str, "why": str, "option": (str, None),
    "parts": {"*": float}, "db_lost": (float, None), "db_lost_sd": (float, None), "workload": dict, "hardware": dict,
}  # fmt: skip

Point = dict[str, Any]
Row = Mapping[str, Any]  # of the table of a study of measurements


def curve(subject: Subject, knob: Knob, rows: Sequence[Row]) -> list[Point]:
    """The measured points of a knob; `front` as by processor seconds, which a busy machine changes least.

    Args:
        subject: The subject.
        knob: Its knob.
        rows: The table of its study.
    """
    by_setting = {setting: _by_seed(knob, setting, rows) for setting in knob.settings}
    about = {"of": knob.of, "why": knob.why, "option": knob.option, "workload": dict(subject.workload),
             "hardware": environment()["hardware"]}  # fmt: skip
    found = [
        {"knob": f"{subject.name}.{knob.name}", "setting": setting, **_numbers(list(own.values()), knob.parts),
         "error_unit": knob.unit, "default": setting == knob.default, **_lost(own, by_setting[knob.default]), **about}
        for setting, own in by_setting.items() if own
    ]  # fmt: skip
    best = front([(point["cpu_seconds"], point["error"]) for point in found])
    return [{**point, "front": i in best} for i, point in enumerate(found)]


def _by_seed(knob: Knob, setting: Setting, rows: Sequence[Row]) -> dict[int, Row]:
    """The measurements of a setting."""
    found = [row for row in rows if row["state"] == "done" and (row["knob"], row["setting"]) == (knob.name, setting)]
    return {row["seed"]: row for row in found}


def curves(subject: Subject, rows: Sequence[Row]) -> list[Point]:
    """All curves of a subject; a knob measured only at its default, for the sake of another knob, has none."""
    found = [curve(subject, knob, rows) for knob in subject.knobs]
    return [jsonable(point) for points in found if not all(point["default"] for point in points) for point in points]


def _numbers(rows: Sequence[Row], parts: Sequence[str]) -> dict[str, Any]:
    def of(name: str) -> list[float]:
        return [row[name] for row in rows]

    common = [name for name in parts if all(row.get(f"parts.{name}") is not None for row in rows)]
    return {
        "seconds": median(of("seconds")), "seconds_sd": sd(of("seconds")), "cpu_seconds": median(of("cpu_seconds")),
        "cpu_seconds_sd": sd(of("cpu_seconds")), "error": mean(of("error")), "error_sd": sd(of("error")),
        "parts": {name: median(of(f"parts.{name}")) for name in common}, "repeats": len(rows),
    }  # fmt: skip


def _lost(rows: Mapping[int, Row], reference: Mapping[int, Row]) -> dict[str, Any]:
    """20 log10 of the error over the default's error with the same seed: common effects of scenes drop out."""
    pairs = [(rows[seed]["error"], reference[seed]["error"]) for seed in rows if seed in reference]
    if not pairs or min(min(pair) for pair in pairs) <= 0:  # no decibels where an error is zero
        return {"db_lost": None, "db_lost_sd": None}
    lost = [20 * (math.log10(error) - math.log10(least)) for error, least in pairs]
    return {"db_lost": mean(lost), "db_lost_sd": sd(lost)}


def sd(values: list[float]) -> float:
    """Standard deviation of a sample; 0 of a single value, of which nothing is known."""
    return stdev(values) if len(values) > 1 else 0.0


def write_curves(folder: Path, points: Iterable[Point]) -> Path:
    """Write the points of some subjects into `curves.jsonl`, beside the points of other subjects that are there
    already.
    """
    path, points = folder / CURVES, list(points)
    new = {point["knob"].partition(".")[0] for point in points}
    kept = [point for point in read_curves(path) if point["knob"].partition(".")[0] not in new] if path.exists() else []
    write_text(path, "".join(json.dumps(point, allow_nan=False) + "\n" for point in (*kept, *points)))
    return path


def read_curves(path: Path) -> list[Point]:
    """The points of a file of curves, or of the file in a folder.

    Raises:
        ValueError: If the file cannot be read, or holds a line that is not a point.
    """
    file = path / CURVES if path.is_dir() else path
    remedy = "remove it and run novags pareto again"
    try:
        text = read_text(file)
    except OSError as error:
        why = error.strerror or error
        raise ValueError(f"cannot read the curves {file}: {why}; novags pareto makes them") from error
    points = []
    for number, line in enumerate(text.splitlines(), 1):
        where = f"{file}, line {number}"
        point = parse_json(line, where, remedy)
        check_shape(point, LINE, where, remedy)
        points.append(point)
    return points
