"""Explain: runs in, the ladder of their lost dB out. Every truth alone, on the same capture, paired by view and seed.

RUN/explain/
explain.json  explain.csv   the ladder
NAME/                       the run with this ingredient replaced by its truth, and its scores
more/                       the set and the capture with more views
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from novags.testbed import metrics
from novags.testbed.console.csv_text import as_csv
from novags.testbed.console.terminal import Console
from novags.testbed.folders.run import EXPLAINED, METRICS, open_run
from novags.testbed.ledger.contents import read_json, write_json
from novags.testbed.ledger.difference import differences, listed
from novags.testbed.ledger.dry import dry_run
from novags.testbed.metrics.differences import Estimate, Values, difference, estimate, paired
from novags.testbed.metrics.truth import ERROR
from novags.testbed.stages.command import run_command
from novags.testbed.stages.configs.command import CommandConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.stages.explaining.more import MORE, make_more
from novags.testbed.stages.explaining.swaps import SWAPS, Again, Case, NotSwapped
from novags.testbed.stages.reconstructing import reconstruct
from novags.testbed.stages.scores.comparing import said
from novags.testbed.stages.scores.scoring import score
from sensor_model.files.atomic import write_text
from sensor_model.files.lock import dry

RECORD, TABLE = "explain.json", "explain.csv"
SEEDS = ("seed", "drawn")  # of a run, of the noise, of a render
SHAPE: Any = {"run": str, "score": str, "value": (float, int, None), "first": str, "not_swapped": {"*": str},
              "steps": [{"swap": str, "truth": str, "won": float}]}  # fmt: skip


@dataclass(frozen=True)
class Ladder:
    """What each truth wins.

    Attributes:
        name: Of the runs.
        score: What is counted, in words.
        value: Of the runs as they are, dB.
        won: By each truth, the most first.
        not_swapped: Why another one could not be tried.
        level: Truths whose gain is not seen to be smaller than the most.
    """

    name: str
    score: str
    value: float
    won: dict[str, Estimate]
    not_swapped: dict[str, str] = field(default_factory=dict)
    level: tuple[str, ...] = ()

    @property
    def first(self) -> str:
        """The first cause, in a sentence."""
        best, gain = next(iter(self.won.items()), (None, None))
        if best is None or gain is None:
            return f"Nothing of {self.name} could be replaced by its truth."
        if gain.value <= 0:
            return f"No truth alone wins anything; the best is {said(gain)}, with {SWAPS[best].truth}."
        if gain.error is not None and not gain.seen:
            return f"Most may be lost to {best}, but {said(gain)}, with {SWAPS[best].truth}, is not seen to be a gain."
        others = f"; {' and '.join(self.level)} may be as much" if self.level else ""
        return f"Most is lost to {best}: with {SWAPS[best].truth} {self.name} has {said(gain)}{others}."

    def lines(self) -> list[str]:
        """For a terminal."""
        width = max(map(len, SWAPS))
        head = [f"{self.name}: {self.value:.2f} dB ({self.score}); each truth alone:"]
        rows = [f"  {name:<{width}}  {said(gain)}, {SWAPS[name].truth}" for name, gain in self.won.items()]
        return [*head, *rows, *(f"  {name:<{width}}  not replaced: {why}" for name, why in self.not_swapped.items()),
                self.first]  # fmt: skip

    def record(self) -> dict[str, Any]:
        """For explain.json."""
        steps = [{"swap": name, "truth": SWAPS[name].truth, "won": gain.value, f"won{ERROR}": gain.error,
                  "freedom": gain.freedom, "over": gain.where} for name, gain in self.won.items()]  # fmt: skip
        return {"run": self.name, "score": self.score, "value": self.value, "first": self.first, "steps": steps,
                "not_swapped": self.not_swapped}  # fmt: skip


Change = Again | Values | NotSwapped


def cases_of(paths: Sequence[Path], console: Console, commands: tuple[CommandConfig, ...] = ()) -> list[Case]:
    """The runs to explain, scored; `commands` are programs that one may be by.

    Raises:
        ValueError: If one cannot be read or scored, or they differ in more than their seeds.
    """
    found = []
    for path in paths:
        with dry_run(dry.get()):
            score(path, console)
        run = open_run(path)
        if (scores := run.scores()) is None:
            raise ValueError(f"{path} has not been scored: run novags score first")
        found.append(Case(run, *run.inputs(console), scores, commands))
    if len(names := sorted({case.run.name for case in found})) > 1:
        raise ValueError(f"runs that are explained together must be of one method, got {', '.join(names)}")
    for case in found[1:]:
        if apart := differences(_but_seeds(found[0]), _but_seeds(case)):
            raise ValueError(f"runs that are explained together must differ in their seeds alone, and of "
                             f"{case.run.path} {listed(apart)}: explain it by itself")  # fmt: skip
    if len({case.seed for case in found}) < len(found):
        raise ValueError("runs that are explained together must differ in their seeds: one at a time")
    return found


def _but_seeds(case: Case) -> dict[str, Any]:
    """The settings of a run, its capture and its set without their seeds; of a set that no stage made, its content."""
    made = case.source.views.meta.get("stage")
    stages = {"run": case.run.record["stage"], "capture": case.capture.record.stage, **({"set": made} if made else {})}
    settings = {what: {name: value for name, value in stage["config"].items() if name not in SEEDS}
                for what, stage in stages.items()}  # fmt: skip
    return {**settings, "set of": made.get("inputs", {}) if made else case.source.content}


def changes_of(case: Case, asked: Sequence[str]) -> dict[str, Change]:
    """What each swap would do with a run."""

    def change(name: str) -> Change:
        try:
            return SWAPS[name].change(case)
        except NotSwapped as why:
            return why

    return {name: change(name) for name in asked}


def forecast(cases: Sequence[Case], asked: Sequence[str]) -> dict[Path, float]:
    """The runs that are not there yet, each with its seconds, by the cost of the run that is explained."""
    found = dict[Path, float]()
    for case in cases:
        inputs = (case.capture.record.stage, case.source.views.meta.get("stage", {}))
        for name, change in changes_of(case, asked).items():
            folder = case.folder(name)
            if isinstance(change, Again) and not (folder / METRICS).exists():
                found[folder] = SWAPS[name].costs * float(case.run.record["stage"]["seconds"])
                if isinstance(change, ReconstructConfig) and change.more is not None:
                    found[folder] += MORE * sum(float(stage.get("seconds", 0)) for stage in inputs)
    return found


def made(cases: Sequence[Case]) -> list[Path]:
    """The files of each ladder."""
    return [case.run.path / EXPLAINED / name for case in cases for name in (RECORD, TABLE)]


def explain(cases: Sequence[Case], asked: Sequence[str], console: Console) -> Ladder:
    """Make the runs that are not there yet, and write the ladder of each run into its folder.

    Returns:
        The ladder of all of them.
    """
    gains = dict[str, dict[tuple[str, str, str], float]]()
    why, own = dict[str, str](), dict[tuple[str, str, str], float]()
    for case in cases:
        mine, lost = dict[str, Values](), dict[str, str]()
        for name, change in changes_of(case, asked).items():
            try:
                values = _values(case, name, change, console)
            except (NotSwapped, ValueError) as error:
                lost[name] = str(error)
                continue
            mine[name] = paired(values, case.values(case.scores, SWAPS[name].above))
            gains.setdefault(name, {}).update(mine[name])
        before = case.values(case.scores)
        ladder = _ladder(case, before, mine, lost)
        write_json(case.run.path / EXPLAINED / RECORD, ladder.record())
        write_text(case.run.path / EXPLAINED / TABLE, as_csv(ladder.record()["steps"]))
        why, own = why | lost, own | dict(before)
    return _ladder(cases[0], own, gains, why)


def _values(case: Case, name: str, change: Change, console: Console) -> Values:
    """The scores of a run with one truth."""
    if isinstance(change, NotSwapped):
        raise change
    if not isinstance(change, Again):
        return change
    folder = case.folder(name)
    if isinstance(change, CommandConfig):
        run_command(case.capture.path, folder, change, console, overwrite=True)
    else:
        if change.more is not None:
            make_more(case.capture, case.source, change.more.parent, console)
        reconstruct(case.capture.path, folder, change, console, overwrite=True)
    return case.values(score(folder, console)["methods"][case.run.name])


def _ladder(case: Case, own: Values, gains: Mapping[str, Values], why: dict[str, str]) -> Ladder:
    won = {name: found for name, values in gains.items() if (found := estimate(values)) is not None}
    won = dict(sorted(won.items(), key=lambda item: -item[1].value))
    best = next(iter(won), None)
    level = tuple(name for name in won if best is not None and name != best and won[name].value > 0
                  and (gap := difference(gains[best], gains[name])) is not None
                  and gap.error is not None and not gap.seen)  # fmt: skip
    kind, number = case.score
    whole = estimate(own)
    assert whole is not None
    named = metrics.METRICS[number].heading if number in metrics.METRICS else "PSNR"
    return Ladder(case.run.name, f"{named} of held-out views against {kind}", whole.value, won, why, level)


def explained(run: Path) -> dict[str, Any] | None:
    """The ladder in the folder of a run; None where there is none."""
    path = run / EXPLAINED / RECORD
    return dict(read_json(path, SHAPE)) if path.exists() else None
