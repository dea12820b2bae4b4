"""Which curves a budget uses, and what it makes of them."""

import json
from pathlib import Path
from typing import Any

import pytest

from novags.methods import METHODS
from novags.testbed.console.provenance import hardware
from novags.testbed.ledger.contents import jsonable
from novags.testbed.study.budget import known as module
from novags.testbed.study.budget.choice import Option
from novags.testbed.study.budget.known import SHIPPED, known, open_options, options_of
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.curves.curve import read_curves

HERE = jsonable(hardware())


def point(
    setting: float, lost: float, fit: float, *, front: bool = True, option: str | None = "points", **more: Any
) -> Any:
    return {
        "knob": f"nova.{option}", "setting": setting, "seconds": 1.0, "cpu_seconds": fit, "error": 1.0, "error_sd": 0.0,
        "error_unit": "u", "default": setting == 800, "front": front, "repeats": 3, "of": "it", "why": "so",
        "option": option, "parts": {"fit": fit, "denoiser": 0.0}, "db_lost": lost, "db_lost_sd": 0.25,
        "workload": {"scene": "mine"}, "hardware": {"processor": "abacus"}, **more,
    }  # fmt: skip


CURVE = [point(100, 2.0, 1.0), point(200, 0.5, 2.0, front=False), point(400, -0.1, 3.0), point(800, 0.0, 4.0),
         point(1600, -0.4, 9.0), point(7, 0.0, 1.0, option=None)]  # fmt: skip


def write(path: Path, points: list[Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(json.dumps(p) + "\n" for p in points))


def test_options_are_shares_of_the_default_and_never_a_gain() -> None:
    found = options_of(CURVE)
    assert list(found) == ["points"]
    measured = {option.share: option for option in found["points"] if option.share in (0.125, 0.25, 0.5, 1.0, 2.0)}
    assert {share: option.lost for share, option in measured.items()} == {0.125: 2.0, 0.25: 0.5, 0.5: 0.0, 1.0: 0.0}
    assert measured[0.125].factors == {"fit": 0.25}  # what takes no time has no factor
    assert measured[0.5].factors == {"fit": 0.75}


def test_a_default_counts_wherever_it_stands_and_alone(tmp_path: Path) -> None:
    default = point(800, 0.0, 4.0)
    points = [default, *(each for each in CURVE if each != default)]
    assert options_of(points) == options_of(CURVE)
    assert [option.share for option in options_of([default])["points"]] == [1.0]
    write(tmp_path / "curves.jsonl", points)
    assert known(tmp_path).points == (default,)


def other(points: list[Any], name: str, part: str) -> list[Any]:
    """The same points of another method, whose training has another part, twice as long and with half the loss."""
    return [
        {**p, "knob": p["knob"].replace("nova.", f"{name}."), "db_lost": p["db_lost"] / 2,
         "parts": {part: 2 * p["parts"]["fit"]}} for p in points
    ]  # fmt: skip


def test_an_experiment_that_compares_several_methods_has_the_parts_of_all_and_their_mean_loss() -> None:
    both = [*CURVE, *other(CURVE[:1] + CURVE[2:], "plus", "refit")]  # it lacks the setting 200
    found = {option.share: option for option in options_of(both, {"nova", "plus", "naive"})["points"]}
    assert min(found) == 0.125
    assert found[0.125].factors == {"fit": 0.25, "refit": 0.25}
    assert found[0.125].lost == pytest.approx((2.0 + 1.0) / 2)
    assert found[0.125].sd == pytest.approx(0.25 * 2**0.5 / 2)
    # halfway between 100 and 400 on a logarithmic scale: 1.0 dB and nothing lost, and a factor of sqrt(1/4 * 3/4)
    assert found[0.25].lost == pytest.approx((0.5 + 0.5) / 2)
    assert found[0.25].factors == pytest.approx({"fit": 0.5, "refit": (0.25 * 0.75) ** 0.5})


def test_settings_that_one_of_the_methods_was_not_measured_at_are_left_out() -> None:
    both = [*CURVE, *other(CURVE[2:], "plus", "refit")]  # from 400 on
    found = options_of(both, {"nova", "plus"})["points"]
    assert min(option.share for option in found) == 0.5


def test_curves_of_methods_that_are_not_compared_count_only_if_there_are_no_others() -> None:
    both = [*CURVE, *other(CURVE, "plus", "refit")]
    assert options_of(both, {"plus"}) == options_of(other(CURVE, "plus", "refit"))
    assert options_of(both, {"naive"}) == options_of(CURVE) == options_of(both)


def test_what_this_machine_has_not_measured_comes_from_novags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "shipped.jsonl", [*CURVE, *other(CURVE, "plus", "refit")])
    monkeypatch.setattr(module, "SHIPPED", tmp_path / "shipped.jsonl")
    here = [{**p, "hardware": HERE, "db_lost": 2 * p["db_lost"]} for p in CURVE if p["setting"] != 200]
    write(tmp_path / "out" / "pareto" / "curves.jsonl", here)
    found = known(None, {"nova", "plus"})
    assert found.source == (
        f"measured earlier on this machine ({Path('out') / 'pareto'}) and those that came with novags (plus, measured "
        "on abacus: scene mine)"
    )
    least = min(found.options["points"], key=lambda option: option.share)
    assert (least.lost, least.factors) == (pytest.approx((4.0 + 1.0) / 2), {"fit": 0.25, "refit": 0.25})
    quarter = next(option for option in found.options["points"] if option.share == 0.25)
    assert quarter.lost == pytest.approx((2.0 + 0.25) / 2)  # between 4.0 and nothing; never the 0.5 of novags
    assert known(None, {"nova"}).source == f"measured earlier on this machine ({Path('out') / 'pareto'})"


