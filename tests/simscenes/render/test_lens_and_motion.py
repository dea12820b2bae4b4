"""Depth of field and motion blur are weighed in pixels, and rendered where the plan says so."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simscenes import Optics, Rig, orbit_rig, plan_transport, render_set
from simscenes.backend import activate
from simscenes.loading.load import build_scene
from simscenes.render.motion import moved_pose, subframe_rig
from simscenes.render.radiance import RenderedView, RenderMethod

SceneMaker = Callable[..., dict[str, Any]]


def test_lens_and_motion_are_weighed_in_pixels(diffuse_box: SceneMaker, ring: Rig) -> None:
    quiet = Optics(aperture_radius=1e-4, focus_distance=3.0, motion=1e-3)
    loud = Optics(aperture_radius=0.1, focus_distance=2.0, motion=0.2)
    plans = [plan_transport(diffuse_box(), rig=ring, optics=o, measure=False) for o in (quiet, loud)]
    for name in ("depth of field", "motion blur"):
        assert not plans[0].is_on(name)
        assert plans[1].is_on(name)
        assert plans[0][name].contribution < 0.5 < plans[1][name].contribution
    assert plans[1].subframes in (4, 16, 64)
    # Circle of confusion of the nearest points and of the sky, by similar triangles.
    focal = 16 / np.tan(np.radians(22.5))
    worst = max(2 * 0.1 * abs(1 - 2.0 / z) * focal / 2.0 for z in (2.0, np.inf))
    assert plans[1]["depth of field"].contribution <= 1.001 * worst


def test_the_lens_is_rendered_when_the_plan_says_so_and_only_then(tmp_path: Path) -> None:
    """A small bright ball out of focus: its light spreads over the circle of confusion, and comes back without lens."""
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    ball = {"type": "sphere", "center": [0, 0, 0], "radius": 0.05, "emitter": glow}
    wall = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}}
    scene = {"type": "scene", "ball": ball, "wall": wall | {"to_world": activate().ScalarTransform4f().scale(0.01)}}
    rig = orbit_rig(2, 32, 32, 20, target=(0, 0, 0), radius=4.0, swing_deg=0)
    optics, areas = Optics(aperture_radius=0.2, focus_distance=2.0), {}
    for on in (True, False):
        plan = plan_transport(scene, rig=rig, optics=optics, measure=False, force={"depth of field": on})
        views = render_set(scene, rig, tmp_path / str(on), spp=64, optics=optics, plan=plan)
        image = views.radiance(0)[..., 1].astype(np.float64)
        areas[on] = image.sum() ** 2 / (image**2).sum()  # pixels that share the light
    focal = float(rig.Ks[0, 0, 0])
    sharp, circle = np.pi * (0.05 * focal / 4) ** 2, np.pi * (0.2 * abs(1 - 2 / 4) / 2 * focal) ** 2
    assert areas[False] == pytest.approx(sharp, rel=0.5)
    assert areas[True] == pytest.approx(circle, rel=0.3)
    assert areas[True] > 10 * areas[False]


@pytest.mark.parametrize("sky", ["pattern", "constant", "hidden"])
def test_a_sky_counts_among_what_moves(sky: str) -> None:
    """A ball in the middle of an orbit hardly moves; a sky moves as far as the camera turns."""
    mi, rig = activate(), orbit_rig(32, 32, 32, 50, target=(0, 0, 0), radius=3.0, swing_deg=0)
    scene: dict[str, Any] = {"type": "scene", "ball": {"type": "sphere", "radius": 0.3}, "sky": {"type": "constant"}}
    if sky != "constant":
        pattern = mi.Bitmap(np.random.default_rng(0).random((8, 16, 3), dtype=np.float32))
        scene["sky"] = {"type": "envmap", "bitmap": pattern}
        scene["eye"] = {"type": "path", "hide_emitters": sky == "hidden"}
    plan = plan_transport(scene, rig=rig, optics=Optics(motion=0.2), measure=False)
    turn = 0.2 * np.radians(360 / 32) * rig.Ks[0, 0, 0]  # px in the middle of the picture
    moved = plan["motion blur"].contribution
    if sky == "pattern":
        assert turn < moved < 1.5 * turn
    else:
        assert moved < 0.2 * turn
    assert plan.is_on("motion blur") == (sky == "pattern")


def angle(one: np.ndarray, other: np.ndarray) -> float:
    """Between two orientations, radians."""
    return float(2 * np.arcsin(np.linalg.norm(one[:3, :3] - other[:3, :3]) / np.sqrt(8)))


def test_poses_of_an_exposure_lie_on_the_way_between_the_views() -> None:
    rig = orbit_rig(8, 16, 16, 50, radius=2.0, swing_deg=0)
    assert np.allclose(moved_pose(rig, 3, 1.0), rig.viewmats[4], atol=1e-9)
    assert np.allclose(moved_pose(rig, 3, -1.0), rig.viewmats[2], atol=1e-9)
    assert np.array_equal(moved_pose(rig, 3, 0.0), rig.viewmats[3])
    ends = moved_pose(rig, 0, -0.5), moved_pose(rig, 7, 0.5)  # past the ends of the rig
    assert all(np.allclose(e[:3, :3] @ e[:3, :3].T, np.eye(3)) for e in ends)
    frames = subframe_rig(rig, 3, 0.4, 8)
    assert np.allclose(frames.positions.mean(0), rig.positions[3], atol=0.05)
    for k, t in enumerate(np.linspace(-0.175, 0.175, 8)):  # middles of eight parts of -0.2 to 0.2
        there = 4 if t > 0 else 2
        place = rig.positions[3] + abs(t) * (rig.positions[there] - rig.positions[3])
        assert np.allclose(frames.positions[k], place, atol=1e-9)
        assert angle(frames.viewmats[k], rig.viewmats[3]) == pytest.approx(abs(t) * angle(*rig.viewmats[[there, 3]]))


def test_motion_blur_averages_the_poses(tmp_path: Path, diffuse_box: SceneMaker, ring: Rig) -> None:
    rig = ring
    blurred = render_set(diffuse_box(), rig, tmp_path / "a", spp=256, optics=Optics(motion=0.3))
    sharp = render_set(diffuse_box(), rig, tmp_path / "b", spp=256)
    assert blurred.meta["plan"]["subframes"] > 1
    frames = subframe_rig(rig, 1, 0.3, blurred.meta["plan"]["subframes"])
    mi = activate()
    loaded = build_scene(diffuse_box(), mi)
    method = RenderMethod(mi, mi.variant(), loaded, mi.load_dict({"type": "path", "max_depth": 8, "rr_depth": 2}))
    mean = np.mean([RenderedView(method, frames, k).render(32, None).mean for k in range(len(frames))], 0)
    away, still = (np.abs(blurred.radiance(1) - other).mean() for other in (mean, sharp.radiance(1)))
    assert away < 0.5 * still
