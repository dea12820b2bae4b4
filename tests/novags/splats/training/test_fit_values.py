"""What one iteration of the fit does, number by number, against arithmetic done here."""

import dataclasses
import math
import sys
from typing import Any

import numpy as np
import pytest
import torch
from scipy.ndimage import correlate1d
from torch import Tensor

from novags.splats import (
    CameraRefinement,
    FitConfig,
    Gaussians,
    LearningRates,
    McmcConfig,
    Step,
    Views,
    fit,
    photometric_loss,
    rasterize,
)
from novags.splats.training.updates.activate import activate
from novags.splats.training.updates.adam import Adam
from novags.splats.training.updates.camera_refinement import CameraState, refined
from novags.splats.training.updates.mcmc import add_noise, grow, relocate

MODULE = sys.modules["novags.splats.training.fit"]  # the package's `fit` is the function
WIDTH, HEIGHT, N_VIEWS, N = 20, 14, 5, 40
RATES = LearningRates(
    means=3e-3, means_final=3e-5, quats=2e-3, log_scales=7e-3, logit_opacities=4e-2, sh_dc=6e-3, sh_rest=1e-3
)


def scene() -> tuple[Gaussians, Views]:
    g = torch.Generator().manual_seed(0)
    gaussians = Gaussians(
        means=torch.rand(N, 3, generator=g) - 0.5, quats=torch.randn(N, 4, generator=g),
        log_scales=-2 + 0.3 * torch.randn(N, 3, generator=g), logit_opacities=torch.randn(N, generator=g),
        sh=0.4 * torch.randn(N, 16, 3, generator=g),
    )  # fmt: skip
    viewmats = torch.eye(4).repeat(N_VIEWS, 1, 1)
    for k in range(N_VIEWS):
        c, s = math.cos(k), math.sin(k)
        viewmats[k, :3] = torch.tensor([[c, 0, -s, 0], [0, 1, 0, 0.1 * k], [s, 0, c, 2.0]])
    K = torch.tensor([[20.0, 0, WIDTH / 2], [0, 20.0, HEIGHT / 2], [0, 0, 1]])
    return gaussians, Views(viewmats, K.repeat(N_VIEWS, 1, 1), WIDTH, HEIGHT)


def pictures(g: Gaussians, views: Views, degree: int, mode: str = "RGB") -> tuple[Tensor, Tensor]:
    image, alpha, _ = rasterize(
        g.means, g.quats, g.scales, g.opacities, g.sh, views.viewmats, views.Ks, WIDTH, HEIGHT, sh_degree=degree,
        render_mode=mode,
    )  # fmt: skip
    return image, alpha[..., 0]


def targets() -> Tensor:
    return torch.rand(N_VIEWS, HEIGHT, WIDTH, 3, generator=torch.Generator().manual_seed(1))


def one(**changes: Any) -> FitConfig:
    return dataclasses.replace(FitConfig(iterations=1, mcmc=None, rates=RATES, extent=2.5), **changes)


def largest_move(after: Gaussians, before: Gaussians) -> dict[str, float]:
    return {name: (t - before.tensors()[name]).abs().max().item() for name, t in after.tensors().items()}


def test_the_first_step_of_each_tensor_is_its_rate_and_of_the_means_rate_times_extent():
    """Adam's first step has the size of the rate, whatever the gradient."""
    start, views = scene()
    images = targets()
    moves = largest_move(fit(start, views, lambda i: images[i], one()).gaussians, start)
    assert moves["means"] == pytest.approx(2.5 * 3e-3, rel=1e-3)
    assert moves["quats"] == pytest.approx(2e-3, rel=1e-3)
    assert moves["log_scales"] == pytest.approx(7e-3, rel=1e-3)
    assert moves["logit_opacities"] == pytest.approx(4e-2, rel=1e-3)
    assert moves["sh"] == pytest.approx(6e-3, rel=1e-3)
    measured = fit(start, views, lambda i: images[i], one(extent=None)).gaussians
    assert largest_move(measured, start)["means"] == pytest.approx(views.extent * 3e-3, rel=1e-3)


def test_every_step_goes_down_the_slope():
    start, views = scene()
    images = targets()
    after = fit(start, views, lambda i: images[i], one(opacity_reg=0.0, scale_reg=0.0, sh_every=1)).gaussians
    seen = FitConfig(seed=0).view_at(0, N_VIEWS)
    leaves = Gaussians(**{name: t.clone() for name, t in start.tensors().items()}).requires_grad_()
    image, _ = pictures(leaves, views, 0)
    photometric_loss(image[seen], images[seen], 0.2).backward()
    for name, leaf in leaves.tensors().items():
        strong = leaf.grad.abs() > 1e-2 * leaf.grad.abs().max()
        moved = after.tensors()[name] - start.tensors()[name]
        assert torch.equal(moved[strong].sign(), -leaf.grad[strong].sign()), name


