"""Guided averages, and the bandwidth that the data choose, against slow versions and known truth."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.noise import Variance
from novags.methods.nova_plus import bandwidth
from novags.methods.nova_plus.average import REACH, averages, non_local_means
from novags.methods.nova_plus.bandwidth import choose_bandwidth, errors_of_average
from novags.methods.nova_plus.data import LightMeasurements
from novags.methods.tone import ToneCurve
from sensor_model import NoiseCurve

CURVE = ToneCurve(top=1.0, k=1e-3)  # light and tone are the same to a thousandth


def slow_average(guide: np.ndarray, data: np.ndarray, h: float, patch: int, own: bool, y: int, x: int) -> Any:
    """Sums at one pixel: every neighbour's patch is compared where both patches lie inside the picture."""
    height, width = guide.shape[:2]
    total, weight, squares = np.zeros(3), np.zeros(3), np.zeros(3)
    for dy in range(-REACH, REACH + 1):
        for dx in range(-REACH, REACH + 1):
            v, u = y + dy, x + dx
            if not (0 <= v < height and 0 <= u < width) or (not own and dy == dx == 0):
                continue
            differences = [
                (guide[y + j, x + i] - guide[v + j, u + i]) ** 2
                for j in range(-patch, patch + 1) for i in range(-patch, patch + 1)
                if 0 <= y + j < height and 0 <= x + i < width and 0 <= v + j < height and 0 <= u + i < width
            ]  # fmt: skip
            w = math.exp(-np.mean(differences) / h**2)
            if w > 1e-4:
                there = ~np.isnan(data[v, u])
                total[there] += w * data[v, u][there]
                weight[there] += w
                squares[there] += w * w
    return total, weight, squares


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("patch", [1, 2])
def test_sums_are_those_of_the_definition(patch: int, own: bool) -> None:
    rng = np.random.default_rng(1)
    guide = rng.random((1, 20, 18, 3)).astype(np.float32) * 0.3
    data = rng.random((1, 20, 18, 3)).astype(np.float32)
    data[rng.random(data.shape) < 0.4] = np.nan
    sums = averages(torch.from_numpy(guide), torch.from_numpy(data), h=0.1, patch=patch, own=own)
    for y, x in ((0, 0), (9, 8), (19, 17), (3, 16)):
        want = slow_average(guide[0], data[0], 0.1, patch, own, y, x)
        found = (sums.data[0, y, x], sums.weights[0, y, x], sums.squares[0, y, x])
        for a, b in zip(found, want, strict=True):
            np.testing.assert_allclose(a.numpy(), b, rtol=2e-4, atol=1e-6)


def test_an_average_along_a_flat_guide_is_the_mean_of_the_window_and_its_variance_falls_as_the_count() -> None:
    data = torch.from_numpy(np.random.default_rng(2).normal(0.5, 0.1, (1, 15, 15, 3))).float()
    sums = averages(torch.full_like(data, 0.3), data, h=0.05, patch=1)
    middle = sums.mean(torch.zeros_like(data))[0, 7, 7]
    torch.testing.assert_close(middle, data[0].mean((0, 1)), rtol=1e-5, atol=1e-5)
    assert float(sums.variance[0, 7, 7, 0]) == pytest.approx(1 / 225, rel=1e-5)


def test_an_edge_of_the_guide_is_not_crossed() -> None:
    guide = torch.zeros(1, 16, 16, 3)
    guide[:, :, 8:] = 1.0
    sums = averages(guide, guide, h=0.1, patch=1)
    mean = sums.mean(guide)
    # two columns from the edge no patch of the own side touches the other
    torch.testing.assert_close(mean[:, :, :6], guide[:, :, :6], atol=1e-6, rtol=0)
    torch.testing.assert_close(mean[:, :, 10:], guide[:, :, 10:], atol=1e-6, rtol=0)


def test_non_local_means_keeps_a_picture_without_noise_and_takes_noise_away() -> None:
    rng = np.random.default_rng(3)
    clean = torch.from_numpy(np.kron(rng.random((4, 4, 3)), np.ones((8, 8, 1)))).float()[None]
    noisy = clean + 0.05 * torch.from_numpy(rng.normal(size=clean.shape)).float()
    torch.testing.assert_close(torch.stack(list(non_local_means(clean, 0.02))), clean, atol=5e-3, rtol=0)
    found = torch.stack(list(non_local_means(noisy, 0.08)))
    before, after = ((image - clean).square().mean() for image in (noisy, found))
    assert float(after) < 0.25 * float(before)


