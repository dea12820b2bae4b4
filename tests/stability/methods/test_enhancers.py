"""Hard cases of the rivals' enhancements: black, flat and white pictures, one bright pixel, pictures of few pixels.

The references go through the pixels one by one with Python's own numbers.
"""

import math
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from novags.methods.enhancers import ENHANCERS, enhancer_of
from novags.methods.enhancers.choice import Enhancement
from novags.methods.enhancers.curves import drago, gain
from novags.methods.enhancers.curves.drago import DARKEST
from novags.methods.enhancers.networks.kind import Kind
from novags.methods.enhancers.networks.mbllen import adjust
from novags.methods.enhancers.networks.rows.mbllen import MbllenConfig
from novags.methods.enhancers.rows.drago import DragoConfig
from novags.methods.enhancers.rows.equalise import EqualiseConfig
from novags.methods.enhancers.rows.gain import GainConfig
from novags.methods.enhancers.rows.gamma import GammaConfig
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, refusal, relative_error, worse

PART = Part("enhancers")
HERE = sys.modules[__name__]  # where the cases find what a test replaces

CURVES: tuple[Enhancement, ...] = (
    GammaConfig(), GammaConfig(gamma=None), GainConfig(), DragoConfig(), EqualiseConfig(),
)  # fmt: skip
WEIGHTS = (0.2126, 0.7152, 0.0722)
Pixel = list[float]


def _curve(config: Enhancement, dark: Tensor) -> Tensor:
    _, enhancer = enhancer_of(config)
    found: Tensor = enhancer.enhance(dark, config, None, None)[0]
    return found


def _light(code: float) -> float:
    return code / 12.92 if code <= 0.04045 else math.exp(2.4 * math.log((code + 0.055) / 1.055))


def _code(light: float) -> float:
    light = min(light, 1.0)
    return 12.92 * light if light <= 0.0031308 else 1.055 * math.exp(math.log(light) / 2.4) - 0.055


def _luma(pixel: Pixel) -> float:
    return math.fsum(w * v for w, v in zip(WEIGHTS, pixel, strict=True))


def _drago(pixels: list[Pixel], bias: float) -> list[Pixel]:
    light = [[_light(v) for v in pixel] for pixel in pixels]
    top = max(map(_luma, light))
    if top == 0:
        return pixels
    average = math.exp(math.fsum(math.log(max(_luma(p), DARKEST * top)) for p in light) / len(light))
    shown = []
    for pixel in light:
        x = _luma(pixel) / average
        if x == 0:
            shown.append([0.0] * 3)
            continue
        bend = math.log(2 + 8 * (x * average / top) ** (math.log(bias) / math.log(0.5)))
        level = math.log1p(x) / bend / math.log10(1 + top / average)
        shown.append([_code(v * level / _luma(pixel)) for v in pixel])
    return shown


def _equalised(pixels: list[Pixel]) -> list[Pixel]:
    lumas = [_luma(pixel) for pixel in pixels]
    low, same = min(lumas), 1e-12  # of one luma, whatever the order in which it was added up
    darkest = sum(v <= low + same for v in lumas)
    if darkest == len(lumas):
        return pixels
    shown = []
    for pixel, luma in zip(pixels, lumas, strict=True):
        share = (sum(v <= luma + same for v in lumas) - darkest) / (len(lumas) - darkest)
        shown.append([min(v * share / luma, 1.0) if luma > 0 else 0.0 for v in pixel])
    return shown


def _slow(config: Enhancement, pixels: list[Pixel]) -> list[Pixel]:
    if isinstance(config, GammaConfig):
        exponent = config.gamma or _root(
            lambda g: math.fsum(v**g for p in pixels for v in p) / (3 * len(pixels)) - config.target, 0.02, 5.0
        )
        return [[v**exponent for v in pixel] for pixel in pixels]
    if isinstance(config, GainConfig):
        light = [[_light(v) for v in pixel] for pixel in pixels]
        gain = math.exp(_root(
            lambda k: config.target - math.fsum(_code(math.exp(k) * v) for p in light for v in p) / (3 * len(pixels)),
            math.log(1e-3), math.log(1e5),
        ))  # fmt: skip
        return [[_code(gain * v) for v in pixel] for pixel in light]
    return _drago(pixels, config.bias) if isinstance(config, DragoConfig) else _equalised(pixels)


