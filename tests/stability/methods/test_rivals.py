"""Hard cases of the rivals on Gaussians: black renders below bright data, curves at their ends, axes that almost meet.

The references go through the numbers one by one with Python's own.
"""

import math
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from scipy import ndimage
from torch import Tensor

from novags.methods.rivals import luminance_gs, raw_gs
from novags.methods.rivals.invariant import COLOUR_MODEL, SCALE, invariant
from novags.methods.rivals.lita_gs import LitaLoss, Networks, structures_of
from novags.methods.rivals.luminance_curve import BINS, ViewCurves, mapped, orthogonal_axes, power_then_s
from novags.methods.rivals.luminance_gs import LuminanceLoss, contrast_loss
from novags.methods.rivals.raw_gs import RawLoss
from novags.methods.rivals.rows.lita_gs import LitaGsConfig
from novags.methods.rivals.rows.luminance_gs import LuminanceGsConfig
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, relative_error, worst_error

PART = Part("rivals")
HERE = sys.modules[__name__]  # where the cases find what a test replaces


def _raw(render: np.ndarray, data: np.ndarray, white: float, epsilon: float) -> float:
    """Error of the loss of RawNeRF and its gradient, by the kernel and by autograd."""
    image, target = (torch.tensor(a, dtype=torch.float32) for a in (render, data))
    loss = RawLoss(torch.full((3,), white), epsilon)
    value, gradient = loss.compare(image.numpy(), target.numpy())
    image.requires_grad_()
    step: Any = SimpleNamespace(render=image)
    by_autograd = loss(step, target)
    by_autograd.backward()
    rounded = image.detach().double().numpy(), target.double().numpy()
    terms, slopes = [], np.zeros(render.shape)
    count = int((~np.isnan(data)).sum())
    for place, (y, t) in np.ndenumerate(np.rec.fromarrays(rounded)):
        if math.isnan(t):
            continue
        error = (min(y, white) - t) / (y + epsilon)
        terms.append(error**2 / count)
        slopes[place] = 0.0 if y > white else 2 * error / (y + epsilon) / count
    total = math.fsum(terms)
    found = (value, total), (gradient, slopes), (by_autograd.detach(), total), (image.grad, slopes)
    return worst_error(found)


@PART.case("raw-gs: black renders below bright data, and the reverse", bound=16 * EPS, unit=LARGEST)
def black_below_bright(setting: Setting) -> float:
    """A relative error of a thousand; its square has seven digits, of which the loss keeps what float32 can hold."""
    rng = np.random.default_rng(3)
    render = np.where(rng.random((6, 5, 3)) < 0.5, 0.0, 0.8)
    return _raw(render, rng.uniform(-0.01, 1.0, (6, 5, 3)), white=4.0, epsilon=1e-3)


@PART.case("raw-gs: renders at and beyond white, data missing", bound=16 * EPS, unit=LARGEST)
def beyond_white(setting: Setting) -> float:
    """What is brighter than the sensor can say has no gradient; what was not measured counts nowhere."""
    rng = np.random.default_rng(4)
    data = np.where(rng.random((6, 5, 3)) < 0.6, np.nan, rng.uniform(0, 0.5, (6, 5, 3)))
    render = rng.choice([0.25, 0.5, 0.75, 1e4], (6, 5, 3))
    return _raw(render, data, white=0.5, epsilon=1e-3)


@PART.case("luminance-gs: S-curves of every steepness, their slopes too", bound=4000 * EPS, unit=LARGEST)
def steep_curves(setting: Setting) -> float:
    """Powers of numbers near 0 and near 1: the ratios are held 1e-3 away from both, a thousand roundings' worth."""
    pairs: list[tuple[Any, Any]] = []
    for gamma, alpha, beta in ((0.2, 0.5, 0.05), (5.0, 0.5, 8.0), (1.0, 0.02, 1.0), (1.0, 0.98, 3.0)):
        given = [torch.tensor(v, requires_grad=True) for v in (gamma, alpha, beta)]
        found = power_then_s(*given)
        found.sum().backward()
        exact = [float(v.detach().double()) for v in given]
        wanted = [_power_then_s(i / (BINS - 1), *exact) for i in range(BINS)]
        pairs.append((found, wanted))
        step = 1e-6
        for k in (0, 2):  # alpha decides which branch a number takes
            low, high = ([v + sign * step * (i == k) for i, v in enumerate(exact)] for sign in (-1, 1))
            slope = math.fsum(
                (_power_then_s(i / (BINS - 1), *high) - _power_then_s(i / (BINS - 1), *low)) / (2 * step)
                for i in range(BINS)
            )
            pairs.append((given[k].grad, slope))
    return worst_error(pairs)


