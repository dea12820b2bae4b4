"""The iteration without autograd does what autograd does, bit for bit, and leaves to it what is out of the ordinary."""

import dataclasses
import importlib
import threading

import numpy as np
import pytest
import torch

from novags.splats import FitConfig, Gaussians, LearningRates, McmcConfig, NotFinite, Views, fit
from novags.splats.cpu import parallel
from novags.splats.cpu.chains import stages
from novags.splats.cpu.compiler import kernel
from novags.splats.training import direct
from novags.splats.training.guard import all_finite

loop = importlib.import_module("novags.splats.training.fit")  # the package has a function of that name
CONFIG = FitConfig(
    iterations=24, sh_every=6, cap_max=560, mcmc=McmcConfig(refine_start=4, refine_every=5), checkpoint_every=10
)


@pytest.fixture(scope="module")
def problem() -> tuple[Gaussians, Views, torch.Tensor]:
    """500 Gaussians, three cameras of 37 x 29 pixels, and pictures that have nothing to do with them."""
    g = torch.Generator().manual_seed(5)
    start = Gaussians.from_points(torch.randn(500, 3, generator=g), torch.rand(500, 3, generator=g), sh_degree=3)
    viewmats = torch.eye(4).repeat(3, 1, 1)
    viewmats[:, 2, 3] = torch.tensor([4.0, 5.0, 6.0])
    K = torch.tensor([[40.0, 0, 18.5], [0, 42.0, 14.5], [0, 0, 1]])
    return start, Views(viewmats, K.repeat(3, 1, 1), 37, 29), torch.rand(3, 29, 37, 3, generator=g)


def by_autograd(problem, config, **options):
    start, views, images = problem
    return fit(start, views, lambda i: images[i], config, extra_losses=[lambda step: None], **options)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"dssim_weight": 0.0, "sh_degree": 0},
        {"dssim_weight": 1.0, "eps2d": 0.05, "antialiased": True},
        {"opacity_reg": 0.0, "scale_reg": 0.3, "mcmc": None, "sh_degree": 2},
        {"opacity_reg": 0.7, "opacity_reg_fall": 1.5},
    ],
)
def test_the_plain_fit_gives_the_bits_of_autograd(problem, monkeypatch, changes):
    config = dataclasses.replace(CONFIG, **changes)
    expected = by_autograd(problem, config)
    monkeypatch.setattr(loop, "backpropagate", None)  # nothing is left to it
    start, views, images = problem
    got = fit(start, views, lambda i: images[i], config)
    assert got.losses == expected.losses
    for name, tensor in got.gaussians.tensors().items():
        assert torch.equal(tensor, getattr(expected.gaussians, name)), name
    assert not torch.equal(got.gaussians.means[:500], start.means)


def test_an_iteration_is_at_most_nine_calls_of_compiled_code(problem, monkeypatch):
    """With one wave of lists: activation, projection, compositing, loss, back, step; and the noise."""
    calls = []
    for module in (loop, direct, *(importlib.import_module(f"novags.splats.{m}") for m in MODULES)):
        for name in ("run", "run_chain"):
            if hasattr(module, name):
                call = getattr(module, name)
                monkeypatch.setattr(module, name, lambda *a, call=call: calls.append(a[0]) or call(*a))
    start, views, images = problem
    fit(start, views, lambda i: images[i], dataclasses.replace(CONFIG, iterations=4))
    assert len(calls) == 4 * 7


MODULES = (
    "training.updates.mcmc", "training.losses", "training.updates.adam", "training.updates.activate", "cpu.pipeline",
)  # fmt: skip


def test_cameras_are_checked_once_a_fit(problem, monkeypatch):
    checked = []
    check = direct.check_camera
    monkeypatch.setattr(direct, "check_camera", lambda tensors: checked.append(tensors) or check(tensors))
    start, views, images = problem
    fit(start, views, lambda i: images[i], CONFIG)
    assert len(checked) == len(views)
    bad = dataclasses.replace(views, Ks=views.Ks * torch.tensor([1.0, 1.0, -1.0])[:, None, None])
    with pytest.raises(ValueError, match="Ks must"):
        fit(start, bad, lambda i: images[0], CONFIG)


def test_a_target_that_is_not_finite_stops_as_with_autograd_and_changes_nothing(problem, tmp_path):
    start, views, images = problem
    images = images.clone()
    images[:, 3, 4] = torch.nan
    messages, states = [], []
    for name, options in (("direct", {}), ("autograd", {"extra_losses": [lambda step: None]})):
        config = dataclasses.replace(CONFIG, iterations=9, seed=2)
        with pytest.raises(NotFinite) as error:
            fit(start, views, lambda i: images[i], config, checkpoint=tmp_path / name, **options)
        messages.append(str(error.value).split(";")[0])
        states.append((tmp_path / name).read_bytes()[-4000:])
    assert messages[0] == messages[1]
    assert "the loss must be finite, got nan at iteration 0" in messages[0]
    assert states[0] == states[1]


@pytest.mark.parametrize(("name", "value"), [("sh", 3e11), ("log_scales", 29.0)])
def test_numbers_so_large_that_a_gradient_might_overflow_are_left_to_autograd(problem, monkeypatch, name, value):
    """Of which nothing was done before: the result is that of autograd."""
    start, views, images = problem
    tensors = {key: tensor.clone() for key, tensor in start.tensors().items()}
    tensors["means"][7, 2] = -50.0  # behind the cameras: in front of them the rasteriser refuses such scales itself
    tensors[name][7] = value
    start = Gaussians(**tensors)
    config = dataclasses.replace(CONFIG, iterations=3, mcmc=None)
    asked, backpropagate = [], loop.backpropagate
    monkeypatch.setattr(loop, "backpropagate", lambda *a, **k: asked.append(a) or backpropagate(*a, **k))
    got = fit(start, views, lambda i: images[i], config)
    assert len(asked) == 3
    expected = by_autograd((start, views, images), config)
    assert all(torch.equal(t, getattr(expected.gaussians, key)) for key, t in got.gaussians.tensors().items())