def _root(falls: Callable[[float], float], low: float, high: float) -> float:
    """Where a falling function is 0; of one without a zero, the end that is nearer to it."""
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if falls(middle) > 0 else (low, middle)
    return (low + high) / 2


def _error(dark: Tensor) -> float:
    """Error of all curves; the result is rounded to float32 once."""
    worst = 0.0
    for config in CURVES:
        wanted = np.array(_slow(config, dark.double().reshape(-1, 3).tolist()))
        worst = max(worst, relative_error(_curve(config, dark).reshape(-1, 3), wanted))
    return worst


def _random(height: int, width: int, seed: int = 0) -> Tensor:
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(seed))


@PART.case("tone curves: all black", bound=0, unit=LARGEST)
def black(setting: Setting) -> float:
    """No logarithm, no luma, no exposure: black stays black."""
    return worse(*(float(_curve(config, torch.zeros(5, 6, 3)).abs().max()) for config in CURVES))


@PART.case("tone curves: flat pictures of every level", bound=2 * EPS, unit=LARGEST)
def flat(setting: Setting) -> float:
    """One luma has no histogram, and its own luminance as average and as maximum."""
    return max(_error(torch.full((4, 3, 3), level / 65535)) for level in (1, 7, 257, 20_000, 65_534, 65_535))


@PART.case("tone curves: one bright pixel, a faint one, the rest black", bound=2 * EPS, unit=LARGEST)
def one_bright_pixel(setting: Setting) -> float:
    """No gain and no exponent reaches the target."""
    dark = torch.zeros(6, 7, 3)
    dark[3, 2] = torch.tensor([0.9, 0.5, 0.1])
    dark[1, 1] = 0.01
    return _error(dark)


@PART.case("tone curves: pictures of one to nine pixels", bound=2 * EPS, unit=LARGEST)
def few_pixels(setting: Setting) -> float:
    """And one pixel wide."""
    return max(_error(0.3 * _random(*size, seed=i)) for i, size in enumerate([(1, 1), (1, 2), (3, 3), (9, 1)]))


@PART.case("tone curves: 16-bit codes of 0 to 3 and of the whole range", bound=2 * EPS, unit=LARGEST)
def codes(setting: Setting) -> float:
    """The darkest picture that 16 bits can hold needs a gain of 3e4; lumas are the same or differ by a step."""
    lowest = torch.randint(0, 4, (9, 8, 3), generator=torch.Generator().manual_seed(3)) / 65535
    return max(_error(lowest), _error(_random(8, 9, 5)))


@PART.case("tone curves: a pixel that is NaN, negative or above 1", bound=0, unit="refused")
def no_picture(setting: Setting) -> float:
    """Refused with value and place."""
    worst = 0.0
    for bad in (math.nan, math.inf, -1e-9, 1.0001):
        dark = 0.1 * _random(4, 5)
        dark[2, 3, 1] = bad
        for config in CURVES:
            refused = refusal(partial(_curve, config, dark), "must be finite and in 0..1", "(2, 3, 1)")
            worst = max(worst, refused)
    return worst


def _pictures() -> list[Tensor]:
    """Black, white, one bright pixel, and pictures of one to nine pixels, [1, 3, H, W]."""
    spot = torch.zeros(1, 3, 14, 15)
    spot[0, :, 6, 7] = torch.tensor([0.9, 0.5, 0.1])
    few = [0.3 * _random(*size).movedim(-1, 0)[None] for size in ((1, 1), (1, 2), (3, 3), (9, 1))]
    return [torch.zeros(1, 3, 13, 16), torch.ones(1, 3, 13, 16), spot, *few]


