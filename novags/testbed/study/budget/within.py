"""An experiment in a given time: try it on a small scale, choose settings, say so, and choose again on the way.

Nothing is run here but by the caller: `within` gives it the settings, and counts the time that it takes.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from novags.cameras.sources.known import KnownConfig
from novags.testbed.console.provenance import hardware
from novags.testbed.console.terminal import Console
from novags.testbed.folders.runs import EXPERIMENT
from novags.testbed.ledger.contents import digest, jsonable, read_json, write_json
from novags.testbed.study.budget import said
from novags.testbed.study.budget.choice import Choice, Option, choice_of, choose, fastest
from novags.testbed.study.budget.known import Known, known, open_options
from novags.testbed.study.budget.trial import Forecast, OutOfTime, Run, at_worst, expected, forecast, together
from novags.testbed.study.cells.presets import Preset
from novags.testbed.study.knobs.options import OF_A_RENDER, WORDS, turned, values
from sensor_model.files.lock import locked
from sensor_model.files.reading import brief

RECORD = "budget.json"
RESERVE = 0.1  # of the budget: by how much a trial may underestimate
TRIAL = 0.1  # of the budget: a trial ends there
REMEDY = "give more time, fewer methods, or smaller pictures"
FORETOLD = {"seconds": float, "lost": float, "sd": float}
SHAPE = {
    "request": str, "budget": float, "trial": float, "curves": str, "shares": {"*": float}, "foretold": FORETOLD,
    "preset_seconds": float, "seconds?": float, "spent?": float,
}  # fmt: skip
State = dict[str, Any]


@dataclass(frozen=True)
class Request:
    """The experiment and its budget.

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

    def known(self) -> Known:
        """The curves of its methods."""
        return known(self.curves, {self.preset.reconstruct(name).variant.method for name in self.preset.methods})


@dataclass
class Budget:
    """An experiment under way.

    Attributes:
        request: The experiment and its budget.
        out: Its folder; `budget.json` in it has the choice, the prediction and the time taken.
        console: Where the choice is shown.
        start: When it began, without the time between its calls.
        state: The choice.
        tried: The basis of the choice: the trial's forecast, the options, the choice; None: it was made by an earlier
            call.
    """

    request: Request
    out: Path
    console: Console
    start: float
    state: State = field(default_factory=dict)
    tried: tuple[Forecast, dict[str, list[Option]], Choice] | None = None

    @property
    def preset(self) -> Preset:
        """The experiment with the settings that are chosen."""
        return turned(self.request.preset, self.state["shares"])

    @property
    def spent(self) -> float:
        """Seconds since the beginning."""
        return time.perf_counter() - self.start

    def write(self, **more: Any) -> None:
        """Write the state, and more of it."""
        self.state.update(more)
        write_json(self.out / RECORD, self.state)

    def choose(self, run: Run) -> None:
        """Try the experiment on a small scale, choose, and say so.

        Raises:
            ValueError: If the budget is too small: names one that will do.
        """
        budget, preset, facts = self.request.budget, self.request.preset, self.request.known()
        options = open_options(preset, facts.options, self.request.decided)
        _refuse_hopeless(self.request, facts, options)
        self.console.note(f"budget {budget:g} s: trying the experiment on a small scale to see this machine's pace")
        begun, worked = self.spent, time.process_time()
        try:
            tried = forecast(preset, TRIAL * budget, run, facts.points)
        except OutOfTime:
            share = min(1.0, (time.process_time() - worked) / max(self.spent - begun, 1e-9))
            to_a_pace, parts = at_worst(preset, facts.points, max(share, 0.01))
            needed = max(2 * self.spent, to_a_pace) / TRIAL
            raise _too_small(budget, max(needed, _enough(fastest(parts, options).seconds, 0.0, TRIAL))) from None
        spent = self.spent
        choice = choose(tried.parts, options, budget * (1 - RESERVE) - spent)
        if choice is None:
            least = fastest(tried.parts, options).seconds
            raise _too_small(budget, _enough(least, spent) if not tried.untried else _enough(least, spent, TRIAL))
        self.tried = tried, options, choice
        self.write(
            request=self.request.identity(), budget=budget, trial=spent, curves=facts.source, shares=_shares(choice),
            foretold={"seconds": choice.seconds + spent, "lost": choice.lost, "sd": choice.sd},
            preset_seconds=sum(tried.parts.values()),
        )  # fmt: skip
        self._say(said.before(preset, self.preset, self.state, tried.untried))

    def adjust(self) -> None:
        """Choose the rest again once the pictures are taken, for the time that is really left; said if it changes."""
        if self.tried is None:
            return
        tried, options, choice = self.tried
        spent, budget = self.spent, self.request.budget
        taken = [option for option in choice.options if option.name in OF_A_RENDER]
        rest = {name: settings for name, settings in options.items() if name not in OF_A_RENDER}
        parts = {part: choice_of({part: seconds}, taken).seconds for part, seconds in tried.after.items()}
        left = budget * (1 - RESERVE / 2) - spent  # less is left to be wrong about
        again = choose(parts, rest, left) or fastest(parts, rest)
        whole = choice_of(tried.parts, [*taken, *again.options])
        foretold = {"seconds": spent + again.seconds, "lost": whole.lost, "sd": whole.sd}
        if foretold["seconds"] > budget:
            self.console.note(
                f"budget: {spent:.0f} s are gone, and the rest takes {again.seconds:.0f} s at least: it will take "
                f"about {foretold['seconds'] - budget:.0f} s more than the budget"
            )
        if _shares(whole) != self.state["shares"]:
            self.write(shares=_shares(whole), foretold=foretold)
            self._say(said.again(self.request.preset, self.preset, self.state, spent))

    def _say(self, lines: list[str]) -> None:
        for line in lines:
            self.console.note(line)


