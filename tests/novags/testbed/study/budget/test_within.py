"""The course of an experiment with a budget, with work that costs nothing."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from novags.methods.variant import Variant
from novags.testbed.console.terminal import Console
from novags.testbed.ledger.contents import jsonable
from novags.testbed.study.budget import said
from novags.testbed.study.budget import within as module
from novags.testbed.study.budget.choice import Option
from novags.testbed.study.budget.known import Known
from novags.testbed.study.budget.trial import Forecast, OutOfTime
from novags.testbed.study.budget.within import RESERVE, TRIAL, Request, told, within
from novags.testbed.study.cells.presets import EXPERIMENTS, Preset, adapted

LOSSES = ((0.25, 2.0, 0.3), (0.5, 0.8, 0.4), (1.0, 0.0, 0.0))
OPTIONS = {
    "iterations": [Option("iterations", s, {"fit": s}, lost, sd) for s, lost, sd in LOSSES],
    "spp": [Option("spp", 0.25, {"render": 0.25}, 1.0, 0.3), Option("spp", 1.0, {}, 0.0, 0.0)],
}
PRESET = adapted(EXPERIMENTS["demo"], iterations=1000, spp=100)


class Told(Console):
    def __init__(self) -> None:
        super().__init__(quiet=True)
        self.lines: list[str] = []

    def note(self, text: str) -> None:
        self.lines.append(text)


class Work:
    """A clock, and an experiment that takes as long on it as it is told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now, self.slow, self.ran, self.tried = 0.0, 0.0, list[Preset](), 0
        self.fit_stops, self.trial, self.points = False, 10.0, ()
        self.guess = 1.0  # times what it really takes, where the trial does not come to its end
        monkeypatch.setattr(module.time, "perf_counter", lambda: self.now)
        monkeypatch.setattr(module, "forecast", self.forecast)
        monkeypatch.setattr(module, "at_worst", lambda *_: (20.0, {"fixed": 60.0, "render": 100.0, "fit": 400.0}))
        monkeypatch.setattr(module, "known", lambda folder, methods: Known(OPTIONS, "made up", self.points))

    def forecast(self, preset: Preset, limit: float, *_: Any) -> Forecast:
        self.tried += 1
        self.now += min(limit, self.trial)
        if limit < 0.3 * self.trial:
            raise OutOfTime
        untried, times = (("oracle",), self.guess) if limit < self.trial else ((), 1.0)
        after = {"fixed": 5.0 * times, "fit": 80.0 * times}
        return Forecast({"fixed": 5.0, "render": 40.0}, after, min(limit, self.trial), untried)

    def photograph(self, preset: Preset) -> None:
        self.now += 5 + 40 * preset.render.spp / 100 + self.slow

    def run(self, preset: Preset, out: Path) -> None:
        if self.fit_stops:
            raise KeyboardInterrupt
        self.ran.append(preset)
        self.now += 5 + 80 * preset.settings["fit.iterations"] / 1000
        write(out, preset, {name: 20.0 for name in preset.methods})

    def do(self, request: Request, out: Path, console: Console) -> dict[str, Any]:
        """As `novags run` does; what is known of the budget in the end."""
        with within(request, out, console, lambda *_: None) as budget:
            if budget.tried is not None:  # what is there already takes no time
                self.photograph(budget.preset)
            budget.adjust()
            self.run(budget.preset, out)
        return budget.state


def write(out: Path, preset: Preset, scores: dict[str, float]) -> None:
    from dataclasses import asdict

    out.mkdir(parents=True, exist_ok=True)
    record = {"command": None, "preset": jsonable(asdict(preset))}
    (out / "experiment.json").write_text(json.dumps(record))
    rows = [{"method": name, "state": "done", "folder": name, "enhanced.aligned_psnr": score}
            for name, score in scores.items()]  # fmt: skip
    (out / "results.json").write_text(json.dumps({"axes": {"method": list(scores)}, "rows": rows}))


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> Work:
    return Work(monkeypatch)


