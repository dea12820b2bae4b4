"""Tidy data frames of opened folders: one row for each view, score, loss or run."""

from collections.abc import Callable, Iterator, Mapping
from math import inf, nan
from typing import TYPE_CHECKING, Any

from novags.interface.opening import Opened, StudyResults
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.run import Run
from novags.testbed.metrics.truth import BIAS, ERROR
from novags.testbed.study.differences import DIFFERENCES
from sensor_model.files.door import opened
from simscenes.sets.multiview import MultiviewSet

if TYPE_CHECKING:
    import pandas as pd

NUMBERS = {"inf": inf, "-inf": -inf, "nan": nan}  # as text in JSON


def frame(of: Opened, what: str | None = None) -> "pd.DataFrame":
    """A table of an opened folder as a pandas data frame (`pip install 'novags[frames]'`).

    Args:
        of: What `novags.open` gave.
        what: Of a set or capture "views" (cameras and split). Of a run "scores" (one row for each held-out view,
            reference and score, with the standard error that the truth's noise leaves and the bias where they are
            known), "along" (the mean scores after fewer iterations) or "losses" (one row a logged step). Of a study
            "runs" (results.csv), "scores" (those of its finished runs, with the values of the axes before them) or
            "differences" (between methods, with errors). The first if not given.

    Raises:
        ValueError: If there is no such table, a run has not been scored, or a file is damaged.
        ModuleNotFoundError: Without pandas.
    """
    kinds = next(tables for kind, tables in TABLES.items() if isinstance(of, kind))
    name = next(iter(kinds)) if what is None else what
    if name not in kinds:
        raise ValueError(f"a {type(of).__name__} has no table {name!r}, it has: {', '.join(kinds)}")
    try:
        import pandas as pd
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("novags.frame makes data frames of pandas: pip install 'novags[frames]'") from error
    found, axes = kinds[name](of), getattr(of, "axes", ())
    if isinstance(found, pd.DataFrame):
        return found
    return pd.DataFrame([{column: value if column in axes else _number(value) for column, value in row.items()}
                         for row in found])  # fmt: skip


def _number(value: Any) -> Any:
    """A value, as a number where it is one that JSON has as text."""
    return NUMBERS.get(value, value) if isinstance(value, str) else value


def _views(of: MultiviewSet) -> Iterator[dict[str, Any]]:
    held = {*of.test_indices}
    for i, (name, viewmat, K) in enumerate(zip(of.names, of.rig.viewmats, of.rig.Ks, strict=True)):
        centre = -viewmat[:3, :3].T @ viewmat[:3, 3]
        lens = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
        yield {"view": name, "held_out": i in held, **dict(zip("xyz", centre, strict=True)), **lens,
               "width": of.rig.width, "height": of.rig.height}  # fmt: skip


def _scores(run: Run) -> Iterator[dict[str, Any]]:
    found = run.scores()
    if found is None:
        raise ValueError(f"{run.path} has not been scored: novags score {run.path}")
    for view, references in found["views"].items():
        for reference, scores in references.items():
            yield from ({"view": view, **row} for row in _long(reference, scores))
    for view, scores in ((found.get("geometry") or {}).get("views") or {}).items():
        yield from ({"view": view, **row} for row in _long("geometry", scores))


def _along(run: Run) -> Iterator[dict[str, Any]]:
    for at in (run.scores() or {}).get("along", ()):
        for reference, scores in at["mean"].items():
            yield from ({"iterations": at["iterations"], **row} for row in _long(reference, scores or {}))


def _long(reference: str, scores: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """One row a score, with its error and bias in columns."""
    for name, value in scores.items():
        beside = any(name.endswith(end) and name.removesuffix(end) in scores for end in (ERROR, BIAS))
        if value is not None and not isinstance(value, Mapping) and not beside:
            yield {"reference": reference, "score": name, "value": float(value), "error": scores.get(name + ERROR),
                   "bias": scores.get(name + BIAS)}  # fmt: skip


def _of_runs(study: StudyResults) -> Iterator[dict[str, Any]]:
    for row, run in study.runs():
        place = {"run": row["run"], **{name: row[name] for name in study.axes}}
        yield from ({**place, **score} for score in _scores(run))


def _differences(study: StudyResults) -> "pd.DataFrame":
    import pandas as pd

    with opened(study.path / DIFFERENCES) as file:
        return pd.read_csv(file, keep_default_na=False, na_values=[""])  # "None" is a value of an axis


TABLES: Mapping[type, Mapping[str, Callable[[Any], Any]]] = {
    MultiviewSet: {"views": _views},
    Capture: {"views": lambda capture: _views(capture.cameras)},
    Run: {"scores": _scores, "along": _along, "losses": Run.events},
    StudyResults: {"runs": lambda study: study.rows, "scores": _of_runs, "differences": _differences},
}
