"""Claims about presets, their adaptation, plain progress and doctor's findings."""

import io
import subprocess
import sys

import pytest
from novags.methods.table import METHODS, method_config, suited

from novags.testbed.console import Console, losses_text
from novags.testbed.presets import PRESETS, adapted
from novags.testbed.stages.capture import CaptureConfig
from novags.testbed.stages.reconstruct import ReconstructConfig
from novags.testbed.stages.render import RenderConfig
from sensor_model import PRESETS as SENSORS


def test_adapting_changes_what_is_named_and_nothing_else() -> None:
    demo = PRESETS["demo"]
    assert adapted(demo) == demo
    changed = adapted(demo, electrons=5.0, iterations=7, width=64)
    assert changed.capture.electrons == 5.0
    assert changed.nova.fit.iterations == 7
    assert changed.render.width == 64
    assert adapted(changed, electrons=20.0, iterations=demo.nova.fit.iterations, width=demo.render.width) == demo


@pytest.mark.parametrize("name", PRESETS)
def test_presets_compare_with_floor_and_ceiling(name: str) -> None:
    assert {"nova", "naive", "oracle"} <= set(PRESETS[name].methods)


def test_methods_share_enhancement_and_fit() -> None:
    nova = PRESETS["demo"].nova
    configs = {name: method_config(name, nova) for name in METHODS}
    assert all(config.enhance == nova.enhance for config in configs.values())
    assert configs["naive"].fit == configs["oracle"].fit == nova.fit
    assert configs["naive-l1"].fit.dssim_weight == 0


def test_channels_are_blinded_alone_only_where_their_noise_is_independent() -> None:
    nova = PRESETS["demo"].nova
    assert nova.denoiser.blind_spots.per_channel
    assert suited(nova, SENSORS["a7s2-iso6400-3chip"]) == nova
    assert not suited(nova, SENSORS["a7s2-iso6400"]).denoiser.blind_spots.per_channel
    assert not suited(nova, SENSORS["a7s2-iso6400-3chip"], color_matrix=True).denoiser.blind_spots.per_channel
    assert suited(PRESETS["paper"].nova, SENSORS["a7s2-iso6400"]) == PRESETS["paper"].nova


def test_a_denoiser_setting_does_not_make_the_naive_run_stale() -> None:
    demo, other = PRESETS["demo"], adapted(PRESETS["demo"], denoiser_steps=1)
    naive, nova = (
        [ReconstructConfig(method=m, points=100, nova=p.nova).resolved() for p in (demo, other)]
        for m in ("naive", "nova")
    )
    assert naive[0] == naive[1]
    assert nova[0] != nova[1]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"electrons": 0.0}, "electrons"),
        ({"electrons": float("nan")}, "electrons"),
        ({"sensor": "kodak"}, "unknown sensor"),
        ({"demosaic": "none"}, "demosaic"),
        ({"demosaic": "half"}, "demosaic must be one of menon, malvar, bilinear, got 'half'"),
        ({"seed": -1}, "seed"),
        ({"time": -1.0}, "time"),
        ({"tolerance": -1.0}, "sd must be > 0"),
    ],
)
def test_impossible_captures_are_refused(values: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        CaptureConfig(**values)


def test_plain_progress_ends_with_the_last_step_and_has_no_control_codes() -> None:
    stream = io.StringIO()
    with Console(stream=stream).progress("fit") as progress:
        for done in range(1, 101):
            progress(done, 100, losses_text({"loss": 0.5, "iteration": float(done)}))
    lines = stream.getvalue().splitlines()
    assert lines[-1] == "fit: 100/100  loss 0.5000"
    assert "\x1b" not in stream.getvalue()


def test_a_warning_is_said_once() -> None:
    stream = io.StringIO()
    console = Console(stream=stream)
    console.warn("17 images are missing")
    console.warn("17 images are missing")
    assert stream.getvalue().count("17 images") == 1


def test_peak_memory_sees_a_large_array_and_forgets_it() -> None:
    """In a process of its own: what other tests have freed goes back to the system when it likes."""
    size = 200_000_000
    code = (
        "from novags.testbed.provenance import PeakMemory as P\n"
        f"print(P().peak_bytes()); p = P(); b = bytearray(b'1') * {size}\n"
        "print(p.peak_bytes()); del b; print(P().peak_bytes())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    before, during, after = map(int, done.stdout.split())
    assert during - before > 0.8 * size
    assert during - after > 0.8 * size


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"spp": 0}, "spp must be >= 2"),
        ({"spp": None}, "either spp or target_error"),
        ({"target_error": 0.1}, "either spp or target_error"),
        ({"spp": None, "target_error": -1.0}, "target_error must lie in"),
        ({"seed": -1}, "seed"),
        ({"variant": "nope"}, "variant must be of auto, .* got nope"),
        ({"on": ("foo",)}, "on and off must be of indirect light, .* got foo"),
        ({"on": ("indirect light",), "off": ("indirect light",)}, "indirect light: forced on and off"),
        ({"export": ("fbx",)}, "export must be of blender, llff; got fbx"),
    ],
)
def test_impossible_renders_are_refused(values: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        RenderConfig(**values)


def test_settings_that_only_the_last_stage_needs_are_checked_before_the_first() -> None:
    with pytest.raises(ValueError, match="points must be >= 4, got -5"):
        adapted(PRESETS["demo"], points=-5)
