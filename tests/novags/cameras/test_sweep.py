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


def test_neighbours_look_the_same_way_and_stand_elsewhere_the_nearest_first() -> None:
    viewmats = np.tile(np.eye(4), (6, 1, 1))
    for k, (angle, distance) in enumerate([(0, 0), (59, 3), (61, 1), (0, 2), (30, 0), (-50, 1)]):
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        viewmats[k, :3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
        viewmats[k, :3, 3] = -viewmats[k, :3, :3] @ [distance, 0, 0]
    assert sweep.neighbours(viewmats, 0).tolist() == [5, 3, 1]


@pytest.mark.parametrize(("axis", "reach"), [(0, 39.5 / 20), (1, 21.5 / 15)])
def test_planes_are_tried_as_near_as_the_neighbour_sees_any_of_the_picture(axis: int, reach: float) -> None:
    """Pictures of 40 x 22 px, focal lengths 20 and 15: from a camera 0.5 aside a point moves by f 0.5 / depth."""
    viewmats, Ks = np.tile(np.eye(4), (2, 1, 1)), np.tile(np.eye(3), (2, 1, 1))
    viewmats[1, axis, 3] = 0.5
    Ks[:, :2] = [[20, 0, 17], [0, 15, 12]]
    found = sweep.planes(viewmats, Ks, 0, np.array([1]), (22, 40))
    assert found is not None
    assert found[0] == pytest.approx(1 / (sweep.FARTHEST * 0.5))
    assert 0.94 < found[-1] * 0.5 / reach <= 1  # of those tried, each is 1.053 times the one before
    np.testing.assert_allclose(np.diff(found), np.ptp(found) / (sweep.PLANES - 1))


def test_reduced_pictures_keep_what_their_cameras_see() -> None:
    """A point at a quarter of the width and two thirds of the height stays there; 150 x 90 px become 64 x 38."""
    ramp = np.broadcast_to(np.arange(150, dtype=np.float32) / 150, (90, 150))
    images = np.stack([ramp, ramp + 0.3, ramp + 0.6], -1)[None]
    small, (K,) = sweep.reduced(images, np.array([[[120.0, 0, 70], [0, 100, 50], [0, 0, 1]]]))
    assert small.shape == (1, 38, 64)
    np.testing.assert_allclose(K, [[51.2, 0, 70 * 64 / 150], [0, 100 * 38 / 90, 50 * 38 / 90], [0, 0, 1]])
    np.testing.assert_allclose(small[0, 5], (np.arange(64) + 0.5) / 64 - 0.5 / 150 + 0.3, atol=1e-3)


def test_paths_of_semi_global_matching_are_those_of_its_recursion() -> None:
    cost = np.random.default_rng(0).uniform(0, 1, (7, 5, 6)).astype(np.float32)
    planes, height, width = cost.shape
    want = np.zeros(cost.shape)
    for dy, dx in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        path = np.zeros(cost.shape)
        for y in range(height)[:: dy or 1]:
            for x in range(width)[:: dx or 1]:
                path[:, y, x] = cost[:, y, x]
                if not (0 <= y - dy < height and 0 <= x - dx < width):
                    continue
                before = path[:, y - dy, x - dx]
                for d in range(planes):
                    beside = [before[e] + sweep.SMOOTH for e in (d - 1, d + 1) if 0 <= e < planes]
                    path[d, y, x] += min(before[d], *beside, before.min() + sweep.JUMP) - before.min()
        want += path
    np.testing.assert_allclose(sweep.semi_global(cost), want, rtol=1e-5)


def test_what_lies_outside_of_the_other_picture_does_not_correlate() -> None:
    image = np.random.default_rng(0).uniform(0, 1, (12, 16)).astype(np.float32)
    other = np.stack([image, np.ones_like(image)], -1)
    shift = np.array([[1.0, 0.0, 5.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])  # a pixel here is 5 px further right there
    found = sweep._Windows.of(image).correlation(other, shift)
    assert np.isfinite(found[:, :11]).all()
    assert np.isneginf(found[:, 11:]).all()
    np.testing.assert_allclose(sweep._Windows.of(image).correlation(other, np.eye(3)), 1, atol=1e-3)


def test_every_picture_of_a_wall_gets_a_map_of_its_distance() -> None:
    """A wall 3 away, seen by three cameras 0.3 apart with a focal length of 40 px: its picture moves by 4 px."""
    wall = np.random.default_rng(0).uniform(0, 1, (24, 40, 3)).astype(np.float32)
    viewmats, Ks = np.tile(np.eye(4), (3, 1, 1)), np.tile([[40.0, 0, 16], [0, 40, 12], [0, 0, 1]], (3, 1, 1))
    viewmats[:, 0, 3] = 0, -0.3, -0.6
    found = sweep.sweep(np.stack([wall[:, k : k + 32] for k in (0, 4, 8)]), viewmats, Ks)
    assert found is not None
    assert found.views.tolist() == [0, 1, 2]
    np.testing.assert_allclose(np.nanmedian(found.depth, (1, 2)), 3, rtol=0.02)
