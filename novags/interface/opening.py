"""Finished folders by what they hold: sets, captures, runs and studies."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar, overload

from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import RECORD as CAPTURE
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.exchanged import refuse_exchanged
from novags.testbed.folders.run import RECORD as RUN
from novags.testbed.folders.run import Run, open_run
from novags.testbed.folders.runs import ROWS, TABLE
from novags.testbed.folders.set import open_source
from novags.testbed.ledger.contents import read_json
from sensor_model.files.door import enter
from simscenes.sets.multiview import MultiviewSet


@dataclass(frozen=True)
class StudyResults:
    """The tables of a study, or of the experiment of `novags run`.

    Attributes:
        path: Its folder.
        axes: The values of each axis of its grid.
        rows: One mapping a run: its values of the axes, state, folder and scores, as in results.json.
    """

    path: Path
    axes: Mapping[str, list[Any]]
    rows: tuple[Mapping[str, Any], ...] = field(repr=False)

    def runs(self, **values: Any) -> Iterator[tuple[Mapping[str, Any], Run]]:
        """Its finished runs, each with its row, in the order of the table.

        Args:
            values: Of axes, by name: only runs that have all of them.

        Raises:
            ValueError: If there is no such axis, or a run is damaged.
        """
        if unknown := [name for name in values if name not in self.axes]:
            raise ValueError(f"{self.path} has no axis {', '.join(unknown)}; its axes: {', '.join(self.axes)}")
        if "method" not in self.axes:
            raise ValueError(f"{self.path} has no axis method: its rows are no runs; see `rows`")
        for row in self.rows:
            if row["state"] == "done" and all(row[name] == value for name, value in values.items()):
                yield row, _run(self.path / row["folder"])


Opened = MultiviewSet | Capture | Run | StudyResults
Kind = TypeVar("Kind", MultiviewSet, Capture, Run, StudyResults)


@overload
def open(folder: str | os.PathLike[str], kind: type[Kind]) -> Kind: ...


@overload
def open(folder: str | os.PathLike[str], kind: None = None) -> Opened: ...


def open(folder: str | os.PathLike[str], kind: type[Any] | None = None) -> Any:
    """Open a finished folder; its pictures are read when they are asked for.

    Args:
        folder: Of a set (any that `novags run --scene` takes), a capture, a run, a study or an experiment.
        kind: What it has to be, `novags.Run` say, which also tells type checkers.

    Returns:
        A `MultiviewSet`, `Capture`, `Run` or `StudyResults`.

    Raises:
        ValueError: If the folder holds none, is unfinished, holds another kind, or its files are not as the stage wrote
            them.
    """
    path = Path(folder)
    if not path.is_dir():
        raise ValueError(f"no such folder: {path}")
    enter(path)
    found = _opened(path)
    if kind is not None and not isinstance(found, kind):
        raise ValueError(f"{path} is a {type(found).__name__}, not a {kind.__name__}")
    return found


def _opened(path: Path) -> Opened:
    if (path / RUN).is_file():
        return _run(path)
    if (path / CAPTURE).is_file():
        return open_capture(path)
    if (path / TABLE).is_file() and "axes" in read_json(path / TABLE):
        return results_of(path)
    try:
        return open_source(path, Console()).views
    except ValueError as error:
        raise ValueError(f"{path} is neither a run, a capture nor a study, and no set either: {error}") from error


def results_of(path: Path) -> StudyResults:
    """The tables of a study.

    Raises:
        ValueError: If they are missing or damaged.
    """
    table = read_json(path / TABLE, ROWS)
    return StudyResults(path, table["axes"], tuple(table["rows"]))


def _run(path: Path) -> Run:
    """A run whose files are as its stage wrote them."""
    found = open_run(path)
    refuse_exchanged(path)
    return found
