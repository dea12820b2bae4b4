"""Hard cases of the camera's noise: tails, clipped and rounded noise, and draws that depend on nothing else.

References: mpmath for quantiles and the bias of clipping, and for the analytic moments the plain double sum over every
charge and every code.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import special

from sensor_model import effects, moments
from sensor_model.fast.blocks import scratch
from sensor_model.fast.kernels import MU, N, U, W, tukey
from sensor_model.fast.poisson import poisson
from sensor_model.frame import streams
from sensor_model.params import Sensor
from tests.stability.case import Case, Error, Fails, Part, Setting, worse
from tests.stability.sensor.frames import BOTH, CAMERA, DIFFER, differ, frame

PART = Part("sensor_noise")


def code_sum(camera: Sensor, mu: float) -> tuple[float, float]:
    """Mean and variance of the codes of mean charge `mu`, summed over all charges and all codes. DN, DN**2."""
    charges = np.arange(0, mu + 12 * math.sqrt(mu) + 60) if mu > 0 else np.zeros(1)
    weight = np.exp(special.xlogy(charges, mu) - mu - special.gammaln(charges + 1))
    level = camera.black_level + camera.gain * np.minimum(charges, camera.mu_e_sat)
    codes = np.arange(camera.max_dn + 1.0)
    above = special.ndtr((level[:, None] - codes[1:] + 0.5) / (camera.gain * camera.sigma_d))  # P(code >= 1, 2, ...)
    reached = weight @ above / weight.sum()
    chance = np.diff(np.concatenate([[1.0], reached, [0.0]])) * -1
    mean = math.fsum(chance * codes)
    return mean, math.fsum(chance * (codes - mean) ** 2)


def _moment_error(camera: Sensor, means: list[float], setting: Setting) -> float:
    """Worst error of the float32 moments: the mean's in standard deviations, the variance's of itself."""
    shot = frame(np.array([means]) / camera.eta, camera, setting)
    wanted = np.array([code_sum(camera, mu) for mu in means]).T
    spread = float(np.abs(shot.variance_dn[0] / wanted[1] - 1).max())
    return worse(spread, float((np.abs(shot.mean_dn[0] - wanted[0]) / np.sqrt(wanted[1])).max()))


# float32 holds 1023 DN to 3e-5 DN, 1e-5 of the least noise there, 3 DN.
@PART.case(
    "analytic moments from no charge to a full well, in float32", bound=1e-5, unit="of the noise", backends=("numpy",)
)
def _(setting: Setting) -> float:
    well = replace(CAMERA, mu_e_sat=400.0, bits=10)  # white at 864 DN
    adc = replace(well, mu_e_sat=math.inf, sigma_d=3.0)  # at 1023 DN, or 479.5 e-
    means = [0.0, 1e-3, 0.1, 2.0, 25.0, 300.0, 390.0, 400.0, 425.0]
    return worse(_moment_error(well, means, setting), _moment_error(adc, [*means, 470.0, 480.0, 520.0], setting))


# Black at 0 cuts a noise of 3 DN in the middle: the first term that Euler and Maclaurin leave out is 2e-5 of it.
@PART.case("8 bits after a gain of 200, and black at 0", bound=1e-4, unit="of the noise", backends=("numpy",))
def _(setting: Setting) -> float:
    loud = Sensor(gain=200.0, eta=1.0, mu_e_sat=1.15, black_level=16, bits=8, sigma_d=0.02, cfa=None)
    low = replace(CAMERA, black_level=0.0, bits=10)
    return worse(_moment_error(loud, [0.0, 0.01, 0.1, 1.0], setting), _moment_error(low, [0.0, 0.3, 3.0], setting))


@PART.case("black at 0, 1 and 3 deviations: K sigma (phi(z) - z Phi(-z))", bound=2e-5, unit="of the noise",
           backends=("numpy",))  # fmt: skip
def _(setting: Setting) -> float:
    """What rounding adds to the formula is phi(z) / 24 s**2 of the noise: with s = 32 DN less than 2e-5."""
    worst, sigma = 0.0, 32.0
    for z in (0, 1, 3):
        camera = replace(CAMERA, gain=1.0, sigma_d=sigma, black_level=z * sigma)
        lift = float(mpmath.npdf(z) - z * mpmath.ncdf(-z))
        mean = float(frame(np.zeros((1, 1)), camera, setting).mean_dn[0, 0])
        worst = worse(worst, abs((mean - z * sigma) / sigma - lift))
    return worst


@PART.case("black at 0, 1 and 3 deviations: mean of 160,000 pixels", bound=5, unit="standard errors", backends=BOTH)
def _(setting: Setting) -> float:
    """Electrons clipped at 0 before the black level is added would be 160 standard errors off."""
    worst, sigma, side = 0.0, 8.0, 400
    for z in (0, 1, 3):
        camera = replace(CAMERA, gain=1.0, sigma_d=sigma, black_level=z * sigma)
        shot = frame(np.zeros((side, side)), camera, setting)
        wanted, variance = code_sum(camera, 0.0)
        worst = worse(worst, abs(float(shot.dn.mean()) - wanted) / math.sqrt(variance) * side)
    return worst


@PART.case("noise of 0.2 to 0.5 codes: the mean errs by exp(-2 pi**2 s**2) / pi at most", bound=1.02,
           unit="of that", backends=("numpy",))  # fmt: skip
def _(setting: Setting) -> float:
    """The formula is the first harmonic of rounding; the second adds 2 (0.047)**2 of it at 0.2 codes, float32 1e-3."""
    worst = 0.0
    for noise in (0.2, 0.3, 0.5):
        camera = replace(CAMERA, gain=0.01, eta=1.0, mu_e_sat=math.inf, sigma_d=noise / 0.01)
        light = np.linspace(0, 300, 61)[None]
        mean = frame(light, camera, setting, shot="none").mean_dn.astype(np.float64)
        stated = math.exp(-2 * (math.pi * noise) ** 2) / math.pi
        worst = worse(worst, float(np.abs(mean - (64 + 0.01 * light)).max()) / stated)
    return worst


LAMBDAS = (-0.45, -0.25, -1e-3, -1e-12, 0.0, 1e-12, 1e-3, 0.149, 0.9)


# The kernel's series of sinh(z)/z ends at z**16 and is used up to z = 2: the next term is 2**18 / 19!.
@PART.case("Tukey-lambda at u = 2**-53 and 1 - 2**-53, lambda 0 and 1e-12", bound=2.2e-12,
           unit="of 1 plus the quantile", backends=BOTH)  # fmt: skip
def _(setting: Setting) -> float:
    low = 2.0 ** -np.arange(1.0, 54.0)
    u = np.concatenate([low, 1 - low[1:], 0.5 + 2.0 ** -np.arange(20.0, 50, 3)])
    worst = 0.0
    with mpmath.workdps(40):
        for lam in LAMBDAS:
            exact = mpmath.mpf(lam)
            for x, found in zip(u, _tukey(u, lam, setting.backend), strict=True):
                a, b = mpmath.mpf(float(x)), 1 - mpmath.mpf(float(x))
                wanted = mpmath.log(a / b) if lam == 0 else (a**exact - b**exact) / exact
                worst = worse(worst, float(abs(mpmath.mpf(float(found)) - wanted) / (1 + abs(wanted))))
    return worst


def _tukey(u: NDArray, lam: float, backend: str) -> NDArray:
    if backend == "numpy":
        return effects.tukey_quantile(u, lam)
    b, _, _ = scratch()
    b[U : U + u.size] = u
    tukey(b, u.size, lam)
    return b[W : W + u.size].copy()


@PART.case("Tukey-lambda's standard deviation around lambda = 0", bound=1e-7, unit="relative", backends=("numpy",))
def _(setting: Setting) -> float:
    """Near 0 the closed form loses eps / lambda**2: 2e-8 at 1e-4, where its series takes over with lambda**2."""
    worst = 0.0
    with mpmath.workdps(60):
        for lam in (*LAMBDAS[:4], 1e-12, 1.01e-4, -1.01e-4, 0.99e-4, *LAMBDAS[6:]):
            x = mpmath.mpf(lam)
            wanted = mpmath.sqrt(2 / x**2 * (1 / (1 + 2 * x) - mpmath.beta(x + 1, x + 1)))
            worst = worse(worst, float(abs(effects.tukey_sd(lam) / wanted - 1)))
    return worst


@PART.case("Poisson quantiles at means of 1e-9 to 1e6, out to u = 2**-40", bound=0, unit="counts differ", backends=BOTH)
def _(setting: Setting) -> float:
    u = np.array([2.0**-40, 1e-9, 1e-4, 0.1, 0.5, 0.9, 0.9999, 1 - 2.0**-30])
    wrong = 0
    for mu in (1e-9, 1e-3, 0.7, 3.999, 4.0, 4.001, 25.0, 1e3, 1e6):
        for x, n in zip(u, _poisson(u, mu, setting.backend), strict=True):
            with mpmath.workdps(30):
                at = mpmath.gammainc(int(n) + 1, mpmath.mpf(mu), regularized=True)  # P(N <= n)
                below = mpmath.gammainc(int(n), mpmath.mpf(mu), regularized=True) if n > 0 else 0
            wrong += not below < mpmath.mpf(float(x)) <= at
    return float(wrong)


def _poisson(u: NDArray, mu: float, backend: str) -> NDArray:
    if backend == "numpy":
        return effects.shot_noise(u, np.full(u.size, mu))
    b, f, where = scratch()
    b[U : U + u.size], b[MU : MU + u.size] = u, mu
    poisson(b, f, u.size, where)
    return b[N : N + u.size].copy()


@PART.case("fast and exact sampler: the same codes from 1e-6 to 1e6 electrons", bound=0, unit=DIFFER,
           backends=("numba",))  # fmt: skip
def _(setting: Setting) -> float:
    light = np.geomspace(1e-6, 1e6, 100_000).reshape(250, 400)
    worst = 0.0
    for camera in (CAMERA, replace(CAMERA, tukey_lambda=-0.1), replace(CAMERA, mu_e_sat=math.inf, bits=16, gain=0.05)):
        plain = frame(light, camera, Setting("numpy", 1))
        worst = worse(worst, differ(frame(light, camera, setting).dn, plain.dn))
    return worst


@PART.case("more light or shot noise leaves the draws of the read noise", bound=0, unit="DN", backends=BOTH)
def _(setting: Setting) -> float:
    """At 1 DN per electron whole electrons move the codes by whole DN: the read noise can be told from them."""
    camera = replace(CAMERA, gain=1.0, eta=1.0)
    alone = frame(np.full((64, 64), 20.0), camera, setting, shot="none").dn.astype(int) - 20
    worst = 0.0
    for mean, shot in ((25.0, "none"), (20.0, "poisson"), (25.0, "poisson")):
        light = np.full((64, 64), mean)
        silent = frame(light, replace(camera, sigma_d=0.0), setting, shot=shot).dn.astype(int) - 64
        read = frame(light, camera, setting, shot=shot).dn.astype(int) - silent
        worst = worse(worst, int(np.abs(read - alone).max()))
    return float(worst)


def test_the_error_stays_within_its_bound(case: Case, setting: Setting, error: Error) -> None:
    assert error(case, setting) <= case.bound


def tukey_by_powers(u: Any, lam: float) -> Any:
    with np.errstate(all="ignore"):
        return (u**lam - (1 - u) ** lam) / lam if lam else np.log(u / (1 - u))


def normal_for_poisson(u: Any, mu: Any) -> Any:
    return np.maximum(np.rint(mu + np.sqrt(mu) * special.ndtri(u)), 0)


def rounding_adds_a_twelfth(level: Any, sd: Any, top: Any) -> Any:
    return np.clip(level, 0, top), np.broadcast_to(sd**2 + 1 / 12, level.shape)


@pytest.mark.parametrize(
    ("module", "name", "naive", "case"),
    [
        (effects, "tukey_quantile", tukey_by_powers, "Tukey-lambda at u"),
        (effects, "tukey_sd", lambda lam: np.sqrt(2 / lam**2 * (1 / (1 + 2 * lam) - special.beta(lam + 1, lam + 1)))
         if lam else np.pi / np.sqrt(3), "Tukey-lambda's standard"),
        (effects, "shot_noise", normal_for_poisson, "Poisson quantiles"),
        (moments, "code_moments", rounding_adds_a_twelfth, "analytic moments"),
        (moments, "code_moments", rounding_adds_a_twelfth, "8 bits after"),
        (moments, "code_moments", rounding_adds_a_twelfth, "black at 0, 1 and 3 deviations: K sigma"),
    ],
)  # fmt: skip
def test_a_formula_as_first_written_exceeds_its_bound(
    module: Any, name: str, naive: Callable, case: str, fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not fails(case)
    monkeypatch.setattr(module, name, naive)
    with np.errstate(all="ignore"):
        assert fails(case)


def test_read_noise_that_is_cut_at_black_shows_in_the_mean_of_many_pixels(
    fails: Fails, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut(u: Any, sigma: Any, lam: Any) -> Any:
        return np.maximum(sigma * special.ndtri(u), 0)

    monkeypatch.setattr(effects, "read_noise", cut)
    assert fails("black at 0, 1 and 3 deviations: mean")


def test_one_stream_for_two_effects_shows_in_the_read_noise(fails: Fails, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawn one after the other, as from a generator with a state, the read noise depends on the charge before it."""
    state: dict[str, np.random.Generator] = {}

    def uniforms(self: streams.Draws, shape: tuple[int, ...], stream: int) -> Any:
        if stream == streams.SHOT or "rng" not in state:
            state["rng"] = np.random.default_rng(0)
        return state["rng"].random(shape)

    monkeypatch.setattr(streams.Draws, "uniforms", uniforms)
    assert fails("more light")


@pytest.mark.parametrize("words", [0, streams.MASK])
def test_the_outermost_random_numbers_are_neither_zero_nor_one(words: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(streams, "philox", lambda c, key: tuple(np.full(c[0].shape, words, np.uint64) for _ in c))
    u = streams.Draws(seed=0).uniforms((2, 2), streams.READ)
    assert ((u > 0) & (u < 1)).all()
    assert (u == (2.0**-53 if words == 0 else 1 - 2.0**-53)).all()
    for lam in (-0.45, 0.0, 0.9):
        assert np.isfinite(effects.tukey_quantile(u, lam)).all()
