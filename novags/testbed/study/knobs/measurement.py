"""One measurement as a stage: the time and the error on this machine at one setting of a knob with one seed."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from novags.testbed.console.provenance import environment
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.ledger.code import Code, code_of
from novags.testbed.ledger.contents import jsonable, read_json
from novags.testbed.ledger.stage import run_stage
from novags.testbed.study.knobs.knob import Knob, Reading, Setting, Subject
from novags.testbed.study.knobs.subjects import Sizes, subject_of

MEASURED = "measured.json"
SHAPE = {"seconds": float, "cpu_seconds": float, "error": float, "parts": {"*": float}}


@dataclass(frozen=True)
class Measurement:
    """One thing to measure: a setting of a knob of a subject with a seed."""

    of: str  # name of the subject
    sizes: Sizes
    name: str  # of the knob
    setting: Setting
    seed: int

    @property
    def subject(self) -> Subject:
        """Its subject."""
        return subject_of(self.of, self.sizes)

    @property
    def knob(self) -> Knob:
        """Its knob."""
        return self.subject.knob(self.name)

    @property
    def code(self) -> Code:
        """What measures it."""
        return code_of(*self.subject.modules)  # the rows of other subjects change nothing

    def resolved(self) -> dict[str, Any]:
        """Everything a measurement depends on, the machine included."""
        name, setting = self.knob.called(self.setting)
        found = {"subject": self.of, "workload": self.subject.workload, "knob": name, "setting": setting,
                 "seed": self.seed, **environment()}  # fmt: skip
        return dict(jsonable(found))


def measure(out: Path, config: Measurement, captured: Path | None, console: Console) -> dict[str, Any]:
    """Make a measurement in `out`; returns its record.

    Args:
        out: Its folder.
        config: The thing to measure.
        captured: The capture of the seed, of a subject that is measured on one.
        console: Where progress goes.
    """
    return run_stage(
        f"measure {config.of}",
        out,
        MEASURED,
        code=config.code,
        inputs=lambda: {} if captured is None else {"capture": open_capture(captured).digest()},
        config=config.resolved(),
        owns=(MEASURED,),
        prepare=lambda: None,
        work=lambda _: jsonable(asdict(config.knob.measure(config.setting, config.seed, captured))),
        console=console,
        overwrite=True,
    )


def read_measured(folder: Path) -> Reading:
    """The measurement in a folder.

    Raises:
        ValueError: If its record is damaged.
    """
    record: Mapping[str, Any] = read_json(folder / MEASURED, SHAPE)
    try:
        return Reading(**{name: record[name] for name in SHAPE})
    except ValueError as error:
        raise ValueError(f"{folder / MEASURED}: {error}; remove it to measure again") from error
