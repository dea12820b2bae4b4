"""Bounds, samples along rays, and what samples add up to, against slow independent versions."""

import math

import numpy as np
import pytest
import torch

from novags.fields.box import Box, box_of, contracted, distance_at
from novags.fields.layout import SIDE
from novags.fields.march import Proposal, Rays, cells_near, rays_of, sampled, weights_of
from novags.fields.training.batch import chosen_pixels, distortion
from novags.splats.views import Views

BOX = Box(center=(0.5, 0.0, -0.5), half=(2.0, 1.0, 1.0), near=0.3, middle=4.0, far=200.0)


def some_rays(n: int) -> Rays:
    rng = np.random.default_rng(1)
    origins = torch.from_numpy(rng.normal(size=(n, 3)).astype(np.float32))
    directions = torch.nn.functional.normalize(torch.from_numpy(rng.normal(size=(n, 3)).astype(np.float32)), dim=1)
    return Rays(origins, directions, torch.ones(n))


def slow_edges(ray: int, rays: Rays, density: np.ndarray, jitter: np.ndarray, even: float) -> list[float]:
    """Distances of the edges between the samples of one ray, in float64, one step at a time."""
    bins, n = 224, jitter.shape[1] - 1
    edges = [float(distance_at(torch.tensor(i / bins, dtype=torch.float64), BOX)) for i in range(bins + 1)]
    weights, through = [], 1.0
    for i in range(bins):
        t = edges[i] + (edges[i + 1] - edges[i]) * float(jitter[ray, i % (n + 1)])
        u = contracted((rays.origins[ray] + t * rays.directions[ray]).double(), BOX).numpy()
        x, y, z = np.clip((u * SIDE).astype(int), 0, SIDE - 1)
        alpha = 1 - math.exp(-float(density[(z * SIDE + y) * SIDE + x]) * (edges[i + 1] - edges[i]) / BOX.unit)
        weights.append(through * alpha)
        through *= 1 - alpha
    spread = [0.5 * (max(weights[max(i - 4, 0) : i + 1]) + max(weights[i : i + 5])) for i in range(bins)]
    shares = [(1 - even) * w / sum(spread) + even / bins for w in spread]
    sums = np.concatenate([[0], np.cumsum(shares)])
    found = []
    for j in range(n + 1):
        place = np.interp((j + float(jitter[ray, j])) / (n + 1), sums, np.arange(bins + 1) / bins)
        found.append(float(distance_at(torch.tensor(place), BOX)))
    return found


def test_samples_lie_where_the_inverse_of_the_weights_sum_puts_them() -> None:
    rng = np.random.default_rng(2)
    density = rng.gamma(0.2, 3.0, SIDE**3).astype(np.float32)
    rays, jitter = some_rays(20), rng.random((20, 13), np.float32)
    found = sampled(rays, BOX, Proposal(density), jitter, 0.1)
    wrong = 0
    for ray in range(len(rays)):
        edges = np.array(slow_edges(ray, rays, density, jitter, 0.1))
        middles, widths = (edges[1:] + edges[:-1]) / 2, np.diff(edges) / BOX.unit
        # A bin on the border of a cell may fall into the other one in float32: such rays differ a lot, and are few.
        wrong += not np.allclose(found.distances[ray].numpy(), middles, rtol=1e-3)
        if np.allclose(found.distances[ray].numpy(), middles, rtol=1e-3):
            np.testing.assert_allclose(found.widths[ray].numpy(), widths, rtol=0.02, atol=1e-3)
    assert wrong <= 1
    world = rays.origins[:, None] + found.distances[..., None] * rays.directions[:, None]
    places = contracted(world, BOX).reshape(-1, 3).numpy()
    np.testing.assert_allclose(found.positions, places, atol=1e-5)


def test_the_map_takes_denser_finds_at_once_and_forgets_what_was_denser_by_and_by() -> None:
    proposal = Proposal(np.full(SIDE**3, 2.0, np.float32))
    places = np.array([[0.1, 0.2, 0.3], [0.6, 0.7, 0.8], [0.6, 0.7, 0.8]], np.float32)
    proposal.learn(places, np.log(np.array([5.0, 1.0, 0.5], np.float32)), 0.75)
    cells = [int((int(z * SIDE) * SIDE + int(y * SIDE)) * SIDE + int(x * SIDE)) for x, y, z in places.astype(float)]
    assert proposal.density[cells[0]] == pytest.approx(5.0, rel=1e-5)
    assert proposal.density[cells[1]] == pytest.approx(0.5 + (1.75 - 0.5) * 0.75, rel=1e-5)  # 1 + (2 - 1) 0.75 first
    assert (np.delete(proposal.density, cells) == 2).all()


