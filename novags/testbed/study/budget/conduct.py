"""Run an experiment in a given time: try it on a small scale, choose settings, say so, run, and say what came of it."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from novags.cameras.sources.known import KnownConfig
from novags.testbed.console.terminal import Console
from novags.testbed.folders.experiment import EXPERIMENT
from novags.testbed.ledger.contents import digest, jsonable, read_json, write_json
from novags.testbed.ledger.dry import NOT_DONE, dry_run, planned
from novags.testbed.study import place as experiment
from novags.testbed.study.budget import said
from novags.testbed.study.budget.choice import Choice, Option, choice_of, choose, fastest
from novags.testbed.study.budget.known import Known, known, open_options
from novags.testbed.study.budget.trial import Forecast, OutOfTime, forecast
from novags.testbed.study.cells.presets import Preset
from novags.testbed.study.knobs.options import OF_A_RENDER, WORDS, turned, values
from sensor_model.files.lock import locked
from sensor_model.files.reading import brief

RECORD = "budget.json"
RESERVE = 0.1  # of the budget: by how much a trial may underestimate
TRIAL = 0.5  # of the budget: a trial that takes longer shows that the budget is too small
FORETOLD = {"seconds": float, "lost": float, "sd": float}
SHAPE = {
    "request": str, "budget": float, "trial": float, "curves": str, "shares": {"*": float}, "foretold": FORETOLD,
    "preset_seconds": float, "seconds?": float, "spent?": float,
}  # fmt: skip
State = dict[str, Any]


@dataclass(frozen=True)
class Request:
    """What is asked for.

    Attributes:
        preset: The experiment that the budget is compared with.
        budget: Seconds.
        decided: Options that the user has set: the budget leaves them alone.
        curves: Folder of curves; None: see `known`.
    """

    preset: Preset
    budget: float
    decided: frozenset[str] = frozenset()
    curves: Path | None = None

    def __post_init__(self) -> None:
        if self.preset.photos is not None:
            raise ValueError("a budget cannot predict how long the cameras of bare photographs take: novags poses "
                             "first, then --scene SET with the budget")  # fmt: skip
        if not isinstance(self.preset.cameras, KnownConfig):
            raise ValueError("a budget cannot predict how long finding cameras takes: leave out --cameras or --budget")

    def identity(self) -> str:
        """Hash of all that the choice depends on, apart from machine and curves."""
        return digest({"preset": jsonable(asdict(self.preset)), "budget": self.budget, "decided": sorted(self.decided)})


@dataclass(frozen=True)
class Plan:
    """A choice, and what it was made of.

    Attributes:
        tried: What the trial predicts.
        options: What there is to choose.
        choice: What was chosen.
        facts: Where the curves come from.
        spent: What trial and choice took, s.
    """

    tried: Forecast
    options: dict[str, list[Option]]
    choice: Choice
    facts: Known
    spent: float


def run(
    request: Request, out: Path, console: Console, *, report: Callable[[Path, Console], Path] | None = None,
    command: str | None = None, overwrite: bool = False,
) -> Path:  # fmt: skip
    """Run the experiment within its budget; returns the path of the report.

    Args:
        request: What is asked for.
        out: The experiment folder; `budget.json` in it has what was chosen, predicted and taken.
        console: Where progress goes.
        report: Writes a report on the folder.
        command: The command line, for the record.
        overwrite: Replace finished results of another request.

    Raises:
        ValueError: If the budget is too small: says the least time; or an input is wrong.
        BlockingIOError: If another process is writing to `out`.
    """
    start = time.perf_counter()
    with locked(out):
        state = _earlier(request, out, console, overwrite)
        start -= 0.0 if state is None else state.get("spent", 0.0)
        with _counted(request, out, start):
            if state is None:
                state = _begin(request, out, console, start, overwrite)
            preset = turned(request.preset, state["shares"])
            page = experiment.run(preset, out, console, report=report, command=command, overwrite=overwrite)
        if "seconds" not in state:
            _write(out, {**state, "seconds": time.perf_counter() - start})
    return page


def _earlier(request: Request, out: Path, console: Console, overwrite: bool) -> State | None:
    """What is gone on with, if it is; refuses to replace another experiment unless `overwrite`."""
    state = begun(request, out)
    if state is not None:
        console.note(f"budget: going on with what was chosen before ({out / RECORD})")
    elif (out / EXPERIMENT).exists() and not overwrite:
        raise ValueError(f"{out} holds a finished experiment of another request: choose another --out, or add "
                         "--overwrite to replace it")  # fmt: skip
    return state


def tell(request: Request, out: Path, console: Console, *, overwrite: bool = False) -> None:
    """Say what `run` would do, and write nothing.

    A choice needs a trial that may take half the budget: it is not made, and what it decides is said instead.

    Raises:
        ValueError: As `run`, but for what the trial would show.
    """
    preset = request.preset
    if (state := _earlier(request, out, console, overwrite)) is not None:
        chosen = turned(preset, state["shares"])
        for line in said.before(preset, chosen, state):
            console.note(line)
        experiment.said(chosen, out, console, overwrite=overwrite)
        return
    experiment.refuse_impossible(preset)
    facts = _known(request)
    options = open_options(preset, facts.options, request.decided)
    for line in said.untried(preset, request.budget, TRIAL * request.budget, options, facts.source):
        console.note(f"{line} {NOT_DONE}")
    with dry_run():
        planned(console, "budget", [out / RECORD])


@contextmanager
def _counted(request: Request, out: Path, start: float) -> Iterator[None]:
    """Keep the time of a call that is interrupted: what all calls together took is what is compared with the budget."""
    try:
        yield
    except BaseException:
        with suppress(OSError, ValueError):  # such as a full disk: the first error is the one to report
            if (state := begun(request, out)) is not None and "seconds" not in state:
                _write(out, {**state, "spent": time.perf_counter() - start})
        raise


def _begin(request: Request, out: Path, console: Console, start: float, overwrite: bool) -> State:
    """Choose, say so, take the pictures, and choose the rest again."""
    plan = _planned(request, console)
    state = _write(out, _state(request, plan))
    preset = turned(request.preset, state["shares"])
    for line in said.before(request.preset, preset, state):
        console.note(line)
    experiment.photograph(preset, out, console, overwrite=overwrite)
    return _adjusted(request, plan, state, time.perf_counter() - start, out, console)


def begun(request: Request, out: Path) -> State | None:
    """What an earlier call with the same request has chosen."""
    if not (out / RECORD).exists():
        return None
    state = read_json(out / RECORD, SHAPE)
    if any(name not in WORDS or not 0 < share <= 1 for name, share in state["shares"].items()):
        raise ValueError(f"{out / RECORD}: shares must be of {', '.join(WORDS)} and in (0, 1], got "
                         f"{brief(state['shares'], 100)}; remove it, the choice is then made again")  # fmt: skip
    if state["request"] != request.identity():
        return None
    own = values(request.preset)
    if gone := [name for name, share in state["shares"].items() if share != 1 and name not in own]:
        raise ValueError(f"{out / RECORD}: shares must be of what this experiment leaves open ({', '.join(own)}), got "
                         f"{', '.join(gone)}, chosen by another version; remove it, the choice is then made again"
                         )  # fmt: skip
    return state


def _write(out: Path, state: State) -> State:
    write_json(out / RECORD, state)
    return state


def _planned(request: Request, console: Console) -> Plan:
    """Try the experiment on a small scale, and choose.

    Raises:
        ValueError: If the budget is too small.
    """
    start, facts = time.perf_counter(), _known(request)
    what = f"a budget of {request.budget:g} s is too small"
    remedy = "give more time, fewer methods, or smaller pictures"
    console.note(f"budget {request.budget:g} s: trying the experiment on a small scale to see this machine's pace")
    try:
        tried = forecast(request.preset, TRIAL * request.budget)
    except OutOfTime:
        raise ValueError(f"{what}: trying the experiment on a small scale alone takes more than "
                         f"{_seconds(TRIAL * request.budget)} here; {remedy}") from None  # fmt: skip
    options = open_options(request.preset, facts.options, request.decided)
    spent = time.perf_counter() - start
    choice = choose(tried.parts, options, request.budget * (1 - RESERVE) - spent)
    if choice is None:
        least = (fastest(tried.parts, options).seconds + spent) / (1 - RESERVE)
        raise ValueError(f"{what}: the least that this experiment takes here is about {_seconds(least)}; {remedy}")
    return Plan(tried, options, choice, facts, spent)


def _known(request: Request) -> Known:
    methods = {request.preset.reconstruct(name).variant.method for name in request.preset.methods}
    return known(request.curves, methods)


def _seconds(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.2g} s"


def _state(request: Request, plan: Plan) -> State:
    choice = plan.choice
    return {
        "request": request.identity(), "budget": request.budget, "trial": plan.spent, "curves": plan.facts.source,
        "shares": {option.name: option.share for option in choice.options},
        "foretold": {"seconds": choice.seconds + plan.spent, "lost": choice.lost, "sd": choice.sd},
        "preset_seconds": sum(plan.tried.parts.values()),
    }  # fmt: skip


def _adjusted(request: Request, plan: Plan, state: State, spent: float, out: Path, console: Console) -> State:
    """The choice for the rest once the pictures are taken, for the time that is really left; said if it changes."""
    left = request.budget * (1 - RESERVE / 2) - spent  # less is left to be wrong about
    taken = [option for option in plan.choice.options if option.name in OF_A_RENDER]
    rest = {name: settings for name, settings in plan.options.items() if name not in OF_A_RENDER}
    parts = _with(plan.tried.after, taken)
    again = choose(parts, rest, left) or fastest(parts, rest)
    whole = choice_of(plan.tried.parts, [*taken, *again.options])
    shares = {option.name: option.share for option in whole.options}
    foretold = {"seconds": spent + again.seconds, "lost": whole.lost, "sd": whole.sd}
    if foretold["seconds"] > request.budget:
        console.note(f"budget: {spent:.0f} s are gone, and the rest takes {again.seconds:.0f} s at least: it will take "
                     f"about {foretold['seconds'] - request.budget:.0f} s more than the budget")  # fmt: skip
    if shares == state["shares"]:
        return state
    state = {**state, "shares": shares, "foretold": foretold}
    for line in said.again(request.preset, turned(request.preset, shares), state, spent):
        console.note(line)
    return _write(out, state)


def _with(parts: dict[str, float], options: list[Option]) -> dict[str, float]:
    """Seconds of parts with some options chosen."""
    return {part: choice_of({part: seconds}, options).seconds for part, seconds in parts.items()}


def result(request: Request, out: Path, against: Path | None) -> list[str]:
    """What came of a finished experiment, line by line; see `said.after`."""
    return said.after(request.preset, out, read_json(out / RECORD, SHAPE), against)
