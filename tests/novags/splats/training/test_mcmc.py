"""Relocation, growth and noise of 3DGS-MCMC."""

import math
from fractions import Fraction

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.overrides import TorchFunctionMode

from novags.splats import Gaussians
from novags.splats.raster.raster_torch import quat_to_rotmat
from novags.splats.training.config import McmcConfig
from novags.splats.training.updates.adam import Adam
from novags.splats.training.updates.mcmc import (
    DEAD_OPACITY,
    NODES,
    ROWS,
    _add_noise_torch,
    _integral,
    add_noise,
    grow,
    prune_to_cap,
    relocate,
    relocation,
)


def cloud(n: int, seed: int = 0, *, logit: float | None = None) -> Gaussians:
    g = torch.Generator().manual_seed(seed)
    logits = torch.randn(n, generator=g) if logit is None else torch.full((n,), logit)
    return Gaussians(
        means=torch.randn(n, 3, generator=g), quats=torch.randn(n, 4, generator=g),
        log_scales=torch.randn(n, 3, generator=g) * 0.3 - 2, logit_opacities=logits,
        sh=torch.randn(n, 4, 3, generator=g),
    )  # fmt: skip


def paper_factor(o: Fraction, new: Fraction, n: int) -> float:
    """Equation 9 of the paper with exact binomials; the roots to 50 digits."""
    total = Fraction(0)
    for i in range(1, n + 1):
        for k in range(i):
            root = Fraction(math.isqrt((k + 1) * 10**100), 10**50)
            total += math.comb(i - 1, k) * (-1) ** k * new ** (k + 1) / root
    return float(o / total)


@pytest.mark.parametrize("opacity", [0.006, 0.3, 0.9, 0.9999])
@pytest.mark.parametrize("n", [1, 2, 3, 10, 51])
def test_relocation_equals_the_papers_sum_in_exact_arithmetic(opacity, n):
    o = torch.tensor([opacity], dtype=torch.float64)
    new, factor = relocation(o, torch.tensor([n]))
    assert new.item() == pytest.approx(1 - (1 - opacity) ** (1 / n), rel=1e-12)
    expected = paper_factor(Fraction(opacity), Fraction(new.item()), n)
    assert factor.item() == pytest.approx(expected, rel=1e-10)


@settings(derandomize=True, deadline=None, max_examples=60)
@given(st.floats(1e-6, 1 - 2**-24), st.integers(1, 100_000))
def test_relocation_is_finite_and_keeps_the_opacity_for_any_number_of_copies(opacity, n):
    new, factor = relocation(torch.tensor([opacity], dtype=torch.float64), torch.tensor([n]))
    assert 0 < new.item() <= opacity
    assert 0 < factor.item() <= 1 + 1e-9
    together = -math.expm1(n * math.log1p(-new.item()))
    assert together == pytest.approx(opacity, rel=1e-7)


class Largest(TorchFunctionMode):
    """Counts the numbers of the largest tensor that a function of torch gives back."""

    numbers = 0

    def __torch_function__(self, function, types, args=(), kwargs=None):
        result = function(*args, **(kwargs or {}))
        if isinstance(result, torch.Tensor):
            self.numbers = max(self.numbers, result.numel())
        return result


@pytest.mark.parametrize("count", [0, 1, ROWS, ROWS + 1, 100_000])
def test_relocation_of_many_goes_by_parts_and_keeps_the_bits(count):
    g = torch.Generator().manual_seed(0)
    o = torch.rand(count, generator=g, dtype=torch.float64) * 0.99 + 0.005
    n = torch.randint(1, 51, (count,), generator=g)
    with Largest() as largest:
        new, factors = relocation(o, n)
    assert largest.numbers <= max(count, ROWS * NODES)  # of 8 bytes: 17 MB instead of 102
    assert torch.equal(factors, o / _integral(new, n.double()))


def test_one_copy_changes_nothing():
    new, factor = relocation(torch.tensor([0.4]), torch.tensor([1]))
    torch.testing.assert_close(new, torch.tensor([0.4]))
    torch.testing.assert_close(factor, torch.tensor([1.0]))


