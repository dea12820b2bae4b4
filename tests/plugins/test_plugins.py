"""The planner knows every plugin of Mitsuba, follows fully what it does not know, and its bounds hold."""

import gc
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from simscenes import plan_transport
from simscenes.backend import activate, using_variant
from simscenes.loading.checks.untrusted import mitsuba_folder
from simscenes.loading.load import build_in_fewest_colors, build_scene
from simscenes.transport import effects, plan, planner
from simscenes.transport.plugins import UNDERSTOOD, filters_in, not_understood
from tests.plugins import files
from tests.plugins.__main__ import line
from tests.plugins.compare import all_rows, moved, passes
from tests.plugins.row import Row, ball, grey, matt, plate, rig, stage

# Of which no light depends: what is sampled how, filtered how and averaged how is ours, not the file's.
OURS = {
    "sampler": {"independent", "stratified", "multijitter", "orthogonal", "ldsampler"},
    "rfilter": {"box", "catmullrom", "gaussian", "lanczos", "mitchell", "tent"},
    "integrator": {"aov", "depth", "direct", "moment", "path", "ptracer", "stokes", "volpath", "volpathmis"},
    "sensor": {"batch", "distant", "irradiancemeter", "orthographic", "perspective", "radiancemeter", "thinlens"},
    "film": {"hdrfilm", "specfilm"},
    "shape": {"blender"},  # Blender's memory, not a file
}
NAMED = {row.name: row for row in all_rows()}


def test_every_plugin_has_a_scene() -> None:
    here = {path.name.partition(".")[0] for path in (mitsuba_folder() / "plugins").iterdir()}
    assert here - set().union(*OURS.values()) == {row.plugin for row in all_rows()}


@pytest.mark.parametrize("kind", ["bsdf", "emitter", "medium", "phase", "volume", "texture", "spectrum", "shape"])
def test_every_plugin_is_understood(kind: str, tmp_path: Path) -> None:
    with using_variant("scalar") as mi:
        scenes = [(row.name, row.make(mi, tmp_path)) for row in all_rows() if row.kind == kind]
        for name, scene in scenes:
            if name in ("directionalarea", "timed_sunsky"):
                continue
            loaded = build_in_fewest_colors(scene, "scalar")
            with using_variant(loaded.variant) as other:
                assert not_understood(loaded.scene, other) == [], name


def test_what_is_in_doubt_is_simulated_fully(monkeypatch: pytest.MonkeyPatch) -> None:
    """A material of a later Mitsuba, a light inside a group: whatever is not listed."""
    mi = activate()
    strange = build_scene(
        stage(mi, thing=ball({"type": "blendbsdf", "weight": 0.5, "a": matt(), "b": {"type": "hair"}})), mi
    )
    assert not_understood(strange.scene, mi) == []
    monkeypatch.setattr("simscenes.transport.plugins.UNDERSTOOD", UNDERSTOOD - {"Hair", "AreaLight"})
    assert not_understood(strange.scene, mi) == ["AreaLight", "Hair"]
    some = [effects.decided(name, False, 0.0, 0.004, "found") for name in plan.EFFECTS]
    everything: Any = SimpleNamespace(loads=lambda color: True)
    found = {e.name: e for e in planner.in_full(some, everything, ["Hair"])}
    assert {name for name, e in found.items() if e.on} == {
        plan.INDIRECT, plan.DEEP, plan.ROULETTE, plan.MEDIA, plan.SPECTRAL, plan.POLARISATION
    }  # fmt: skip
    assert found[plan.DEEP].reason == "the planner does not know Hair: simulated fully"
    rgb: Any = SimpleNamespace(loads=lambda color: False)
    lacking = {e.name: e for e in planner.in_full(some, rgb, ["Hair"])}[plan.SPECTRAL]
    assert (lacking.on, lacking.contribution) == (False, np.inf)
    assert lacking.reason == "the planner does not know Hair, and the scene cannot be loaded with it"


@pytest.mark.slow
@pytest.mark.usefixtures("jit")
def test_two_polarisers_are_measured_although_nobody_asked_for_it(tmp_path: Path) -> None:
    scene = NAMED["polarizer, two in parallel"].make(activate(), tmp_path)
    made = plan_transport(scene, rig=rig(), measure=False)
    assert made.color == "spectral_polarized"
    assert 0.02 < made["polarisation"].contribution < 0.3
    assert made["polarisation"].reason.endswith("behind LinearPolarizer")


def test_a_scalar_variant_simulates_filters_unmeasured(tmp_path: Path) -> None:
    scene = NAMED["polarizer, two in parallel"].make(activate(), tmp_path)
    made = plan_transport(scene, rig=rig(), measure=False, variant="scalar")
    assert made.color == "spectral_polarized"
    assert made["polarisation"].reason == "the scene holds LinearPolarizer, not quantified in scalar"


def test_two_parallel_polarisers_halve_once_and_two_crossed_ones_stop_all() -> None:
    """In front of a white sky. Without polarisation each of them halves, which is why it has to be planned."""
    middle = 14  # of 36 blocks, one that the plates cover

    def seen(turned: tuple[float, ...], color: str = "spectral_polarized") -> float:
        mi = activate()
        filters = {f"p{k}": plate(mi, -0.2 * k, {"type": "polarizer"}, 0.8, a) for k, a in enumerate(turned)}
        scene = {"type": "scene", "sky": {"type": "constant", "radiance": grey(1.0)}, **filters}
        return float(passes(scene, {"type": "path", "max_depth": 8, "rr_depth": 9}, color, 0)[:, middle].mean())

    assert seen((0, 0)) == pytest.approx(0.5, abs=1e-3)
    assert seen((0, 90)) == pytest.approx(0.0, abs=0.01)  # tilted a little, they let some pass
    assert seen((0, 0), "rgb") == pytest.approx(0.25, abs=1e-3)