@pytest.mark.parametrize("weights", [(0.2, 0.01, 0.03), (0.0, 0.5, 0.0), (1.0, 0.0, 2.0)])
def test_the_loss_is_photometric_plus_weighted_mean_opacity_and_scale_plus_extra_losses(weights):
    start, views = scene()
    images, (dssim, opacity_reg, scale_reg) = targets(), weights
    config = one(dssim_weight=dssim, opacity_reg=opacity_reg, scale_reg=scale_reg)
    (entry,) = fit(
        start, views, lambda i: images[i], config,
        extra_losses=[lambda step: step.render.new_tensor(0.25), lambda step: None, lambda step: 2 * step.alpha.mean()],
    ).losses  # fmt: skip
    seen = FitConfig(seed=0).view_at(0, N_VIEWS)
    image, alpha = pictures(start, views, 0)
    photometric = photometric_loss(image[seen].double(), images[seen].double(), dssim).item()
    assert entry["photometric"] == pytest.approx(photometric, rel=1e-5)
    rest = opacity_reg * start.opacities.mean() + scale_reg * start.scales.mean() + 0.25 + 2 * alpha[seen].mean()
    assert entry["loss"] == pytest.approx(photometric + rest.item(), rel=1e-5)


@pytest.mark.parametrize("options", [{}, {"extra_losses": [lambda step: None]}], ids=["direct", "autograd"])
@pytest.mark.parametrize("fall", [0.0, 1.0, 2.5])
def test_the_weight_of_the_opacities_falls_with_what_is_left_of_the_run(fall, options):
    start, views = scene()
    views.viewmats[:, 2, 3] = -100.0  # all is behind the cameras: nothing is left but the regularisers
    still = LearningRates(means=0, means_final=0, quats=0, log_scales=0, logit_opacities=0, sh_dc=0, sh_rest=0)
    config = one(iterations=20, opacity_reg=0.3, opacity_reg_fall=fall, scale_reg=0.0, rates=still)
    black = torch.zeros(HEIGHT, WIDTH, 3)
    middle, last = fit(start, views, lambda i: black, config, **options).losses
    opacity = 0.3 * start.opacities.mean().item()
    assert middle["loss"] == pytest.approx(opacity * 0.55**fall, rel=1e-5)  # of the tenth iteration, which is number 9
    assert last["loss"] == pytest.approx(opacity * 0.05**fall, rel=1e-5)


