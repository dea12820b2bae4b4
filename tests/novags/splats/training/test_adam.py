"""The optimiser against torch.optim.Adam, and its learning rates."""

import pytest
import torch
from numba.core.errors import TypingError

from novags.splats import FitConfig, Gaussians, LearningRates, Views, fit
from novags.splats.training.updates.activate import activate
from novags.splats.training.updates.adam import Adam


def cloud(n: int, dtype=torch.float32) -> Gaussians:
    g = torch.Generator().manual_seed(0)
    shapes = {"means": (n, 3), "quats": (n, 4), "log_scales": (n, 3), "logit_opacities": (n,), "sh": (n, 9, 3)}
    return Gaussians(
        **{name: torch.randn(*s, generator=g, dtype=torch.float64).to(dtype) for name, s in shapes.items()}
    )


def test_steps_equal_torch_adam_with_a_rate_per_tensor():
    rates = LearningRates()
    gaussians, adam = cloud(333), Adam(cloud(333))
    reference = {name: t.clone().requires_grad_() for name, t in gaussians.tensors().items()}
    dc, rest = (t.clone().requires_grad_() for t in (gaussians.sh[:, :1], gaussians.sh[:, 1:]))
    groups = [{"params": [reference["means"]], "lr": 1e-3}, {"params": [dc], "lr": rates.sh_dc}]
    groups += [{"params": [rest], "lr": rates.sh_rest}]
    groups += [{"params": [reference[n]], "lr": getattr(rates, n)} for n in ("quats", "log_scales", "logit_opacities")]
    optimizer = torch.optim.Adam(groups, eps=1e-15)
    g = torch.Generator().manual_seed(1)
    for step in range(20):
        for name, tensor in gaussians.tensors().items():
            gradient = torch.randn(tensor.shape, generator=g) * 10.0 ** (-step)  # down to 1e-20: eps must not matter
            gradient[::7] = 0
            tensor.grad = gradient
            reference[name].grad = gradient
        dc.grad, rest.grad = gaussians.sh.grad[:, :1], gaussians.sh.grad[:, 1:]
        adam.step(gaussians, rates, 1e-3)
        optimizer.step()
    reference["sh"] = torch.cat([dc, rest], 1)
    for name, tensor in gaussians.tensors().items():
        torch.testing.assert_close(tensor, reference[name].detach(), rtol=1e-5, atol=1e-5)


def test_a_gaussian_that_was_never_seen_does_not_move():
    gaussians, before = cloud(10), cloud(10)
    adam = Adam(gaussians)
    for tensor in gaussians.tensors().values():
        tensor.grad = torch.zeros_like(tensor)
    adam.step(gaussians, LearningRates(), 1e-3)
    assert all(torch.equal(t, before.tensors()[name]) for name, t in gaussians.tensors().items())


def test_the_two_schedules_of_the_means_differ_only_in_where_they_end():
    original, gsplat = LearningRates(schedule="original"), LearningRates(schedule="gsplat")
    for rates in (original, gsplat):
        assert rates.means_at(0, 7000, 2.0) == pytest.approx(3.2e-4)
        assert rates.means_at(30_000, 30_000, 2.0) == pytest.approx(3.2e-6)
    assert gsplat.means_at(7000, 7000, 2.0) == pytest.approx(3.2e-6)
    assert original.means_at(7000, 7000, 1.0) == pytest.approx(1.6e-4 * 0.01 ** (7 / 30))


def test_bad_rates_are_refused():
    with pytest.raises(ValueError, match="learning rate quats must be >= 0, got -1"):
        LearningRates(quats=-1.0)
    with pytest.raises(ValueError, match="schedule must be"):
        LearningRates(schedule="cosine")
    with pytest.raises(ValueError, match="means_final must be > 0 where means is .* got 0 and means 0.001"):
        LearningRates(means=1e-3, means_final=0.0)


def test_means_without_a_rate_stay_whatever_the_final_one_is():
    assert LearningRates(means=0, means_final=0).means_at(3, 10, 2.0) == 0
    assert LearningRates(means=0, means_final=1e-5).means_at(3, 10, 2.0) == 0


@pytest.mark.parametrize("n", [1, 16, 5003])
def test_activation_and_regulariser_equal_autograd_in_float64(n):
    gaussians, exact = cloud(n).requires_grad_(), cloud(n, torch.float64)
    exact = Gaussians(**{name: t.float().double() for name, t in exact.tensors().items()}).requires_grad_()
    g = torch.Generator().manual_seed(2)
    ws, wo = torch.randn(n, 3, generator=g), torch.randn(n, generator=g)
    scales, opacities, regularizer = activate(gaussians, 0.01, 0.03)
    ((scales * ws).sum() + (opacities * wo).sum() + 5 * regularizer).backward()
    expected = 0.01 * exact.opacities.mean() + 0.03 * exact.scales.mean()
    ((exact.scales * ws).sum() + (exact.opacities * wo).sum() + 5 * expected).backward()
    torch.testing.assert_close(scales.double(), exact.scales, rtol=2e-6, atol=0)
    torch.testing.assert_close(opacities.double(), exact.opacities, rtol=2e-6, atol=0)
    assert regularizer.item() == pytest.approx(expected.item(), rel=1e-6)
    for name in ("log_scales", "logit_opacities"):
        got, want = getattr(gaussians, name).grad.double(), getattr(exact, name).grad
        torch.testing.assert_close(got, want, rtol=1e-5, atol=1e-6)


