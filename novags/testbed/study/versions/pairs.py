"""The captures of a comparison, and its fits: of each pair one side after the other, so that other load on the machine
meets both alike.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders import capture as captures
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.run import RECORD, Run, open_run
from novags.testbed.study.cells.grid import study_of
from novags.testbed.study.conduct import conduct
from novags.testbed.study.engines.choice import OneMachine
from novags.testbed.study.plan import StudyPlan, plan_of
from novags.testbed.study.versions.sides import Side
from sensor_model.files.door import resolved

SCENES = ("tabletop:3", "cornell", "busts", "bookshop")
SMALL = {"width": 64, "height": 64, "views": 24}  # of the captures that are made
ITERATIONS, POINTS = 800, 4000  # of fits of these


@dataclass(frozen=True)
class FittedCase:
    """A capture, and the seed of the fits of it."""

    path: Path
    scene: str
    noise: str  # the seed of its noise; "" of photographs
    seed: int

    @property
    def name(self) -> str:
        """Of folders of its fits."""
        return f"{self.path.name if self.path.name != 'capture' else self.path.parent.name}-s{self.seed}"


@dataclass(frozen=True)
class Fit:
    """A scored run of one side."""

    run: Run
    scores: dict[str, Any]
    cpu_seconds: float | None


@dataclass(frozen=True)
class Pair:
    """The same fit by both sides."""

    case: FittedCase
    method: str  # as the comparison calls it
    base: Fit
    changed: Fit

    @property
    def same(self) -> bool:
        """Whether both show the same held-out views, bit for bit."""
        one, other = ({name: found for name, found in fit.run.record["stage"]["files"].items()
                       if name.startswith(("exr/", "renders/"))} for fit in (self.base, self.changed))  # fmt: skip
        return one == other


def made(scenes: Sequence[str], seeds: Sequence[int], preset: str, store: Path, console: Console) -> StudyPlan:
    """The plan of small captures of scenes, one of each seed."""
    table = {"preset": preset, "grid": {"scene": list(scenes), "seed": list(seeds)}, "override": dict(SMALL)}
    return plan_of(study_of(Path("compare"), table, "capture"), store, console)


def make(plan: StudyPlan, out: Path, store: Path, console: Console) -> list[FittedCase]:
    """Make these captures where they are not there yet; each is fitted with the seed of its noise.

    Raises:
        ValueError: If one cannot be made.
    """
    rows = conduct(plan, out, store, console, OneMachine.shared(len(plan.runs), None), retry_failed=True)
    if failed := next((row for row in rows if row["state"] != "done"), None):
        raise ValueError(f"no capture of {failed['scene']}: {failed['reason']}")
    return [FittedCase(plan.tasks[key].folder(store), str(cell.values["scene"]), str(cell.values["seed"]),
                 int(cell.values["seed"])) for cell, key in plan.runs]  # fmt: skip


def given(folders: Sequence[Path], seeds: Sequence[int], console: Console) -> list[FittedCase]:
    """The captures in folders of captures, of runs, and of experiments, each to be fitted with every seed.

    Raises:
        ValueError: If a folder is none of them, or two captures would lie in one place.
    """
    found = dict[Path, list[FittedCase]]()
    scenes = dict[str, str]()  # by the content of the set: captures of one set are of one scene
    for folder in folders:
        place = next((place for place in (folder, folder / "capture") if (place / captures.RECORD).exists()), None)
        if place is None and not (folder / RECORD).exists():
            raise ValueError(f"{folder} is no folder of a capture, a run or an experiment, because it has neither "
                             f"{captures.RECORD} nor {RECORD}: name one, or leave --captures out")  # fmt: skip
        capture = open_capture(place or open_run(folder).capture().path)
        path, told = resolved(capture.path), capture.record.simulated
        scene = scenes.setdefault(capture.source(console).content, FittedCase(path, "", "", 0).name.removesuffix("-s0"))
        found[path] = [FittedCase(path, scene, "" if told is None else str(told.noise_seed), seed) for seed in seeds]
    cases = [case for several in found.values() for case in several]
    names = [case.name for case in cases]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ValueError(f"two captures are called {twice.rpartition('-s')[0]}: rename one, or compare on each alone")
    return cases


def fit_pairs(
    sides: tuple[Side, Side],
    cases: Sequence[FittedCase],
    words: Mapping[str, Sequence[str]],
    out: Path,
    console: Console,
) -> list[Pair]:
    """Make and score all fits that are not there yet.

    Args:
        sides: Base and changed.
        cases: What is fitted.
        words: Of `novags reconstruct`, by method.
        out: The folder of the comparison.
        console: Where progress goes.

    Raises:
        ValueError: If a fit fails.
    """
    asked = [(case, method) for case in cases for method in words if sides[0].method in (None, method)]
    found = []
    with console.progress("compare") as progress:
        for k, (case, method) in enumerate(asked):
            fits = dict[str, Fit]()
            for side in sides if k % 2 == 0 else sides[::-1]:
                name = side.method or method
                folder = out / side.role / f"{case.name}-{name}"
                line = [str(case.path.absolute()), "--seed", str(case.seed), "--method", name, *words[name]]
                cpu = side.fit(line, folder, out / "logs" / f"{side.role}-{folder.name}.log")
                scores = stages.score(folder, Console(quiet=True))["methods"]
                (own,) = scores.values()
                fits[side.role] = Fit(open_run(folder), dict(own), cpu)
                progress(2 * k + len(fits), 2 * len(asked), f"{case.name}-{name} by {side.role}")
            found.append(Pair(case, method, **fits))
    return found
