"""Gaussians at points: as wide as the points are apart, in their colours, and only of numbers."""

import numpy as np
import pytest
import torch

from novags.splats import Gaussians
from novags.splats.sh import rgb_to_sh

POINTS = torch.rand(40, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
COLORS = torch.rand(40, 3, generator=torch.Generator().manual_seed(1))


@pytest.mark.parametrize("scale", [0.1, 0.7, 2.0])
@pytest.mark.parametrize("neighbours", [1, 3])
def test_they_are_as_wide_as_the_nearest_points_are_away(scale: float, neighbours: int) -> None:
    found = Gaussians.from_points(POINTS, COLORS, sh_degree=1, init_scale=scale, n_neighbors=neighbours)
    distances = torch.cdist(POINTS, POINTS).sort(1).values[:, 1 : neighbours + 1]
    wanted = scale * distances.square().mean(1).sqrt()
    np.testing.assert_allclose(found.scales, wanted[:, None].expand(-1, 3), rtol=1e-5)


def test_they_lie_at_the_points_unturned_in_one_colour_from_all_sides() -> None:
    found = Gaussians.from_points(POINTS, COLORS, sh_degree=2, init_opacity=0.2)
    torch.testing.assert_close(found.means, POINTS.float())
    torch.testing.assert_close(found.opacities, torch.full((40,), 0.2))
    torch.testing.assert_close(found.sh[:, 0], rgb_to_sh(COLORS))
    assert (found.sh.shape, found.sh_degree) == ((40, 9, 3), 2)
    assert not found.sh[:, 1:].any()
    assert torch.equal(found.quats, torch.tensor([1.0, 0, 0, 0]).expand(40, 4))


def test_points_at_one_place_have_a_width_too() -> None:
    found = Gaussians.from_points(torch.zeros(3, 3), COLORS[:3], sh_degree=0)
    assert torch.isfinite(found.log_scales).all()


@pytest.mark.parametrize("what", ["points", "colors"])
def test_numbers_that_are_none_are_refused_by_name(what: str) -> None:
    given = {"points": POINTS.clone(), "colors": COLORS.clone()}
    given[what][7:9, 1] = torch.nan
    with pytest.raises(ValueError, match=f"{what} must be finite, got 2 non-finite of 120 values"):
        Gaussians.from_points(given["points"], given["colors"], sh_degree=0)
