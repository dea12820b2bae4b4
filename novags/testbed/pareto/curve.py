"""Curves: the points of a subject's knobs, as lines of JSON."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from statistics import mean, median, stdev
from typing import Any

from novags.testbed.ledger.contents import jsonable
from novags.testbed.pareto.front import front
from novags.testbed.pareto.knob import Knob, Subject
from novags.testbed.pareto.samples import NUMBER, Samples
from sensor_model.files.atomic import write_text
from sensor_model.files.door import read_text
from sensor_model.files.records import check_shape, parse_json

CURVES = "curves.jsonl"
LINE = {
    "knob": str, "setting": NUMBER, "seconds": float, "error": float, "error_unit": str, "error_sd": float,
    "default": bool, "cpu_seconds": float, "front": bool, "repeats": int, "of": str, "why": str, "option": (str, None),
    "parts": {"*": float}, "db_lost": (float, None), "db_lost_sd": (float, None), "workload": dict, "hardware": dict,
}  # fmt: skip

Point = dict[str, Any]


def curve(subject: Subject, knob: Knob, samples: Samples) -> list[Point]:
    """The measured points of a knob; `front` as by processor seconds, which a busy machine changes least."""
    reference = samples.of(knob, knob.default)
    found = []
    for setting in knob.settings:
        rows = samples.of(knob, setting)
        if rows:
            about = {"of": knob.of, "why": knob.why, "option": knob.option, "workload": dict(subject.workload)}
            found.append({
                "knob": f"{subject.name}.{knob.name}", "setting": setting, **_numbers(list(rows.values()), knob.parts),
                "error_unit": knob.unit, "default": setting == knob.default, **_lost(rows, reference), **about,
                "hardware": samples.about["hardware"],
            })  # fmt: skip
    best = front([(point["cpu_seconds"], point["error"]) for point in found])
    return [{**point, "front": i in best} for i, point in enumerate(found)]


def curves(subject: Subject, samples: Samples) -> list[Point]:
    """All curves of a subject; a knob measured only at its default, for the sake of another knob, has none."""
    found = [curve(subject, knob, samples) for knob in subject.knobs]
    return [jsonable(point) for points in found if not all(point["default"] for point in points) for point in points]


def _numbers(rows: list[Mapping[str, Any]], parts: Sequence[str]) -> dict[str, Any]:
    errors = [row["error"] for row in rows]
    common = [name for name in parts if all(name in row["parts"] for row in rows)]
    medians = {name: median(row["parts"][name] for row in rows) for name in common}
    return {
        "seconds": median(row["seconds"] for row in rows), "seconds_sd": sd([row["seconds"] for row in rows]),
        "cpu_seconds": median(row["cpu_seconds"] for row in rows),
        "cpu_seconds_sd": sd([row["cpu_seconds"] for row in rows]), "error": mean(errors),
        "error_sd": sd(errors), "parts": medians, "repeats": len(rows),
    }  # fmt: skip


def _lost(rows: Mapping[int, Mapping[str, Any]], reference: Mapping[int, Mapping[str, Any]]) -> dict[str, Any]:
    """20 log10 of the error over that of the default of the same seed: what scenes have in common drops out."""
    pairs = [(rows[seed]["error"], reference[seed]["error"]) for seed in rows if seed in reference]
    if not pairs or min(min(pair) for pair in pairs) <= 0:  # no decibels where an error is zero
        return {"db_lost": None, "db_lost_sd": None}
    lost = [20 * (math.log10(error) - math.log10(least)) for error, least in pairs]
    return {"db_lost": mean(lost), "db_lost_sd": sd(lost)}


def sd(values: list[float]) -> float:
    """Standard deviation of a sample; 0 of a single value, of which nothing is known."""
    return stdev(values) if len(values) > 1 else 0.0


def write_curves(folder: Path, points: Iterable[Point]) -> Path:
    """Write the points of some subjects into `curves.jsonl`, beside those of others that are there already."""
    path, points = folder / CURVES, list(points)
    new = {point["knob"].partition(".")[0] for point in points}
    kept = [point for point in read_curves(path) if point["knob"].partition(".")[0] not in new] if path.exists() else []
    write_text(path, "".join(json.dumps(point, allow_nan=False) + "\n" for point in (*kept, *points)))
    return path


def read_curves(path: Path) -> list[Point]:
    """The points of a file of curves, or of the one in a folder.

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