def test_a_point_lamp_shines_through_a_mask(tmp_path: Path) -> None:
    """Only the volumetric integrators follow a shadow ray through it."""
    mi = activate()
    scene = NAMED["mask, before a point lamp"].make(mi, tmp_path)
    made = plan_transport(scene, rig=rig(), measure=False, variant="scalar")
    assert made.integrator()["type"] == "volpath"
    assert made["participating media"].reason.startswith("point lights shine through MaskBSDF: without, ")
    assert made["participating media"].contribution > 0.1
    plain = build_scene(NAMED["mask"].make(mi, tmp_path), mi)  # a lamp of some size is found by chance as well
    assert effects.screens_before_points(plain.scene, mi) == []


def test_filters_are_told_from_other_straight_materials(tmp_path: Path) -> None:
    mi = activate()
    for name, filters in (("polarizer, alone", ["LinearPolarizer"]), ("null", []), ("thindielectric", [])):
        assert filters_in(build_scene(NAMED[name].make(mi, tmp_path), mi).scene, mi) == filters


def test_light_that_no_camera_finds_is_refused(tmp_path: Path) -> None:
    mi = activate()
    with pytest.raises(ValueError, match="'directionalarea' emitter, whose light no path"):
        build_scene(NAMED["directionalarea"].make(mi, tmp_path), mi)


def test_a_scene_for_spectra_leaves_nothing_behind_that_rgb_stumbles_over(tmp_path: Path) -> None:
    """Mitsuba's llvm variants trace what every object alive would do, also those of scenes that were refused."""
    rows = {(row.name, row.note): row for row in all_rows()}
    gc.disable()  # it would help now and then
    try:
        made = [plan_transport(rows[which, ""].make(activate(), tmp_path), rig=rig(), measure=False)
                for which in ("irregular", "cube")]  # fmt: skip
    finally:
        gc.enable()
    assert [one.color for one in made] == ["spectral", "rgb"]


def test_a_light_that_mitsuba_cannot_render_is_refused(tmp_path: Path) -> None:
    mi = activate()
    with pytest.raises(ValueError, match="the scene holds a 'timed_sunsky': Mitsuba's llvm and cuda"):
        build_scene(NAMED["timed_sunsky"].make(mi, tmp_path), mi)


def test_a_raw_bitmap_as_a_colour_keeps_a_scene_in_rgb(tmp_path: Path) -> None:
    """It has no spectrum: spectral variants of Mitsuba stop in the middle of a render. As a number it is in no way."""

    def scene(*names: str) -> dict[str, Any]:
        raw = {"type": "bitmap", "filename": files.picture(tmp_path / "t.exr"), "raw": True}
        shape = {"type": "sphere", "bsdf": {"type": "principled", **dict.fromkeys(names, raw)}}
        return {"type": "scene", "lamp": {"type": "constant"}, "shape": shape}

    made = plan_transport(scene("base_color"), rig=rig())
    assert made.color == "rgb"
    assert made[plan.SPECTRAL].reason == "the scene holds parts made for RGB alone"
    with pytest.raises(ValueError, match="forced on, but the scene holds parts made for RGB alone: "):
        plan_transport(scene("base_color"), rig=rig(), force={plan.SPECTRAL: True})
    with using_variant("scalar", "spectral") as mi:
        with pytest.raises(ValueError, match="raw = true as base_color: it has no spectrum"):
            build_scene(scene("roughness", "base_color"), mi)
        build_scene(scene("roughness"), mi)


def test_a_medium_that_some_wavelengths_pass_unhindered_is_planned(tmp_path: Path) -> None:
    """Mitsuba's `volpath` gives nan in it, `volpathmis` does not."""
    (row,) = (row for row in all_rows() if (row.kind, row.note) == ("medium", "a measured spectrum"))
    made = plan_transport(row.make(activate(), tmp_path), rig=rig(), measure=False)
    assert (made.color, made.integrator()["type"]) == ("spectral", "volpathmis")


def test_differences_are_told_from_noise() -> None:
    """Of 36 blocks half lose and half win 0.1 of 1; noise of another 0.1 a pass adds nothing on average."""
    random = np.random.default_rng(0)
    signs = np.where(np.arange(36) % 2, 1, -1)[:, None]
    plain, full = (1 + 0.1 * random.standard_normal((16, 36, 3)) for _ in range(2))
    change, error = moved(plain, full + 0.1 * signs)
    assert change == pytest.approx(0.1, abs=5 * error)
    assert error < 0.01
    none, error = moved(plain, full)
    assert none == pytest.approx(0, abs=5 * error)


@pytest.mark.slow
@pytest.mark.usefixtures("jit")
@pytest.mark.parametrize("row", all_rows(), ids=lambda row: f"{row.kind}-{row.name}")
def test_the_difference_from_everything_on_is_within_the_bound(row: Row, tmp_path: Path) -> None:
    """With -s, the lines that `python -m tests.plugins` keeps."""
    found = line(row, tmp_path)
    print(json.dumps(found))
    assert found.get("refused") or found["holds"]
