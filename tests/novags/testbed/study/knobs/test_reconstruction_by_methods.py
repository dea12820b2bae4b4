"""Whole reconstructions as subjects: which methods, what a knob turns, and what of it is measured."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from novags.methods import METHODS
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.knob import MethodKnob
from novags.methods.variant import parse_variant
from novags.settings import flattened
from novags.testbed.study.budget.known import SHIPPED
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.curves.curve import read_curves
from novags.testbed.study.curves.measuring import measurements_of
from novags.testbed.study.curves.study import STUDIES
from novags.testbed.study.knobs import methods as of_methods
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


def test_a_splat_is_dilated_by_as_much_of_the_picture_at_the_full_size(monkeypatch: pytest.MonkeyPatch) -> None:
    dilations: list[float] = []

    def render(scene: GaussianScene, views: Any) -> Any:
        dilations.append(scene.eps2d)
        return torch.zeros(1, 4, 4, 3), None, None

    frame = SimpleNamespace(of=lambda *given: SimpleNamespace(view=lambda i, device: None))
    monkeypatch.setattr(GaussianScene, "render", render)
    monkeypatch.setattr(reconstruction, "CoordinateFrame", frame)
    monkeypatch.setattr(reconstruction, "pictured", lambda run, capture, rendered: rendered)
    monkeypatch.setattr(reconstruction, "enhanced_truth", lambda *given: None)
    monkeypatch.setattr(reconstruction, "aligned_psnr", lambda *given: 20.0)
    rigs = (SimpleNamespace(rig=SimpleNamespace(width=width), test_indices=[0]) for width in (16, 48))
    small, whole = (SimpleNamespace(cameras=rig) for rig in rigs)
    result: Any = SimpleNamespace(scene=GaussianScene(None, 0.3, False), enhancement={}, viewmats=None)
    prepared: Any = SimpleNamespace(indices=[], estimate=None, device="cpu")
    assert reconstruction.held_out_error(result, prepared, small, whole) == pytest.approx(10.0)  # 20 dB below white
    assert dilations == [pytest.approx(9 * 0.3)]  # px^2, three times as many px


def test_every_held_out_view_counts_in_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {2: 10.0, 5: None, 7: 30.0}
    scene = SimpleNamespace(render=lambda view: (torch.full((1, 2, 2, 3), float(view)), None, None))
    frame = SimpleNamespace(of=lambda *given: SimpleNamespace(view=lambda i, device: i))
    monkeypatch.setattr(reconstruction, "CoordinateFrame", frame)
    monkeypatch.setattr(reconstruction, "pictured", lambda run, capture, rendered: rendered)
    monkeypatch.setattr(reconstruction, "enhanced_truth", lambda truth, i, enhancement: i)
    monkeypatch.setattr(reconstruction, "aligned_psnr", lambda image, i: scores[i] if image.mean() == i else -1.0)
    cameras = SimpleNamespace(rig=SimpleNamespace(width=16), test_indices=[2, 5, 7])
    capture: Any = SimpleNamespace(cameras=cameras, path=HERE)
    result: Any = SimpleNamespace(scene=scene, enhancement={}, viewmats=None)
    prepared: Any = SimpleNamespace(indices=[], estimate=None, device="cpu")
    assert reconstruction.held_out_error(result, prepared, capture, capture) == pytest.approx(10.0)  # 20 dB on average
    cameras.test_indices = [5]
    with pytest.raises(ValueError, match="has contrast"):
        reconstruction.held_out_error(result, prepared, capture, capture)


@pytest.mark.parametrize("seed", [0, 3])
def test_the_seed_is_that_of_the_scene_and_of_the_noise_whatever_is_turned(seed: int, asked: Asked) -> None:
    bench = PresetBench(adapted(EXPERIMENTS["demo"], methods=("naive",)))
    rows = (MethodKnob(option="iterations", shares=(0.5, 1.0), why="so", parts=()), SHAPE)
    for preset in (bench.plain(seed), *(bench.preset(row, "low" if row is SHAPE else 9, seed) for row in rows)):
        assert (preset.render.scene, preset.capture.seed) == (f"{reconstruction.SCENE}:{seed}", seed)
    turned = bench.knob("iterations", rows[0])
    turned.measure(turned.settings[0], seed, HERE)
    assert asked.seeds == [(f"{reconstruction.SCENE}:{seed}", seed)]


@pytest.mark.parametrize("option", ["iterations", "spp", "size"])
def test_a_measurement_prepares_and_scores_the_experiment_of_its_seed(
    option: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Nothing is trained: what would be is written down."""
    seen = dict[str, Any]()
    bench = PresetBench(adapted(EXPERIMENTS["demo"], methods=("naive",)))
    row = MethodKnob(option=option, shares=(0.5, 1.0), why="so", parts=())

    def photographed(preset: Any, folder: Path) -> Any:
        seen["photographed"] = preset
        (folder / "set").mkdir(parents=True)
        (folder / "set" / "set.json").write_text('{"seconds": {"load": 1.0, "radiance": 3.0}}')
        return SimpleNamespace(name="turned", source=lambda console: None)

    def prepare(capture: Any, source: Any, config: Any, console: Any) -> str:
        seen.update(prepared=(capture.name, config))
        return "prepared"

    def error(result: Any, prepared: Any, capture: Any, truth: Any) -> float:
        seen["scored"] = (capture.name, truth.name)
        return 0.5

    plain = SimpleNamespace(name="plain", source=lambda console: None)
    monkeypatch.setattr(reconstruction, "open_capture", lambda folder: plain)
    monkeypatch.setattr(reconstruction, "photographed", photographed)
    monkeypatch.setattr(reconstruction, "prepare", prepare)
    monkeypatch.setattr(reconstruction, "timed", lambda prepared, config: ((2.0, 4.0), {"fit": 3.0}, None))
    monkeypatch.setattr(reconstruction, "held_out_error", error)
    found = bench.measure(row, 16, 5, tmp_path)
    name, config = seen["prepared"]
    assert config.seed == 5
    assert found.error == 0.5
    assert found.parts["fit"] == 3.0
    if option == "iterations":
        assert (name, seen["scored"]) == ("plain", ("plain", "plain"))
        assert (found.seconds, found.cpu_seconds) == (2.0, 4.0)
    else:
        assert seen["photographed"].render.scene == f"{reconstruction.SCENE}:5"
        assert seen["photographed"].capture.seed == 5
        assert (name, seen["scored"]) == ("turned", ("turned", "plain" if option == "size" else "turned"))


