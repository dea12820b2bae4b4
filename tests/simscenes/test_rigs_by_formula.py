"""Rigs against their formulas written out camera by camera."""

import math

import numpy as np
import pytest

from simscenes import rigs
from simscenes.rigs import Rig, forward_rig, look_at, orbit_rig, unproject


def camera_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """World to camera, z towards the target, y away from world z."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, -rotation @ position
    return viewmat


def test_a_ring_follows_its_wave_of_elevation() -> None:
    target = np.array([0.3, -0.2, 0.5])
    rig = orbit_rig(
        7, 40, 30, 55, target=target, radius=2.5, elevation_deg=20, swing_deg=12, waves=2, start_deg=30, sweep_deg=360
    )
    for k in range(7):
        azimuth = math.radians(30 + 360 * k / 7)
        elevation = math.radians(20 + 12 * math.sin(2 * math.pi * 2 * k / 7))
        flat = math.cos(elevation)
        offset = np.array([math.cos(azimuth) * flat, math.sin(azimuth) * flat, math.sin(elevation)])
        position = target + 2.5 * offset
        np.testing.assert_allclose(rig.viewmats[k], camera_at(position, target), atol=1e-12)
        np.testing.assert_allclose(rig.positions[k], position, atol=1e-12)


def test_every_camera_of_a_rig_has_the_same_centred_lens() -> None:
    rig = orbit_rig(3, 40, 30, 55, radius=1.0)
    focal = 20 / math.tan(math.radians(27.5))
    assert (rig.width, rig.height) == (40, 30)
    for K in rig.Ks:
        np.testing.assert_allclose(K, [[focal, 0, 20], [0, focal, 15], [0, 0, 1]])


def test_a_forward_rig_zigzags_over_its_window() -> None:
    position, target = np.array([0.5, -4.0, 1.0]), np.array([0.2, 0.0, 1.3])
    rig = forward_rig(9, 40, 30, 50, position=position, target=target, extent=(0.6, 0.3), rows=2)
    right, down = camera_at(position, target)[:2, :3]
    for t, found in zip(rigs.there_and_back(9) / 8, rig.positions, strict=True):
        phase = (2 * t) % 2
        across = 2 * phase - 1 if phase < 1 else 3 - 2 * phase
        expected = position + 0.6 * across * right - 0.3 * (2 * t - 1) * down
        np.testing.assert_allclose(found, expected, atol=1e-12)
    for viewmat, found in zip(rig.viewmats, rig.positions, strict=True):
        np.testing.assert_allclose(viewmat, camera_at(found, target), atol=1e-12)


def test_look_at_takes_any_up_that_is_not_in_line() -> None:
    viewmat = look_at((1, 2, 3), (0, 0, 0), up=(0, 2, 0))
    right, down, forward = viewmat[:3, :3]
    np.testing.assert_allclose(forward, -np.array([1, 2, 3]) / math.sqrt(14))
    assert abs(right[1]) < 1e-12
    assert down[1] < 0
    np.testing.assert_allclose(viewmat[:3, :3] @ [1, 2, 3] + viewmat[:3, 3], 0, atol=1e-12)


def uneven() -> Rig:
    """Two cameras that differ in pose and lens."""
    viewmats = np.stack([look_at((3, 1, 2), (0.5, 0.2, 0.1)), look_at((-2, 2.5, 1), (0.1, 0.3, 0.0))])
    Ks = np.array([[[30.0, 0, 9], [0, 30, 7], [0, 0, 1]], [[25.0, 0, 11], [0, 28, 6], [0, 0, 1]]])
    return Rig(viewmats=viewmats, Ks=Ks, width=20, height=13)


@pytest.mark.parametrize("view", [0, 1])
def test_unprojected_pixels_project_back_to_their_centres(view: int) -> None:
    rig = uneven()
    z = np.random.default_rng(0).uniform(1, 5, (13, 20))
    pixels = np.array([0, 19, 40, 137, 259])
    found, depths = rig.project(unproject(rig, view, z, pixels))
    expected = np.stack([pixels % 20 + 0.5, pixels // 20 + 0.5], -1)
    np.testing.assert_allclose(found[view], expected, atol=1e-9)
    np.testing.assert_allclose(depths[view], z.ravel()[pixels], atol=1e-12)


def test_projection_is_the_pinhole_written_out() -> None:
    rig, points = uneven(), np.random.default_rng(1).uniform(-1, 1, (6, 3))
    pixels, depths = rig.project(points)
    for c in range(2):
        for p, point in enumerate(points):
            x, y, z = rig.viewmats[c, :3, :3] @ point + rig.viewmats[c, :3, 3]
            K = rig.Ks[c]
            np.testing.assert_allclose(pixels[c, p], [K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]])
            assert depths[c, p] == pytest.approx(z)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: orbit_rig(0, 4, 4, 50, radius=1.0), "n_views"),
        (lambda: orbit_rig(2, 4, 4, 50, radius=0.0), "radius"),
        (lambda: orbit_rig(2, 4, 4, 50, radius=1.0, elevation_deg=-70, swing_deg=20), "elevation"),
        (lambda: forward_rig(0, 4, 4, 50, position=(0, -1, 0), target=(0, 0, 0), extent=(1, 1)), "n_views"),
        (lambda: forward_rig(2, 4, 4, 50, position=(0, -1, 0), target=(0, 0, 0), extent=(1, 1), rows=0), "rows"),
        (lambda: orbit_rig(2, 4, 4, 180, radius=1.0), "fov_x_deg"),
    ],
)
def test_impossible_rigs_are_refused(make, match) -> None:
    with pytest.raises(ValueError, match=match):
        make()