def test_choice_and_loss_are_said_before_the_work_which_keeps_the_budget(work: Work, tmp_path: Path) -> None:
    """130 s of work and a trial of 10 s: of 120 s, 108 are used, so that half the iterations it is."""
    console = Told()
    work.do(Request(PRESET, 120.0), tmp_path / "x", console)
    (done,) = work.ran
    assert (done.settings["fit.iterations"], done.render.spp) == (500, 100)
    text = "\n".join(console.lines)
    assert "iterations 1000 -> 500" in text
    assert "predicted 100 s, of which 10 s are spent on the trial; the preset takes 130 s here" in text
    assert "expected to lose 0.8 ± 0.4 dB of aligned PSNR against the preset" in text
    assert "made up" in text
    state = json.loads((tmp_path / "x" / "budget.json").read_text())
    assert state["seconds"] == 100.0
    assert state["shares"] == {"iterations": 0.5, "spp": 1.0}


def test_a_preset_that_fits_is_left_as_it_is(work: Work, tmp_path: Path) -> None:
    work.do(Request(PRESET, 160.0), tmp_path / "x", Told())
    assert work.ran == [PRESET]


def test_options_that_the_user_set_stay(work: Work, tmp_path: Path) -> None:
    work.do(Request(PRESET, 125.0, frozenset({"iterations"})), tmp_path / "x", Told())
    (done,) = work.ran
    assert (done.settings["fit.iterations"], done.render.spp) == (1000, 25)


def named(error: pytest.ExceptionInfo[ValueError]) -> float:
    """The budget that a refusal names."""
    (found,) = re.findall(r" ([\d.]+) s will do", str(error.value))
    assert "\n" not in str(error.value)
    return float(found)


@pytest.mark.parametrize("trial", [1.0, 10.0, 60.0])
@pytest.mark.parametrize("guess", [1.0, 1.5, 4.0])
@pytest.mark.parametrize("budget", [0.5, 5.0, 20.0, 35.0])
def test_a_budget_that_is_too_small_is_refused_in_a_tenth_of_it_with_one_that_then_holds(
    work: Work, tmp_path: Path, budget: float, guess: float, trial: float
) -> None:
    """Whether the trial has come to its end, or to some of the methods, or to nothing at all."""
    work.guess, work.trial = guess, trial
    with pytest.raises(ValueError, match="s is too small here") as error:
        work.do(Request(PRESET, budget), tmp_path / "x", Told())
    assert work.now <= TRIAL * budget + 1e-9
    assert work.ran == []
    assert not (tmp_path / "x" / "budget.json").exists()
    work.now, enough = 0.0, named(error)
    assert enough > budget
    work.do(Request(PRESET, enough), tmp_path / "y", Told())
    assert len(work.ran) == 1
    assert work.now <= enough


def test_a_trial_that_does_not_come_to_its_end_is_enough_for_a_choice(work: Work, tmp_path: Path) -> None:
    work.trial, work.guess, console = 30.0, 1.5, Told()
    work.do(Request(PRESET, 150.0), tmp_path / "x", console)
    assert work.now <= 150
    assert any("of oracle in part from the curves, at that pace" in line for line in console.lines)


