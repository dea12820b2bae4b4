"""Gaussians that start exactly black learn their colours, although their fused sum rounds to just below zero."""

import pytest
import torch
from torch import Tensor

from novags.splats import FitConfig, Gaussians, Views, fit, rasterize

POINTS = torch.tensor([[0.0, 0, 0], [0.3, 0, 0.1], [-0.2, 0.3, 0], [0.1, -0.3, -0.1]])
GREY = torch.full((16, 16, 3), 0.5)


def view() -> Views:
    viewmat = torch.eye(4)
    viewmat[2, 3] = 2.0
    return Views(viewmat[None], torch.tensor([[[20.0, 0, 8], [0, 20, 8], [0, 0, 1]]]), 16, 16)


def black(degree: int) -> Gaussians:
    return Gaussians.from_points(POINTS, torch.zeros_like(POINTS), sh_degree=degree)


def gradient(degree: int, backend: str) -> tuple[Tensor, Tensor]:
    """The picture, and the gradient of its squared distance from grey for the first coefficients."""
    g, seen = black(degree).requires_grad_(), view()
    image, _, _ = rasterize(
        g.means, g.quats, g.scales, g.opacities, g.sh, seen.viewmats, seen.Ks, 16, 16, sh_degree=degree, backend=backend
    )
    (image[0] - GREY).square().sum().backward()
    assert g.sh.grad is not None
    return image.detach(), g.sh.grad[:, 0]


@pytest.mark.parametrize("degree", range(4))
def test_black_has_the_gradient_of_the_reference_and_is_shown_as_black(degree):
    image, found = gradient(degree, "numba")
    _, expected = gradient(degree, "torch")
    assert not image.any()
    assert (expected < -0.1).all()
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=0)


@pytest.mark.parametrize("extra", [[], [lambda step: None]], ids=["direct", "autograd"])
def test_a_fit_brightens_every_channel_of_black_gaussians(extra):
    config = FitConfig(iterations=30, sh_degree=1, sh_every=10, mcmc=None)
    result = fit(black(1), view(), lambda i: GREY, config, extra_losses=extra)
    assert (result.gaussians.sh[:, 0] > black(1).sh[:, 0] + 0.01).all()
