"""Hard cases of the enhancement: no light, one bright pixel, images smaller than the window.

The reference evaluates the published equations in float64 with window means as one matrix and the variance in two
passes. Like the enhancement it takes gamma and epsilon as constants of the gradient.
"""

import math
import sys
from functools import partial

import mpmath
import numpy as np
import pytest
import torch
from scipy.optimize import brentq
from torch import Tensor

from novags.methods.enhancers import guided
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import enhance
from novags.methods.enhancers.noise_level import known_sigma
from novags.methods.noise import Variance
from novags.methods.noise_estimate import _before_8_bits, noise_from
from novags.methods.problem import RawPictures
from sensor_model.noise import NoiseCurve
from tests.stability.case import (
    EPS,
    LARGEST,
    Case,
    Error,
    Fails,
    Part,
    Setting,
    refusal,
    relative_error,
    worse,
    worst_error,
)

PART = Part("enhance")
HERE = sys.modules[__name__]  # where the cases find what a test replaces

# The ratio L^gamma / (L + eta) and its slope take about ten float32 operations, each within EPS / 2.
ROUNDINGS = 20 * EPS


def _window_means(length: int, radius: int) -> Tensor:
    at = torch.arange(length)
    near = ((at[:, None] - at).abs() <= radius).double()
    return near / near.sum(1, keepdim=True)


def _smooth(plane: Tensor, radius: int, epsilon: float) -> Tensor:
    """The guided filter of one plane [H, W], guided by itself."""
    height, width = plane.shape
    means = torch.kron(_window_means(height, radius), _window_means(width, radius))
    values = plane.flatten()
    mean = means @ values
    variance = (means * (values - mean[:, None]).square()).sum(1)
    a = variance / (variance + max(epsilon, 1e-14))
    return (means @ a * values + means @ (mean * (1 - a))).reshape(height, width)


def _gamma(brightness: np.ndarray, config: EnhanceConfig) -> float:
    def excess(gamma: float) -> float:
        return float((brightness**gamma).mean()) - config.target

    if excess(config.gamma_min) <= 0:
        return config.gamma_min
    if excess(config.gamma_max) >= 0:
        return config.gamma_max
    return float(brentq(excess, config.gamma_min, config.gamma_max, xtol=1e-14, rtol=1e-14))


def reference(dark: Tensor, radius: int, epsilon: float, config: EnhanceConfig) -> Tensor:
    """The enhanced picture of dark [H, W, 3] float64, differentiable."""
    smooth = torch.stack([_smooth(dark[..., c], radius, epsilon) for c in range(3)], -1)
    bounded = torch.where(smooth < config.eta, config.eta, smooth)
    gamma = _gamma(bounded.detach().numpy(), config)
    return torch.minimum(dark * torch.exp(gamma * torch.log(bounded)) / (smooth + config.eta), torch.ones_like(dark))


