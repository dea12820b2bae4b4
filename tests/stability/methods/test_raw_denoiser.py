"""Hard cases of the denoiser of raw data: no signal, read noise that hides all of it, saturation, single pixels."""

import copy
import math

import mpmath
import numpy as np
import pytest
import torch
from torch import Tensor, nn

from novags.methods.denoised import measured as of_data
from novags.methods.denoised import recorrupted
from novags.methods.denoised.anscombe import Anscombe
from novags.methods.denoised.blend import best_blend
from novags.methods.denoised.config import AdaptConfig
from novags.methods.denoised.estimate import estimate
from novags.methods.denoised.measured import MeasuredPictures, of_capture
from novags.methods.denoised.network import Network
from novags.methods.denoised.packing import mask_of
from novags.methods.denoised.recorrupted import Adaptation
from novags.methods.denoised.weights import load_weights
from novags.methods.noise import Noise, Variance
from sensor_model.noise import NoiseCurve
from sensor_model.params import Cfa
from tests.stability.case import EPS, LARGEST, Case, Error, Fails, Part, Setting, refusal, relative_error

PART = Part("raw_denoiser")

# Twenty convolutions in a row. Each sums some hundred products of either sign, whose roundings partly cancel.
LAYERS = 1e-4


def _exact(electrons: float, read_variance: float) -> tuple[float, float]:
    """The transform and its slope, as they are defined, in 60 digits."""
    with mpmath.workdps(60):
        e, floor = mpmath.mpf(electrons), mpmath.mpf(read_variance) + mpmath.mpf(3) / 8
        value = 2 * (mpmath.sqrt(e + floor) - mpmath.sqrt(floor)) if e > 0 else e / mpmath.sqrt(floor)
        return float(value), float(1 / mpmath.sqrt(max(e, 0) + floor))


def _transform_errors(electrons: np.ndarray, read_variance: float) -> float:
    """Error of each value relative to itself, and of its slope."""
    given = torch.from_numpy(electrons.astype(np.float32)).requires_grad_()
    found = Anscombe(torch.tensor(read_variance))(given)
    found.sum().backward()
    assert given.grad is not None
    exact = [_exact(float(e), float(torch.tensor(read_variance))) for e in given.detach()]
    values, slopes = np.array(exact).T
    return max(
        relative_error(found.detach().numpy() / values, np.ones_like(values)),
        relative_error(given.grad.numpy() / slopes, np.ones_like(slopes)),
    )


@PART.case("the transform at a millionth of an electron, read noise 0 to 1,000 e-", bound=8 * EPS, unit="of each value")
def no_signal(setting: Setting) -> float:
    """The difference of two roots that agree in all their digits; a handful of roundings if it is not taken."""
    small = np.array([-1e-6, 1e-30, 1e-6, 1e-3])
    return max(_transform_errors(small, sigma**2) for sigma in (0.0, 0.3, 4.0, 1000.0))


@PART.case("the transform far below black and at a million electrons", bound=8 * EPS, unit="of each value")
def all_signals(setting: Setting) -> float:
    """Data are never cut at black, so that the noise of dark pixels keeps its mean."""
    large = np.array([-1e4, -30.0, -0.1, 0.5, 300.0, 1e6])
    return max(_transform_errors(large, sigma**2) for sigma in (0.0, 0.3, 4.0, 1000.0))


@PART.case("there and back, at any read noise", bound=16 * EPS, unit="of each value")
def round_trip(setting: Setting) -> float:
    """The inverse of the transform, each some roundings."""
    values = torch.tensor([-1e4, -2.0, -1e-6, 1e-6, 0.5, 20.0, 3000.0, 1e6])
    errors = []
    for sigma in (0.0, 0.3, 4.0, 1000.0):
        stabilised = Anscombe(torch.tensor(sigma**2))
        errors.append(relative_error(stabilised.inverse(stabilised(values)) / values, torch.ones(8)))
    return max(errors)


def _doubled(network: Network) -> Network:
    return copy.deepcopy(network).double()


def _estimate_error(electrons: Tensor, cfa: Cfa | None, read_variance: float) -> float:
    """Error of the trained network in float32 against the same one in float64."""
    network = load_weights()
    mask = mask_of(electrons.shape[2:], cfa)
    variance = torch.full((3,), read_variance)
    with torch.no_grad():
        found = estimate(network, electrons * mask, mask, variance)
        wanted = estimate(_doubled(network), (electrons * mask).double(), mask.double(), variance.double())
    return relative_error(found, wanted)