def _power_then_s(x: float, gamma: float, alpha: float, beta: float) -> float:
    x = math.exp(gamma * math.log(max(x, 1e-3)))
    if x <= alpha:
        return alpha - alpha * math.exp(beta * math.log(1 - min(x / alpha, 1 - 1e-3)))
    share = min(max((x - alpha) / (1 - alpha), 1e-3), 1 - 1e-3)
    return alpha + (1 - alpha) * math.exp(beta * math.log(share))


@PART.case("luminance-gs: axes that are far from red, green and blue", bound=64 * EPS, unit=LARGEST)
def far_axes(setting: Setting) -> float:
    """Orthogonal and of length 1 whatever was learned; a straight curve then gives the picture back, but for bins."""
    worst = 0.0
    for first, second in (
        ([1.0, 30.0, -20.0], [1.0, 0.5]),
        ([1e-3, 1.0, 0.0], [1.0, 1.0]),
        ([-1.0, 2.0, 2.0], [0.1, 3.0]),
    ):
        axes = orthogonal_axes(torch.tensor(first), torch.tensor(second))
        worst = max(worst, relative_error(axes @ axes.T, np.eye(3)))
        picture = torch.rand(5, 4, 3, generator=torch.Generator().manual_seed(1))
        fine = torch.linspace(0, 1, 2**20 + 1)
        low, high = axes.clamp_max(0).sum(1), axes.clamp_min(0).sum(1)
        bins = float((high - low).abs().sum()) / 2**20  # what looking up without interpolation may be off
        worst = max(worst, relative_error(mapped(picture, axes, fine), picture.double().numpy()) - 2 * bins)
    return worst


@PART.case("luminance-gs: black, white and tiny pictures, loss and gradients", bound=0, unit="not finite")
def blank_pictures(setting: Setting) -> float:
    """No contrast to ask for, a histogram of one bin, fewer pixels than a cell."""
    wrong = 0
    for height, width in ((1, 1), (3, 5), (16, 12)):
        for level in (0.0, 1.0):
            pictures = torch.full((1, height, width, 3), level)
            curves = ViewCurves(pictures, torch.eye(4)[None], 16)
            render = torch.full((height, width, 3), level, requires_grad=True)
            gaussians = SimpleNamespace(sh=torch.zeros(2, 1, 3), features=torch.zeros(2, 6))
            step: Any = SimpleNamespace(
                view=0, iteration=0, iterations=1, render=render, gaussians=gaussians, splat=lambda _, r=render: r
            )
            loss = LuminanceLoss(curves, LuminanceGsConfig())(step, pictures[0])
            loss.backward()
            grads = [p.grad for p in (render, *curves.parameters()) if p.grad is not None]
            wrong += sum(not bool(torch.isfinite(t).all()) for t in (loss.detach(), *grads))
    return float(wrong)


@PART.case("luminance-gs: contrasts of a picture a thousand times as dark", bound=64 * EPS, unit=LARGEST)
def dark_contrasts(setting: Setting) -> float:
    """The factor makes good for what is missing, and the difference of the two is small beside both."""
    lit = torch.rand(12, 8, 3, generator=torch.Generator().manual_seed(2))
    dark = lit / 1024  # exactly
    noise = 1e-2 * torch.rand(12, 8, 3, generator=torch.Generator().manual_seed(5))
    cells = (lit - (lit + noise)).double().reshape(3, 4, 2, 4, 3).mean((1, 3, 4)).numpy()
    total = 0.0
    for (y, x), value in np.ndenumerate(cells):
        for j, i in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)):
            total += (value - (cells[j, i] if 0 <= j < 3 and 0 <= i < 2 else 0.0)) ** 2
    found: Tensor = contrast_loss(dark, lit + noise, 1024.0)
    return relative_error(found, total / cells.size)


