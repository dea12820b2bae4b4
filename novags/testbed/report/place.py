"""One place: the runs of a capture, which alone have the same truth, with their scores."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from shlex import quote
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.folders import shapes
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.exposures import Exposures, exposures_of
from novags.testbed.folders.run import Run
from novags.testbed.folders.runs import EXPERIMENT, runs_in
from novags.testbed.folders.set import Source
from novags.testbed.ledger.contents import read_json
from novags.testbed.metrics.differences import Estimate
from novags.testbed.report.rows import Row, main_row, rows_of
from novags.testbed.stages.scores.comparing import deltas, enhancement_of, recovered_shares

MAIN = {"enhanced": "aligned_psnr", "lit": "tone_aligned_psnr"}  # the score of each reference that runs are compared by


@dataclass(frozen=True)
class Place:
    """The runs of one capture."""

    capture: Capture
    lit: Source  # the set it was made from
    runs: dict[str, Run]  # by the names that a page gives them
    metrics: dict[str, Any]  # their scores, see `merged`
    views: Sequence[int] = ()  # the views of which a page has pictures

    @property
    def title(self) -> str:
        """Scene, electrons and camera."""
        return title_of(self.capture, self.lit)

    @property
    def scene(self) -> str:
        """Name of the scene, or of the folder of photographs."""
        return scene_of(self.lit)

    @cached_property
    def rows(self) -> dict[str, Row]:
        """How each run appears."""
        return rows_of(self.runs)

    @cached_property
    def exposures(self) -> dict[str, Exposures]:
        """The exposures at which the runs in linear light are shown, by name."""
        found = {name: run for name, run in self.runs.items() if run.space == "linear"}
        return {name: exposures_of(run, self.capture, self.lit) for name, run in found.items()}

    @property
    def one_reference(self) -> bool:
        """Whether the noise-free references of all runs are enhanced by the same: their scores can be compared then."""
        return len({row.enhancement for row in self.rows.values()}) == 1

    @property
    def main(self) -> str:
        """The main run."""
        return main_row(self.rows.values())

    def bound(self, end: str) -> str | None:
        """The run at that end of the scale, if there is one."""
        return next((row.name for row in self.rows.values() if row.bound == end), None)

    def deltas(self, kind: str) -> tuple[dict[str, Estimate], str]:
        """The gain of each run over the floor, or over the first run, in the main score of a reference; and which of
        both.
        """
        methods = {name: run.method for name, run in self.runs.items()}
        return deltas(self.metrics["methods"], methods, kind, MAIN[kind], enhancements_of(self.runs))


def command_of(folder: Path) -> str | None:
    """The command that made an experiment; None of other folders."""
    path = folder / EXPERIMENT
    found: str | None = read_json(path, shapes.EXPERIMENT)["command"] if path.exists() else None
    return found


def places_in(folders: Sequence[Path], console: Console) -> list[Place]:
    """The scored runs of several folders, by the capture that they were made from, in order.

    Raises:
        ValueError: If a folder holds no run, or a run is not scored or no longer fits its capture.
    """
    return [Place(capture, lit, mine, merged(mine)) for capture, lit, mine in runs_by_capture(folders, console)]


def runs_by_capture(folders: Sequence[Path], console: Console) -> list[tuple[Capture, Source, dict[str, Run]]]:
    """The runs of several folders, scored or not, by the capture that they were made from, in order.

    Raises:
        ValueError: If a folder holds no run, or a run no longer fits its capture.
    """
    found: dict[str, tuple[Capture, Source, dict[str, Run]]] = {}
    for name, run in runs_in(folders).items():
        capture, lit = run.inputs(console)
        found.setdefault(capture.content, (capture, lit, {}))[2][name] = run
    return list(found.values())


def title_of(capture: Capture, lit: Source) -> str:
    """Scene, electrons and camera of a capture."""
    if (told := capture.record.simulated) is None:
        return f"{scene_of(lit)}, photographs from the dark"
    parts = [scene_of(lit), f"{told.electrons:g} electrons", capture.record.variety, capture.record.sensor_name]
    return ", ".join(part for part in parts if part)


def scene_of(lit: Source) -> str:
    """Name of the scene, or of the folder of photographs."""
    return str(lit.views.meta.get("scene") or lit.views.path.name)


def enhancements_of(runs: Mapping[str, Run]) -> dict[str, str]:
    """The enhancement of each run's noise-free reference, as text to compare."""
    return {name: enhancement_of(run.record) for name, run in runs.items()}


def merged(runs: Mapping[str, Run]) -> dict[str, Any]:
    """The scores of runs of one capture, with the share of what noise costs that each recovers.

    Raises:
        ValueError: If one of them is not scored.
    """
    scores, unavailable = dict[str, Any](), dict[str, str]()
    for name, run in runs.items():
        record = run.metrics()
        if record is None or run.name not in record["methods"]:
            raise ValueError(f"{run.path} is not scored: run novags score {quote(str(run.path))}")
        scores[name] = record["methods"][run.name]
        unavailable |= record["unavailable"]
    methods = {name: run.method for name, run in runs.items()}
    shares, why = recovered_shares(scores, methods, enhancements_of(runs))
    return {"methods": scores, **shares, "unavailable": unavailable | why}