def _networks() -> list[tuple[Kind, nn.Module, Any]]:
    """Every kind of network with the weights that a training begins with."""
    found = []
    rows = [(row.config, row.network()) for row in ENHANCERS.values() if row.network is not None]
    for config, kind in rows:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            found.append((kind, kind.make(config()).eval(), config()))
    return found


@PART.case("networks: black, white, one bright pixel, one to nine pixels", bound=500 * EPS, unit=LARGEST, slow=True)
def networks(setting: Setting) -> float:
    """Against float64. At most some forty layers, each with sums of some hundred products, of both signs."""
    worst = 0.0
    for kind, network, config in _networks():
        for picture in _pictures():
            with torch.no_grad():
                found = kind.run(network.float(), picture, config)
                wanted = kind.run(network.double(), picture.double(), config)
            worst = worse(worst, relative_error(found, wanted))
    return worst


@PART.case("losses without references: slopes on the same pictures", bound=5000 * EPS, unit=LARGEST, slow=True)
def slopes(setting: Setting) -> float:
    """Against float64. Colours without difference have no slope under a root; batches without spread are normalised."""
    worst = 0.0
    for kind, network, config in _networks():
        if kind.rehearsal is None:
            continue
        for picture in _pictures():
            found = []
            for dtype in (torch.float32, torch.float64):
                network.to(dtype).zero_grad()  # converts the network itself: one after the other
                kind.rehearsal.loss(network, picture.to(dtype), config).backward()
                found.append([p.grad.clone() for p in network.parameters() if p.grad is not None])
            largest = max(float(g.abs().max()) for g in found[1])
            for a, b in zip(*found, strict=True):
                worst = worse(worst, float((a.double() - b).abs().max()) / max(largest, 1e-30))
    return worst


@PART.case("adjustment of a result: black, white, grey, one bright pixel", bound=20 * EPS, unit="of white")
def adjusted(setting: Setting) -> float:
    """MBLLEN's percentiles and saturation against float64; nothing is divided by a saturation or a percentile of 0."""
    worst = 0.0
    for picture in (*_pictures(), torch.full((1, 3, 5, 5), 0.4)):
        found, params = adjust(picture, MbllenConfig(), None)
        wanted, _ = adjust(picture.double(), MbllenConfig(), params)
        off = float((found.double() - wanted).abs().max()) if np.isfinite(params).all() else math.inf
        worst = worse(worst, off)
    return worst


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_a_logarithm_over_its_argument_without_its_limit_is_noticed(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(np, "where", lambda condition, yes, no: yes)
    assert fails("tone curves: one bright pixel, a faint one, the rest black")


def test_a_log_average_in_which_black_ends_the_sum_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drago, "DARKEST", 1e-300)
    assert fails("tone curves: one bright pixel, a faint one, the rest black")


def test_a_gain_sought_in_too_small_a_range_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gain, "GAINS", (1.0, 1e3))
    assert fails("tone curves: 16-bit codes of 0 to 3 and of the whole range")


def test_a_bisection_that_stops_early_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gain, "STEPS", 12)
    assert fails("tone curves: pictures of one to nine pixels")


def test_slopes_of_two_precisions_are_compared() -> None:
    """They differ by roundings; equal ones would be those of one network compared with itself."""
    assert PART.named("losses without references").error(Setting("torch")) > 0


def test_a_root_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.Tensor, "clamp_min", lambda self, low: self)
    assert fails("losses without references: slopes on the same pictures")


def test_a_saturation_of_grey_that_is_raised_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "where", lambda condition, yes, no: yes)
    assert fails("adjustment of a result: black, white, grey, one bright pixel")


def test_a_curve_that_makes_nan_of_black_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    curve, last = _curve, CURVES[-1]
    monkeypatch.setattr(HERE, "_curve", lambda c, dark: curve(c, dark) * (np.nan if c is last else 1))
    assert fails("tone curves: all black")
