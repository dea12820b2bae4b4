"""Time left, with a simulated clock: every part of a piece of work is extrapolated at its own pace."""

import io

import pytest

from novags.methods import METHODS
from novags.methods.denoised.config import DenoisedConfig
from novags.methods.nova.config import NovaConfig
from novags.methods.nova_plus.config import NovaPlusConfig
from novags.methods.rivals.rows.denoised_twice import DenoisedTwiceConfig
from novags.methods.rivals.rows.raw3dgs import Raw3dgsConfig
from novags.testbed.console import terminal as console
from novags.testbed.console.time_left import TimeLeft

PARTS = {"denoiser": 100, "fit": 400}


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def run(left: TimeLeft, clock: Clock, costs: dict[str, float], first: int = 0) -> dict[int, str]:
    """What is said after each ten steps, of which those of a part take costs[part] seconds each."""
    said, total = {}, sum(PARTS.values())
    for done in range(first + 1, total + 1):
        clock.now += costs["denoiser" if done <= PARTS["denoiser"] else "fit"]
        if done % 10 == 0:
            said[done] = left.update(done, total)
    return said


def test_each_part_is_extrapolated_from_its_own_steps() -> None:
    """Denoiser steps of 2 s and fit steps of 0.1 s: at one pace the first half of the denoiser would promise 880 s."""
    clock = Clock()
    said = run(TimeLeft("nova", PARTS, {}, clock), clock, {"denoiser": 2.0, "fit": 0.1})
    assert said[50] == "100 s left, then fit"
    assert said[90] == "20 s left, then fit"
    assert said[200] == "30 s left"
    assert said[490] == "1 s left"
    assert said[500] == ""


def test_a_later_part_counts_with_what_it_cost_before() -> None:
    clock, paces = Clock(), {}
    other = TimeLeft("naive", {"fit": 20}, paces, clock)
    for done in (10, 20):
        clock.now += 5.0
        other.update(done, 20)
    first = run(TimeLeft("nova", PARTS, paces, clock), clock, {"denoiser": 2.0, "fit": 1.0})
    assert first[50] == "300 s left"  # 50 steps of 2 s, and 400 of the half second that they took in another work
    second = run(TimeLeft("nova", PARTS, paces, clock), clock, {"denoiser": 2.0, "fit": 1.0})
    assert second[50] == "500 s left"  # of the same work they are known better


def test_resumed_work_counts_only_what_this_process_did() -> None:
    clock = Clock()
    left = TimeLeft("nova", PARTS, {}, clock)
    said = run(left, clock, {"denoiser": 9.0, "fit": 0.5}, first=300)
    assert said[310] == ""  # one report tells no pace
    assert said[400] == "50 s left"


def test_what_comes_between_two_parts_belongs_to_the_later_one() -> None:
    clock = Clock()
    left = TimeLeft("nova", PARTS, {}, clock)
    left.update(50, 500)
    clock.now += 50.0
    assert left.update(100, 500) == "0 s left, then fit"
    clock.now += 40.0  # the Gaussians are made, and 100 steps are done
    assert left.update(200, 500) == "120 s left"


def test_what_prepares_a_part_is_not_taken_for_its_pace() -> None:
    """Rationale: averages that took 7 s before the first of 100 denoiser steps promised that these would take 690 s."""
    clock, paces = Clock(), {}
    left = TimeLeft("nova-plus", PARTS, paces, clock)
    left.update(50, 500)
    clock.now += 50.0
    left.update(100, 500)
    clock.now += 60.0
    assert left.update(101, 500) == ""  # one step tells no pace
    clock.now += 9.0
    assert left.update(110, 500) == "390 s left"
    assert paces["fit"] == 6.9  # for what comes later, which prepares it too


def test_other_totals_than_the_parts_have_one_pace() -> None:
    clock = Clock()
    left = TimeLeft("render", {"a": 3}, {}, clock)
    left.update(1, 10)
    clock.now += 8.0
    assert left.update(5, 10) == "10 s left"


@pytest.mark.parametrize("name", [name for name, method in METHODS.items() if hasattr(method.config(), "fit")])
def test_the_parts_of_a_method_are_what_its_progress_counts(name: str) -> None:
    method = METHODS[name]
    assert method.parts is not None
    config = method.config()
    iterations = config.fit.iterations
    expected = {"fit": iterations}
    if isinstance(config, NovaConfig):
        expected["denoiser"] = config.denoiser.warmup_steps
    elif isinstance(config, DenoisedConfig):
        expected["denoiser"] = config.denoise.adapt.steps
        if isinstance(config, DenoisedTwiceConfig):
            expected |= {"denoiser again": expected["denoiser"], "first fit": iterations}
    elif isinstance(config, NovaPlusConfig):  # 5, 5 and 1 twelfths; two seeds
        expected = dict.fromkeys(("likelihood", "structure"), 2 * round(iterations * 5 / 12))
        expected |= {"merged": round(iterations / 12), "denoiser": config.denoise.adapt.steps}
    elif isinstance(config, Raw3dgsConfig):
        expected["pretraining"] = config.pretrain.steps
    elif steps := getattr(getattr(config, "enhance", None), "steps", 0):  # of a network that learns from the scene
        expected["enhancer"] = steps
    assert method.parts(config) == expected


def test_the_console_extrapolates_the_parts_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "PLAIN_INTERVAL", -1.0)
    stream = io.StringIO()
    with console.Console(stream=stream).progress("nova", PARTS) as progress:
        for done in (10, 20, 110, 120):
            progress(done, 500, "")
    assert [line.partition("left")[2] for line in stream.getvalue().splitlines()] == ["", ", then fit", "", ""]
    assert stream.getvalue().splitlines()[3].endswith(" s left")


def test_a_live_bar_shows_names_with_brackets_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: of `novags score --renders 'mine [red]'` the name of the folder was taken for markup, and left out."""
    monkeypatch.setenv("TERM", "xterm")
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: True, raising=False)
    with console.Console(stream=stream).progress("score mine [red]") as progress:
        progress(1, 2, "view [a]")
    assert "score mine [red]" in stream.getvalue()
    assert "view [a]" in stream.getvalue()


def test_of_work_without_a_known_end_nothing_is_foretold_and_lines_stay_few(monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that is run as a method says how long it has taken, four times a second: it ended the command."""
    clock, said = Clock(), io.StringIO()
    assert TimeLeft("command", {}, {}, clock).update(0, 0) == ""
    assert TimeLeft("command", PARTS, {}, clock).update(3, 0) == ""
    monkeypatch.setattr(console.time, "monotonic", clock)
    with console.Console(stream=said).progress("command theirs") as update:
        for k in range(48):
            clock.now += 0.25
            update(0, 0, f"{k / 4:.0f} s")
    assert said.getvalue().splitlines() == ["command theirs: 5 s", "command theirs: 10 s"]
