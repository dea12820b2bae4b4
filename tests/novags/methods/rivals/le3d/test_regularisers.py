"""Each regulariser of LE3D against a slow version, number by number in float64, and its gradient."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from novags.methods.rivals.le3d.regularisers import (
    BINS,
    FARTHEST,
    NEAREST,
    bin_edges,
    in_bins,
    near_far,
    opaque,
    spread,
)


def differences(function, tensor: Tensor, places: list[tuple[int, ...]]) -> list[float]:  # type: ignore[no-untyped-def]
    """Slopes of a function of arrays at some places, from values a little to both sides."""
    found = []
    for place in places:
        ends = []
        for step in (1e-6, -1e-6):
            moved = tensor.detach().numpy().copy()
            moved[place] += step
            ends.append(function(moved))
        found.append((ends[0] - ends[1]) / 2e-6)
    return found


def check(found: Tensor, function, tensor: Tensor, rng: np.random.Generator) -> None:  # type: ignore[no-untyped-def]
    """Value and gradient at a dozen places are those of a slow function."""
    assert float(found.detach()) == pytest.approx(function(tensor.detach().numpy()), rel=1e-9)
    (gradient,) = torch.autograd.grad(found, tensor, retain_graph=True)
    places = [tuple(int(rng.integers(n)) for n in tensor.shape) for _ in range(12)]
    slopes = differences(function, tensor, places)
    assert [float(gradient[place]) for place in places] == pytest.approx(slopes, rel=1e-4, abs=1e-9)


def test_rays_are_drawn_to_be_opaque() -> None:
    rng = np.random.default_rng(1)
    alpha = torch.tensor(rng.uniform(0, 0.998, (5, 4))).requires_grad_()

    def slowly(alphas: np.ndarray) -> float:
        return math.fsum(-math.log(min(float(a) + 1e-3, 1)) for a in alphas.flat) / alphas.size

    check(opaque(alpha), slowly, alpha, rng)
    assert float(opaque(torch.tensor([0.9995, 1.0]))) == 0  # what is as good as opaque is left alone
    assert float(opaque(torch.zeros(2, 2))) == pytest.approx(-math.log(1e-3))


def test_weights_of_a_ray_are_drawn_together() -> None:
    rng = np.random.default_rng(2)
    edges = torch.linspace(0.5, 9, BINS + 1, dtype=torch.float64)
    histogram = torch.tensor(rng.dirichlet(np.full(BINS, 0.2), (4, 3))).requires_grad_()
    inverse = [1 / float(t) for t in edges]
    s = [(i - inverse[0]) / (inverse[-1] - inverse[0]) for i in inverse]
    assert s[0] == 0
    assert s[-1] == 1
    assert s == sorted(s)

    def slowly(weights: np.ndarray) -> float:
        total = 0.0
        for ray in weights.reshape(-1, BINS):
            for u in range(BINS):
                total += ray[u] ** 2 * (s[u + 1] - s[u]) / 3
                for v in range(BINS):
                    total += ray[u] * ray[v] * abs((s[u] + s[u + 1]) / 2 - (s[v] + s[v + 1]) / 2)
        return total / 12

    check(spread(histogram, edges), slowly, histogram, rng)


def test_the_nearest_and_the_farthest_are_drawn_together() -> None:
    rng = np.random.default_rng(3)
    maps = torch.tensor(rng.uniform(0.1, 1, (4, 3, 5)) * np.array([5, 1, 9, 1])[:, None, None]).requires_grad_()

    def slowly(values: np.ndarray) -> float:
        rays = zip(*(plane.flat for plane in values), strict=True)
        terms = [t * u * math.log((e + 1e-3) / (d + 1e-3)) ** 2 for d, t, e, u in rays]
        return math.fsum(terms) / len(terms)

    check(near_far((maps[0], maps[1]), (maps[2], maps[3])), slowly, maps, rng)
    nothing = torch.zeros(2, 2)
    assert float(near_far((nothing, nothing), (nothing, nothing))) == 0  # rays that meet nothing


def test_bins_are_even_in_depth_between_the_ends_of_all_that_is_seen() -> None:
    depths = torch.tensor([3.0, 0.7, 8.0, 2.0])
    edges = bin_edges(depths)
    assert edges is not None
    np.testing.assert_allclose(edges.numpy(), [0.7 + 7.3 * k / 32 for k in range(33)], rtol=1e-6)
    wide = bin_edges(torch.tensor([0.05, 5000.0]))
    assert wide is not None
    assert wide[[0, -1]].tolist() == pytest.approx([NEAREST, FARTHEST])
    for alone in ([], [2.0, 2.0], [0.1, 0.15], [2000.0, 3000.0]):
        assert bin_edges(torch.tensor(alone)) is None


def test_each_gaussian_is_in_one_bin_and_bins_have_no_gradient() -> None:
    depths = torch.tensor([0.1, 1.0, 1.24, 1.26, 5.0, 8.99, 9.0, 50.0], requires_grad=True)
    edges = torch.linspace(1, 9, BINS + 1)  # 0.25 apart
    found = in_bins(depths, edges)
    assert found.argmax(1).tolist() == [0, 0, 0, 1, 16, 31, 31, 31]
    assert bool((found.sum(1) == 1).all())
    assert not found.requires_grad
    moving = bin_edges(depths)
    assert moving is not None
    assert not moving.requires_grad
