"""The depth of a field's ray: what halves its weight, however far away a remainder lies."""

import numpy as np
import pytest
import torch

from novags.fields.box import Box
from novags.fields.field import first_field
from novags.fields.layout import SIDE, FieldLayout
from novags.fields.march import Proposal
from novags.fields.render import median_distance, render_field
from novags.splats import Views


def slowly(weights: np.ndarray, distances: np.ndarray) -> float:
    """Walk along the ray in tiny steps until half of the weight is behind."""
    middles = (distances[1:] + distances[:-1]) / 2
    edges = [2 * distances[0] - middles[0], *middles, 2 * distances[-1] - middles[-1]]
    passed, half = 0.0, weights.sum() / 2
    for k, weight in enumerate(weights):
        for step in range(1000):
            passed += weight / 1000
            if passed >= half:
                return float(edges[k] + (edges[k + 1] - edges[k]) * (step + 1) / 1000)
    raise AssertionError


def test_it_is_where_half_of_the_weight_has_been_passed() -> None:
    rng = np.random.default_rng(1)
    weights, distances = rng.random((40, 9)) ** 4, np.cumsum(rng.uniform(0.1, 3, (40, 9)), 1)
    found = median_distance(torch.tensor(weights), torch.tensor(distances)).numpy()
    np.testing.assert_allclose(found, [slowly(w, d) for w, d in zip(weights, distances, strict=True)], atol=4e-3)


def test_what_gets_through_a_surface_does_not_move_it() -> None:
    weights = torch.tensor([[0.0, 0.97, 0.0, 0.03]])
    for far in (10.0, 1000.0):
        found = median_distance(weights, torch.tensor([[1.0, 2.0, 3.0, far]]))
        assert float(found) == pytest.approx(1.5 + 0.5 / 0.97)


def test_rays_through_nothing_have_no_depth_and_one_sample_has_its_own() -> None:
    distances = torch.tensor([[1.0, 2.0, 4.0]])
    assert float(median_distance(torch.zeros(1, 3), distances)) == 0
    for k, want in enumerate((1.0, 2.25, 4.0)):  # the middles between the three are 1.5 and 3
        assert float(median_distance(torch.eye(3)[k][None], distances)) == pytest.approx(want)


def test_depth_is_along_the_axis_of_the_camera_not_along_the_ray() -> None:
    """In thick fog all rays end at the same distance."""
    box = Box(center=(0, 0, 0), half=(1, 1, 1), near=0.5, middle=4, far=50)
    field = first_field(FieldLayout(log2_rows=10, static=0, viewed=3), 0, np.ones(SIDE**3, bool))
    K = torch.tensor([[[8.0, 0, 8], [0, 8.0, 8], [0, 0, 1]]])  # 45 degrees to each side
    viewmat = torch.eye(4)[None]
    thick = Proposal(np.full(SIDE**3, 50, np.float32))
    _, alpha, depth = render_field(
        field, box, thick, Views(viewmat, K, 16, 16), lambda raw, w: w[..., None].sum(1).expand(-1, 3), 16
    )
    x = (torch.arange(16) + 0.5 - 8) / 8
    distances = depth[0] * (1 + x[:, None] ** 2 + x[None] ** 2).sqrt()
    assert float(alpha.min()) > 0.9
    assert float(depth[0].max() / depth[0].min()) > 1.4
    assert float(distances.max() / distances.min()) < 1.2
