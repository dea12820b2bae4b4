"""The error that a render of a dense medium claims covers its distance from a reference of great depth."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import Rig, render_set
from simscenes.backend import activate, using_variant
from simscenes.loading.load import build_scene
from simscenes.render.sensors import sensor_dict
from simscenes.rigs import intrinsics, look_at

SIZE = 16


def milk(density: float) -> dict[str, Any]:
    """A ball of a medium that hardly absorbs, on a dark floor under a white sky."""
    t = activate().ScalarTransform4f()
    medium = {"type": "homogeneous", "albedo": {"type": "rgb", "value": 0.999}, "sigma_t": 1.0, "scale": density}
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.1}}
    return {
        "type": "scene",
        "ball": {"type": "sphere", "bsdf": {"type": "null"}, "interior": medium},
        "floor": {"type": "rectangle", "to_world": t.translate([0, 0, -1]).scale(4), "bsdf": black},
        "sky": {"type": "constant"},
    }


@pytest.fixture(scope="module")
def one() -> Rig:
    poses = np.stack([look_at((x, -4, 0.5), (0, 0, 0)) for x in (0, 0.1)])  # one alone would be held out
    return Rig(viewmats=poses, Ks=np.repeat(intrinsics(SIZE, SIZE, 40)[None], 2, 0), width=SIZE, height=SIZE)


def reference(scene: dict[str, Any], rig: Rig) -> np.ndarray[Any, Any]:
    """To depth 2000 without roulette: two independent halves."""
    settings = {"type": "volpath", "max_depth": 2000, "rr_depth": 2001}
    with using_variant("scalar") as mi:
        loaded = build_scene(scene, mi)
        sensor, method = mi.load_dict(sensor_dict(mi, rig, 0, loaded)), mi.load_dict(settings)
        images = [np.array(mi.render(loaded.scene, sensor=sensor, integrator=method, spp=256, seed=k)) for k in (1, 2)]
    return np.stack(images).astype(np.float64)[..., :3]


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["scalar", "auto"])
def test_the_claimed_error_covers_the_measured_one(variant: str, one: Rig, tmp_path: Path) -> None:
    """Scalar variants do not look deeper than 64 bounces, and say what that leaves out; the others go deeper."""
    scene = milk(20.0 if variant == "scalar" else 12.0)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        done = render_set(scene, one, tmp_path, target_error=0.05, variant=variant)
    halves = reference(scene, one)
    truth, level = halves.mean(0), halves.mean()
    noise = np.square(halves[0] - halves[1]).mean() / 4  # of the reference
    light = done.radiance(0).astype(np.float64)
    measured = np.sqrt(max(np.square(light - truth).mean() - noise, 0.0)) / level
    view = done.meta["views"]["0000"]
    print(variant, measured, view, done.meta["left_out"], done.meta["integrator"], [str(s.message) for s in said])
    # The measured error of one render scatters about its expectation, by a few per cent of itself at these pixels.
    assert measured <= 1.2 * view["error"]
    depth = done.meta["integrator"]["max_depth"]
    if variant == "scalar" and done.meta["mitsuba_variant"].startswith("scalar"):
        assert depth == 64
        assert view["relative_error"] < 0.8 * measured  # noise alone would have claimed too little
        assert any("'paths beyond max_depth'" in str(s.message) for s in said)
    else:
        assert depth >= 128
        assert view["error"] <= 0.06