def test_the_modules_of_a_bench_are_those_of_every_setting_of_every_knob(monkeypatch: pytest.MonkeyPatch) -> None:
    """A setting may turn to another enhancer, whose code then counts."""
    turns = {"own": {"enhance.window": 9}, "other": {"enhance.window": 11}}
    monkeypatch.setitem(METHODS, "mine", replace(METHODS["naive"], knobs={
        "shape": SHAPE, "window": MethodKnob(settings=turns, why="so", parts=())}))  # fmt: skip
    used = list[str]()
    plain = PresetBench.preset

    def preset(bench: PresetBench, row: MethodKnob, setting: Setting, seed: int) -> Any:
        used.append(str(setting))
        return plain(bench, row, setting, seed)

    monkeypatch.setattr(PresetBench, "preset", preset)
    bench = PresetBench(adapted(EXPERIMENTS["demo"], methods=("mine",)))
    found = bench.modules()
    assert used == ["low", "own", "own", "other"]
    code = bench.reconstruct.code
    assert set(code.roots) <= set(found)
    assert set(bench.base.render.code.roots) <= set(found)
    assert found[0] == reconstruction.__name__


@pytest.mark.parametrize("k", range(3))
def test_a_method_is_measured_as_the_first_variant_of_it_wherever_that_stands(
    k: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [("nova-fast", "nova"), ("naive-l1", "naive"), ("oracle", "oracle")]
    monkeypatch.setattr(of_methods, "PRESET", SimpleNamespace(methods=tuple(name for name, _ in names)))
    variant, method = names[k]
    assert of_methods.measured_as(method) == variant
    assert of_methods.measured_as("gamma") == "gamma"