def test_the_curves_that_are_named_come_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "mine" / "curves.jsonl", CURVE)
    write(tmp_path / "out" / "pareto" / "curves.jsonl", [{**p, "hardware": HERE} for p in CURVE])
    assert "in mine (measured on abacus: scene mine)" in known(Path("mine")).source


def test_curves_measured_here_come_before_those_of_novags(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = known(None)
    assert "that came with novags" in shipped.source
    usual = tmp_path / "out" / "pareto" / "curves.jsonl"
    write(usual, [{**p, "hardware": HERE} for p in CURVE])
    assert known(None).source == f"measured earlier on this machine ({Path('out') / 'pareto'})"
    write(usual, CURVE)  # of another machine
    assert known(None) == shipped
    for order in (1, -1):  # a folder that another machine has gone on with, by another method
        mixed = [[{**p, "hardware": HERE} for p in CURVE], other(CURVE, "nova-plus", "refit")]
        write(usual, [p for points in mixed[::order] for p in points])
        both = known(None, {"nova", "nova-plus"})
        assert "and those that came with novags (nova-plus, measured on AMD EPYC" in both.source
    write(usual, [{**point(1, 0, 1), "option": None, "hardware": HERE}])  # of the sensor alone, say
    assert known(None) == shipped


def test_curves_without_options_are_refused_when_they_are_named(tmp_path: Path) -> None:
    write(tmp_path / "curves.jsonl", [point(1, 0, 1, option=None)])
    with pytest.raises(ValueError, match="holds no curves of whole reconstructions: novags pareto METHOD --out"):
        known(tmp_path)


def test_novags_ships_curves_of_every_option() -> None:
    assert set(options_of(read_curves(SHIPPED))) == {"iterations", "points", "denoiser_steps", "spp", "size"}
    preset = EXPERIMENTS["demo"]
    plans = [preset.reconstruct(name) for name in preset.methods]
    methods, parts = {plan.variant.method for plan in plans}, set[str]()
    for plan in plans:
        counted = METHODS[plan.variant.method].parts
        parts |= set() if counted is None else set(counted(plan.config))
    least = min(options_of(read_curves(SHIPPED), methods)["iterations"], key=lambda option: option.share)
    assert least.share == 1 / 16
    # every part of every method that the demonstration trains gets shorter, but for that which has its own number
    assert set(least.factors) == parts - {"denoiser"}
    assert max(least.factors.values()) < 0.25
    assert module.USUAL == Path("out") / "pareto"


def test_all_settings_that_make_sense_for_the_preset_stay_open_and_no_others() -> None:
    def settings(*shares: float) -> list[Option]:
        return [Option("x", share, {}, 0.0, 0.0) for share in shares]

    preset = adapted(EXPERIMENTS["demo"], methods=("naive",), iterations=100, points=1000, spp=4)
    options = {"iterations": settings(0.01, 0.1, 0.5, 1.0), "points": settings(0.05, 1.0),
               "spp": settings(0.5, 0.25, 1.0), "denoiser_steps": settings(0.5, 1.0),
               "size": settings(0.5, 1.0)}  # fmt: skip
    found = open_options(preset, options, {"size"})
    assert {name: [option.share for option in own] for name, own in found.items()} == {
        "iterations": [0.1, 0.5, 1.0], "spp": [0.5, 1.0]
    }  # fmt: skip