@contextmanager
def within(request: Request, out: Path, console: Console, run: Run, *, overwrite: bool = False) -> Iterator[Budget]:
    """The settings of an experiment that the caller runs in the block; an interrupted one goes on with its own.

    Args:
        request: The experiment and its budget.
        out: The experiment folder.
        console: Where notes go.
        run: The function that runs the trial.
        overwrite: Replace finished results of another request.

    Raises:
        ValueError: If the budget is too small: names one that will do; or an input is wrong.
        BlockingIOError: If another process is writing to `out`.
    """
    with locked(out):
        found = Budget(request, out, console, time.perf_counter())
        state = earlier(request, out, console, overwrite)
        if state is not None:
            found.state, found.start = state, found.start - state.get("spent", 0.0)
        else:
            found.choose(run)
        over = "seconds" in found.state
        try:
            yield found
        except BaseException:  # the budget is compared with the time of all calls together
            with suppress(OSError, ValueError):  # such as a full disk: the first error is the one to report
                if not over:
                    found.write(spent=found.spent)
            raise
        if not over:
            found.write(seconds=found.spent)


def _refuse_hopeless(request: Request, facts: Known, options: Mapping[str, Sequence[Option]]) -> None:
    """Refuse at once a budget that this machine is known to be too slow for.

    Raises:
        ValueError: If it has made the curves, and training alone takes longer even where all its cores share it.
    """
    here = jsonable(hardware())
    if facts.points and all(point["hardware"] == here for point in facts.points):
        least = fastest(together(expected(request.preset, facts.points)), options).seconds
        if least / here["cores"] > request.budget:
            worst = fastest(at_worst(request.preset, facts.points)[1], options).seconds
            raise _too_small(request.budget, _enough(worst, 0.0, TRIAL))


def _enough(seconds: float, spent: float, trial: float = 0.0) -> float:
    """A budget in which a trial of these seconds, or of this share, and then an experiment find room."""
    return max((seconds + spent * (not trial)) / (1 - RESERVE - trial), spent / TRIAL)


def _too_small(budget: float, needed: float) -> ValueError:
    return ValueError(f"a budget of {budget:g} s is too small here; {_round(needed):g} s will do, or {REMEDY}")


def _round(seconds: float) -> float:
    """Not below, in two figures."""
    step = 10.0 ** max(0, len(f"{seconds:.0f}") - 2)
    return step * -(-seconds // step)


def _shares(choice: Choice) -> dict[str, float]:
    return {option.name: option.share for option in choice.options}


def earlier(request: Request, out: Path, console: Console, overwrite: bool) -> State | None:
    """The earlier choice to go on with, if there is one; refuses to replace another experiment unless `overwrite`."""
    state = begun(request, out)
    if state is not None:
        console.note(f"budget: going on with the earlier choice ({out / RECORD})")
    elif (out / EXPERIMENT).exists() and not overwrite:
        raise ValueError(f"{out} holds a finished experiment of another request: choose another --out, or add "
                         "--overwrite to replace it")  # fmt: skip
    return state


def begun(request: Request, out: Path) -> State | None:
    """The choice of an earlier call with the same request."""
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


def told(request: Request, out: Path, console: Console, *, overwrite: bool = False) -> tuple[Preset | None, list[str]]:
    """A dry run of `within`: the settings that are chosen already, if they are, and the lines to show.

    Raises:
        ValueError: As `within`, except errors that only the trial would show.
    """
    if (state := earlier(request, out, console, overwrite)) is not None:
        chosen = turned(request.preset, state["shares"])
        return chosen, said.before(request.preset, chosen, state)
    facts = request.known()
    options = open_options(request.preset, facts.options, request.decided)
    _refuse_hopeless(request, facts, options)
    return None, said.untried(request.preset, request.budget, TRIAL * request.budget, options, facts.source)