def test_each_view_is_rendered_by_its_own_camera_and_compared_with_its_own_target():
    start, views = scene()
    still = LearningRates(means=0, means_final=0, quats=0, log_scales=0, logit_opacities=0, sh_dc=0, sh_rest=0)
    config = one(iterations=2 * N_VIEWS, rates=still, sh_every=3, sh_degree=2)
    asked: list[int] = []
    seen: list[int] = []

    def target(view: int) -> Tensor:
        asked.append(view)
        return torch.zeros(HEIGHT, WIDTH, 3)

    def check(step: Step) -> None:
        degree = [0, 0, 0, 1, 1, 1, 2, 2, 2, 2][step.iteration]
        image, alpha = pictures(start, views, degree, "RGB+ED")
        torch.testing.assert_close(step.render, image[step.view, ..., :3], rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(step.depth, image[step.view, ..., 3], rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(step.alpha, alpha[step.view])
        other = (step.view + 2) % N_VIEWS
        render, depth, covered, info = step.rasterize_view(other)
        torch.testing.assert_close(render, image[other, ..., :3], rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(depth, image[other, ..., 3], rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(covered, alpha[other])
        z = start.means @ views.viewmats[other, 2, :3] + views.viewmats[other, 2, 3]
        torch.testing.assert_close(info["depths"][0], z)
        assert step.views is views
        assert (step.iterations, step.iteration) == (2 * N_VIEWS, len(seen))
        seen.append(step.view)

    fit(start, views, target, config, extra_losses=[check], needs_depth=True)
    assert asked == seen
    assert sorted(seen) == sorted(2 * list(range(N_VIEWS)))


def test_a_photometric_loss_of_ones_own_takes_the_place_of_the_default():
    start, views = scene()
    asked: list[tuple[int, float]] = []

    def raw(step: Step, target: Tensor) -> Tensor:
        asked.append((step.view, target.item()))
        return 3 + 0 * step.render.sum()

    (entry,) = fit(start, views, lambda i: torch.tensor(float(i)), one(), photometric=raw).losses
    assert entry["photometric"] == 3
    assert entry["loss"] == pytest.approx(3 + 0.01 * (start.opacities.mean() + start.scales.mean()).item())
    assert asked == [(asked[0][0], float(asked[0][0]))]


def test_harmonics_above_the_rendered_degree_move_only_where_extra_losses_reach_them():
    start, views = scene()
    images = targets()
    plain = fit(start, views, lambda i: images[i], one()).gaussians
    reached = fit(start, views, lambda i: images[i], one(), extra_losses=[lambda s: s.gaussians.sh[:, 9:].sum()])
    assert torch.equal(plain.sh[:, 1:], start.sh[:, 1:])
    torch.testing.assert_close(reached.gaussians.sh[:, 9:], start.sh[:, 9:] - 1e-3, rtol=0, atol=1e-6)


def test_a_start_of_another_degree_is_cut_or_padded_with_zeros():
    start, views = scene()
    images = targets()
    cut = fit(start, views, lambda i: images[i], one(iterations=0, sh_degree=1)).gaussians
    assert torch.equal(cut.sh, start.sh[:, :4])
    padded = fit(cut, views, lambda i: images[i], one(iterations=0, sh_degree=2)).gaussians
    assert torch.equal(padded.sh[:, :4], start.sh[:, :4])
    assert padded.sh.shape == (N, 9, 3)
    assert not padded.sh[:, 4:].any()


def counts(config: FitConfig) -> list[int]:
    """Gaussians in each iteration."""
    start, views = scene()
    images, seen = targets(), []
    fit(start, views, lambda i: images[i], config, extra_losses=[lambda step: seen.append(len(step.gaussians))])
    return seen


def test_growth_happens_after_the_start_before_the_stop_and_every_so_often():
    mcmc = McmcConfig(refine_start=4, refine_stop=12, refine_every=4, growth=1.25, noise_lr=None)
    # at iteration 8 alone: 4 is the start, 12 the stop; seen from iteration 9 on
    assert counts(one(iterations=16, mcmc=mcmc, cap_max=1000)) == 9 * [40] + 7 * [50]
    often = dataclasses.replace(mcmc, refine_start=0, refine_every=1, refine_stop=None)
    # 5/6 of 6 iterations: at 1, 2, 3, 4, each time by a quarter, rounded down, until the cap
    assert counts(one(iterations=6, mcmc=often, cap_max=1000)) == [40, 40, 50, 62, 77, 96]
    assert counts(one(iterations=6, mcmc=often, cap_max=70)) == [40, 40, 50, 62, 70, 70]
    assert counts(one(iterations=6, mcmc=often)) == 6 * [40]


def test_relocation_comes_before_growth_and_noise_with_streams_of_their_own(monkeypatch):
    calls: list[tuple[str, float, int]] = []
    limits: list[float] = []

    def record(name: str) -> None:
        original = getattr(MODULE, name)

        def wrapped(gaussians: Gaussians, *rest: Any, **options: Any) -> Any:
            number = len(gaussians) if name == "relocate" else rest[0]
            calls.append((name, number, next(x for x in rest if isinstance(x, torch.Generator)).initial_seed()))
            limits.extend(x for key, x in options.items() if key == "limit")
            return original(gaussians, *rest, **options)

        monkeypatch.setattr(MODULE, name, wrapped)

    for name in ("relocate", "grow", "add_noise"):
        record(name)
    mcmc = McmcConfig(refine_start=0, refine_stop=10, refine_every=2, growth=1.25, noise_lr=1e3)
    assert counts(one(iterations=4, mcmc=mcmc, cap_max=1000)) == [40, 40, 40, 50]
    names = [name for name, _, _ in calls]
    assert names == ["add_noise", "add_noise", "relocate", "grow", "add_noise", "add_noise"]
    rates = [2.5 * 3e-3 * 0.01 ** (i / 4) for i in range(4)]  # extent times a rate that falls to a hundredth
    assert [x for name, x, _ in calls if name == "add_noise"] == pytest.approx([1e3 * rate for rate in rates])
    assert [x for name, x, _ in calls if name == "grow"] == [50]
    assert len({seed for _, _, seed in calls}) == len(calls)
    assert limits == 4 * [2.5]  # the extent


def test_refinement_forgets_the_moments_of_the_drawn_and_of_them_alone():
    start, _ = scene()
    start.logit_opacities[:] = -9.0  # dead
    start.logit_opacities[3] = 2.0
    adam = Adam(start)
    for moments in (adam.first, adam.second):
        for tensor in moments.values():
            tensor += 1
    config = one(iterations=100, mcmc=McmcConfig(refine_start=0, refine_every=1, growth=1.1, noise_lr=None))
    before = start.means.clone()
    relocated = MODULE._mcmc_step(start, adam, 1, config, N, 1.0, 2.5)
    assert (relocated.means == before[3]).all()
    for tensor in (*adam.first.values(), *adam.second.values()):
        assert not tensor[3].any()
        assert tensor[torch.arange(N) != 3].all()
        tensor[:] = 1
    opacities = relocated.logit_opacities.clone()
    grown = MODULE._mcmc_step(relocated, adam, 1, config, 44, 1.0, 2.5)
    assert len(grown) == 44
    drawn = grown.logit_opacities[:N] != opacities  # they share their opacity with their copies
    for tensor in (*adam.first.values(), *adam.second.values()):
        assert not tensor[:N][drawn].any()
        assert (tensor[:N][~drawn] == 1).all()
    for moments in (adam.first, adam.second):
        for name, tensor in moments.items():
            assert tensor.shape == grown.tensors()[name].shape
            assert not tensor[N:].any()


def test_noise_of_a_scene_in_small_units_is_that_of_the_scene_in_usual_ones(monkeypatch):
    """In units 10 times smaller the rate is 10 times larger, covariances 100 times; steps are to be 10 times longer."""
    start, given = scene()[0], []
    monkeypatch.setattr(MODULE, "add_noise", lambda g, amount, stream, *, limit, good: given.append((amount, limit)))
    for extent in (2.0, 20.0):
        config = one(extent=extent, mcmc=McmcConfig(noise_lr=5e5))
        MODULE._mcmc_step(start, Adam(start), 1, config, N, 1e-4 * extent, extent)
    assert given == [pytest.approx((100.0, 2.0)), pytest.approx((10.0, 20.0))]


@pytest.mark.parametrize("dead", [1, 2, 7])
def test_any_number_of_copies_share_the_opacity_of_one(dead):
    start, _ = scene()
    few = Gaussians(**{name: t[: dead + 1].clone() for name, t in start.tensors().items()})
    few.logit_opacities[:] = torch.tensor([2.0] + dead * [-9.0])
    relocate(few, torch.Generator().manual_seed(0))
    whole = 1 / (1 + math.exp(-2.0))
    torch.testing.assert_close(few.opacities, torch.full((dead + 1,), 1 - (1 - whole) ** (1 / (dead + 1))))


def test_gaussians_at_or_below_an_opacity_of_0_005_are_dead_and_no_copy_becomes_so():
    start, _ = scene()
    start.logit_opacities[:] = torch.logit(torch.tensor(0.0051))
    start.logit_opacities[7] = torch.logit(torch.tensor(0.0049))
    before = start.means.clone()
    drawn = relocate(start, torch.Generator().manual_seed(0))
    moved = (start.means != before).any(1)
    assert moved.nonzero()[:, 0].tolist() == [7]
    # half of 0.0051 would be dead at once
    assert start.opacities[drawn].item() == pytest.approx(0.005, rel=1e-4)


def test_growth_draws_in_proportion_to_opacity():
    start, _ = scene()
    three = Gaussians(**{name: t[:3].clone() for name, t in start.tensors().items()})
    three.logit_opacities[:] = torch.logit(torch.tensor([0.1, 0.3, 0.6]))
    grown, _ = grow(three, 30_003, torch.Generator().manual_seed(0))
    found = torch.tensor([(grown.means[3:] == three.means[i]).all(1).sum() for i in range(3)]).double()
    p = torch.tensor([0.1, 0.3, 0.6]).double()
    assert ((found - 30_000 * p).abs() / torch.sqrt(30_000 * p * (1 - p))).max() < 5


@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_photometric_loss_equals_its_definition_in_numpy(weight, dtype):
    a, b = torch.rand(2, 19, 15, 3, generator=torch.Generator().manual_seed(4), dtype=torch.float64).to(dtype).numpy()
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    taps /= taps.sum()

    def mean(x: np.ndarray) -> np.ndarray:
        return correlate1d(correlate1d(x.astype(np.float64), taps, 0, mode="constant"), taps, 1, mode="constant")

    ma, mb = mean(a), mean(b)
    va, vb, cov = mean(a.astype(float) ** 2) - ma**2, mean(b.astype(float) ** 2) - mb**2, mean(a * b) - ma * mb
    ssim = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4) / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
    expected = (1 - weight) * np.abs(a - b).mean() + weight * (1 - ssim.mean())
    assert photometric_loss(torch.from_numpy(a), torch.from_numpy(b), weight).item() == pytest.approx(
        expected, abs=2e-6
    )


def test_defaults_are_those_of_3dgs_mcmc():
    mcmc, rates, config = McmcConfig(), LearningRates(), FitConfig()
    assert dataclasses.astuple(mcmc) == (500, None, 100, 1.05, 5e5)
    assert dataclasses.astuple(rates) == (1.6e-4, 1.6e-6, "gsplat", 1e-3, 5e-3, 5e-2, 2.5e-3, 1.25e-4, 2.5e-3, 0.6, 1.0)
    assert (config.dssim_weight, config.opacity_reg, config.scale_reg, config.sh_every) == (0.2, 0.01, 0.01, 1000)
    assert config.refine_cameras is None


# Few machines have one. That all tensors of a fit are on one device is checked without, below.
@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device to compare with")
def test_a_fit_on_a_gpu_equals_one_on_the_cpu(tmp_path):
    start, views = scene()
    images, mcmc = targets(), McmcConfig(refine_start=2, refine_every=3, growth=1.2, noise_lr=None)
    refinement = CameraRefinement(start=3)
    config = one(iterations=12, mcmc=mcmc, cap_max=60, backend="torch", refine_cameras=refinement, checkpoint_every=5)
    expected = fit(start, views, lambda i: images[i], config)
    on_gpu, path = images.cuda(), tmp_path / "state.safetensors"
    found = fit(start.to("cuda"), views.to("cuda"), lambda i: on_gpu[i], config, checkpoint=path)
    again = fit(start.to("cuda"), views.to("cuda"), lambda i: on_gpu[i], config, checkpoint=path)
    torch.testing.assert_close(found.viewmats.cpu(), expected.viewmats, rtol=1e-3, atol=1e-3)
    for name, tensor in found.gaussians.tensors().items():
        assert tensor.is_cuda
        torch.testing.assert_close(tensor.cpu(), expected.gaussians.tensors()[name], rtol=1e-2, atol=1e-2)
        assert torch.equal(again.gaussians.tensors()[name], tensor)


def test_optimiser_noise_and_losses_make_no_tensor_on_another_device():
    """On the "meta" device, which has shapes but no numbers, tensors of the CPU are refused as on a GPU."""
    start, _ = scene()
    gaussians = start.to("meta").requires_grad_()
    adam = Adam(gaussians)
    scales, opacities, regularizer = activate(gaussians, 0.01, 0.01)
    image = gaussians.sh.sum() * torch.ones(HEIGHT, WIDTH, 3, device="meta")
    loss = photometric_loss(image, torch.zeros_like(image), 0.2) + regularizer + scales.sum() + opacities.sum()
    loss = loss + gaussians.means.sum() + gaussians.quats.sum()
    loss.backward()
    adam.step(gaussians, RATES, 1e-3, 2)
    detached = gaussians.detach()
    add_noise(detached, 1.0, torch.Generator().manual_seed(0))
    state = CameraState.of(torch.eye(4, device="meta")[None])
    viewmats = refined(torch.eye(4, device="meta")[None], state.twists, 2.0)
    for tensor in (loss, viewmats, state.visits, *detached.tensors().values(), *adam.first.values()):
        assert tensor.device.type == "meta"


def test_views_on_another_device_than_the_gaussians_are_refused():
    start, views = scene()
    with pytest.raises(ValueError, match=r"one device, got viewmats on meta and Gaussians on cpu.*\.to\(device\)"):
        fit(start, views.to("meta"), lambda i: targets()[i], one())
    mixed = dataclasses.replace(views, Ks=views.Ks.to("meta"))
    with pytest.raises(ValueError, match="got Ks on meta and Gaussians on cpu"):
        fit(start, mixed, lambda i: targets()[i], one())
    with pytest.raises(ValueError, match=r"target\(\d\) must be .* on cpu as the views, got .* on meta"):
        fit(start, views, lambda i: targets()[i].to("meta"), one())


def test_the_fit_says_what_it_needs_to_start():
    start, views = scene()
    none = Views(views.viewmats[:0], views.Ks[:0], WIDTH, HEIGHT)
    with pytest.raises(ValueError, match="views must hold at least one camera, got none"):
        fit(start, none, lambda i: targets()[i], one())
    nobody = Gaussians(**{name: t[:0] for name, t in start.tensors().items()})
    with pytest.raises(ValueError, match="at least one Gaussian to start from"):
        fit(nobody, views, lambda i: targets()[i], one())