@pytest.mark.parametrize("what", ["gradient", "double", "strides"])
def test_targets_of_other_kinds(problem, what):
    """One that needs a gradient or is of another type is left to autograd; strides do not matter."""
    start, views, images = problem
    leaf = images.clone().requires_grad_()
    kinds = {"gradient": lambda i: leaf[i] * 1, "double": lambda i: images[i].double()}
    kinds["strides"] = lambda i: images[i].permute(1, 0, 2).contiguous().permute(1, 0, 2)
    config = dataclasses.replace(CONFIG, iterations=3)
    got, expected = fit(start, views, kinds[what], config), fit(start, views, lambda i: images[i], config)
    torch.testing.assert_close(got.gaussians.means, expected.gaussians.means, rtol=0, atol=2e-4)
    assert what != "gradient" or float(leaf.grad.abs().max()) > 0


def test_other_backends_are_left_to_autograd(problem):
    start, views, images = problem
    reference = dataclasses.replace(CONFIG, iterations=2, sh_degree=0, backend="torch", mcmc=None)
    fast, slow = (
        fit(start, views, lambda i: images[i], dataclasses.replace(reference, backend=b)) for b in ("auto", "torch")
    )
    torch.testing.assert_close(fast.gaussians.log_scales, slow.gaussians.log_scales, rtol=0, atol=1e-3)
    assert fast.losses[0]["loss"] == pytest.approx(slow.losses[0]["loss"], rel=1e-4)


def test_rates_so_high_that_coefficients_may_grow_at_once_are_left_to_autograd(problem, monkeypatch):
    start, views, images = problem
    monkeypatch.setattr(direct.DirectFit, "step", None)
    rates = LearningRates(sh_rest=2e3)
    fit(start, views, lambda i: images[i], dataclasses.replace(CONFIG, iterations=1, rates=rates))


@kernel
def _first(begin, end, values):
    for i in range(begin, end):
        values[i] += i


@kernel
def _second(begin, end, values, sums):
    for i in range(begin, end):
        sums[i] += values[len(values) - 1 - i]  # written by another range


_stage_one, _stage_two = stages.shared(_first), stages.shared(_second)


@kernel
def _chain(control, threads, values, sums, total):
    n = len(values)
    _stage_one(control, 0, threads, n, 8, values)
    _stage_two(control, 1, threads, n, 8, values, sums)
    if stages.alone(control, 2):
        total[0] += sums.sum()
        stages.done(control, 2)
    stages.wait(control, 2, 1)


def test_every_stage_of_a_chain_is_done_once_and_after_the_one_before():
    before = torch.get_num_threads()
    torch.set_num_threads(4)
    try:
        for n in [0, 1, 7, 4096, 20_000] * 20:
            values, sums, total = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(1, np.int64)
            parallel.run_chain(_chain, n, values, sums, total)
            assert (values == np.arange(n)).all()
            assert (sums == np.arange(n)[::-1]).all()
            assert total[0] == n * (n - 1) // 2
    finally:
        torch.set_num_threads(before)


def test_an_error_in_a_helper_ends_the_chain_and_reaches_the_caller():
    caller = threading.get_ident()

    def chain(control, threads):
        if threading.get_ident() != caller:
            raise MemoryError("no room")
        for _ in range(6000):
            if control[stages.DONE] > 0:  # what all stages wait for
                return
            threading.Event().wait(0.01)

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with pytest.raises(MemoryError, match="no room"):
            parallel.run_chain(chain, 10_000)
    finally:
        torch.set_num_threads(before)


class _Squares:
    """A loss of the picture that brings its own gradient; counts how it was asked."""

    def __init__(self) -> None:
        self.by_autograd = self.direct = 0

    def __call__(self, step, target):
        self.by_autograd += 1
        return (step.render - target).square().mean()

    def compare(self, image, target):
        self.direct += 1
        variable = torch.from_numpy(image).requires_grad_()
        value = (variable - torch.from_numpy(target)).square().mean()
        value.backward()
        return np.float32(value.detach()), variable.grad.numpy()


def test_a_loss_with_a_gradient_of_its_own_needs_no_autograd_and_gives_the_same(problem):
    start, views, images = problem
    own, plain = _Squares(), _Squares()
    found = fit(start, views, lambda i: images[i], CONFIG, photometric=own)
    want = fit(start, views, lambda i: images[i], CONFIG, photometric=plain.__call__)
    assert (own.direct, own.by_autograd) == (CONFIG.iterations, 0)
    assert (plain.direct, plain.by_autograd) == (0, CONFIG.iterations)
    for name, tensor in found.gaussians.tensors().items():
        assert torch.equal(tensor, want.gaussians.tensors()[name]), name


@pytest.mark.parametrize("place", range(3))
def test_a_number_that_is_not_finite_is_found_wherever_it_stands(place):
    tensors = [torch.ones(2) for _ in range(3)]
    assert all_finite(tensors)
    tensors[place][1] = torch.nan
    assert not all_finite(tensors)
