"""Claims about scores of a surface against a scan: distances of known clouds, and points of known depths."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from novags.testbed.metrics.geometry import NEAR, seen_points, surface_scores, thinned


def grid(step: float, height: float = 0.0) -> np.ndarray:
    """A square metre of points, so far apart that none share a cube."""
    x, y = np.meshgrid(*2 * [np.arange(0.5 * step, 1, step)])
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, height + 0.01)], -1)


def test_the_same_points_are_exact_and_a_shift_is_its_length() -> None:
    scan = grid(0.1)
    assert surface_scores([scan[:30], scan[30:]], scan) == {"accuracy": 0, "completeness": 0, "f1": 1}
    for shift, right in ((NEAR - 0.001, 1.0), (NEAR + 0.001, 0.0)):
        found = surface_scores([scan + [0, 0, shift]], scan)
        assert found["accuracy"] == pytest.approx(shift)
        assert found["completeness"] == pytest.approx(shift)
        assert found["f1"] == right


def test_a_missing_half_costs_completeness_and_a_floater_costs_accuracy() -> None:
    scan = grid(0.1)
    half = scan[scan[:, 0] < 0.5]
    found = surface_scores([half], scan)
    assert found["accuracy"] == 0
    assert found["completeness"] == pytest.approx(np.mean([0.1, 0.2, 0.3, 0.4, 0.5]) / 2)
    assert found["f1"] == pytest.approx(2 / 3)  # precision 1, recall 1/2
    floaters = surface_scores([scan, grid(0.1, height=2.0)], scan)
    assert floaters["accuracy"] == pytest.approx(1.0)
    assert floaters["completeness"] == 0
    assert floaters["f1"] == pytest.approx(2 / 3)


def test_points_of_a_cube_are_their_mean_however_many_see_them() -> None:
    points = np.array([[0.01, 0.01, 0.01], [0.03, 0.01, 0.01], [0.03, 0.04, 0.01], [-0.01, 0.01, 0.01]])
    np.testing.assert_allclose(thinned(points), [[-0.01, 0.01, 0.01], [0.07 / 3, 0.02, 0.01]])
    scan = grid(0.1)
    assert surface_scores([scan, scan, scan, scan + [0, 0, 0.2]], scan)["accuracy"] == pytest.approx(0.1)


def test_points_lie_on_the_rays_through_pixel_centres_at_their_depth() -> None:
    """Independent: each point is projected again."""
    K = np.array([[30.0, 0, 17.0], [0, 31.0, 11.0], [0, 0, 1]])
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix(), (0.5, -1.0, 4.0)
    depth = np.random.default_rng(0).uniform(1, 3, (24, 32))
    depth[0], alpha = 0, np.ones((24, 32))
    alpha[1] = 0.4
    points = seen_points(depth, alpha, K, viewmat)
    local = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    pixels = local @ K.T
    y, x = np.mgrid[2:24, :32]
    np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], np.stack([x.ravel(), y.ravel()], -1) + 0.5, atol=1e-9)
    np.testing.assert_allclose(local[:, 2], depth[2:].ravel())


@pytest.mark.parametrize("pair", [([], grid(0.1)), ([grid(0.1)], np.zeros((0, 3)))])
def test_of_nothing_nothing_is_said(pair: tuple[list[np.ndarray], np.ndarray]) -> None:
    assert surface_scores(*pair) == {"accuracy": None, "completeness": None, "f1": None}