def test_an_empty_map_spreads_samples_evenly_and_a_wall_draws_them() -> None:
    rays, jitter = Rays(torch.tensor([[0.5, 0.0, -3.0]]), torch.tensor([[0.0, 0.0, 1.0]]), torch.ones(1)), None
    jitter = np.full((1, 25), 0.5, np.float32)
    empty = sampled(rays, BOX, Proposal(np.zeros(SIDE**3, np.float32)), jitter, 0.0).distances[0]
    steps = torch.diff(empty[empty < BOX.middle])
    assert torch.allclose(steps, steps[0].expand_as(steps), rtol=1e-3)
    wall = np.zeros((SIDE, SIDE, SIDE), np.float32)
    wall[SIDE // 2] = 1e4  # z = -0.5, at a distance of 2.5
    found = sampled(rays, BOX, Proposal(wall.reshape(-1)), jitter, 0.0).distances[0]
    assert (found - 2.5).abs().max() < 0.15


def test_weights_are_those_of_front_to_back_compositing() -> None:
    rng = np.random.default_rng(3)
    log_density, widths = rng.normal(1, 2, (5, 7)), rng.random((5, 7))
    expected = np.zeros((5, 7))
    for r in range(5):
        through = 1.0
        for i in range(7):
            alpha = 1 - math.exp(-math.exp(log_density[r, i]) * widths[r, i])
            expected[r, i] = through * alpha
            through *= 1 - alpha
    found = weights_of(torch.from_numpy(log_density), torch.from_numpy(widths))
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-6, atol=1e-15)


def test_an_opaque_first_sample_takes_all_and_nothing_gives_nothing() -> None:
    log_density = torch.tensor([[80.0, 80.0], [-80.0, -80.0]], requires_grad=True)
    weights = weights_of(log_density, torch.full((2, 2), 0.5))
    assert weights.tolist() == [[1.0, 0.0], [pytest.approx(0, abs=1e-30)] * 2]
    weights.sum().backward()
    assert torch.isfinite(log_density.grad).all()


def test_distortion_is_the_double_sum_of_mip_nerf_360() -> None:
    rng = np.random.default_rng(4)
    weights, widths = rng.random((3, 6)), rng.random((3, 6))
    distances = np.cumsum(widths, 1) - widths / 2
    expected = 0.0
    for r in range(3):
        for i in range(6):
            expected += weights[r, i] ** 2 * widths[r, i] / 3
            for j in range(6):
                expected += weights[r, i] * weights[r, j] * abs(distances[r, i] - distances[r, j])
    found = distortion(*(torch.from_numpy(a) for a in (weights, distances, widths)))
    assert float(found) == pytest.approx(expected / 3, rel=1e-12)


def test_rays_pass_through_what_projects_to_their_pixels() -> None:
    from scipy.spatial.transform import Rotation

    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = Rotation.from_rotvec([0.3, -0.8, 0.2]).as_matrix(), (0.4, -0.2, 1.5)
    K = np.array([[30.0, 0, 9], [0, 28.0, 7], [0, 0, 1]])
    views = Views(*(torch.tensor(m[None], dtype=torch.float32) for m in (viewmat, K)), 18, 14)
    point = np.array([0.2, 0.1, 2.0])
    local = viewmat[:3, :3] @ point + viewmat[:3, 3]
    pixel = (K @ local)[:2] / local[2]
    x, y = (torch.tensor([v - 0.5], dtype=torch.float64) for v in pixel)
    rays = rays_of(views, torch.tensor([0]), x, y)
    distance = np.linalg.norm(point - rays.origins[0].numpy())
    np.testing.assert_allclose(rays.origins[0].numpy() + distance * rays.directions[0].numpy(), point, atol=1e-5)
    assert float(rays.forward[0]) * distance == pytest.approx(local[2], rel=1e-5)