def test_a_bandwidth_of_nothing_is_refused() -> None:
    with pytest.raises(ValueError, match="h must be > 0, got 0"):
        averages(torch.zeros(1, 8, 8, 3), torch.zeros(1, 8, 8, 3), h=0.0, patch=1)


def exposures_of(truth: np.ndarray, sigma: float, seed: int, views: int) -> LightMeasurements:
    """Data of even noise."""
    noise = np.random.default_rng(seed).normal(0, sigma, (views, *truth.shape))
    light = torch.from_numpy(truth + noise).float()
    zero, never = (0.0,) * 3, (math.inf,) * 3
    curve = NoiseCurve(
        black=zero, white=(1.0,) * 3, offset=(sigma**2,) * 3, slope=zero, quadratic=zero, switch=never, step=zero
    )
    held = torch.zeros(light.shape[:3], dtype=torch.bool)
    return LightMeasurements(light=light, held=held, noise=Variance(curve), white=torch.full((3,), 10.0), matrix=None)


def texture(seed: int = 4, side: int = 48) -> np.ndarray:
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:side, :side] / 6.0
    waves = 0.5 + 0.05 * np.sin(x + 0.3 * y) + 0.03 * np.sin(2.7 * y)
    return waves[..., None] + 0.02 * rng.normal(size=(side, side, 3))


def test_bias_and_variance_of_the_average_are_found_without_truth() -> None:
    truth, sigma = texture(), 0.06
    data = exposures_of(truth, sigma, seed=5, views=12)
    guide = torch.from_numpy(truth).float().expand(12, -1, -1, -1).contiguous()
    for h in (0.02, 0.05, 0.1):
        bias2, variance = errors_of_average(guide, data, CURVE, h)
        mean = averages(guide, data.light, h=h, patch=1).mean(data.light)
        across = mean.double().mean(0) - torch.from_numpy(truth)  # of twelve views
        true_variance = float(mean.double().var(0).mean())
        true_bias2 = float(across.square().mean()) - true_variance / 12
        # of 12 views; pixels of one window share their data
        windows = 3 * 48 * 48 / float(averages(guide, data.light, h=h, patch=1).weights.mean())
        assert variance == pytest.approx(true_variance, rel=5 * math.sqrt(2 / (11 * windows)))
        # the residuals scatter by sigma^2 sqrt(2 / n), n = 12 * 48^2 * 3, and neighbours share averages
        scatter = sigma**2 * math.sqrt(2 / (12 * 48 * 48 * 3))
        assert bias2 == pytest.approx(true_bias2, abs=5 * scatter + 0.1 * true_bias2)


def test_bias_and_variance_are_in_tone_and_of_noise_that_grows_with_the_light() -> None:
    """A loop over the definition, for a curve that is far from straight; behind a filter array, some data held out."""
    rng, curve, h = np.random.default_rng(10), ToneCurve(top=0.3, k=3.0), 0.15
    tones, offset, slope = rng.uniform(0.1, 0.9, (5, 6, 3)).astype(np.float32), 4e-4, 3e-3

    def lin(r: Any) -> Any:
        return 0.3 * np.expm1(3 * r) / math.expm1(3)

    light = lin(tones) + 0.02 * rng.normal(size=tones.shape)
    light[rng.random(tones.shape) < 0.3] = np.nan
    held = rng.random((5, 6)) < 0.2
    seen = np.where(held[..., None], np.nan, light)
    biases, variances = list[float](), list[float]()
    for y, x in np.ndindex(5, 6):
        total, weight, squares = slow_average(tones, seen, h, 1, False, y, x)
        for c in np.flatnonzero(~np.isnan(seen[y, x])):
            rise = 0.9 * math.exp(3 * tones[y, x, c]) / math.expm1(3)  # d lin / d r
            noise = (offset + slope * lin(tones[y, x, c])) / rise**2
            w, w2 = weight[c], squares[c]
            if w > 0.01:
                residual = ((light[y, x, c] - total[c] / w) / rise) ** 2
                biases.append((w / (w + 1)) ** 2 * (residual - noise * (1 + w2 / w**2)))
            else:
                biases.append(0.0)
            variances.append(noise * (w2 + 1) / (w + 1) ** 2)
    three = {name: (value,) * 3 for name, value in {
        "black": 0.0, "white": 1.0, "offset": offset, "slope": slope, "quadratic": 0.0, "switch": math.inf,
        "step": 0.0}.items()}  # fmt: skip
    data = LightMeasurements(
        light=torch.from_numpy(light)[None].float(), held=torch.from_numpy(held)[None],
        noise=Variance(NoiseCurve(**three)), white=torch.full((3,), 10.0), matrix=None,
    )  # fmt: skip
    found = errors_of_average(torch.from_numpy(tones)[None], data, curve, h)
    assert found == pytest.approx((np.mean(biases), np.mean(variances)), rel=1e-3)


