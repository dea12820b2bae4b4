"""Verify: some runs made again from their own records, stage by stage, and what differs.

OUT/
verify.json                        the stages that were made again, and their differences
NAME/set  NAME/capture  NAME/run   the stages of each run, each made from the inputs of the first time; of runs that
                                   share a set or a capture, that once
tables/NAME/                       the tables of each study, from the scores that all of its runs have

So a difference is of this stage alone, by another code, library or processor. Checksums of the inputs are compared with
their records before.
"""

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import Run
from novags.testbed.folders.runs import VERIFIED, runs_in
from novags.testbed.ledger.contents import write_json
from novags.testbed.ledger.difference import flat
from novags.testbed.stages.capturing import capture as take
from novags.testbed.stages.explaining.recorded import rendering_of, taking_of
from novags.testbed.stages.explaining.swaps import Case
from novags.testbed.stages.reconstructing import reconstruct
from novags.testbed.stages.rendering import render
from novags.testbed.stages.scores.scoring import score
from sensor_model.files.door import resolved
from simscenes.sets.names import safe_name

RECORD = VERIFIED
SHOWN = 3  # files that one line can hold
SCORES = ("mean", "geometry", "noise", "training_2d")  # parts of the scores of a run; its cost is another each time


@dataclass(frozen=True)
class Verified:
    """A stage of a run, made again.

    Attributes:
        run: Name of the run.
        stage: "set", "capture", "run" or "scores"; "all of it" where none could begin; of a study "tables".
        parts: How many files it has, or scores.
        differ: Names of files with another content, or of scores with another value.
        largest: Of scores in dB, the largest difference; None for files.
        why_not: Why it was not made again.
    """

    run: str
    stage: str
    parts: int = 0
    differ: tuple[str, ...] = ()
    largest: float | None = None
    why_not: str = ""

    @property
    def same(self) -> bool:
        """Whether it was made again without any difference."""
        return not self.why_not and not self.differ

    def line(self) -> str:
        """For a terminal."""
        if self.why_not:
            return f"{self.run}: {self.stage}: not made again: {self.why_not}"
        things = "scores" if self.stage == "scores" else "files"
        if not self.differ:
            return f"{self.run}: {self.stage}: all {self.parts} {things} are the same"
        more = len(self.differ) - SHOWN
        names = ", ".join([*self.differ[:SHOWN], *([f"{more} more"] if more > 0 else [])])
        most = "" if self.largest is None else f", by {self.largest:.3g} dB at most"
        return f"{self.run}: {self.stage}: {len(self.differ)} of {self.parts} {things} differ{most}: {names}"


def chosen_runs(folders: Sequence[Path], count: int, seed: int) -> dict[str, Run]:
    """So many runs of these folders, drawn by the seed, in the order in which they lie there; all if there are fewer.

    Raises:
        ValueError: If the folders hold no finished run.
    """
    every = runs_in(folders)
    drawn = set(random.Random(seed).sample(sorted(every), min(count, len(every))))
    return {name: run for name, run in every.items() if name in drawn}


def verify(runs: Mapping[str, Run], out: Path, console: Console, tables: Sequence[Verified] = ()) -> list[Verified]:
    """Make these runs again below `out`; writes `RECORD`, with the tables of their studies first.

    What cannot be made again is said, and does not cost the others: runs that are damaged, or whose inputs have changed
    since they were recorded; stages that need something which is not here.
    """
    made = dict[Path, Verified]()
    found = [
        *tables,
        *(part for name, run in runs.items() for part in _stages(name, run, out / safe_name(name), console, made)),
    ]
    write_json(out / RECORD, {"parts": [asdict(part) for part in found]})
    return found


def _stages(name: str, run: Run, folder: Path, console: Console, made: dict[Path, Verified]) -> Iterator[Verified]:
    try:
        scores, (capture, source) = run.scores(), run.inputs(console)
    except ValueError as why:
        yield Verified(name, "all of it", why_not=str(why))
        return
    case = Case(run, capture, source, scores or {})

    def again(stage: str, before: Mapping[str, Any], make: Callable[[], Mapping[str, Any]]) -> Verified:
        try:
            new, old = make()["stage"]["files"], before["files"]
        except ValueError as why:
            return Verified(name, stage, why_not=str(why))
        differ = sorted(each for each in {*old, *new} if old.get(each) != new.get(each))
        return Verified(name, stage, len({*old, *new}), tuple(differ))

    if (place := resolved(source.views.path)) not in made:
        made[place] = again("set", source.views.meta.get("stage", {}), lambda: render(
            folder / "set", rendering_of(source), console, overwrite=True))  # fmt: skip
    yield replace(made[place], run=name)
    if (place := resolved(capture.path)) not in made:
        made[place] = again("capture", capture.record.stage, lambda: take(
            source.views.path, folder / "capture", taking_of(capture), console, overwrite=True))  # fmt: skip
    yield replace(made[place], run=name)
    fit = again("run", run.record["stage"], lambda: reconstruct(
        capture.path, folder / "run", case.config, console, overwrite=True))  # fmt: skip
    yield fit
    if fit.why_not or scores is None:
        yield Verified(name, "scores", why_not=fit.why_not or "the run has none")
    else:
        yield _compared(name, scores, score(folder / "run", console)["methods"][run.name])


def _compared(name: str, before: Mapping[str, Any], after: Mapping[str, Any]) -> Verified:
    """The scores of both: means over views, of depth and noise too."""
    old, new = (
        {key.removeprefix("mean."): value for key, value in flat({part: scores.get(part) for part in SCORES}).items()
         if isinstance(value, float) and not key.startswith("geometry.views.")} for scores in (before, after)
    )  # fmt: skip
    differ = {key for key in {*old, *new} if old.get(key) != new.get(key)}
    decibels = [abs(old[key] - new[key]) for key in differ & old.keys() & new.keys() if key.endswith("psnr")]
    return Verified(name, "scores", len({*old, *new}), tuple(sorted(differ)), max(decibels, default=0.0))
