"""The tables of a study: one row a run, in results.csv and results.json; and differences.csv."""

import os
from collections.abc import Mapping
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from novags.testbed.console.csv_text import as_csv
from novags.testbed.folders import shapes
from novags.testbed.folders.run import METRICS, RECORD, open_run
from novags.testbed.folders.runs import ROWS, TABLE
from novags.testbed.ledger.contents import checksum, read_json, write_json
from novags.testbed.ledger.store import read_seal
from novags.testbed.stages.explaining.verifying import Verified
from novags.testbed.stages.scores.comparing import enhancement_of, recovered_shares, with_errors
from novags.testbed.stages.scores.lengths import length_columns
from novags.testbed.study.differences import DIFFERENCES, Finished, write_differences
from novags.testbed.study.entry import Task
from novags.testbed.study.knobs.measurement import read_measured
from novags.testbed.study.light import METHOD
from novags.testbed.study.plan import StudyPlan
from sensor_model.files.atomic import write_text

CSV = "results.csv"
# Beginnings of the columns that differ from one time to the next.
COSTS = ("seconds.", "frames_per_second.", "peak_bytes")


@dataclass(frozen=True)
class State:
    """Where a run is: "done", "failed", "skipped" (a task it needs has failed) or "waiting"."""

    name: str = "waiting"
    reason: str | None = None
    stage: str | None = None
    log: str | None = None  # relative to the study


@dataclass
class StudyTable:
    """The rows of a study.

    Attributes:
        plan: The runs of the study.
        out: Folder of the study.
        store: The store.
        url: Where the store is, if `store` holds only this machine's part of it.
        kept: Rows of finished runs that an earlier start wrote, by key; they stand until the run is looked at again.
    """

    plan: StudyPlan
    out: Path
    store: Path
    url: str | None = None
    kept: Mapping[str, dict[str, Any]] = field(default_factory=dict)
    _scores: dict[str, dict[str, Any]] = field(default_factory=dict)  # columns of finished runs, by key: made once
    _runs: dict[str, dict[str, Any]] = field(default_factory=dict)  # and what they are made of

    def rows(self, states: Mapping[str, State]) -> list[dict[str, Any]]:
        """One row a run, in the order of the file.

        Args:
            states: Of the runs, by key; missing ones wait, or keep their earlier state.
        """
        found = []
        shares = self._recovered(states)
        for number, (cell, key) in enumerate(self.plan.runs, 1):
            if key not in states and key in self.kept:
                found.append({**self.kept[key], "run": number, **cell.values})
                continue
            state = states.get(key, State())
            row = {
                "run": number, **cell.values, "state": state.name, "reason": state.reason, "stage": state.stage,
                "log": state.log, "folder": place_of(self.plan.tasks[key], self.out, self.store, self.url),
            }  # fmt: skip
            scores = self._scores_of(key) if state.name == "done" else {}
            found.append({**row, **shares.get(key, {}), **scores})
        return found

    def write(self, states: Mapping[str, State]) -> list[dict[str, Any]]:
        """Write both tables; returns the rows."""
        rows = self.rows(states)
        _write(self.out, self.plan.study.axes, rows)
        if self.plan.study.ends == "run":
            write_differences(self.out, self.plan.study.axes, self._finished(states))
        return rows

    def _finished(self, states: Mapping[str, State]) -> list[Finished]:
        """The finished runs of which the scores are on this machine."""
        found = []
        for cell, key in self.plan.runs:
            task = self.plan.tasks[key]
            folder = task.folder(self.store)
            looked_at = states.get(key, State()).name == "done"
            if (looked_at or (key in self.kept and key not in states)) and (folder / METRICS).is_file():
                # A run of an earlier start may turn out to be damaged: nothing is kept before it is looked at.
                with nullcontext() if looked_at else suppress(ValueError):
                    scores = self._whole(key) if looked_at else read_scores(folder)
                    found.append(Finished(cell.values, task.config.variant.method, scores, _enhancement(folder)))
        return found

    def _scores_of(self, key: str) -> dict[str, Any]:
        if key not in self._scores:
            read = {"run": self._method, "capture": self._costs, "measurement": self._measured}
            self._scores[key] = read[self.plan.study.ends](key)
        return self._scores[key]

    def _measured(self, key: str) -> dict[str, Any]:
        return dict(_flat(asdict(read_measured(self.plan.tasks[key].folder(self.store))), ""))

    def _costs(self, key: str) -> dict[str, Any]:
        """Costs of a capture, which has no scores."""
        seal = read_seal(self.plan.tasks[key].folder(self.store))
        assert seal is not None  # it is done
        return {**dict(_flat({"seconds": seal.cost["seconds"]}, "")), "peak_bytes": seal.cost["peak_bytes"]}

    def _method(self, key: str) -> dict[str, Any]:
        return flat_scores(self._whole(key))

    def _whole(self, key: str) -> dict[str, Any]:
        """All scores of a finished run, view by view."""
        if key not in self._runs:
            self._runs[key] = read_scores(self.plan.tasks[key].folder(self.store))
        return self._runs[key]

    def _recovered(self, states: Mapping[str, State]) -> dict[str, dict[str, float | None]]:
        """The recovered shares of every run whose floor and ceiling are in the study too, at the same values."""
        groups: dict[tuple[Any, ...], dict[str, str]] = {}
        for cell, key in self.plan.runs:
            if self.plan.study.ends == "run" and states.get(key, State()).name == "done":
                place = tuple(value for name, value in cell.values.items() if name != "method")
                groups.setdefault(place, {})[cell.preset.methods[0]] = key
        found: dict[str, dict[str, float | None]] = {}
        for keys in groups.values():
            if len(keys) > 1:
                methods = {name: self.plan.tasks[key].config.variant.method for name, key in keys.items()}
                scores = {name: self._whole(key) for name, key in keys.items()}
                tones = {name: _enhancement(self.plan.tasks[key].folder(self.store)) for name, key in keys.items()}
                shares = _shares(scores, methods, tones)
                found |= {keys[name]: own for name, own in shares.items()}
        return found