def test_doubles_do_not_reach_the_kernels_as_other_numbers():
    with pytest.raises(TypingError, match="a vector must lie in an array of float32 or int32, got float64"):
        activate(cloud(20, torch.float64), 0.01, 0.01)


def test_opacities_stay_finite_at_the_ends_of_float32():
    gaussians = cloud(4)
    gaussians.logit_opacities = torch.tensor([-200.0, -50.0, 50.0, 200.0])
    _, opacities, _ = activate(gaussians, 0.01, 0.01)
    assert torch.isfinite(opacities).all()
    assert opacities.min() >= 0
    assert opacities.max() <= 1


@pytest.mark.parametrize("what", ["scales", "opacities"])
def test_an_activation_changed_before_its_gradient_is_noticed(what):
    gaussians = cloud(20).requires_grad_()
    scales, opacities, regularizer = activate(gaussians, 0.01, 0.01)
    with torch.no_grad():
        {"scales": scales, "opacities": opacities}[what].mul_(2)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        regularizer.backward()


def test_a_second_derivative_of_an_activation_is_refused():
    gaussians = cloud(20).requires_grad_()
    scales, _, _ = activate(gaussians, 0.01, 0.01)
    with pytest.raises(RuntimeError, match="no second derivative"):
        torch.autograd.grad(scales.sum(), gaussians.log_scales, create_graph=True)


@pytest.mark.parametrize("name", ["means", "quats", "sh"])
def test_a_tensor_that_could_not_be_updated_in_place_is_refused(name):
    gaussians = cloud(20)
    setattr(gaussians, name, getattr(gaussians, name).mT.contiguous().mT)
    for tensor in gaussians.tensors().values():
        tensor.grad = torch.ones_like(tensor)
    before = gaussians.logit_opacities.clone()
    with pytest.raises(ValueError, match=rf"{name} must be contiguous.*call \.contiguous\(\)"):
        Adam(gaussians).step(gaussians, LearningRates(), 1e-3)
    assert torch.equal(gaussians.logit_opacities, before)


def test_rates_cool_log_linearly_but_for_those_of_the_means():
    rates = LearningRates(cool_from=0.6, cool_to=0.01)
    assert rates.at(0, 100) == rates.at(60, 100) == rates
    for name in ("quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest"):
        assert getattr(rates.at(80, 100), name) == pytest.approx(0.1 * getattr(rates, name))
        assert getattr(rates.at(100, 100), name) == pytest.approx(0.01 * getattr(rates, name))
    assert rates.at(80, 100).means_at(80, 100, 2.0) == rates.means_at(80, 100, 2.0)
    assert LearningRates().at(99, 100) == LearningRates()


@pytest.mark.parametrize("setting", [{"cool_from": 1.0}, {"cool_from": -0.1}, {"cool_to": 0.0}, {"cool_to": 1.5}])
def test_coolings_that_mean_nothing_are_refused(setting):
    with pytest.raises(ValueError, match=r"cool_from must lie in \[0, 1\) and cool_to in \(0, 1\]"):
        LearningRates(**setting)


@pytest.mark.parametrize("direct", [True, False])
def test_a_fit_takes_cooled_steps(direct):
    """The first step of Adam is its rate: a run that begins at its end moves by the cooled one."""
    g = torch.Generator().manual_seed(0)
    start = Gaussians.from_points(torch.rand(20, 3, generator=g), torch.rand(20, 3, generator=g), sh_degree=0)
    viewmat, K = torch.eye(4), torch.tensor([[16.0, 0, 8], [0, 16.0, 8], [0, 0, 1]])
    viewmat[2, 3] = 3.0
    views, image = Views(viewmat[None], K[None], 16, 16), torch.rand(16, 16, 3, generator=g)
    moved = {}
    for cool_to in (1.0, 0.1):
        rates = LearningRates(cool_from=0.0, cool_to=cool_to)
        config = FitConfig(iterations=2, rates=rates, mcmc=None, sh_degree=0)
        extra = [] if direct else [lambda step: None]
        found = fit(start, views, lambda i: image, config, extra_losses=extra).gaussians
        once = fit(start, views, lambda i: image, FitConfig(iterations=1, mcmc=None, sh_degree=0), extra_losses=extra)
        moved[cool_to] = (found.log_scales - once.gaussians.log_scales).abs().median()
    assert float(moved[0.1] / moved[1.0]) == pytest.approx(0.1**0.5, rel=0.02)
