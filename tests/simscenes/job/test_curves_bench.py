"""What the cost curves make of renders: errors, spreads and settings, on renders made by hand."""

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simscenes import default_rig
from simscenes.job import curves
from simscenes.job.curves import DEFAULT, KNOBS, SceneBench, Setting, TimedError, settings_of, unit_of
from simscenes.render import radiance

TRUTHS = [np.arange(1.0, 13.0).reshape(2, 2, 3) * level for level in (1.0, 2.0, 5.0)]


@pytest.fixture
def bench() -> SceneBench:
    """A bench that has rendered nothing yet."""
    made = SceneBench.__new__(SceneBench)
    made.scene, made.weights = "cornell", ()
    made.rig = default_rig("cornell", 3, 4, 2)
    made._loaded, made._references = {}, {}
    return made


def test_noise_is_the_relative_error_without_that_of_the_reference(
    bench: SceneBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A checkerboard of +-e on each view, relative to its mean: e = 0.1, 0.2, 0.4 first, then three times that."""
    sign = np.array([[1, -1], [-1, 1]])[..., None] * np.ones(3)
    asked: list[Any] = []

    def rendered(s: Setting, i: int, seed: int) -> tuple[np.ndarray, float, float]:
        asked.append((i, seed))
        error = 0.1 * 2**i * (1 if seed == 40 else 3)
        return TRUTHS[i] + error * TRUTHS[i].mean() * sign, 3.0**i, 5.0**i

    monkeypatch.setattr(bench, "reference", lambda s: TRUTHS if s.color == "rgb" else None)
    monkeypatch.setattr(bench, "render", rendered)
    found = [bench.noise(Setting(color="spectral"), seed) for seed in (40, 41)]
    assert asked == [(i, seed) for seed in (40, 41) for i in range(3)]
    expected = [np.sqrt((0.01 + 0.04 + 0.16) / 3 * scale - 1e-4) for scale in (1, 9)]
    assert [each.error for each in found] == pytest.approx(expected)
    assert {(each.seconds, each.cpu_seconds) for each in found} == {(3.0, 5.0)}  # the medians
    monkeypatch.setattr(bench, "render", lambda s, i, seed: (TRUTHS[i], 1.0, 1.0))
    assert bench.noise(Setting(), 0).error == 0  # not less than the reference can tell


def test_light_is_missing_against_the_same_paths_followed_further(
    bench: SceneBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """View i lacks 1, 2, 4 % of its light, and twice that with the second seed."""
    asked = list[tuple[int, int, int]]()

    def rendered(s: Setting, i: int, seed: int) -> tuple[np.ndarray, float, float]:
        asked.append((i, s.max_depth, seed))
        lack = 0.0 if s.max_depth == 64 else 0.01 * 2**i * (seed - 39)
        assert s.spp == 16
        seconds = 100.0 if s.max_depth == 64 else 2.0 + i
        return TRUTHS[i] * (1 - lack), seconds, 2 * seconds

    monkeypatch.setattr(bench, "render", rendered)
    first, second = (bench.missing(Setting(spp=16, max_depth=3), seed) for seed in (40, 41))
    assert asked == [(i, depth, seed) for seed in (40, 41) for i in range(3) for depth in (3, 64)]
    assert (first.error, second.error) == pytest.approx((0.07 / 3, 0.14 / 3))
    assert (first.seconds, first.cpu_seconds) == (3, 6)


def test_a_view_is_prepared_with_its_seed(bench: SceneBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curves, "RenderedView", lambda method, rig, i: (method.seed, i))
    monkeypatch.setattr(curves, "integrator", lambda *_: None)
    mi, loaded = SimpleNamespace(variant=lambda: "scalar_rgb"), SimpleNamespace()
    assert [bench.view(mi, loaded, DEFAULT, i, seed) for i, seed in ((0, 40), (2, 41))] == [(40, 0), (41, 2)]  # type: ignore[arg-type]


def test_the_reference_is_deep_and_shares_no_random_numbers_with_what_is_measured(
    bench: SceneBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is rendered once for each kind of colours, to the error that is subtracted later."""
    made: list[Any] = []

    @contextmanager
    def ready(s: Setting) -> Iterator[Any]:
        yield "mi", "loaded"

    def view(mi: Any, loaded: Any, s: Setting, i: int, seed: int) -> Any:
        made.append((s, i, seed))
        mean = np.full((2, 4, 3), i, np.float32)
        return SimpleNamespace(render=lambda spp, error: SimpleNamespace(mean=mean * (spp is None) * (error == 0.01)))

    monkeypatch.setattr(bench, "ready", ready)
    monkeypatch.setattr(bench, "view", view)
    for color in ("rgb", "spectral", "rgb"):
        images = bench.reference(Setting(spp=4, max_depth=2, color=color))
        assert [(image.dtype, image.min(), image.max()) for image in images] == [(np.float64, i, i) for i in range(3)]
    expected = [(Setting(max_depth=64, color=color), i) for color in ("rgb", "spectral") for i in range(3)]
    assert [(s, i) for s, i, _ in made] == expected
    assert min(seed for _, _, seed in made) >= 1e5  # seeds of measurements count from 0


@pytest.mark.parametrize(("sampler", "samples"), [(curves.OWN, "even"), (curves.OWN, "uneven"), ("stratified", "even")])
def test_a_view_is_timed_when_its_kernels_are_compiled(
    sampler: str, samples: str, bench: SceneBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first of two runs takes 46 s more; sensors and integrators, which take 100 s here, are made before."""
    clock, runs = SimpleNamespace(now=5.0), []
    clocks = SimpleNamespace(perf_counter=lambda: clock.now, process_time=lambda: 2 * clock.now)
    monkeypatch.setattr(curves, "time", clocks)

    def run(kind: str, spp: int) -> Any:
        clock.now += 50 if not runs else 4
        runs.append((kind, spp))
        return np.full((2, 4, 4), 7.0, np.float32)

    def slow(made: Any) -> Any:
        clock.now += 100
        return made

    class Seen:
        def __init__(self, *about: Any) -> None:
            asked.append(about)
            self.samples = SimpleNamespace(mean=lambda: np.full((2, 4, 3), 7.0))

        @property
        def sensors(self) -> Any:
            return slow(["sensor"])

        def render(self, spp: int, target_error: None) -> None:
            run("even", spp)

        def spread(self, spp: int) -> None:
            run("uneven", spp)

    def plain(scene: Any, sensor: Any, integrator: Any, spp: int, seed: int) -> Any:
        assert sensor == {"sampler": {"type": "stratified", "sample_count": 64}, "fov": 1}
        assert seed == radiance.view_seed(bench.rig, 2, 11)
        asked.append((2, 11))
        return run("even", spp)

    @contextmanager
    def ready(s: Setting) -> Iterator[Any]:
        yield SimpleNamespace(load_dict=slow, render=plain), SimpleNamespace(scene="scene")

    monkeypatch.setattr(curves, "sensor_dict", lambda *a: {"fov": 1})
    monkeypatch.setattr(curves, "integrator", lambda mi, s: slow("path"))
    asked: list[Any] = []
    monkeypatch.setattr(bench, "ready", ready)
    monkeypatch.setattr(bench, "view", lambda mi, loaded, s, i, seed: Seen(i, seed))
    image, seconds, cpu = bench.render(Setting(spp=64, samples=samples, sampler=sampler), 2, 11)
    assert (image == 7).all()
    assert asked == [(2, 11)] * 2
    assert runs == [(samples, 64)] * 2
    assert (seconds, cpu) == (4, 8)


def test_lights_are_weighed_where_the_setting_says_so(bench: SceneBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """And every variant loads the scene once."""
    loads, weights = [], []

    @contextmanager
    def variant(backend: str, color: str) -> Iterator[Any]:
        yield SimpleNamespace(variant=lambda: f"{backend}_{color}")

    def load(scene: str, mi: Any) -> Any:
        loads.append((scene, mi.variant()))
        return SimpleNamespace(scene=SimpleNamespace(emitters=lambda: [0] * 4))

    monkeypatch.setattr(curves, "using_variant", variant)
    monkeypatch.setattr(curves, "build_scene", load)
    monkeypatch.setattr(curves, "set_light_weights", lambda loaded, w, mi: weights.append(w))
    bench.weights = (0.5, 0.25, 0.125, 0.125)
    scalar = Setting(variant="scalar")
    for s in (scalar, Setting(variant="scalar", lights="equal"), Setting(variant="scalar", color="spectral")):
        with bench.ready(s) as (mi, _):
            assert mi.variant() == f"scalar_{s.color}"
    bench.weights = ()
    with bench.ready(scalar):
        pass
    even = (0.25,) * 4
    assert weights == [(0.5, 0.25, 0.125, 0.125), even, (0.5, 0.25, 0.125, 0.125), even]
    assert loads == [("cornell", "scalar_rgb"), ("cornell", "scalar_spectral")]


@pytest.mark.parametrize("seed", [0, 9])
def test_the_seed_draws_the_weights_of_the_lamps(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def weighed(mi: Any, loaded: Any, rig: Any, seed: int) -> tuple[float, ...]:
        asked.append(seed)
        return (0.75, 0.25)

    @contextmanager
    def ready(self: SceneBench, s: Setting) -> Iterator[Any]:
        yield "mi", "loaded"

    monkeypatch.setattr(SceneBench, "ready", ready)
    monkeypatch.setattr(curves, "light_weights", weighed)
    assert SceneBench("cornell", 4, seed=seed).weights == (0.75, 0.25)
    assert asked == [seed]


def test_every_knob_is_turned_alone(bench: SceneBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Depth is measured as missing light, colours against full spectra, the rest as noise; missing variants not."""
    asked: list[tuple[Setting, int, str]] = []

    def measured(s: Setting, seed: int, by: str = "missing") -> TimedError:
        asked.append((s, seed, by))
        return TimedError(1.0, 2.0, 3.0)

    monkeypatch.setattr(bench, "noise", measured)
    monkeypatch.setattr(bench, "missing", measured)
    works = {"scalar": True, "llvm_ad": True, "cuda_ad": False}  # asked about nothing else
    monkeypatch.setattr(curves, "backend_status", lambda name: (works[name], ""))
    monkeypatch.setattr(curves, "backend_of", lambda: "llvm_ad")
    wanted = [(knob, value) for knob in KNOBS for value in settings_of(knob)[0]]
    assert wanted == [(knob, value) for knob, values in KNOBS.items() for value in values if value != "cuda_ad"]
    for knob, value in wanted:
        assert bench.measure(knob, value, 6) == TimedError(1.0, 2.0, 3.0)
        turned, seed, by = asked[-1]
        changed = {k for k, v in vars(turned).items() if v != getattr(DEFAULT, k)}
        assert changed <= {knob}
        assert getattr(turned, knob) == value
        assert seed == 6
        assert by == {"max_depth": "missing", "color": "spectral"}.get(knob, "rgb")
    defaults = {knob: settings_of(knob)[1] for knob in KNOBS}
    assert defaults == {knob: getattr(DEFAULT, knob) for knob in KNOBS} | {"variant": "llvm_ad"}
    assert {unit_of(knob) for knob in KNOBS if knob != "max_depth"} == {"relative RMSE"}
    assert unit_of("max_depth") == "share of all light"
