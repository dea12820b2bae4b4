"""What a report is made of: a capture, the runs that were made from it, and their scores."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from novags.testbed.exposures import Exposures, exposures_of
from novags.testbed.folders.capture import Capture
from novags.testbed.folders.run import Run
from novags.testbed.folders.set import Source
from novags.testbed.report.rows import Row, main_row, rows_of


@dataclass(frozen=True)
class Material:
    """Everything a report is made of, read from the folders."""

    folder: Path
    experiment: dict[str, Any]  # {} for a single run
    runs: dict[str, Run]
    metrics: dict[str, Any]
    capture: Capture
    lit: Source

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