def _error(dark: Tensor, config: EnhanceConfig | None = None) -> float:
    """Error of the enhanced picture and of the gradient of a random weighting of it."""
    config = config or EnhanceConfig()
    x = dark.clone().requires_grad_()
    weights = torch.rand(dark.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found, used = enhance(x, config)
    (found * weights.float()).sum().backward()
    y = dark.double().requires_grad_()
    wanted = reference(y, used.radius, float(used.epsilon), config)
    (wanted * weights).sum().backward()
    return worst_error([(found, wanted), (x.grad, y.grad)])


def _random(*size: int, seed: int = 0) -> Tensor:
    return torch.rand(*size, 3, generator=torch.Generator().manual_seed(seed))


@PART.case("all black", bound=ROUNDINGS, unit=LARGEST)
def black(setting: Setting) -> float:
    """L = 0: the slope is eta^(gamma - 1), about 5000."""
    return _error(torch.zeros(12, 14, 3))


@PART.case("one bright pixel, the rest black", bound=ROUNDINGS, unit=LARGEST)
def one_bright_pixel(setting: Setting) -> float:
    """As in a picture of one electron."""
    dark = torch.zeros(13, 12, 3)
    dark[5, 6] = torch.tensor([1.0, 0.5, 1 / 65535])
    return _error(dark)


@PART.case("constant images of 16-bit levels", bound=ROUNDINGS, unit="of the level wanted")
def constant(setting: Setting) -> float:
    """Whatever is left of E[x^2] - E[x]^2. In closed form a constant x becomes x max(x, eta)^gamma / (x + eta)."""
    levels = torch.cat([torch.arange(32), torch.arange(32, 65536, 521), torch.tensor([65535])]) / 65535
    config = EnhanceConfig(noise_estimator="immerkaer")
    found, _ = enhance(levels[:, None, None, None].expand(-1, 5, 7, 3).contiguous(), config)
    x = levels.numpy().astype(np.float64)
    bounded = np.maximum(x, config.eta)
    gamma = np.clip(math.log(config.target) / np.minimum(np.log(bounded), -1e-9), config.gamma_min, config.gamma_max)
    wanted = x * bounded**gamma / (x + config.eta)
    off = np.abs(found.numpy() - wanted[:, None, None, None])
    return float((off / np.maximum(wanted, 1e-30)[:, None, None, None]).max())


@PART.case("texture of one 16-bit step on a bright picture", bound=0.02, unit="of the texture")
def faint_texture(setting: Setting) -> float:
    """The guided filter alone. Its variance, 1e-10, is lost in the rounding of E[x^2], 5e-8 in float32.

    The bound is the rounding of the result itself: EPS / 2 at 0.9 is 1/300 of a step; some of them add up.
    """
    step = 1 / 65535
    steps = torch.randint(0, 2, (20, 21), generator=torch.Generator().manual_seed(2))
    dark = ((58982 + steps).double() * step).float()
    found = guided.guided_filter(dark[None, None], 4, torch.tensor([step**2 / 4]))[0, 0]
    return float((found - _smooth(dark.double(), 4, step**2 / 4)).abs().max()) / step


@PART.case("images smaller than the window", bound=ROUNDINGS, unit=LARGEST)
def smaller_than_the_window(setting: Setting) -> float:
    """Down to one pixel, and one pixel wide."""
    sizes = [(1, 1), (1, 2), (1, 9), (2, 2), (3, 2), (7, 1), (5, 30), (33, 4)]
    return max(_error(0.2 * _random(*size, seed=i)) for i, size in enumerate(sizes))


@PART.case("codes 0 to 3 of 65535", bound=ROUNDINGS, unit=LARGEST)
def lowest_codes(setting: Setting) -> float:
    """The darkest picture that 16 bits can hold."""
    codes = torch.randint(0, 4, (16, 15, 3), generator=torch.Generator().manual_seed(3))
    return _error(codes / 65535)


@PART.case("L from 1e-12 to 1: the ratio where L goes to 0", bound=ROUNDINGS, unit=LARGEST)
def ratio_at_zero(setting: Setting) -> float:
    """Constant pictures, so that L is the picture; value and slope go over from eta's to L's own."""
    return max(_error(torch.full((4, 4, 3), 0.9 * 10.0**k)) for k in range(-12, 1))


@PART.case("no exponent reaches the target", bound=ROUNDINGS, unit=LARGEST)
def unreachable(setting: Setting) -> float:
    """White; nearly white; more white than black; and a target too high for a dark picture."""
    mostly = torch.zeros(10, 12, 3)
    mostly[:6] = 1
    high = EnhanceConfig(target=0.999)
    return max(
        _error(torch.ones(9, 9, 3)), _error(torch.full((9, 9, 3), 0.99)), _error(mostly),
        _error(1e-3 * _random(9, 9), high),
    )  # fmt: skip


@PART.case("a picture brighter than the target", bound=ROUNDINGS, unit=LARGEST)
def already_bright(setting: Setting) -> float:
    """Gamma above 1 darkens it."""
    return _error(0.7 + 0.25 * _random(14, 13))


@PART.case("a pixel that is NaN, infinite, negative or above 1", bound=0, unit="refused")
def no_picture(setting: Setting) -> float:
    """Refused with value and place."""
    worst = 0.0
    for bad in (math.nan, math.inf, -1e-9, 1.0001):
        dark = 0.1 * _random(6, 7)
        dark[2, 3, 1] = bad
        worst = max(worst, refusal(partial(enhance, dark), "dark must be finite and in 0..1", "(2, 3, 1)"))
    return worst


@PART.case("known noise of constant pictures from black to white", bound=64 * EPS, unit="of the true one")
def known_noise(setting: Setting) -> float:
    """At black the curve's slope is 12.92, not that of its power, which is infinite; codes are float32."""
    zero, never = (0.0,) * 3, (math.inf,) * 3
    curve = NoiseCurve(
        black=zero, white=(1.0,) * 3, offset=(1e-9,) * 3, slope=(1e-4,) * 3, quadratic=zero, switch=never, step=zero
    )
    found, true = [], []
    for level in (0, 1, 2, 2600, 2700, 40001, 65535):
        code = float(torch.tensor(level / 65535))
        dark = code <= 0.04045
        light = code / 12.92 if dark else math.exp(2.4 * math.log((code + 0.055) / 1.055))
        slope = 12.92 if dark else 1.055 / 2.4 / math.exp((1 - 1 / 2.4) * math.log(light))
        true.append(math.sqrt(1e-9 + 1e-4 * light) * slope)
        found.append(float(known_sigma(torch.full((3, 7, 9), code), Variance(curve))))
    return max(relative_error(np.array(f), np.array(t)) for f, t in zip(found, true, strict=True))


@PART.case(
    "noise of pictures that are black, white, of one code or of two", bound=0, unit="variances that are not a number"
)
def noise_of_nothing(setting: Setting) -> float:
    """Where nothing varies there are ratios of 0 and 0 everywhere: what comes out is finite and not negative."""
    wrong, shape = 0, (2, 34, 37, 3)
    for low, high in ((0, 0), (255, 255), (7, 7), (0, 1), (254, 255)):
        codes = torch.full(shape, float(low))
        codes[:, ::2, ::3] = high
        dn = codes[..., 0].contiguous()
        raw = RawPictures(dn=dn, cfa="RGGB", black=0.0, white=255.0)
        for linear, frames in ((None, None), (codes / 255, raw), (codes / 255, None)):
            noise = noise_from(codes / 255, linear, frames, mixed=False)
            at = torch.tensor([[0.0] * 3, [0.5] * 3, [1.0] * 3], dtype=torch.float64)
            values = [noise.linear16(at), *([] if noise.raw is None else [noise.raw(255 * at)])]
            wrong += sum(int((~(torch.isfinite(v) & (v >= 0))).sum()) for v in values)
    return float(wrong)


@PART.case(
    "a normal before it was clipped at black, its mean from -0.9 to 5.9 deviations", bound=2e-4, unit="of the deviation"
)
def before_clipping(setting: Setting) -> float:
    """The table of 701 ratios is read linearly: their curvature times the square of its step of 0.01."""
    # So wide that the rounding to 8 bits is nothing beside it
    mean, variance, at = [], [], np.linspace(-0.9, 5.9, 35) + 0.0037
    with mpmath.workdps(40):
        for z in at:
            density, above = mpmath.npdf(z), mpmath.ncdf(z)
            first = z * above + density
            mean.append(float(first))
            variance.append(float((z * z + 1) * above + z * density - first**2))
    scale = 1e4
    m, v = _before_8_bits(scale * torch.tensor(mean, dtype=torch.float64), scale**2 * torch.tensor(variance).double())
    sigma = v.sqrt().numpy() / scale
    return worse(float(np.abs(m.numpy() / scale - at).max()), float(np.abs(sigma - 1).max()))


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_a_variance_in_float32_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def in_float32(image, radius, epsilon):
        mean = guided.box_mean(image, radius)
        variance = guided.box_mean(image * image, radius) - mean * mean
        a = variance / (variance + epsilon.reshape(-1, 1, 1, 1).clamp_min(1e-14).to(image.dtype))
        return guided.box_mean(a, radius) * image + guided.box_mean(mean * (1 - a), radius)

    monkeypatch.setattr(guided, "guided_filter", in_float32)
    assert fails("texture of one 16-bit step on a bright picture")


def test_a_ratio_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.Tensor, "clamp_min", lambda self, low: self)
    assert fails("all black")
    assert fails("one bright pixel, the rest black")


