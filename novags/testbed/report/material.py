"""What a page is made of, for one place or many: the rows of a table, the runs behind them, and the places with
pictures.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from os.path import relpath
from pathlib import Path
from typing import Any

import numpy as np

from novags.methods.memo import Memo
from novags.testbed.folders import capture as capture_folder
from novags.testbed.folders import shapes
from novags.testbed.folders.place import PLACE, place_of
from novags.testbed.folders.run import Run
from novags.testbed.ledger.contents import read_json
from novags.testbed.report.again import score_again
from novags.testbed.report.grid import CAPTURE, Line, lines_of
from novags.testbed.report.place import MAIN, Place
from novags.testbed.report.rows import Row, rows_of
from novags.testbed.stages.scores.comparing import enhancement_of, with_errors
from novags.testbed.study.light import METHOD
from novags.testbed.study.results import flat_scores
from sensor_model.files.door import resolved

HELD_OUT, TRAINING = 4, 2  # views shown of one place, at most: enough to judge, small enough to mail
VIEWS = 8  # of several captures together; each has one at least
PLURALS = {"method": "methods", "scene": "scenes", "seed": "seeds", "electrons": "light levels", "sensor": "cameras",
           "rig": "rigs", "photos": "sets of photographs", "level": "data sets"}  # fmt: skip
SET = "set.json"
COST = {"seconds": float, "peak_bytes": int}
MADE_SET: Any = {"stage?": {"name?": str, **COST, "inputs?": {"scene?": str}, "config?": {"scene?": str}},
                 "plan?": (shapes.PLAN, None)}  # fmt: skip
MADE_CAPTURE: Any = {"stage": COST, "set?": ({"path": PLACE}, None), "plan?": (shapes.PLAN, None), "kind?": str,
                     "signal_quantiles_e?": {"*": shapes.MEASURED}, "sensor_name?": (str, None)}  # fmt: skip


@dataclass(frozen=True)
class RunRecords:
    """A run, and the records of its inputs."""

    run: Run
    name: str  # what tells it from the others of the page
    capture: Path
    captured: dict[str, Any]  # its capture.json
    set: Path
    rendered: dict[str, Any]  # its set.json; {} where there is none


@dataclass(frozen=True)
class Material:
    """Everything a page is made of."""

    path: Path  # of the page
    rows: list[dict[str, Any]]  # one for each run, as in the table of a study
    axes: Mapping[str, Sequence[Any]]  # what the runs differ in, and the values
    looks: Mapping[str, Row]  # how runs, or the methods of a study, appear, by name
    made: Mapping[int, RunRecords]  # the runs on this machine, by number of their row
    places: dict[str, Callable[[], Place | None]]  # what opens each that has pictures; None: nothing is rendered
    one: Place | None = None  # where all runs are of one capture
    study: tuple[Path, Mapping[str, Any]] | None = None  # the folder of a study, and its study.json
    command: str | None = None  # what makes all of it again, where it was one command
    unseen: dict[str, str] = field(default_factory=dict)  # places without pictures, and why
    unavailable: Mapping[str, str] = field(default_factory=dict)  # scores that could not be computed, and why
    unregistered: Mapping[str, tuple[Sequence[str], int]] = field(default_factory=dict)  # without a camera; with one
    lost: int = 0  # finished runs that are not on this machine, or cannot be read
    other: tuple[int, ...] = ()  # rows with other scores than their runs have, by number

    @property
    def title(self) -> str:
        """The heading of the page."""
        if self.study:
            values = {name: list({str(row[name]): row[name] for row in self.rows}.values()) for name in self.axes}
            several = [
                f"{len(found)} {PLURALS.get(name, f'values of {name}')}{_light(found) if name == 'electrons' else ''}"
                for name, found in values.items() if len(found) > 1
            ]  # fmt: skip
            shared = [f"{said:g} {unit}" for key, unit in (("views", "views"), ("electrons", "electrons"))
                      if (said := self._same(key)) is not None]  # fmt: skip
            return f"{Path(str(self.study[1]['file'])).stem}: {', '.join([' × '.join(several) or '1 run', *shared])}"
        if self.one is None:
            return f"{len(self.rows)} runs of {len(self.places)} captures"
        if (told := self.one.capture.record.simulated) is None:
            return f"{self.one.scene}: photographs from the dark"
        return f"{self.one.scene} at {told.electrons:g} electrons per pixel"

    def _same(self, key: str) -> float | None:
        """A number of capture.json that all runs on this machine share."""
        found = {made.captured.get(key) for made in self.made.values()}
        one = found.pop() if len(found) == 1 else None
        return one if isinstance(one, (int, float)) else None

    @cached_property
    def lines(self) -> list[Line]:
        """The runs that differ in their seed alone, best first at each place."""
        enhancements = {number: enhancement_of(each.run.record) for number, each in self.made.items()}
        scores = {number: own for number, each in self.made.items() if (own := each.run.scores()) is not None}
        return lines_of(self.rows, self.axes, self.competes, enhancements, scores)

    @property
    def competes(self) -> dict[str, bool]:
        """Whether a method may be the best, by name."""
        return {name: look.competes for name, look in self.looks.items()}

    @property
    def varied(self) -> list[str]:
        """The axes but the method that have several values."""
        return [name for name in self.axes if name != METHOD and len({str(row[name]) for row in self.rows}) > 1]

    @cached_property
    def commands(self) -> dict[int, str | None]:
        """The commands that make each run again in the folder of the page; None where no command does."""
        return {number: score_again(each.run, self.path.parent, each.name) for number, each in self.made.items()}

    def of(self, line: Line) -> list[RunRecords]:
        """The runs of a line that are here."""
        return [self.made[int(row["run"])] for row in line.runs if int(row["run"]) in self.made]

    def called(self, made: RunRecords) -> str:
        """The name of runs together: of one place each has its name, of several a method is named once."""
        return made.name if self.one else made.run.name


def _light(levels: Sequence[Any]) -> str:
    """The electrons of several light levels, in brackets; of many the first and the last."""
    told = [f"{level:g}" for level in sorted(level for level in levels if isinstance(level, (int, float)))]
    return f" ({', '.join(told) if len(told) <= 4 else f'{told[0]} to {told[-1]}'} electrons)" if told else ""


def material_of(places: Sequence[Place], path: Path, command: str | None = None) -> Material:
    """What the page at `path` on these runs is made of."""
    named = dict(zip(titles(places, path.parent), places, strict=True))
    runs = {name: run for place in places for name, run in place.runs.items()}
    known = dict[Path, Any]()
    made = {number: made_of(run, name, known) for number, (name, run) in enumerate(runs.items(), 1)}
    one = _prepared(places[0], 1) if len(places) == 1 else None
    unavailable = {f"{name}: {what}" if name else what: why for name, place in named.items()
                   for what, why in place.metrics["unavailable"].items()}  # fmt: skip
    unregistered = {name: (missing, place.capture.record.views) for name, place in named.items()
                    if (missing := place.lit.views.unregistered)}  # fmt: skip
    return Material(
        path, _rows(named), {CAPTURE: list(named), METHOD: list(runs)}, one.rows if one else _by_method(runs), made,
        {name: (lambda: one) if one else partial(_prepared, place, len(places)) for name, place in named.items()},
        one, command=command, unavailable=unavailable, unregistered=unregistered,
    )  # fmt: skip


def titles(places: Sequence[Place], folder: Path) -> list[str]:
    """The title of each place, with the folder of its capture where others have the same title; "" of one alone."""
    if len(places) == 1:
        return [""]
    count = Counter(place.title for place in places)
    return [place.title if count[place.title] == 1
            else f"{place.title} ({relpath(resolved(place.capture.path), resolved(folder))})"
            for place in places]  # fmt: skip


def made_of(run: Run, name: str, known: dict[Path, Any]) -> RunRecords:
    """A run with the records of its capture and its set; `known` keeps the records that were read.

    Raises:
        ValueError: If one cannot be read.
    """
    capture = place_of(run.path, run.record["capture"])
    if (record := capture / capture_folder.RECORD) not in known:
        known[record] = read_json(record, MADE_CAPTURE)
    made = place_of(capture, (known[record].get("set") or {}).get("path", "."))
    if (rendered := made / SET) not in known:
        known[rendered] = read_json(rendered, MADE_SET) if rendered.is_file() else {}
    return RunRecords(run, name, capture, known[record], made, known[rendered])


def spread(indices: Sequence[int], count: int) -> list[int]:
    """At most `count` of them, evenly."""
    places = np.linspace(0, len(indices) - 1, min(count, len(indices)))
    return [indices[round(place)] for place in places]


def _prepared(place: Place, count: int) -> Place:
    """A place among `count` with the views that are shown of it."""
    cameras = place.capture.cameras
    if count == 1:
        return replace(place, views=[*spread(cameras.test_indices, HELD_OUT), *spread(cameras.train_indices, TRAINING)])
    # Of its own memory, so that data for the pictures of one capture go before the next.
    capture = replace(place.capture, memo=Memo())
    return replace(place, capture=capture, views=spread(cameras.test_indices, max(1, VIEWS // count)))


def _by_method(runs: Mapping[str, Run]) -> dict[str, Row]:
    """How runs of several captures appear: runs of one name alike."""
    first: dict[str, Run] = {}
    for run in runs.values():
        first.setdefault(run.name, run)
    rows = rows_of(first)
    return {**rows, **{name: replace(rows[run.name], name=name) for name, run in runs.items()}}


def _rows(places: Mapping[str, Place]) -> list[dict[str, Any]]:
    """The runs of places as rows of the table of a study."""
    found: list[dict[str, Any]] = []
    for title, place in places.items():
        columns = {**{f"over.{kind}": place.deltas(kind)[0] for kind in MAIN},
                   **{key: place.metrics[key] for key in ("recovered", "recovered_lit")}}  # fmt: skip
        for name in place.runs:
            own = with_errors({column: values[name] for column, values in columns.items() if name in values})
            row = {"run": len(found) + 1, CAPTURE: title, METHOD: name, "state": "done"}
            found.append({**flat_scores(place.metrics["methods"][name]), **own, **row})
    return found
