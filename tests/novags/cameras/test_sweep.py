"""Claims about the planes swept through a scene: what a plane costs, and which depth that says."""

import numpy as np
import pytest

from novags.cameras import sweep


@pytest.mark.parametrize("scores", [(0.9, 0.8, 0.1), (0.1, 0.9, 0.8), (0.9, 0.1, 0.8)])
def test_a_plane_costs_the_mean_over_the_two_neighbours_that_agree_best(
    monkeypatch: pytest.MonkeyPatch, scores: tuple[float, ...]
) -> None:
    left = iter(scores)
    monkeypatch.setattr(sweep._Windows, "correlation", lambda *given: np.full((8, 8), next(left), np.float32))
    viewmats, Ks = np.tile(np.eye(4), (4, 1, 1)), np.tile(np.diag([8.0, 8.0, 1.0]), (4, 1, 1))
    found = sweep.costs(np.zeros((4, 8, 8), np.float32), viewmats, Ks, 0, np.array([1, 2, 3]), np.array([0.5]))
    np.testing.assert_allclose(found, (1 - 0.85) / 2, rtol=1e-5)


@pytest.mark.parametrize("lowest", [1.8, 2.0, 2.3])
def test_between_planes_the_lowest_point_of_a_parabola_is_found(lowest: float) -> None:
    cost = ((np.arange(5.0) - lowest) ** 2)[:, None, None]
    np.testing.assert_allclose(sweep.between(cost, cost.argmin(0)), lowest)