def read_scores(folder: Path) -> dict[str, Any]:
    """All scores of the run in a folder.

    Raises:
        ValueError: If they cannot be read.
    """
    (scores,) = read_json(folder / METRICS, shapes.METRICS)["methods"].values()
    return dict(scores)


def rescored(out: Path, into: Path | None = None) -> None:
    """Write the tables of a study again, with the scores that its runs have now.

    Args:
        out: Its folder.
        into: Where they go; into its folder if not given.

    Raises:
        ValueError: If the tables or the scores of a run cannot be read.
    """
    table = read_json(out / TABLE, ROWS)
    kept = ("run", *table["axes"], "state", "reason", "stage", "log", "folder")
    rows, finished = list[dict[str, Any]](), list[Finished]()
    places = dict[tuple[str, ...], dict[str, tuple[dict[str, Any], Finished]]]()
    for row in table["rows"]:
        rows.append({name: row.get(name) for name in kept})
        run = open_run(out / row["folder"]) if row["state"] == "done" else None
        if run is not None and (own := run.scores()) is not None:
            values = {name: row.get(name) for name in table["axes"]}
            finished.append(Finished(values, run.method, own, enhancement_of(run.record)))
            place = tuple(str(value) for name, value in values.items() if name != METHOD)
            places.setdefault(place, {})[row[METHOD]] = rows[-1], finished[-1]
    for members in places.values():
        several = {name: one for name, (_, one) in members.items()}
        shares = _shares({name: one.scores for name, one in several.items()},
                         {name: one.method for name, one in several.items()},
                         {name: one.enhancement for name, one in several.items()})  # fmt: skip
        for name, (row, one) in members.items():
            row.update({**shares.get(name, {}), **flat_scores(one.scores)})
    _write(into or out, table["axes"], rows)
    write_differences(into or out, table["axes"], finished)


