"""Which curves a budget uses, and what it makes of them."""

import json
from pathlib import Path
from typing import Any

import pytest

from novags.testbed.budget import known as module
from novags.testbed.budget.known import SHIPPED, known, options_of
from novags.testbed.cache import jsonable
from novags.testbed.machine.provenance import hardware
from novags.testbed.pareto.curve import read_curves

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
    write(usual, [{**point(1, 0, 1), "option": None, "hardware": HERE}])  # of the sensor alone, say
    assert known(None) == shipped


def test_curves_without_options_are_refused_when_they_are_named(tmp_path: Path) -> None:
    write(tmp_path / "curves.jsonl", [point(1, 0, 1, option=None)])
    with pytest.raises(ValueError, match="holds no curves of whole reconstructions: novags pareto METHOD --out"):
        known(tmp_path)


def test_novags_ships_curves_of_every_option() -> None:
    assert set(options_of(read_curves(SHIPPED))) == {"iterations", "points", "denoiser_steps", "spp", "size"}
    assert module.USUAL == Path("out") / "pareto"
