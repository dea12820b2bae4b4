"""Claims about one measurement: which setting of which knob it measures, with which seed, on what."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from novags.testbed.console.terminal import Console
from novags.testbed.study.cells.presets import EXPERIMENTS
from novags.testbed.study.knobs import measurement, options
from novags.testbed.study.knobs.knob import Knob, Reading, Subject
from novags.testbed.study.knobs.measurement import Measurement, measure
from novags.testbed.study.knobs.render import render
from simscenes.job import curves

ASKED = list[tuple[str, Any, int, Any]]()


def subject() -> Subject:
    def knob(name: str) -> Knob:
        def made(setting: Any, seed: int, captured: Any) -> Reading:
            ASKED.append((name, setting, seed, captured))
            return Reading(1.0, 2.0, float(seed), {})

        return Knob(name=name, settings=(1, 2), default=1, unit="", of="", why="", measure=made)

    return Subject("made", {}, (knob("first"), knob("second")))


@pytest.mark.parametrize("name", ["first", "second"])
@pytest.mark.parametrize("captured", [None, Path("c")])
def test_the_knob_is_measured_at_its_setting_with_the_seed_on_the_capture_of_it(
    name: str, captured: Path | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    inputs = dict[str, Any]()

    def stage(*_: Any, work: Any, inputs: Any, **more: Any) -> Any:
        found.update(inputs=inputs(), config=more["config"])
        return work(None)

    found = inputs
    ASKED.clear()
    monkeypatch.setattr(measurement, "run_stage", stage)
    monkeypatch.setattr(measurement, "subject_of", lambda of, sizes: subject())
    monkeypatch.setattr(measurement, "open_capture", lambda path: SimpleNamespace(digest=lambda: f"digest of {path}"))
    record = measure(tmp_path, Measurement("made", (), name, 2, 7), captured, Console(quiet=True))
    assert ASKED == [(name, 2, 7, captured)]
    assert record["error"] == 7.0
    assert found["inputs"] == ({} if captured is None else {"capture": "digest of c"})
    assert (found["config"]["knob"], found["config"]["setting"], found["config"]["seed"]) == (name, 2, 7)


def test_a_render_is_measured_with_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = list[int]()

    def bench(scene: str, size: int) -> Any:
        def made(name: str, setting: Any, seed: int) -> Any:
            seeds.append(seed)
            return SimpleNamespace(seconds=1.0, cpu_seconds=2.0, error=0.5)

        return SimpleNamespace(measure=made)

    monkeypatch.setattr(curves, "SceneBench", bench)
    knob = render(8).knobs[0]
    for seed in (3, 4):
        knob.measure(knob.settings[0], seed, None)
    assert seeds == [3, 4]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_an_option_has_the_value_of_the_first_method_that_has_it_open(
    order: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(options, "flattened", lambda config: config)
    plans: list[Any] = [
        SimpleNamespace(config={}, variant=SimpleNamespace(decides=lambda name: False)),
        SimpleNamespace(config={"fit.iterations": 5}, variant=SimpleNamespace(decides=lambda name: True)),
        SimpleNamespace(config={"fit.iterations": 7}, variant=SimpleNamespace(decides=lambda name: False)),
    ]
    assert options._first([plans[k] for k in order], "fit.iterations") == 7
    assert options._first(plans[:2], "fit.iterations") is None


def test_an_option_is_there_where_any_method_has_it() -> None:
    demo = EXPERIMENTS["demo"]
    assert "denoiser_steps" not in options.values(replace(demo, methods=("naive",)))
    for methods in (("naive", "nova"), ("nova", "naive")):
        assert options.values(replace(demo, methods=methods))["denoiser_steps"] > 0