def tables_again(out: Path, into: Path) -> Verified:
    """Whether the tables of a study are what the scores of its runs make.

    Args:
        out: Its folder.
        into: Where they are made again.

    Raises:
        ValueError: If the tables or the scores of a run cannot be read.
    """
    rescored(out, into)
    there = [name for name in (TABLE, CSV, DIFFERENCES) if (out / name).exists()]
    differ = tuple(name for name in there if checksum(out / name) != checksum(into / name))
    return Verified(out.name, "tables", len(there), differ)


def _write(out: Path, axes: Mapping[str, Any], rows: list[dict[str, Any]]) -> None:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    columns.sort(key=lambda name: name.startswith(COSTS))  # stable: costs go last
    write_text(out / CSV, as_csv(rows, columns))
    write_json(out / TABLE, {"axes": axes, "columns": columns, "rows": rows})


def _enhancement(folder: Path) -> str:
    """The enhancement of the noise-free reference of the run in a folder, as text to compare."""
    return enhancement_of(read_json(folder / RECORD) if (folder / RECORD).is_file() else {})


def _shares(
    scores: Mapping[str, Mapping[str, Any]], methods: Mapping[str, str], enhancements: Mapping[str, str]
) -> dict[str, dict[str, float | None]]:
    """The recovered shares of runs of one place with their errors, by run, from their scores."""
    found = dict[str, dict[str, Any]]()
    for column, values in recovered_shares(scores, methods, enhancements)[0].items():
        for run, share in values.items():
            found.setdefault(run, {})[column] = share
    return {run: with_errors(own) for run, own in found.items()}


def rows_before(
    plan: StudyPlan, out: Path, store: Path, url: str | None, sealed: set[str]
) -> dict[str, dict[str, Any]]:
    """Rows of runs of this plan that were done when the tables in `out` were last written, by key.

    Args:
        plan: The study.
        out: Its folder.
        store: The store.
        url: Of the store, see `StudyTable`.
        sealed: Keys of the entries that are there.
    """
    try:
        rows = read_json(out / TABLE, ROWS)["rows"] if (out / TABLE).exists() else []
    except ValueError:  # damaged, which `refuse_other` has said unless it may be overwritten: all are looked at again
        return {}
    done = {row["folder"]: row for row in rows if row["state"] == "done"}
    places = {key: place_of(plan.tasks[key], out, store, url) for _, key in plan.runs if key in sealed}
    return {key: done[place] for key, place in places.items() if place in done}


def place_of(task: Task, out: Path, store: Path, url: str | None) -> str:
    """Where an entry is: relative to the study, or a URL."""
    if url is not None:
        return f"{url}/{task.kind}/{task.name}"
    return Path(os.path.relpath(task.folder(store), out)).as_posix()


def flat_scores(method: Mapping[str, Any]) -> dict[str, Any]:
    """The scores and costs of a run as columns: `lit.psnr`, `geometry.abs_rel`, `seconds.render`, ..."""
    cameras = method.get("cameras") or {}
    geometry = {name: value for name, value in (method.get("geometry") or {}).items() if name != "views"}
    chosen = {
        **method["mean"], "geometry": geometry, "noise": method.get("noise") or {},
        "cameras": {name: cameras.get(name) for name in ("registered_share", "mean_rotation_deg",
                                                         "mean_centre_error") if name in cameras},
        "seconds": method["seconds"], "frames_per_second": method.get("frames_per_second") or {},
    }  # fmt: skip
    return {**dict(_flat(chosen, "")), **length_columns(method), "peak_bytes": method["peak_bytes"]}


def _flat(value: Any, prefix: str) -> list[tuple[str, Any]]:
    if not isinstance(value, Mapping):
        return [(prefix, value)]
    return [pair for name, part in value.items() for pair in _flat(part, f"{prefix}.{name}" if prefix else name)]


def counted(rows: list[dict[str, Any]]) -> dict[str, int]:
    """How many runs are in each state."""
    states = [row["state"] for row in rows]
    return {state: states.count(state) for state in ("done", "failed", "skipped", "waiting") if state in states}