@PART.case("black frames: nothing but read noise, and nothing at all", bound=LAYERS, unit=LARGEST)
def black(setting: Setting) -> float:
    """The error is that of an estimate which is itself near zero, in electrons."""
    noise = torch.randn(1, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    return max(_estimate_error(0.4 * noise, None, 0.16), _estimate_error(4 * noise, "RGGB", 16.0),
               _estimate_error(0 * noise, None, 0.0))  # fmt: skip


@PART.case("read noise of a thousand electrons", bound=LAYERS, unit=LARGEST)
def loud(setting: Setting) -> float:
    """Far beyond what the network was trained with."""
    noise = torch.randn(1, 3, 32, 32, generator=torch.Generator().manual_seed(1))
    return max(_estimate_error(1000 * noise + 20, cfa, 1e6) for cfa in (None, "GRBG"))


@PART.case("saturated pictures, and one lamp in the dark", bound=LAYERS, unit=LARGEST)
def saturated(setting: Setting) -> float:
    """A full well of 166,000 electrons is 800 deviations of the noise from black."""
    full = torch.full((1, 3, 32, 32), 1.66e5)
    lamp = torch.poisson(torch.full((1, 3, 32, 32), 2.0), generator=torch.Generator().manual_seed(2))
    lamp[..., 12:20, 12:20] = 1.66e5
    return max(_estimate_error(picture, cfa, 1.0) for picture in (full, lamp) for cfa in (None, "BGGR"))


@PART.case("pictures of one cell, one row, odd sides", bound=LAYERS, unit=LARGEST)
def any_size(setting: Setting) -> float:
    """Margins are mirrored again and again."""
    stream = torch.Generator().manual_seed(3)
    sizes: tuple[tuple[int, int, Cfa | None], ...] = (
        (2, 2, "RGGB"), (2, 37, "GBRG"), (17, 3, "RGGB"), (1, 1, None), (1, 9, None),
    )  # fmt: skip
    return max(_estimate_error(torch.poisson(torch.full((1, 3, h, w), 15.0), generator=stream), cfa, 1.0)
               for h, w, cfa in sizes)  # fmt: skip


def _curve(offset: float, slope: float) -> Variance:
    zero, never = (0.0,) * 3, (math.inf,) * 3
    return Variance(NoiseCurve(black=zero, white=never, offset=(offset,) * 3, slope=(slope,) * 3, quadratic=zero,
                               switch=never, step=zero))  # fmt: skip


@PART.case("adaptation to frames without a single electron", bound=0, unit="1 where not finite")
def adaptation_in_the_dark(setting: Setting) -> float:
    """Without read noise the known variance is 0 there: a weight of 1 / 0 unless it has a floor."""
    one, dark, network = torch.ones(3), torch.zeros(2, 3, 16, 16), load_weights()
    nn.init.zeros_(network.leave.weight)  # an estimate of exactly 0, whose variance is exactly 0
    nn.init.zeros_(network.leave.bias)
    pictures = MeasuredPictures(dark, mask_of((16, 16), None), _curve(0.0, 1.0), one, None)
    loss = Adaptation(network, pictures, AdaptConfig(batch=2, crop=16), seed=0).loss()
    loss.backward()
    slopes = [p.grad for p in network.parameters() if p.grad is not None]
    return float(not all(bool(torch.isfinite(value).all()) for value in (loss, *slopes)))


@PART.case("shares of adapted estimates over nine decades of light, and of none", bound=1e-5, unit=LARGEST)
def adapted_shares(setting: Setting) -> float:
    """Changes of a hundredth of the noise, at up to a million electrons; without a change nothing is 0 / 0.

    A change is a difference of two float32 numbers of up to 1e6, whose rounding is what the bound allows.
    """
    stream = np.random.default_rng(4)
    mean = 10 ** stream.uniform(-3, 6, 200_000)
    deviation = np.sqrt(mean + 1)
    given = [mean, mean + 0.01 * deviation * stream.standard_normal(mean.size),
             mean + deviation * stream.standard_normal(mean.size), deviation**2]  # fmt: skip
    before, after, second, variance = (torch.from_numpy(values).float() for values in given)
    found = best_blend(before, after, second, variance)
    levels, shares = list[float](), list[float]()
    b, a, y, v = (values.double().numpy() for values in (before, after, second, variance))
    for some in np.array_split(np.argsort(b, kind="stable"), len(found.levels)):
        change = (a - b)[some]
        levels.append(b[some].mean())
        shares.append(np.clip((change * (y - b)[some] / v[some]).sum() / (change**2 / v[some]).sum(), 0, 1))
    dark = torch.zeros(50)
    still = best_blend(dark, dark, dark, dark + 1)(dark, dark)
    if not bool((still == 0).all()):
        return math.inf
    return max(relative_error(found.levels.numpy() / levels, np.ones(len(levels))),
               relative_error(found.shares.numpy(), np.array(shares)))  # fmt: skip


@PART.case("data without any noise", bound=0, unit="refused")
def noise_free(setting: Setting) -> float:
    """Without noise the pictures cannot be brought to unit variance."""
    pictures, noise = torch.full((1, 8, 8, 3), 0.2), Noise(_curve(0.0, 0.0), None, "pictures")
    return refusal(lambda: of_capture(noise, None, pictures, ()), "variance > 0")


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def test_the_difference_of_two_roots_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    def naive(self: Anscombe, electrons: torch.Tensor) -> torch.Tensor:
        floor = self.read_variance + 3 / 8
        return 2 * ((electrons + floor).clamp_min(1e-9).sqrt() - floor.sqrt())

    monkeypatch.setattr(Anscombe, "__call__", naive)
    assert fails("the transform at a millionth of an electron, read noise 0 to 1,000 e-")
    assert fails("there and back, at any read noise")


def test_data_cut_at_black_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    call = Anscombe.__call__
    monkeypatch.setattr(Anscombe, "__call__", lambda self, electrons: call(self, electrons.clamp_min(0)))
    assert fails("the transform far below black and at a million electrons")


def test_a_variance_without_its_floor_is_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorrupted, "LEAST_VARIANCE", 0.0)
    assert fails("adaptation to frames without a single electron")


def test_noise_free_data_that_are_let_through_are_noticed(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(of_data, "LacksInput", RuntimeError)
    assert fails("data without any noise")
