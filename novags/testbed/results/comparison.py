"""Scored runs side by side: those of one capture form a group, since only they have the same truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from shlex import quote
from typing import Any

from novags.testbed.console import Console
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.experiment import gather
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.stages.scoring import deltas, merge

MAIN = {"enhanced": "aligned_psnr", "lit": "tone_aligned_psnr"}  # the score of each reference that runs are compared by


@dataclass(frozen=True)
class Group:
    """The runs of one capture.

    Attributes:
        capture: The capture.
        lit: The set it was made from.
        runs: By name.
        metrics: Theirs, merged: as metrics.json of an experiment.
    """

    capture: Capture
    lit: Source
    runs: dict[str, Run]
    metrics: dict[str, Any]

    @property
    def title(self) -> str:
        """Scene, electrons and camera."""
        return title_of(self.capture, self.lit)

    def deltas(self, kind: str) -> tuple[dict[str, float], str]:
        """What each run has over the floor, or the first run, in the main score of a reference; and what that is."""
        return deltas_of(self.metrics, {name: run.method for name, run in self.runs.items()}, kind)


def deltas_of(metrics: Mapping[str, Any], methods: dict[str, str], kind: str) -> tuple[dict[str, float], str]:
    """As `deltas`, in the main score of a reference."""
    return deltas(metrics["methods"], methods, kind, MAIN[kind])


def groups_of(folders: Sequence[Path], console: Console) -> list[Group]:
    """The scored runs of several folders, by the capture that they were made from, in order.

    Raises:
        ValueError: If a folder holds no run, or a run is not scored or no longer fits its capture.
    """
    return [Group(capture, lit, mine, merged(mine)) for capture, lit, mine in runs_by_capture(folders, console)]


def runs_by_capture(folders: Sequence[Path], console: Console) -> list[tuple[Capture, Source, dict[str, Run]]]:
    """The runs of several folders, scored or not, by the capture that they were made from, in order.

    Raises:
        ValueError: If a folder holds no run, or a run no longer fits its capture.
    """
    found: dict[str, tuple[Capture, Source, dict[str, Run]]] = {}
    for name, run in gather(folders).items():
        capture, lit = run.inputs(console)
        found.setdefault(capture.content, (capture, lit, {}))[2][name] = run
    return list(found.values())


def title_of(capture: Capture, lit: Source) -> str:
    """Scene, electrons and camera of a capture."""
    scene = lit.views.meta.get("scene") or lit.views.path.name
    if (told := capture.record.simulated) is None:
        return f"{scene}, photographs from the dark"
    return f"{scene}, {told.electrons:g} electrons, {capture.record.sensor_name}"


def merged(runs: Mapping[str, Run]) -> dict[str, Any]:
    """The scores of runs of one capture, with the share of what noise costs that each recovers.

    Raises:
        ValueError: If one of them is not scored.
    """
    metrics = {}
    for name, run in runs.items():
        scores = run.scores()
        if scores is None:
            raise ValueError(f"{run.path} is not scored: run novags score {quote(str(run.path))}")
        metrics[name] = {"methods": {name: scores}, "unavailable": {}}
    return merge(metrics, {name: run.method for name, run in runs.items()})
