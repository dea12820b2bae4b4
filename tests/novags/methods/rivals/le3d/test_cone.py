"""The cone scatter: where its apex and its ends lie, that it is even, and cameras without a cone."""

import math

import numpy as np
import pytest
from scipy import stats

from novags.methods.rivals.le3d.cone import cone_scatter

SIZE = (80, 60)
KS = np.array([[100.0, 0, 40], [0, 90, 30], [0, 0, 1]])
SLOPE = 40 / 100  # of the wider side, tan(Θ / 2)


def looking_down(centers: np.ndarray) -> np.ndarray:
    """Cameras [C, 4, 4] at these places that look along -z."""
    viewmats = np.tile(np.eye(4), (len(centers), 1, 1))
    viewmats[:, :3, :3] = np.diag([1.0, -1, -1])
    viewmats[:, :3, 3] = -np.einsum("cij,cj->ci", viewmats[:, :3, :3], centers)
    return viewmats


CENTERS = np.array([[1.0, 0, 5], [-1, 0, 5], [0, 2, 5], [0, -2, 5]])
APEX = np.array([0, 0, 5 + 0.9 * 2 / SLOPE])


def test_points_fill_the_cone_evenly_from_the_nearest_first_point_to_ten_times_the_farthest() -> None:
    points = np.array([[0.3, 0.2, 1.0], [-2, 0, 0], [0, 1, -1]])
    distances = [math.dist(point, APEX) for point in points]
    near, far = min(distances), 10 * max(distances)
    Ks = np.stack([KS, KS, KS, KS])
    found = cone_scatter(points, looking_down(CENTERS), Ks, SIZE, 4000, np.random.default_rng(1))
    assert found.shape == (4000, 3)
    along = APEX[2] - found[:, 2]
    radius = np.hypot(found[:, 0], found[:, 1])
    assert near <= along.min() < near + 0.2 * (far - near)
    assert far - 0.01 * (far - near) < along.max() <= far
    assert (radius <= SLOPE * along * (1 + 1e-12)).all()
    # 1e-3: one run in a thousand of an even scatter would fail, and this one is always the same
    assert stats.kstest(((along - near) / (far - near)) ** 3, "uniform").pvalue > 1e-3
    assert stats.kstest((radius / (SLOPE * along)) ** 2, "uniform").pvalue > 1e-3
    assert stats.kstest(np.arctan2(found[:, 1], found[:, 0]) / (2 * math.pi) + 0.5, "uniform").pvalue > 1e-3


def test_the_cone_is_as_wide_as_the_widest_camera_and_holds_all_of_them() -> None:
    Ks = np.stack([KS] * 4)
    Ks[2, 1, 1] = 20.0  # 60 px high: tan(Θ / 2) = 1.5
    points = np.array([[0.0, 0, 0], [0, 0, 1]])
    found = cone_scatter(points, looking_down(CENTERS), Ks, SIZE, 4000, np.random.default_rng(2))
    apex = 5 + 0.9 * 2 / 1.5
    slopes = np.hypot(found[:, 0], found[:, 1]) / (apex - found[:, 2])
    assert 0.99 * 1.5 < slopes.max() <= 1.5 * (1 + 1e-12)
    inside = [math.hypot(x, y) / (apex - z) for x, y, z in CENTERS]
    assert max(inside) == pytest.approx(1.5 / 0.9)  # at 0.9 of its distance a camera lies a little outside


def test_one_camera_is_the_apex_of_its_own_cone() -> None:
    points = np.array([[1.0, 0, 4], [1, 0, 3]])
    found = cone_scatter(points, looking_down(CENTERS[:1]), KS[None], SIZE, 500, np.random.default_rng(3))
    along = 5 - found[:, 2]
    assert along.min() >= 1
    assert along.max() <= 20
    assert (np.hypot(found[:, 0] - 1, found[:, 1]) <= SLOPE * along * (1 + 1e-12)).all()


def test_cameras_that_look_in_all_directions_have_no_cone() -> None:
    viewmats = looking_down(CENTERS[:2])
    viewmats[1, :3, :3] = np.eye(3)
    found = cone_scatter(np.ones((3, 3)), viewmats, np.stack([KS, KS]), SIZE, 9, np.random.default_rng(4))
    assert found.shape == (0, 3)
