import pytest
import torch

from novags.methods.nova.sh_penalty import noise_map, noise_weights, penalty_weights
from novags.splats.training.step import harmonics_penalty

NOISE = torch.arange(12.0).reshape(3, 4)


def sh_penalty(sh: torch.Tensor, means2d: torch.Tensor, radii: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
    """L_SH; radii are 0 where a Gaussian is not visible."""
    return harmonics_penalty(sh, penalty_weights(means2d, radii > 0, noise))


def test_noise_map_is_the_mean_absolute_difference_over_colours():
    a, b = torch.zeros(2, 2, 3), torch.zeros(2, 2, 3)
    a[0, 1] = torch.tensor([0.3, -0.6, 0.0])
    torch.testing.assert_close(noise_map(a, b), torch.tensor([[0.0, 0.3], [0.0, 0.0]]))


def test_weights_are_bilinear_between_pixel_centres():
    centres = torch.tensor([[0.5, 0.5], [3.5, 2.5], [1.0, 0.5], [1.5, 1.0], [0.0, 0.0]])
    torch.testing.assert_close(noise_weights(NOISE, centres), torch.tensor([0.0, 11.0, 0.5, 3.0, 0.0]))


def test_the_penalty_equals_its_formula_over_visible_gaussians():
    sh = torch.rand(4, 9, 3, generator=torch.Generator().manual_seed(0))
    means2d = torch.tensor([[1.5, 0.5], [2.5, 1.5], [1.5, 1.5], [9.0, 1.0]])
    radii = torch.tensor([3, 2, 0, 5])  # the third is not visible, the fourth is centred outside the frame
    expected = (1.0 * (sh[0, 1:] ** 2).sum() + 6.0 * (sh[1, 1:] ** 2).sum()) / 2
    torch.testing.assert_close(sh_penalty(sh, means2d, radii, NOISE), expected)


def test_gradient_reaches_higher_orders_of_visible_gaussians_alone():
    sh = torch.rand(3, 4, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    means2d = torch.tensor([[1.5, 1.5], [2.5, 2.5], [1.5, 0.5]], requires_grad=True)
    noise = NOISE.clone().requires_grad_()
    sh_penalty(sh, means2d, torch.tensor([1, 1, 0]), noise).backward()
    assert (sh.grad[:2, 1:] != 0).all()
    assert (sh.grad[:, 0] == 0).all()
    assert (sh.grad[2] == 0).all()
    assert means2d.grad is None
    assert noise.grad is None


@pytest.mark.parametrize(("radii", "orders"), [([0, 0], 4), ([1, 1], 1)])
def test_nothing_visible_or_no_higher_orders_costs_nothing(radii, orders):
    assert float(sh_penalty(torch.ones(2, orders, 3), torch.ones(2, 2), torch.tensor(radii), NOISE)) == 0