@pytest.mark.parametrize("move", [relocate, lambda gaussians, generator: grow(gaussians, 3, generator)])
def test_a_drawn_gaussian_of_any_size_and_opacity_shrinks_by_the_papers_factor(move):
    for log_scale, logit in ((-104.0, 1.0), (95.0, 1.0), (-2.0, 25.0), (-2.0, 17.0)):
        gaussians = cloud(2)
        gaussians.log_scales[0] = log_scale
        gaussians.logit_opacities[:] = torch.tensor([logit, -200.0])
        move(gaussians, torch.Generator().manual_seed(0))
        opacity = torch.sigmoid(torch.tensor([logit], dtype=torch.float64))
        new, factor = relocation(opacity, torch.tensor([2]))
        expected = torch.full((3,), log_scale + math.log(factor.item()))
        torch.testing.assert_close(gaussians.log_scales[0], expected, rtol=1e-6, atol=0)
        assert gaussians.logit_opacities[0].item() == pytest.approx(torch.logit(new).item(), rel=1e-5)


def test_dead_gaussians_move_onto_live_ones_in_proportion_to_opacity():
    gaussians = cloud(40_003, logit=-8.0)
    gaussians.logit_opacities[:3] = torch.logit(torch.tensor([0.2, 0.4, 0.8]))
    gaussians.logit_opacities[3] = torch.logit(torch.tensor(DEAD_OPACITY)) - 1e-3
    before = gaussians.means.clone()
    drawn = relocate(gaussians, torch.Generator().manual_seed(0))
    assert drawn.unique().tolist() == [0, 1, 2]
    counts = torch.tensor([(gaussians.means[3:] == before[i]).all(1).sum() for i in range(3)]).double()
    assert counts.sum() == 40_000
    p = torch.tensor([1, 2, 4]).double() / 7
    error = (counts - 40_000 * p).abs() / torch.sqrt(40_000 * p * (1 - p))
    assert error.max() < 5


def test_relocated_twins_are_equal_and_as_opaque_together_as_one_was():
    gaussians = cloud(2)
    gaussians.logit_opacities[:] = torch.logit(torch.tensor([0.7, 0.001]))
    relocate(gaussians, torch.Generator().manual_seed(0))
    for tensor in gaussians.tensors().values():
        assert torch.equal(tensor[0], tensor[1])
    assert 1 - (1 - gaussians.opacities[0]).item() ** 2 == pytest.approx(0.7, abs=1e-6)


@pytest.mark.parametrize("logit", [-9.0, 2.0])
def test_all_dead_or_none_dead_leaves_everything_in_place(logit):
    gaussians = cloud(20, logit=logit)
    before = {name: t.clone() for name, t in gaussians.tensors().items()}
    assert len(relocate(gaussians, torch.Generator().manual_seed(0))) == 0
    assert all(torch.equal(t, before[name]) for name, t in gaussians.tensors().items())


def test_growth_adds_copies_up_to_the_goal_and_keeps_the_optimiser_in_step():
    gaussians = cloud(100)
    adam = Adam(gaussians)
    for moments in (adam.first, adam.second):
        for tensor in moments.values():
            tensor += 1
    grown, drawn = grow(gaussians, 130, torch.Generator().manual_seed(0))
    adam.reset(drawn)
    adam.grow(grown)
    assert len(grown) == 130
    assert (grown.means[100:, None] == grown.means[None, :100]).all(-1).any(1).all()
    for tensor in adam.first.values():
        assert len(tensor) == 130
        assert not tensor[100:].any()
        assert not tensor[drawn].any()
        assert tensor[:100].reshape(100, -1).any(1).sum() == 100 - len(drawn.unique())
    same, none = grow(grown, 120, torch.Generator())
    assert same is grown
    assert len(none) == 0


def test_pruning_keeps_the_most_opaque_in_order():
    gaussians = cloud(50)
    kept = prune_to_cap(gaussians, 20, torch.Generator().manual_seed(0))
    expected = torch.sort(torch.topk(gaussians.logit_opacities, 20).indices).values
    assert torch.equal(kept.means, gaussians.means[expected])
    assert prune_to_cap(gaussians, 50, torch.Generator()) is gaussians


# Few machines have one. What is pruned is tested without, above and below.
@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device to compare with")
def test_pruning_on_a_gpu_keeps_the_same_gaussians():
    gaussians = cloud(50)
    kept = prune_to_cap(gaussians, 20, torch.Generator().manual_seed(0))
    on_gpu = Gaussians(**{name: t.cuda() for name, t in gaussians.tensors().items()})
    assert torch.equal(prune_to_cap(on_gpu, 20, torch.Generator().manual_seed(0)).means.cpu(), kept.means)


