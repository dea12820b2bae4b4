"""Whole reconstructions as subjects: which methods, what a knob turns, and what of it is measured."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from novags.methods import METHODS
from novags.methods.knob import MethodKnob
from novags.methods.variant import parse_variant
from novags.settings import flattened
from novags.testbed.study.budget.known import SHIPPED
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.curves.curve import read_curves
from novags.testbed.study.curves.measuring import measurements_of
from novags.testbed.study.curves.study import STUDIES
from novags.testbed.study.knobs import reconstruction
from novags.testbed.study.knobs.knob import Knob, Reading, Setting, Subject
from novags.testbed.study.knobs.reconstruction import PresetBench, parts_of
from novags.testbed.study.knobs.subjects import chosen, subject_of, subjects
from sensor_model.files.toml_file import read_toml

HERE = Path("here")
SHAPE = MethodKnob(
    settings={"low": {"fit.sh_degree": 0, "init_scale": 0.5}, "own": {"fit.sh_degree": 1, "init_scale": 0.7}}, why="so",
    parts=("fit",),
)  # fmt: skip


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Subject:
    """The subject of a new method, which is `naive` under another name with one knob of two settings."""
    monkeypatch.setitem(METHODS, "mine", replace(METHODS["naive"], knobs={"shape": SHAPE}))
    return made_of("mine")


def made_of(name: str, quick: bool = False) -> Subject:
    """A method as its study measures it."""
    subject_of.cache_clear()
    file = STUDIES / "method.toml"
    measured = measurements_of(file, read_toml(file), subject=name, quick=quick).cells[0].measured
    assert measured is not None
    return measured.subject


def knob(subject: Subject, name: str) -> Knob:
    return next(knob for knob in subject.knobs if knob.name == name)


@dataclass
class Asked:
    """Stands for the measuring: keeps the experiments that it was to make."""

    configs: list[dict[str, Any]]
    seeds: list[tuple[str, int]]

    def __call__(self, bench: PresetBench, row: MethodKnob, setting: Setting, seed: int, captured: Path) -> Reading:
        preset = bench.preset(row, setting, seed)
        config = preset.reconstruct(preset.methods[0])
        self.configs.append({**flattened(config.config), "points": config.points, "width": preset.render.width})
        self.seeds.append((preset.render.scene, preset.capture.seed))
        return Reading(1.0, 1.0, 1.0)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    found = Asked([], [])
    monkeypatch.setattr(PresetBench, "measure", lambda *given: found(*given))
    return found


def test_a_method_with_a_row_of_knobs_is_a_subject_of_its_own(made: Subject) -> None:
    assert "mine" in subjects()
    names = [knob.name for knob in made.knobs]
    assert names == ["iterations", "shape", "samples per pixel", "resolution"]
    assert (made.name, made.workload["method"], made.workload["fit"]) == ("mine", "mine", 800)
    shape = knob(made, "shape")
    assert (shape.settings, shape.default, shape.why, shape.parts, shape.option) == (
        ("low", "own"), "own", "so", ("fit",), None,
    )  # fmt: skip


def test_a_knob_of_several_settings_turns_all_of_them_and_nothing_else(made: Subject, asked: Asked) -> None:
    shape = knob(made, "shape")
    shape.measure("own", 3, HERE), shape.measure("low", 3, HERE)
    own, low = asked.configs
    assert {name for name in own if own[name] != low[name]} == {"fit.sh_degree", "init_scale"}
    assert (low["fit.sh_degree"], low["init_scale"]) == (0, 0.5)
    assert asked.seeds == [("tabletop:3", 3)] * 2


def test_options_of_every_method_are_shares_of_the_presets_value(made: Subject, asked: Asked) -> None:
    iterations, size = knob(made, "iterations"), knob(made, "resolution")
    assert iterations.settings == (50, 100, 200, 400, 800, 2400)
    assert (iterations.default, iterations.option, size.settings, size.option) == (
        800,
        "iterations",
        (32, 45, 64),
        "size",
    )
    iterations.measure(50, 0, HERE), size.measure(32, 0, HERE)
    assert [config["fit.iterations"] for config in asked.configs] == [50, 800]
    assert [config["width"] for config in asked.configs] == [64, 32]


def test_iterations_and_size_change_the_time_of_the_parts_that_count_iterations() -> None:
    found = {}
    for name in ("nova", "nova-plus"):
        subject = made_of(name)
        found[name] = (set(knob(subject, "iterations").parts), set(knob(subject, "resolution").parts))
    fits = {"likelihood", "structure", "merged"}
    assert found == {"nova": ({"fit"}, {"render", "fit"}), "nova-plus": (fits, {"render", *fits})}


def test_an_option_that_the_method_does_not_have_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = MethodKnob(option="denoiser_steps", shares=(0.5, 1.0), why="so")
    monkeypatch.setitem(METHODS, "mine", replace(METHODS["naive"], knobs={"steps": steps}))
    with pytest.raises(ValueError, match="the knob steps turns denoiser_steps, which this method does not have"):
        made_of("mine")


def test_a_method_is_measured_as_the_variant_that_the_demonstration_has() -> None:
    found = {}
    for name in ("nova", "nova-plus"):
        found[name] = made_of(name, quick=True).workload["method"]
    assert found == {"nova": "nova-fast", "nova-plus": "nova-plus"}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("naive", "the method naive declares no knobs; these do: nova, nova-plus"),
        ("nova-fast", "nova-fast is a variant of nova, and knobs are measured by method: novags pareto nova"),
        ("naive-l1", "naive-l1 is a variant of naive, .*: one of nova, nova-plus"),
        ("nova-pluss", "one of render, sensor, splats, nova, nova-plus, all; .*did you mean 'nova-plus'"),
    ],
)
def test_what_cannot_be_measured_is_refused_with_what_can(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        chosen(name)


def test_all_is_every_part_and_every_method_with_knobs() -> None:
    assert len(chosen("all")) == len(subjects())
    assert list(subjects()) == ["render", "sensor", "splats", "nova", "nova-plus"]


def test_the_seconds_of_a_part_are_those_of_its_own_steps() -> None:
    """Rationale: between two parts lies work that no setting of their steps changes."""
    stamps = {10: 1.0, 20: 2.0, 30: 3.0, 40: 53.0, 50: 55.0, 60: 57.0, 64: 70.0}
    found = parts_of(stamps, {"first": 30, "second": 30, "last": 4})
    assert found == pytest.approx({"first": 3.0, "second": 6.0, "last": 13.0})  # 2 s in 20 steps, 4 s in 20, 13 s
    assert parts_of({}, {"a": 5}) == {"a": 0.0}


def test_curves_that_came_with_novags_are_of_knobs_that_are_there() -> None:
    points = read_curves(SHIPPED)
    for name in ("nova", "nova-plus"):
        subject = made_of(name)
        own = [point for point in points if point["knob"].startswith(f"{name}.")]
        assert own
        work = ("method", "scene", "views", "size", "samples per pixel", "sensor", "electrons", "points")
        # what the method's parts are, and how many steps each has, may have changed since
        assert all({key: point["workload"][key] for key in work} == {key: subject.workload[key] for key in work}
                   for point in own)  # fmt: skip
        settings = {f"{name}.{knob.name}": knob.settings for knob in subject.knobs}
        assert all(point["setting"] in settings[point["knob"]] for point in own)


def test_the_smaller_demonstration_differs_from_the_preset_in_what_is_said_alone() -> None:
    said = made_of("nova-plus").workload
    demo = EXPERIMENTS["demo"]
    small = adapted(demo, width=64, height=64, points=3200, n_views=16, iterations=800, denoiser_steps=128)
    config = flattened(small.reconstruct("nova-plus").config)
    assert reconstruction.SCENE == demo.render.scene
    assert said["points"] / 64**2 == pytest.approx(demo.points / demo.render.width**2, rel=1e-6)
    assert (said["likelihood"], said["structure"], said["merged"]) == (2 * 333, 2 * 333, 67)
    assert config["fit.iterations"] == 800


def test_variants_can_be_given_the_settings_of_a_row() -> None:
    """Rationale: a row is how a user finds the setting; it must work on the command line as it stands."""
    width = METHODS["nova"].knobs["width"].settings["8-16-32-48"]
    text = ";".join(f"{name}={','.join(map(str, v)) if isinstance(v, tuple) else v}" for name, v in width.items())
    config = parse_variant(f"thin=nova:{text}").config(METHODS["nova"].config(), {})
    assert (config.denoiser.network.widths, config.denoiser.network.bottleneck) == ((8, 16, 32), 48)
