"""Cameras fitted around a scene's own sensor stay where it is: in the room, round the thing, not round the sky."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from simscenes import Rig, fit_rig
from simscenes.backend import activate, using_variant
from simscenes.loading.load import build_scene
from simscenes.render.fitting import _middle_distance, _rays
from simscenes.rigs import invert_rigid

Scene = dict[str, Any]


def sensor(origin: tuple[float, ...], target: tuple[float, ...], fov: float = 50.0) -> Scene:
    pose = activate().ScalarTransform4f().look_at(list(origin), list(target), [0, 0, 1])
    film = {"type": "hdrfilm", "width": 40, "height": 30}
    return {"type": "perspective", "fov": fov, "to_world": pose, "film": film}


def wall(center: tuple[float, ...], axis: tuple[float, ...], degrees: float, half: tuple[float, float]) -> Scene:
    place = activate().ScalarTransform4f().translate(list(center)).rotate(list(axis), degrees)
    return {"type": "rectangle", "to_world": place.scale([*half, 1])}


def room(door: float = 0.0) -> Scene:
    """Four metres square, three high, with a thing in it; the wall behind the sensor may have a door."""
    scene = {
        "type": "scene",
        "floor": wall((0, 0, 0), (1, 0, 0), 0, (2, 2)),
        "ceiling": wall((0, 0, 3), (1, 0, 0), 180, (2, 2)),
        "back": wall((0, 2, 1.5), (1, 0, 0), 90, (2, 1.5)),
        "left": wall((-2, 0, 1.5), (0, 1, 0), 90, (1.5, 2)),
        "right": wall((2, 0, 1.5), (0, 1, 0), -90, (1.5, 2)),
        "thing": {"type": "sphere", "center": [0.2, 0.5, 0.6], "radius": 0.5},
    }
    half = (2 - door) / 2
    for side in (-1, 1):
        scene[f"front_{side}"] = wall((side * (door + half), -2, 1.5), (1, 0, 0), -90, (half, 1.5))
    return scene


def box() -> Scene:
    """The Cornell box as its files have it: open in front, the sensor far before it."""
    scene = {k: v for k, v in room().items() if not k.startswith("front")}
    return {**scene, "camera": sensor((0, -6.5, 1.5), (0, 0, 1.5), 40)}


def dome(radius: float) -> Scene:
    """A small thing before a textured sky of its own, as archives of captured light have it."""
    sky = {"type": "sphere", "center": [0, 0, 0], "radius": radius, "flip_normals": True}
    thing = {"type": "cube", "to_world": activate().ScalarTransform4f().scale(0.4)}
    return {"type": "scene", "camera": sensor((0, -4, 1), (0, 0, 0.1), 60), "sky": sky, "thing": thing}


def under_the_sky(ground: bool) -> Scene:
    """A thing beside the sensor's axis under an environment map, with or without ground to the horizon."""
    sky = {"type": "constant"}
    thing = {"type": "sphere", "center": [1.2, 0, 0.5], "radius": 0.5}
    scene = {"type": "scene", "camera": sensor((0, -5, 1.2), (0, 0, 1.0), 60), "sky": sky, "thing": thing}
    return {**scene, "ground": wall((0, 0, 0), (1, 0, 0), 0, (500, 500))} if ground else scene


def turn(rig: Rig) -> float:
    """Largest angle between two viewing directions, degrees."""
    forward = invert_rigid(rig.viewmats)[:, :3, 2]
    return float(np.degrees(np.arccos(np.clip(forward @ forward.T, -1, 1)).max()))


@pytest.mark.parametrize("door", [0.0, 0.6], ids=["closed", "with a door"])
def test_cameras_stay_in_the_room_in_which_the_sensor_is(door: float) -> None:
    scene = {**room(door), "camera": sensor((0.3, -1.6, 1.4), (0.2, 0.5, 0.7))}
    rig = fit_rig(scene, 24)
    assert (np.abs(rig.positions[:, :2]) < 2).all()
    assert ((rig.positions[:, 2] > 0) & (rig.positions[:, 2] < 3)).all()
    assert turn(rig) > 10