def test_pruning_equal_opacities_is_a_random_choice_without_preference_for_early_ones():
    gaussians = cloud(4000, logit=0.0)
    gaussians.means[:, 0] = torch.arange(4000)
    kept = prune_to_cap(gaussians, 1000, torch.Generator().manual_seed(0))
    # mean of a random subset of 0..3999: 1999.5, standard error 4000 / sqrt(12 * 1000) * sqrt(3 / 4)
    assert abs(kept.means[:, 0].mean().item() - 1999.5) < 5 * 31.7


@pytest.mark.parametrize("device_path", ["kernel", "torch"])
def test_noise_has_the_covariance_of_the_paper(device_path, monkeypatch):
    n = 100_000
    one = cloud(1, 3)
    gaussians = Gaussians(**{name: t.repeat(n, *[1] * (t.ndim - 1)) for name, t in one.tensors().items()})
    gaussians.means = torch.zeros(n, 3)
    opacity = 0.02
    gaussians.logit_opacities = torch.full((n,), math.log(opacity / (1 - opacity)))
    amount = 0.3
    if device_path == "kernel":
        add_noise(gaussians, amount, torch.Generator().manual_seed(1))
    else:
        _add_noise_torch(gaussians, amount, torch.Generator().manual_seed(1))
    R = quat_to_rotmat(one.quats)[0].double()
    sigma = R @ torch.diag(torch.exp(2 * one.log_scales[0].double())) @ R.T
    gate = amount / (1 + math.exp(-100 * (DEAD_OPACITY - opacity)))
    white = gaussians.means.double() @ torch.linalg.inv(gate * sigma)  # must be standard normal, component by component
    assert white.mean(0).abs().max() < 5 / math.sqrt(n)
    assert (white.T @ white / n - torch.eye(3)).abs().max() < 5 * math.sqrt(2 / n)
    assert ((white**4).mean(0) - 3).abs().max() < 5 * math.sqrt(96 / n)
    neighbours = (white[1:, 0] * white[:-1, 0]).mean()
    assert abs(neighbours) < 5 / math.sqrt(n)


@pytest.mark.parametrize("device_path", ["kernel", "torch"])
def test_no_step_of_noise_is_longer_than_the_limit_along_an_axis(device_path):
    step = add_noise if device_path == "kernel" else _add_noise_torch
    moved = {}
    for limit in (math.inf, 0.2, 0.0):
        gaussians = cloud(1000, logit=-5.0)
        gaussians.means = torch.zeros(1000, 3)
        step(gaussians, 30.0, torch.Generator().manual_seed(0), limit=limit)
        moved[limit] = (quat_to_rotmat(gaussians.quats).mT @ gaussians.means[..., None])[..., 0]
    free = moved[math.inf]
    assert 0.1 < (free.abs() > 0.2).float().mean() < 0.9
    torch.testing.assert_close(moved[0.2], free.clamp(-0.2, 0.2), rtol=1e-4, atol=1e-5)
    assert not moved[0.0].any()


def test_noise_whose_variance_overflows_ends_at_the_limit():
    gaussians = cloud(40, logit=-5.0)
    gaussians.log_scales[:] = 60.0
    before = gaussians.means.clone()
    add_noise(gaussians, 10.0, torch.Generator().manual_seed(0), limit=2.0)
    torch.testing.assert_close((gaussians.means - before).norm(dim=1), torch.full((40,), 2 * math.sqrt(3)))


def test_noise_leaves_opaque_gaussians_alone_and_depends_on_the_generator():
    gaussians = cloud(1000, logit=1.0)
    before = gaussians.means.clone()
    add_noise(gaussians, 10.0, torch.Generator().manual_seed(0))
    assert torch.equal(gaussians.means, before)
    moved = []
    for seed in (0, 0, 1):
        other = cloud(1000, logit=-5.0)
        add_noise(other, 10.0, torch.Generator().manual_seed(seed))
        moved.append(other.means)
    assert torch.equal(moved[0], moved[1])
    assert not torch.equal(moved[0], moved[2])


def test_bad_configurations_are_refused():
    with pytest.raises(ValueError, match="refine_every >= 1"):
        McmcConfig(refine_every=0)
    with pytest.raises(ValueError, match="noise_lr must be >= 0 or None, got -1"):
        McmcConfig(noise_lr=-1.0)
