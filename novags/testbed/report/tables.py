"""The tables of scores: which columns there are, who comes first in each, and every view by itself."""

import math
import statistics
from collections.abc import Callable, Mapping
from typing import Any

from novags.testbed.metrics import METRICS
from novags.testbed.metrics.differences import Values, order, places
from novags.testbed.metrics.truth import ERROR
from sensor_model.files.reading import brief

# key, heading, unit, whether more is better; the first is the main score
_LINEAR = (("linear_psnr", "PSNR linear", "dB", True),)
_FIRST = {"enhanced": "aligned_psnr", "enhanced_demosaiced": "aligned_psnr", "lit": "tone_aligned_psnr"}
_FIXED = {
    "linear": _LINEAR,
    "linear_demosaiced": _LINEAR,
    "geometry": (
        ("abs_rel", "relative error", "", False),
        ("within_5_percent", "within 5 %", "", True),
        ("coverage", "covered", "", True),
        ("floaters", "floaters", "", False),
        ("consistency", "colour change between views", "", False),
        ("f1", "F1 within 5 cm", "", True),
        ("accuracy", "off the scan", "m", False),
        ("completeness", "of the scan missed by", "m", False),
    ),
    "noise": (
        ("renders", "left in renderings", "", False),
        ("targets", "left in targets", "", False),
        ("known", "noise", "sRGB code", False),
        ("bias_floor", "bias floor", "dB", True),
    ),
}
KINDS = ("enhanced", "enhanced_demosaiced", "linear", "linear_demosaiced", "lit", "geometry", "noise")
OWN = ("enhanced", "enhanced_demosaiced")  # references that every enhancement has its own of
GIVEN = ("known", "bias_floor")  # of these: facts of the enhanced pictures, by which no method is better

Columns = tuple[tuple[str, str, str, bool], ...]
Several = Callable[[str, str], Values]


def columns(kind: str) -> Columns:
    """The columns of the table of scores against a reference, or of "geometry" or "noise"."""
    if kind in _FIXED:
        return _FIXED[kind]
    listed = [(name, metric.heading, metric.unit, metric.more) for name, metric in METRICS.items()]
    return tuple(sorted(listed, key=lambda column: column[0] != _FIRST[kind]))


def is_plain(key: str) -> bool:
    """Whether nothing is aligned before a score of pictures: of linear light the truth decides the exposure alone."""
    return key in METRICS and METRICS[key].aligned == "none"


def scores_of(metrics: Mapping[str, Any], kind: str) -> dict[str, Mapping[str, Any]]:
    """The scores of each run that has any against a reference, or of its "geometry" or "noise", by name."""
    methods = metrics["methods"].items()
    if kind == "geometry":
        found = {name: m["geometry"] for name, m in methods if m.get("geometry")}
        return {name: {**scores, "consistency": scores["consistency"]["excess"]} for name, scores in found.items()}
    return {name: found for name, m in methods if (found := m.get("noise") if kind == "noise" else m["mean"].get(kind))}


def ranked(
    values: Mapping[str, Mapping[str, Any]], shown: Columns, competes: Mapping[str, bool],
    placed: Callable[[str, str], bool] = lambda name, key: True, several: Several | None = None,
) -> list[dict[str, Any]]:  # fmt: skip
    """Rows of cells, of values by row and column, in the order of the first column, with the place in each.

    Values that are not seen to differ share a place (`differences.places`), and the best are marked where some are seen
    to be worse. `competes`: whether a row may be the best; other rows have no place. `placed`: (row, column) -> whether
    its value can be compared with the other rows'. `several`: (row, column) -> its values by view; None: one of each.
    """
    ranks, rows, first = {}, [], list[str]()
    for key, _, _, more in shown:
        known = {name: found for name, row in values.items() if (found := measured(row.get(key))) is not None}
        every: dict[str, Values] = {name: (several and several(name, key)) or {("", "", ""): value}
                                    for name, value in known.items()}  # fmt: skip
        own = {name: each for name, each in every.items() if competes[name] and placed(name, key)}
        ranks[key] = places(own, more, digits(key))
        if key == shown[0][0]:
            first = order(every, more)
    for name, row in values.items():
        own_ranks = {key: ranks[key].get(name) for key, *_ in shown}
        cells = [{"key": key, "value": row.get(key), "rank": rank, "error": measured(row.get(f"{key}{ERROR}")),
                  "best": rank == 1 and max(ranks[key].values()) > 1} for key, rank in own_ranks.items()]  # fmt: skip
        rows.append({"method": name, "competes": competes[name], "cells": cells})
    last = len(first)  # rows without a value
    return sorted(rows, key=lambda row: first.index(row["method"]) if row["method"] in first else last)


def measured(value: float | str | None) -> float | None:
    """A score as a number: JSON has infinity as text; None and NaN are not scores.

    Raises:
        ValueError: If it is another text.
    """
    try:
        number = math.nan if value is None else float(value)
    except ValueError as error:
        raise ValueError(f"a score must be a number, got {brief(repr(value))}: score again") from error
    return None if math.isnan(number) else number


def per_view(metrics: Mapping[str, Any], kind: str) -> dict[str, Any] | None:
    """Every score of every held-out view, and its spread over them; None where there are no scores.

    That is `views`, `methods`, and by score `heading`, `unit`, `digits`, `values` (a row for each view, a value or None
    for each method) and `spread` (mean, standard deviation, worst and best of each method).
    """
    methods = [name for name, m in metrics["methods"].items() if m["mean"].get(kind)]
    views = list(dict.fromkeys(view for name in methods for view in metrics["methods"][name]["views"]))
    scores = {}
    for key, heading, unit, more in columns(kind):
        values = [[(metrics["methods"][name]["views"].get(view, {}).get(kind) or {}).get(key) for name in methods]
                  for view in views]  # fmt: skip
        if any(value is not None for row in values for value in row):
            by_method = [[found for row in values if (found := measured(row[m])) is not None]
                         for m in range(len(methods))]  # fmt: skip
            spreads = [spread_of(column, more) for column in by_method]
            scores[key] = {"heading": heading, "unit": unit, "more": more, "digits": digits(key), "values": values,
                           "spread": {what: [found[what] for found in spreads] for what in spreads[0]}}  # fmt: skip
    return {"views": views, "methods": methods, "scores": scores} if scores else None


def spread_of(values: list[float], more: bool) -> dict[str, float | None]:
    """Mean, standard deviation (None of fewer than two), worst and best."""
    if not values:
        return {"mean": None, "sd": None, "worst": None, "best": None}
    low, high = min(values), max(values)
    sd = statistics.stdev(values) if len(values) > 1 and math.isfinite(high - low) else None
    return {"mean": statistics.fmean(values), "sd": sd,
            "worst": low if more else high, "best": high if more else low}  # fmt: skip


def digits(key: str) -> int:
    """Digits after the point in which a score is shown."""
    return METRICS[key].digits if key in METRICS else 2 if "psnr" in key or key == "bias_floor" else 3