def test_what_this_machine_is_known_to_be_too_slow_for_is_refused_at_once(
    work: Work, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it has made the curves itself: 80 processor seconds of fits are 20 s at least, with a quarter of them."""
    monkeypatch.setattr(module, "hardware", lambda: {"processor": "abacus", "cores": 2})
    monkeypatch.setattr(module, "expected", lambda *_: {"naive": {"fit": 80.0}})
    work.points = ({"hardware": {"processor": "abacus", "cores": 2}},)
    with pytest.raises(ValueError, match="a budget of 9 s is too small here") as error:
        work.do(Request(PRESET, 9.0), tmp_path / "x", Told())
    assert (work.tried, work.now) == (0, 0.0)
    with pytest.raises(ValueError, match="a budget of 9 s is too small here"):
        told(Request(PRESET, 9.0), tmp_path / "x", Told())
    assert named(error) == pytest.approx((60 + 25 + 100) / (1 - RESERVE - TRIAL), rel=0.1)
    work.points = ({"hardware": {"processor": "quipu", "cores": 2}},)
    with pytest.raises(ValueError, match="a budget of 9 s is too small here"):
        work.do(Request(PRESET, 9.0), tmp_path / "x", Told())
    assert work.tried == 1  # another machine may be faster


def test_pictures_that_took_longer_leave_less_for_the_fit(work: Work, tmp_path: Path) -> None:
    work.slow, console = 30.0, Told()
    work.do(Request(PRESET, 120.0), tmp_path / "x", console)
    (done,) = work.ran
    assert done.settings["fit.iterations"] == 250
    assert work.now < 120
    text = "\n".join(console.lines)
    assert "the pictures are taken after 85 s" in text
    assert "expected to lose 2.0 ± 0.3 dB" in text


def test_pictures_that_took_less_leave_more_for_the_fit(work: Work, tmp_path: Path) -> None:
    work.slow = -30.0
    work.do(Request(PRESET, 120.0), tmp_path / "x", Told())
    assert work.ran[0].settings["fit.iterations"] == 1000
    assert work.now <= 120


@pytest.mark.parametrize("order", [1, -1])
def test_the_pictures_stay_as_chosen_in_any_order_of_the_options(
    order: int, work: Work, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 80 s, 62 are left: for a quarter of the samples and half of the iterations."""
    options = dict([*OPTIONS.items()][::order])
    monkeypatch.setattr(module, "known", lambda folder, methods: Known(options, "made up"))
    state = work.do(Request(PRESET, 80.0), tmp_path / "x", Told())
    assert state["shares"] == {"iterations": 0.5, "spp": 0.25}
    assert [(done.settings["fit.iterations"], done.render.spp) for done in work.ran] == [(500, 25)]


def test_an_excess_is_never_silent(work: Work, tmp_path: Path) -> None:
    work.slow, console, request = 70.0, Told(), Request(PRESET, 120.0)
    work.do(request, tmp_path / "x", console)
    assert any("it will take about 30 s more than the budget" in line for line in console.lines)
    state = json.loads((tmp_path / "x" / "budget.json").read_text())
    lines = said.after(request.preset, tmp_path / "x", state, None)
    assert lines[0] == "budget 120 s: took 150 s, predicted 150 s: 30 s more than the budget"


def test_an_interrupted_experiment_goes_on_with_what_was_chosen(work: Work, tmp_path: Path) -> None:
    work.fit_stops = True
    with pytest.raises(KeyboardInterrupt):
        work.do(Request(PRESET, 120.0), tmp_path / "x", Told())
    work.fit_stops, console = False, Told()
    work.do(Request(PRESET, 120.0), tmp_path / "x", console)
    assert work.tried == 1
    assert work.ran[0].settings["fit.iterations"] == 500
    assert "going on with the earlier choice" in console.lines[0]
    state = json.loads((tmp_path / "x" / "budget.json").read_text())
    assert state["seconds"] == 100.0  # of both calls, as if there had been one


def test_a_dry_run_tells_the_choice_that_is_gone_on_with(work: Work, tmp_path: Path) -> None:
    work.do(Request(PRESET, 120.0), tmp_path / "x", Told())
    before = (tmp_path / "x" / "budget.json").read_bytes()
    chosen, lines = told(Request(PRESET, 120.0), tmp_path / "x", Told())
    assert [chosen] == work.ran
    assert "iterations 1000 -> 500" in lines[0]
    assert "predicted 100 s, of which 10 s are spent on the trial" in lines[1]
    assert (work.tried, (tmp_path / "x" / "budget.json").read_bytes()) == (1, before)


def test_a_dry_run_says_what_a_trial_would_decide_and_makes_none(work: Work, tmp_path: Path) -> None:
    chosen, lines = told(Request(PRESET, 120.0, frozenset({"spp"})), tmp_path / "x", Told())
    assert (chosen, work.tried) == (None, 0)
    assert not (tmp_path / "x").exists()
    text = "\n".join(lines)
    assert "tried on a small scale, for 12 s at most" in text
    assert "by the curves made up: iterations 1000 -> 250 at the least" in text
    work.do(Request(PRESET, 120.0), tmp_path / "x", Told())
    with pytest.raises(ValueError, match="holds a finished experiment of another request"):
        told(Request(PRESET, 130.0), tmp_path / "x", Told())


def test_a_choice_of_another_version_that_this_one_leaves_to_the_variant_is_refused(work: Work, tmp_path: Path) -> None:
    """Versions that took the iterations of a variant for the preset's halved what the variant itself decides."""
    own = Variant(name="long", method="naive", settings={"fit.iterations": 700})
    request = Request(adapted(PRESET, methods=("long",), variants=(own,)), 120.0)
    (tmp_path / "x").mkdir()
    state = {"request": request.identity(), "budget": 120.0, "trial": 10.0, "curves": "made up",
             "shares": {"iterations": 0.5}, "foretold": {"seconds": 100.0, "lost": 0.8, "sd": 0.4},
             "preset_seconds": 130.0}  # fmt: skip
    (tmp_path / "x" / "budget.json").write_text(json.dumps(state))
    with pytest.raises(ValueError, match=r"leaves open \(points, .* got iterations, chosen by another .* remove it"):
        work.do(request, tmp_path / "x", Told())


def test_a_finished_experiment_of_another_request_is_refused_before_the_trial(work: Work, tmp_path: Path) -> None:
    work.do(Request(PRESET, 120.0), tmp_path / "x", Told())
    with pytest.raises(ValueError, match="holds a finished experiment of another request"):
        work.do(Request(PRESET, 130.0), tmp_path / "x", Told())
    assert work.tried == 1


def test_the_loss_is_measured_against_a_run_of_the_preset_itself(work: Work, tmp_path: Path) -> None:
    request = Request(PRESET, 120.0)
    state = work.do(request, tmp_path / "x", Told())

    def told_of(against: Path) -> str:
        return "\n".join(said.after(request.preset, tmp_path / "x", state, against))

    unknown = told_of(tmp_path / "whole")
    assert "known once the preset itself has been run" in unknown
    write(tmp_path / "whole", adapted(PRESET, electrons=3.0), {name: 99.0 for name in PRESET.methods})
    assert told_of(tmp_path / "whole") == unknown  # that is another one
    write(tmp_path / "whole", PRESET, {name: 20.75 for name in PRESET.methods})
    found = told_of(tmp_path / "whole")
    assert found.count("lost 0.75 dB") == len(PRESET.methods)
    assert "expected to lose 0.8 ± 0.4 dB" in found


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: adapted(EXPERIMENTS["demo"], photos=Path("x")), "novags poses first"),
        (lambda: adapted(EXPERIMENTS["demo"], cameras=_sfm()), "leave out --cameras or --budget"),
    ],
)
def test_what_no_trial_can_foretell_is_refused(make: Callable[[], Preset], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Request(make(), 100.0)


def _sfm() -> Any:
    from novags.cameras import parse_cameras

    return parse_cameras("sfm")


def test_a_request_is_the_same_only_with_the_same_preset_budget_and_decisions() -> None:
    """And it asks for the curves of all its methods."""
    request = Request(PRESET, 100.0, frozenset({"spp"}))
    assert request.identity() == Request(PRESET, 100.0, frozenset({"spp"})).identity()
    others = (Request(PRESET, 101.0, frozenset({"spp"})), Request(PRESET, 100.0),
              Request(adapted(PRESET, iterations=999), 100.0, frozenset({"spp"})))  # fmt: skip
    assert len({request.identity(), *(other.identity() for other in others)}) == 4


def test_the_curves_of_all_methods_are_looked_up(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[set[str]]()
    monkeypatch.setattr(module, "known", lambda folder, methods: asked.append(methods))
    Request(adapted(EXPERIMENTS["demo"], methods=("naive", "oracle", "nova-fast")), 100.0).known()
    assert {"naive", "oracle"} < asked[0]
    assert len(asked[0]) == 3


@pytest.mark.parametrize("elsewhere", [None, 0, 1, 2])
def test_a_budget_is_hopeless_only_by_curves_that_were_all_made_here(
    elsewhere: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = {"processor": "this", "cores": 2}
    points: Any = tuple({"hardware": here | ({"processor": "that"} if k == elsewhere else {})} for k in range(3))
    monkeypatch.setattr(module, "hardware", lambda: here)
    monkeypatch.setattr(module, "expected", lambda preset, points: {"naive": {"fit": 1e6}})
    monkeypatch.setattr(module, "at_worst", lambda preset, points: ({}, {"fit": 1e6}))
    facts = Known({}, "here", points)
    request = Request(PRESET, 10.0)
    if elsewhere is None:
        with pytest.raises(ValueError, match="a budget of 10 s is too small here"):
            module._refuse_hopeless(request, facts, OPTIONS)
    else:
        module._refuse_hopeless(request, facts, OPTIONS)