def test_cameras_outside_of_an_open_box_look_into_it() -> None:
    """Each sees the thing in the box, and none mostly the outside of a wall."""
    rig = fit_rig(box(), 24)
    assert turn(rig) > 10
    across = rig.positions[:, 0]
    # Lines from each camera to the far corners of the floor pass the opening at y = -2, |x| < 2.
    at_front = [across + (x - across) * (-2 - rig.positions[:, 1]) / (2 - rig.positions[:, 1]) for x in (-1.2, 1.2)]
    assert (np.abs(at_front) < 2).all()


@pytest.mark.parametrize(
    ("make", "reach"),
    [
        (lambda: dome(50.0), (2.5, 5.0)),
        (lambda: dome(1e4), (2.5, 5.0)),
        (lambda: under_the_sky(ground=False), (3.0, 6.0)),
        (lambda: under_the_sky(ground=True), (1.0, 12.0)),
    ],
    ids=["dome", "huge dome", "thing in the sky", "ground to the horizon"],
)
def test_cameras_turn_about_what_is_near_and_not_about_the_sky(
    make: Callable[[], Scene], reach: tuple[float, float]
) -> None:
    rig = fit_rig(make(), 16)
    c2w = invert_rigid(rig.viewmats)
    # All axes meet in the target: least squares over the planes normal to each axis.
    planes = np.eye(3) - np.einsum("ci,cj->cij", c2w[:, :3, 2], c2w[:, :3, 2])
    target = np.linalg.solve(planes.sum(0), np.einsum("cij,cj->i", planes, c2w[:, :3, 3]))
    distance = np.linalg.norm(target - c2w[:, :3, 3], axis=1)
    assert reach[0] < distance.min() <= distance.max() < reach[1]
    assert turn(rig) > 10


@pytest.mark.parametrize(("sweep", "swing", "widest"), [(40.0, 0.0, 40.0), (0.0, 9.0, 18.0)])
def test_in_free_space_the_arc_is_as_wide_as_asked_for(sweep: float, swing: float, widest: float) -> None:
    """To both sides of the sensor by half the sweep, or above and below it by the whole swing."""
    rig = fit_rig(dome(50.0), 17, sweep_deg=sweep, swing_deg=swing)
    own = np.array([0.0, 4, -0.9]) / np.hypot(4, 0.9)  # the sensor's axis
    forward = invert_rigid(rig.viewmats)[:, :3, 2]
    assert turn(rig) == pytest.approx(widest, abs=1e-3)
    assert np.degrees(np.arccos(np.clip(forward @ own, -1, 1))).max() == pytest.approx(widest / 2, abs=1e-3)
    up = np.cross([1.0, 0, 0], own)
    across, over = np.abs(forward @ [1.0, 0, 0]).max(), np.abs(forward @ up).max()
    assert (across > 0.1 > 10 * over) if sweep else (over > 0.1 > 10 * across)


def test_the_middle_distance_halves_the_squared_disparities() -> None:
    assert _middle_distance(np.array([1.0] + [10.0] * 50)) == 1.0  # 1 against 0.5
    assert _middle_distance(np.array([1.0] + [10.0] * 150)) == 10.0  # 1 against 1.5


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "scalar_rgb"])
def test_every_ray_finds_its_own_surface(variant: str) -> None:
    with using_variant(variant):
        mi = activate(variant)
        ball = build_scene({"type": "scene", "ball": {"type": "sphere", "radius": 0.5}}, mi)
        origins = np.array([[0.0, 0, 2], [0, 0, 3], [5, 0, 2]])
        found = _rays(ball, mi, origins, np.tile([0.0, 0, -1], (3, 1)))
    np.testing.assert_allclose(found, [1.5, 2.5, np.inf], rtol=1e-5)