def test_an_average_of_few_neighbours_without_bias_is_found_to_have_none() -> None:
    """Each column of the guide is like itself alone: a datum has at most 14 neighbours, all of its own mean."""
    sigma, columns = 0.06, np.random.default_rng(9).normal(0.5, 0.3, (1, 40, 3))
    data = exposures_of(np.full((40, 40, 3), 0.5), sigma, seed=8, views=16)
    guide = torch.from_numpy(columns).float().expand(16, 40, 40, 3).contiguous()
    bias2, variance = errors_of_average(guide, data, CURVE, 0.02)
    rows = np.array([min(7, y) + min(7, 39 - y) for y in range(40)])
    assert variance == pytest.approx(sigma**2 * float(np.mean(1 / (rows + 1))), rel=1e-3)
    # the squared residuals scatter by sigma^2 sqrt(2 / n), n = 16 * 40^2 * 3
    assert abs(bias2) < 5 * sigma**2 * math.sqrt(2 / (16 * 1600 * 3))


def test_data_without_neighbours_count_as_their_own_average() -> None:
    """Behind a filter array few are alike; left out, the rest would make narrow windows look better than they are."""
    sigma = 0.06
    data = exposures_of(texture(), sigma, seed=8, views=2)
    light = data.light.clone()
    light[:, ::2, 1::2] = torch.nan
    light[:, 1::2] = torch.nan
    data = replace(data, light=light)
    guide = torch.from_numpy(texture(seed=11)).float().expand(2, -1, -1, -1).contiguous()
    bias2, variance = errors_of_average(guide, data, CURVE, 1e-4)
    assert bias2 == pytest.approx(0, abs=1e-6)
    assert variance == pytest.approx(sigma**2, rel=1e-3)
    found = [errors_of_average(guide, data, CURVE, h)[1] for h in (0.005, 0.01, 0.02, 0.04)]
    assert found == sorted(found, reverse=True)


def test_the_chosen_bandwidth_is_near_the_best_and_follows_the_noise() -> None:
    truth = texture()
    chosen = []
    for sigma in (0.02, 0.08):
        data = exposures_of(truth, sigma, seed=6, views=4)
        guide = torch.from_numpy(truth).float().expand(4, -1, -1, -1).contiguous()
        h, found = choose_bandwidth(guide, data, CURVE)

        def risk(width: float, data: LightMeasurements = data, guide: torch.Tensor = guide) -> float:
            mean = averages(guide, data.light, h=width, patch=1).mean(data.light).double()
            variance = float(mean.var(0).mean())
            bias2 = float((mean.mean(0) - torch.from_numpy(truth)).square().mean()) - variance / 4
            return bias2 + variance / bandwidth.VIEWS

        best = min((risk(h * 2 ** (k / 4)), h * 2 ** (k / 4)) for k in range(-6, 7))
        assert risk(h) < 1.15 * best[0], (sigma, h, best)
        assert found[0]["h"] == bandwidth.SMALLEST
        assert len(found) > 3
        chosen.append(h)
    assert chosen[1] > 1.5 * chosen[0]


def test_each_judging_view_is_compared_with_its_own_guide() -> None:
    truth = texture(side=24)
    turned = torch.stack([torch.from_numpy(np.roll(truth, 3 * i, 0)).float() for i in range(7)])  # no two alike
    data = exposures_of(truth, 0.06, seed=6, views=7)
    data = replace(data, light=data.light - torch.from_numpy(truth).float() + turned)
    _, found = choose_bandwidth(turned, data, CURVE)
    views = [0, 2, 4, 6]
    some = replace(data, light=data.light[views], held=data.held[views])
    want = errors_of_average(turned[views], some, CURVE, found[5]["h"])
    assert (found[5]["bias2"], found[5]["variance"]) == pytest.approx(want)