def test_the_box_holds_the_points_but_not_the_one_that_is_wrong() -> None:
    rng = np.random.default_rng(6)
    points = torch.from_numpy(rng.uniform(-1, 1, (2000, 3)) * [3, 1, 0.01] + [10, 0, 0])
    points[0] = torch.tensor([1e6, 0, 0])
    box = box_of(torch.tensor([[10.0, 0.0, 5.0]]), points)
    assert box.center[0] == pytest.approx(10, abs=0.1)
    assert box.half[0] == pytest.approx(3.3, rel=0.03)
    assert box.half[2] == pytest.approx(1.1, rel=0.03)  # a third of the longest side
    assert 5 < box.middle < 7.5
    assert box.near < 2.6


def test_squares_of_pixels_are_drawn_up_to_the_last_row_and_column() -> None:
    views = Views(torch.eye(4).repeat(3, 1, 1), torch.eye(3).repeat(3, 1, 1), 5, 4)
    view, x, y = (each.reshape(-1, 4) for each in chosen_pixels(views, 4 * 2000, 2, np.random.default_rng(0)))
    corners = set(zip(view[:, 0].tolist(), x[:, 0].tolist(), y[:, 0].tolist(), strict=True))
    assert corners == {(i, column, row) for i in range(3) for column in range(4) for row in range(3)}
    assert torch.equal(x - x[:, :1], torch.tensor([0, 1, 0, 1]).expand(2000, 4))
    assert torch.equal(y - y[:, :1], torch.tensor([0, 0, 1, 1]).expand(2000, 4))


def test_cells_near_points_are_theirs_and_those_beside_them_with_x_running_fastest() -> None:
    box = Box(center=(1.0, -2.0, 0.5), half=(2.0, 1.0, 4.0), near=0.1, middle=3.0, far=100.0)
    point = torch.tensor([[1.0 + 0.5, -2.0 - 0.75, 0.5 + 2.0]])  # 1/4, -3/4 and 1/2 of the half sides
    x, y, z = (int(96 * (share + 1.5) / 3) for share in (0.25, -0.75, 0.5))
    beside = {((z + c) * 96 + y + b) * 96 + x + a for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1)}
    assert set(np.flatnonzero(cells_near(point, box)).tolist()) == beside


def test_rays_begin_before_the_nearest_points_and_change_their_spacing_behind_the_farthest() -> None:
    """Of 1,001 points on a line before a camera, one of the nearest and five of the farthest count as outliers."""
    points = torch.stack([torch.zeros(1001), torch.zeros(1001), 10 + torch.arange(1001.0)], 1)
    box = box_of(torch.zeros(1, 3), points)
    assert box.near == pytest.approx(0.5 * 11)
    assert box.middle == pytest.approx(1.1 * 1005)
    assert box.far == pytest.approx(50 * box.middle)


@pytest.mark.parametrize("points", [torch.zeros(5, 3), torch.ones(1, 3)])
def test_points_in_one_place_still_give_a_box(points: torch.Tensor) -> None:
    box = box_of(torch.tensor([[0.0, 0.0, 2.0]]), points)
    assert min(box.half) > 0
    box = box_of(points[:1], points)  # a camera on the only point
    assert 0 < box.near < box.middle


def test_bounds_without_points_are_refused() -> None:
    with pytest.raises(ValueError, match="finite first points and cameras for its bounds, got 0 points"):
        box_of(torch.zeros(1, 3), torch.zeros(0, 3))


def test_all_space_lies_in_the_unit_cube_and_the_box_in_its_middle() -> None:
    far = torch.tensor([[1e6, -1e6, 3.0], [2.5, 1.0, 0.5], [0.5, 0.0, -0.5]], dtype=torch.float64)
    u = contracted(far, BOX)
    assert ((u >= 0) & (u <= 1)).all()
    np.testing.assert_allclose(u[1:].numpy(), [[5 / 6] * 3, [0.5] * 3], rtol=1e-12)


def test_pixels_come_in_squares_of_one_view() -> None:
    views = Views(torch.eye(4).expand(3, 4, 4), torch.eye(3).expand(3, 3, 3), 11, 7)
    view, x, y = (t.reshape(-1, 3, 3) for t in chosen_pixels(views, 90, 3, np.random.default_rng(0)))
    assert (view == view[:, :1, :1]).all()
    assert (torch.diff(x, dim=2) == 1).all()
    assert (torch.diff(y, dim=1) == 1).all()
    assert int(x.max()) <= 10
    assert int(y.max()) <= 6
    with pytest.raises(ValueError, match="at least as large as a patch of 8, got 11x7"):
        chosen_pixels(views, 64, 8, np.random.default_rng(0))
