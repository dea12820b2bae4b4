"""Hard cases of nova-plus: lamps in view, tones far outside 0..1, data below black, nothing alike, extreme opacities.

The references are written out in numpy's float64, one datum after the other.
"""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.noise import Variance
from novags.methods.nova_plus import merge
from novags.methods.nova_plus.average import averages
from novags.methods.nova_plus.data import LightMeasurements
from novags.methods.nova_plus.likelihood import FLOOR, Likelihood
from novags.methods.nova_plus.merge import merged
from novags.methods.tone import ToneCurve, tone_curve
from novags.splats.gaussians import Gaussians
from sensor_model.noise import NoiseCurve
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, relative_error, worse, worst_error

PART = Part("nova_plus")

BOTH = ("torch", "numba")
SLOPE, OFFSET = 3e-4, 1e-8  # of the variance: read noise of a third of an electron, 3,333 electrons of full well
Array = np.ndarray


def _exposures(light: Array) -> LightMeasurements:
    zero, never = (0.0,) * 3, (math.inf,) * 3
    curve = NoiseCurve(
        black=zero, white=(1.0,) * 3, offset=(OFFSET,) * 3, slope=(SLOPE,) * 3, quadratic=zero, switch=never, step=zero
    )
    data = torch.tensor(light, dtype=torch.float32)[None]
    held = torch.zeros(data.shape[:3], dtype=torch.bool)
    return LightMeasurements(light=data, held=held, noise=Variance(curve), white=torch.ones(3), matrix=None)


def _likelihood(setting: Setting, tones: Array, light: Array, curve: ToneCurve) -> float:
    """Error of the loss and its gradient."""
    data = _exposures(light)
    loss, target = Likelihood(data, curve), data.light[0]
    render = torch.tensor(tones, dtype=torch.float32)
    if setting.backend == "numba":
        value, gradient = loss.compare(render.numpy(), target.numpy())
        found: tuple[Any, Any] = float(value), gradient
    else:
        render.requires_grad_()
        step: Any = SimpleNamespace(render=_OffCpu(render))
        result = loss(step, target)
        result.backward()
        found = float(result.detach()), render.grad
    seen, want = target.double().numpy(), np.zeros(tones.shape)
    total = 0.0
    for place, r in np.ndenumerate(render.detach().double().numpy()):
        y, steep = float(seen[place]), math.exp(min(curve.k * r, ToneCurve.STEEPEST))
        mean, slope = curve.knee * (steep - 1), curve.knee * curve.k * steep
        if math.isnan(y) or (y >= 0.98 and mean > y):
            continue
        n = (OFFSET + SLOPE * min(max(mean, 0.0), 1.0)) / slope**2
        weight, residual = FLOOR / (n + FLOOR), (mean - y) / slope
        total += weight * residual**2
        want[place] = 2 * weight * residual
    count = float((~np.isnan(seen)).sum())
    return worst_error([(found[0], total / count), (found[1], want / count)])


class _OffCpu:
    """A render that takes the way of other devices."""

    device = SimpleNamespace(type="meta")

    def __init__(self, render: torch.Tensor) -> None:
        self.render = render

    def detach(self) -> torch.Tensor:
        return self.render.detach()

    def __sub__(self, other: torch.Tensor) -> torch.Tensor:
        return self.render - other


@PART.case("a lamp a million times as bright as the median", bound=200 * EPS, unit="of 1")
def lamp(setting: Setting) -> float:
    """From light to tone and back, beside a median that keeps its tone: k is about 16."""
    light = np.random.default_rng(0).lognormal(-6, 1, 9_999)
    light[:50] = 1e6 * np.median(light)
    curve = tone_curve(torch.tensor(light))
    tones = curve.tone(torch.tensor(light, dtype=torch.float32))
    want = np.log1p(light / curve.knee) / curve.k
    back = curve.light(tones).double().numpy() / light
    # exp hands on an absolute error of k r as a relative one
    return worse(float(np.abs(tones.double().numpy() - want).max()), float(np.abs(back - 1).max()) / curve.k)