@PART.case("lita-gs: structure of pictures from a lamp to a millionth of it", bound=256 * EPS, unit=LARGEST)
def structure_in_the_dark(setting: Setting) -> float:
    """Ratios of differences that are small beside what they are of, over twenty powers of two of light."""
    rng = np.random.default_rng(6)
    light = rng.uniform(0.5, 1, (20, 24, 3)).astype(np.float32)
    light[:, 12:] *= np.float32(2.0**-10)
    worst = 0.0
    for power in (0, -20):
        dimmed = light * np.float32(2.0**power)
        worst = max(worst, relative_error(invariant(torch.from_numpy(dimmed)), _invariant(dimmed.astype(np.float64))))
    return worst


def _invariant(light: np.ndarray) -> np.ndarray:
    """The invariant in float64, by the filters of another library."""
    offsets = np.arange(-4, 5)
    smooth = np.exp(-0.5 * (offsets / SCALE) ** 2)
    slope = offsets * smooth
    smooth, slope = smooth / smooth.sum(), slope / (slope * offsets).sum()
    spectral = np.moveaxis(light @ np.array(COLOUR_MODEL).T, -1, 0)

    def filtered(planes: np.ndarray, down: np.ndarray, across: np.ndarray) -> np.ndarray:
        rows = ndimage.correlate1d(planes, down, axis=1, mode="nearest")
        out: np.ndarray = ndimage.correlate1d(rows, across, axis=2, mode="nearest")
        return out

    strength = filtered(spectral[:1], smooth, smooth)
    slopes = filtered(spectral, smooth, slope) / strength, filtered(spectral, slope, smooth) / strength
    length: np.ndarray = np.sqrt((np.concatenate(slopes) ** 2).sum(0))
    return length


@PART.case("lita-gs: black, white and tiny pictures, loss and gradients", bound=0, unit="not finite")
def blank_lita(setting: Setting) -> float:
    """No structure, fewer pixels than a patch, and a lit picture that is clipped at both ends."""
    wrong = 0
    for height, width in ((1, 1), (3, 5), (18, 16)):
        for level in (0.0, 1.0):
            pictures = torch.full((1, height, width, 3), level)
            render = torch.full((height, width, 3), 3 * level - 1, requires_grad=True)
            features = torch.zeros(1, 7, requires_grad=True)
            step: Any = SimpleNamespace(
                view=0, render=render, gaussians=SimpleNamespace(features=features),
                splat=lambda values, h=height, w=width: values.expand(h * w, -1).reshape(h, w, -1),
            )  # fmt: skip
            networks = Networks(2)
            loss = LitaLoss(networks, structures_of(pictures), LitaGsConfig())(step, pictures[0])
            loss.backward()
            grads = [p.grad for p in (render, features, *networks.parameters()) if p.grad is not None]
            wrong += sum(not bool(torch.isfinite(t).all()) for t in (loss.detach(), *grads))
    return float(wrong)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_a_gradient_beyond_white_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def unbounded(self: raw_gs.RawLoss, step: object, target: torch.Tensor) -> torch.Tensor:
        render = step.render
        there = ~target.isnan()
        residual = torch.where(there, render - target, 0.0) / (render.detach() + self.epsilon)
        return residual.square().sum() / there.sum()

    monkeypatch.setattr(raw_gs.RawLoss, "__call__", unbounded)
    assert fails("raw-gs: renders at and beyond white, data missing")


def test_ratios_that_reach_0_and_1_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def plain(gamma: torch.Tensor, alpha: torch.Tensor, beta: torch.Tensor) -> torch.Tensor:
        x = torch.linspace(0, 1, BINS) ** gamma
        below = alpha - alpha * (1 - x / alpha) ** beta
        return torch.where(x <= alpha, below, alpha + (1 - alpha) * ((x - alpha) / (1 - alpha)) ** beta)

    monkeypatch.setattr(HERE, "power_then_s", plain)
    assert fails("luminance-gs: S-curves of every steepness, their slopes too")


def test_a_mean_of_0_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(luminance_gs, "DARKEST", 0.0)
    assert fails("luminance-gs: black, white and tiny pictures, loss and gradients")
