"""The loss of LE3D on rendered Gaussians against a version that composites one by one, in float64."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from novags.methods.light import raw_loss
from novags.methods.rivals.le3d.colours import ColourNetwork, seen_from, with_first_colours
from novags.methods.rivals.le3d.ends import first_and_last
from novags.methods.rivals.le3d.regularisers import BINS, bin_edges, near_far, opaque, spread
from novags.methods.rivals.le3d.trainer import Le3dLoss
from novags.methods.rivals.rows.le3d import Le3dConfig
from novags.splats import FitConfig, Gaussians, Views, rasterize
from novags.splats.raster.raster_torch import project
from novags.splats.training.step import Step, render_step

CONFIG = Le3dConfig(fit=FitConfig(extent=1.0, eps2d=0.3), seen=16, opaque_weight=0.3, spread_weight=0.7,
                    near_far_weight=0.2)  # fmt: skip
WIDTH, HEIGHT = 32, 24  # seen 16 x 12


def cloud() -> Gaussians:
    """Forty Gaussians, faint and opaque, one behind another; some out of sight."""
    g = torch.Generator().manual_seed(5)
    points = torch.randn(40, 3, generator=g) * torch.tensor([0.8, 0.6, 1.0])
    found = Gaussians.from_points(points, torch.rand(40, 3, generator=g), sh_degree=0)
    found.log_scales += 0.4 * torch.randn(40, 3, generator=g) - 0.5
    found.quats = torch.randn(40, 4, generator=g)
    found.logit_opacities = 2 * torch.randn(40, generator=g)
    return found


def step_of(gaussians: Gaussians, network: ColourNetwork, config: Le3dConfig) -> Step:
    """The iteration of a fit that renders the second of two views."""
    with_first_colours(gaussians, torch.rand(40, 3, generator=torch.Generator().manual_seed(6)), network,
                       torch.zeros(3), 3)  # fmt: skip
    gaussians.requires_grad_()
    viewmats = torch.eye(4).repeat(2, 1, 1)
    viewmats[:, 2, 3], viewmats[1, 0, 3] = 3.5, 0.2
    K = torch.tensor([[40.0, 0, 17], [0, 38.0, 11], [0, 0, 1]])
    return render_step(
        gaussians, gaussians.scales, gaussians.opacities, Views(viewmats, K.repeat(2, 1, 1), WIDTH, HEIGHT), view=1,
        iteration=3, iterations=9, sh_degree=0, with_depth=False, splatting=config.fit.splatting, backend="numba",
    )  # fmt: skip


def weights_of(step: Step, K: Tensor, width: int, height: int, chosen: Tensor) -> tuple[Tensor, list[list[int]]]:
    """Blending weights [pixels, N] of the view, and for each pixel the Gaussians composited there, front to back."""
    g = step.gaussians
    means2d, covs2d, depths = project(
        g.means.double(), g.quats.double(), g.scales.double(), step.views.viewmats[1].double(), K.double(), width,
        height, 0.3,
    )  # fmt: skip
    conics, opacities = torch.linalg.inv(covs2d), g.opacities.double()
    pixels = torch.tensor([(x + 0.5, y + 0.5) for y in range(height) for x in range(width)]).double()
    left, stopped = torch.ones(len(pixels)).double(), torch.zeros(len(pixels)).bool()
    weights, rays = [torch.zeros_like(left)] * len(g), [list[int]() for _ in pixels]
    for i in torch.argsort(depths.detach()).tolist():
        if depths[i] < 0.01 or not chosen[i]:
            continue
        apart = pixels - means2d[i]
        alpha = (opacities[i] * torch.exp(-0.5 * ((apart @ conics[i]) * apart).sum(1))).clamp_max(0.999)
        after = left * (1 - alpha)
        counts = ~stopped & (alpha >= 1 / 255)
        stopped = stopped | (counts & (after < 1e-4))
        counts = counts & ~stopped
        weights[i] = torch.where(counts, left * alpha, 0.0)
        left = torch.where(counts, after, left)
        for pixel in counts.nonzero()[:, 0].tolist():
            rays[pixel].append(i)
    return torch.stack(weights, 1), rays


def expected(step: Step, K: Tensor, chosen: Tensor) -> tuple[Tensor, Tensor]:
    """Depth and alpha of chosen Gaussians, a value for each pixel of the small view."""
    depths = (step.gaussians.means @ step.views.viewmats[1, :3, :3].T + step.views.viewmats[1, :3, 3])[:, 2].double()
    weights, _ = weights_of(step, K, 16, 12, chosen)
    sums = weights @ torch.stack([depths, torch.ones_like(depths)], 1)
    return sums[:, 0] / sums[:, 1].clamp_min(1e-10), sums[:, 1]


@pytest.mark.parametrize("count", [1, 2])
def test_the_loss_and_its_gradient_are_those_of_gaussians_composited_one_by_one(count: int) -> None:
    config = dataclasses.replace(CONFIG, ends=count)
    torch.manual_seed(4)
    network, white, every = ColourNetwork(), torch.tensor([0.9, 1.2, 0.5]), torch.ones(40, dtype=torch.bool)
    step = step_of(cloud(), network, config)
    target = torch.rand(HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(7))
    target[::2, 1::2, 0] = torch.nan
    leaves = [*step.gaussians.tensors().values(), *network.parameters()]
    found = Le3dLoss(network, white, 0.05, config)(step, target)
    gradients = torch.autograd.grad(found, leaves, retain_graph=True)

    g, viewmat, Ks = step.gaussians, step.views.viewmats[1], step.views.Ks[1]
    assert g.features is not None
    colors = seen_from(-viewmat[:3, :3].T @ viewmat[:3, 3], g.means, g.features, g.sh[:, 0], network).double()
    whole = weights_of(step, Ks, WIDTH, HEIGHT, every)[0] @ torch.cat([colors, torch.ones(40, 1)], 1)
    want = raw_loss(whole[:, :3], target.reshape(-1, 3).double(), 0.05, white.double()) + 0.3 * opaque(whole[:, 3])
    small = torch.diag(torch.tensor([16 / 32, 12 / 24, 1])) @ Ks
    weights, rays = weights_of(step, small, 16, 12, every)
    depths = (g.means.detach() @ viewmat[:3, :3].T + viewmat[:3, 3])[:, 2].double()
    edges = bin_edges(depths[step.visible])
    assert edges is not None
    bins = torch.zeros(40, BINS, dtype=torch.float64)
    for i, depth in enumerate(depths.tolist()):
        bins[i, min(BINS - 1, max(0, int((depth - edges[0]) / (edges[-1] - edges[0]) * BINS)))] = 1
    want = want + 0.7 * spread(weights @ bins, edges)
    first = {i for ray in rays for i in ray[:count]}
    last = {i for ray in rays for i in ray[-count:]}
    assert first != last
    ends = (torch.tensor([i in end for i in range(40)]) for end in (first, last))
    near, far = (expected(step, small, end) for end in ends)
    want = want + 0.2 * near_far(near, far)
    assert float(found.detach()) == pytest.approx(float(want.detach()), rel=1e-4)
    for gradient, slow in zip(gradients, torch.autograd.grad(want, leaves), strict=True):
        np.testing.assert_allclose(gradient.numpy(), slow.numpy(), rtol=5e-3, atol=2e-3 * float(slow.abs().max()))


@pytest.mark.parametrize("count", [1, 3])
def test_the_ends_of_rays_are_those_of_lists_made_one_by_one(count: int) -> None:
    step = step_of(cloud(), ColourNetwork(), CONFIG)
    _, rays = weights_of(step, step.views.Ks[1], WIDTH, HEIGHT, torch.ones(40, dtype=torch.bool))
    first, last = first_and_last(step.info, WIDTH, HEIGHT, count)
    assert set(first.nonzero()[:, 0].tolist()) == {i for ray in rays for i in ray[:count]}
    assert set(last.nonzero()[:, 0].tolist()) == {i for ray in rays for i in ray[-count:]}
    assert max(len(ray) for ray in rays) > 3 * count


def test_nothing_is_met_behind_the_place_where_a_ray_stops() -> None:
    """Half of the light is left, then five of 10,000; the third would leave too little, the fourth would not."""
    means = torch.tensor([[0.0, 0, 2], [0, 0, 3], [0, 0, 4], [0, 0, 5]])
    quats, scales = torch.tensor([1.0, 0, 0, 0]).repeat(4, 1), torch.full((4, 3), 9.0)
    _, _, info = rasterize(
        means, quats, scales, torch.tensor([0.5, 0.999, 0.99, 0.2]), torch.ones(4, 1), torch.eye(4)[None],
        torch.tensor([[[40.0, 0, 8], [0, 40, 8], [0, 0, 1]]]), 16, 16, packed=False,
    )  # fmt: skip
    first, last = first_and_last(info, 16, 16, 1)
    assert first.tolist() == [True, False, False, False]
    assert last.tolist() == [False, True, False, False]


def test_a_term_without_weight_and_an_empty_view_take_nothing() -> None:
    network, step = ColourNetwork(), step_of(cloud(), ColourNetwork(), CONFIG)
    none = dataclasses.replace(CONFIG, spread_weight=0.0, near_far_weight=0.0)
    assert Le3dLoss(network, torch.ones(3), 0.1, none).along_rays(step) == 0
    away = cloud()
    away.means -= torch.tensor([0.0, 0, 50])  # behind the camera
    empty: Any = step_of(away, network, CONFIG)
    loss = Le3dLoss(network, torch.ones(3), 0.1, CONFIG)
    assert loss.along_rays(empty) == 0
    assert bool(torch.isfinite(loss(empty, torch.rand(HEIGHT, WIDTH, 3))))