@PART.case("one electron, and data far below black", bound=200 * EPS, unit=LARGEST, backends=BOTH)
def below_black(setting: Setting) -> float:
    """Full well is 3,333 e-: light 3e-4, noise as large."""
    rng = np.random.default_rng(1)
    light = 3e-4 + 4e-4 * rng.normal(size=(8, 9, 3))
    return _likelihood(setting, rng.uniform(-0.2, 0.4, light.shape), light, ToneCurve(1e-3, 5.0))


@PART.case("tones of -3 and of 20", bound=200 * EPS, unit=LARGEST, backends=BOTH)
def extreme_tones(setting: Setting) -> float:
    """exp(k r) is 1e-9 and would be infinite: renders that a fit must come back from.

    Colours are never below 0, and tones neither: much further down the curve is too flat for float32.
    """
    rng = np.random.default_rng(2)
    tones = rng.choice([-1.0, -3.0, 0.5, 6.0, 20.0], (6, 7, 3))
    light = np.where(tones < 0, 0.05, rng.uniform(0, 0.5, tones.shape))
    return _likelihood(setting, tones, light, ToneCurve(0.3, 7.0))


@PART.case("saturated, hidden and no data at all", bound=200 * EPS, unit=LARGEST, backends=BOTH)
def gaps(setting: Setting) -> float:
    """A pixel of nan next to a saturated one, and one datum only."""
    light = np.full((4, 5, 3), np.nan)
    light[1, 2] = [1.0, 0.2, np.nan]
    light[3, 4] = [1.5, 1.0, 0.99]
    return _likelihood(setting, np.full(light.shape, 0.9), light, ToneCurve(0.8, 3.0))


@PART.case("averages where nothing is alike", bound=100 * EPS, unit=LARGEST, backends=("numba",))
def nothing_alike(setting: Setting) -> float:
    """A bandwidth of a millionth: every weight but a datum's own is 0, and where it has none the fallback stays."""
    rng = np.random.default_rng(3)
    guide = torch.tensor(rng.random((1, 12, 12, 3)), dtype=torch.float32)
    data = guide.clone()
    data[0, 5] = torch.nan
    found = averages(guide, data, h=1e-6, patch=1).mean(guide + 1)
    want = torch.where(data.isnan(), guide + 1, data)
    return relative_error(found, want.double())


@PART.case("averages of a million times the spread of the guide", bound=500 * EPS, unit=LARGEST, backends=("numba",))
def large_values(setting: Setting) -> float:
    """All weights are 1: the plain mean of the window, in float32 sums of 225."""
    rng = np.random.default_rng(4)
    data = torch.tensor(1e6 * rng.random((1, 15, 15, 3)), dtype=torch.float32)
    found = averages(torch.full_like(data, 0.5), data, h=1e-3, patch=2).mean(data)[0, 7, 7]
    return relative_error(found, data.double().mean((0, 1, 2)))


@PART.case("merged opacities of nearly 0 and nearly 1", bound=50 * EPS, unit="of 1")
def merged_opacities(setting: Setting) -> float:
    """Logits of -60 and 60 and what lies between."""
    logits = torch.linspace(-60, 60, 41)
    n = len(logits)
    some = Gaussians(torch.zeros(n, 3), torch.ones(n, 4), torch.zeros(n, 3), logits, torch.zeros(n, 1, 3))
    found = merged([some, some])
    want = -np.expm1(-np.logaddexp(0, logits.double().numpy()) / 2)
    if not all(bool(torch.isfinite(tensor).all()) for tensor in found.tensors().values()):
        return math.inf
    return float(np.abs(found.opacities[:n].double().numpy() - want).max())


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_an_exponential_without_its_bound_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ToneCurve, "light", lambda self, tone: self.knee * torch.expm1(self.k * tone))
    monkeypatch.setattr(ToneCurve, "slope", lambda self, tone: self.knee * self.k * torch.exp(self.k * tone))
    assert fails("tones of -3 and of 20")


def test_opacities_without_their_bounds_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(merge, "INSIDE", (0.0, 1.0))
    assert fails("merged opacities of nearly 0 and nearly 1")


def test_light_that_is_nan_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ToneCurve, "light", lambda self, tone: tone * torch.nan)
    assert fails("a lamp a million times as bright as the median")