def test_a_gamma_that_stops_early_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    solve = guided.solve_gamma
    monkeypatch.setattr(guided, "solve_gamma", lambda brightness, config: solve(brightness, config) * (1 + 1e-4))
    for name in ("codes 0 to 3 of 65535", "a picture brighter than the target", "constant images of 16-bit levels"):
        assert fails(name), name


def test_a_check_that_lets_nan_through_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guided, "check_picture", lambda dark: None)
    assert fails("a pixel that is NaN, infinite, negative or above 1")


def test_a_curve_without_its_straight_foot_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "where", lambda condition, yes, no: no)
    assert fails("known noise of constant pictures from black to white")


def test_a_ratio_without_its_floors_is_noticed_in_the_noise_of_nothing(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.Tensor, "clamp_min", lambda self, low: self)
    assert fails("noise of pictures that are black, white, of one code or of two")


def test_moments_of_clipped_values_taken_for_those_before_are_noticed(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = _before_8_bits
    monkeypatch.setattr(HERE, "_before_8_bits", lambda mean, variance: (mean, variance))
    assert fails("a normal before it was clipped at black, its mean from -0.9 to 5.9 deviations")
    monkeypatch.setattr(
        HERE, "_before_8_bits", lambda mean, variance: (before(mean, variance)[0], variance * torch.nan)
    )
    assert fails("a normal before it was clipped at black, its mean from -0.9 to 5.9 deviations")
