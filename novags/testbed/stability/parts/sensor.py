"""Hard cases of the camera: no light and far too much, clipping, rounding, tails, odd sizes, threads.

References: rational arithmetic for what has no noise, mpmath for quantiles and the bias of clipping, and for the
analytic moments the plain double sum over every charge and every code.
"""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from novags.testbed.stability.case import Part, Setting, refusal, worse
from sensor_model import effects
from sensor_model.capture import RawFrame, clean_response, expose
from sensor_model.isp import develop, develop_linear
from sensor_model.mosaicking import mosaic
from sensor_model.params import CFAS, DualGain, Exposure, Sensor
from sensor_model.presets import PRESETS

PART = Part("sensor")
BOTH = ("numpy", "numba")
EXPOSURE = Exposure(time=0.02)
CAMERA = Sensor(gain=2.0, eta=0.5, mu_e_sat=1800.0, black_level=64, bits=12, sigma_d=1.5, cfa=None)
SILENT = replace(CAMERA, eta=1.0, sigma_d=0.0, mu_e_sat=math.inf)
FLOAT32 = float(np.finfo(np.float32).eps)
DIFFER = "codes differ"


def frame(light: NDArray, camera: Sensor, setting: Setting, **how: object) -> RawFrame:
    """One frame in a setting."""
    known: dict = {"seed": 0, "view": 0, "threads": setting.threads, **how}
    return expose(light, camera, EXPOSURE, backend="numpy" if setting.backend == "numpy" else "numba", **known)


def _differ(a: NDArray, b: NDArray) -> float:
    return float(np.count_nonzero(np.asarray(a, np.int64) != np.asarray(b, np.int64)))


@PART.case("light of 0, -0, and less than the smallest number: a dark frame", bound=0, unit=DIFFER, backends=BOTH)
def _(setting: Setting) -> float:
    dark = frame(np.zeros((64, 64)), CAMERA, setting)
    worst = 0.0
    for level in (-0.0, 5e-324, 1e-310, 1e-30):
        shot = frame(np.full((64, 64), level), CAMERA, setting)
        moments = np.abs([shot.mean_dn - dark.mean_dn, shot.variance_dn - dark.variance_dn]).max()
        worst = worse(worst, _differ(shot.dn, dark.dn) + float(moments))  # NaN does not hold either
    return worst


@PART.case("light that is nan, infinite or negative: refused with its count", bound=0, unit="refused", backends=BOTH)
def _(setting: Setting) -> float:
    worst = 0.0
    for bad in (math.nan, math.inf, -math.inf, -1.0, -1e-12):
        light = np.full((30, 40), 5.0)
        light[7, 11] = light[20, 0] = bad
        told = ("photons must be finite and >= 0", "(7, 11)", "(2 of 1200 values)")
        worst = worse(worst, refusal(lambda light=light: frame(light, CAMERA, setting), *told))  # type: ignore[misc]
    return worst


@PART.case(
    "light of 1e6 to 1.7e308: every pixel full, no overflow", bound=2.5e-4, unit="DN of 3664", backends=BOTH
)  # float32 holds 3664 DN to 1.2e-4
def _(setting: Setting) -> float:
    worst = 0.0
    for level in (1e6, 1e15, 1e19, 1e38, 1.7e308):
        shot = frame(np.full((32, 32), level), CAMERA, setting)
        uneven = frame(np.full((32, 32), level), replace(CAMERA, eta=1.0, prnu=0.1), setting)
        error = float(np.abs(shot.mean_dn.astype(np.float64) - CAMERA.white_dn).max())
        astray = abs(float(shot.dn.mean()) - CAMERA.white_dn) > 5 * 3 / 32  # 3 DN of read noise, 32 x 32 pixels
        worst = worse(worst, error + astray + (~shot.saturated).sum() + (~uneven.saturated).sum())
    return worst


def _code(charge: Fraction, camera: Sensor) -> int:
    """The code of a charge without noise: Python's own rounding of fractions, which goes half to even."""
    held = charge if math.isinf(camera.mu_e_sat) else min(charge, Fraction(camera.mu_e_sat))
    signal, low = Fraction(camera.gain) * held + Fraction(camera.black_level) + Fraction(camera.rgb_bias[1]), 1
    if camera.dual_gain is not None and held > camera.dual_gain.threshold:
        low = int(camera.dual_gain.ratio)
    return min(max(round(signal / low) * low, 0), camera.max_dn)


@PART.case("codes below 0 and beyond 16 bits: clipped, then cast", bound=0, unit=DIFFER, backends=BOTH)
def _(setting: Setting) -> float:
    camera = replace(SILENT, bits=16, gain=500.0, black_level=0, rgb_bias=(-700.0,) * 3)
    light = np.array([[0.0, 1, 2, 3, 130, 132, 133, 141, 1e3, 1e5, 1e9]])
    codes = [[_code(Fraction(mean), camera) for mean in light[0]]]
    return _differ(frame(light, camera, setting, shot="none").dn, np.array(codes))


@PART.case("signals half way between two codes: to the even one", bound=0, unit=DIFFER, backends=BOTH)
def _(setting: Setting) -> float:
    light = np.arange(0, 900, 0.25)[None]
    plain = replace(SILENT, gain=0.5)
    # A code of the low gain is 6 DN wide: half of it is 3 DN, a charge of 12 apart.
    merged = replace(plain, dual_gain=DualGain(threshold=400, sigma_d=0, ratio=6))
    worst = 0.0
    for camera in (plain, merged):
        codes = np.array([[_code(Fraction(mean), camera) for mean in light[0]]])
        worst = worse(worst, _differ(frame(light, camera, setting, shot="none").dn, codes))
    return worst


def code_sum(camera: Sensor, mu: float) -> tuple[float, float]:
    """Mean and variance of the codes of mean charge `mu`, summed over all charges and all codes. DN, DN**2."""
    from scipy import special

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
    import mpmath

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


@PART.case("full pixels: charge clips, then the ADC, then white balance", bound=FLOAT32, unit="of white",
           backends=BOTH)  # fmt: skip
def _(setting: Setting) -> float:
    worst = 0.0
    for full in (1800.0, math.inf):
        camera = replace(SILENT, mu_e_sat=full, rgb_response=(1.4, 1.0, 0.7))
        light = np.stack([np.geomspace(0.1, 1e6, 64)] * 3, -1)[None] * camera.rgb_response
        span = Fraction(camera.white_dn) - Fraction(camera.black_level)
        balance = [max(camera.rgb_response) / response for response in camera.rgb_response]
        wanted = np.array([
            [float((_code(Fraction(light[0, i, c]), camera) - 64) / span) * balance[c] for c in range(3)]
            for i in range(64)
        ])  # fmt: skip
        shot = frame(light, camera, setting, shot="none")
        worst = worse(worst, float(np.abs(develop_linear(shot.dn, camera)[0] - wanted).max()) / max(balance))
        worst += float((develop(shot, camera).srgb8[0, -8:] != 255).sum())  # pink highlights
    return worst


LAMBDAS = (-0.45, -0.25, -1e-3, -1e-12, 0.0, 1e-12, 1e-3, 0.149, 0.9)


# The kernel's series of sinh(z)/z ends at z**16 and is used up to z = 2: the next term is 2**18 / 19!.
@PART.case("Tukey-lambda at u = 2**-53 and 1 - 2**-53, lambda 0 and 1e-12", bound=2.2e-12,
           unit="of 1 plus the quantile", backends=BOTH)  # fmt: skip
def _(setting: Setting) -> float:
    import mpmath

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
    from sensor_model.fast.blocks import scratch
    from sensor_model.fast.kernels import U, W, tukey

    b, _, _ = scratch()
    b[U : U + u.size] = u
    tukey(b, u.size, lam)
    return b[W : W + u.size].copy()


@PART.case("Tukey-lambda's standard deviation around lambda = 0", bound=1e-7, unit="relative", backends=("numpy",))
def _(setting: Setting) -> float:
    """Near 0 the closed form loses eps / lambda**2: 2e-8 at 1e-4, where its series takes over with lambda**2."""
    import mpmath

    worst = 0.0
    with mpmath.workdps(60):
        for lam in (*LAMBDAS[:4], 1e-12, 1.01e-4, -1.01e-4, 0.99e-4, *LAMBDAS[6:]):
            x = mpmath.mpf(lam)
            wanted = mpmath.sqrt(2 / x**2 * (1 / (1 + 2 * x) - mpmath.beta(x + 1, x + 1)))
            worst = worse(worst, float(abs(effects.tukey_sd(lam) / wanted - 1)))
    return worst


@PART.case("Poisson quantiles at means of 1e-9 to 1e6, out to u = 2**-40", bound=0, unit="counts differ", backends=BOTH)
def _(setting: Setting) -> float:
    import mpmath

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
    from sensor_model.fast.blocks import scratch
    from sensor_model.fast.kernels import MU, N, U
    from sensor_model.fast.poisson import poisson

    b, f, where = scratch()
    b[U : U + u.size], b[MU : MU + u.size] = u, mu
    poisson(b, f, u.size, where)
    return b[N : N + u.size].copy()


@PART.case("odd sizes and all four filter patterns: an even colour stays even", bound=2e-6, unit="of the colour",
           backends=BOTH)  # fmt: skip
def _(setting: Setting) -> float:
    """Blue is 12 DN over black, which float32 holds at 300 DN to 1.5e-5."""
    worst, colour = 0.0, np.array([30.0, 50.0, 20.0])
    for cfa in CFAS:
        camera = replace(PRESETS["imx900-hcg"], cfa=cfa, dark_current=0.0)
        for shape in ((2, 3), (3, 2), (5, 5), (31, 33)):
            light = mosaic(np.broadcast_to(colour * camera.rgb_response / camera.eta, (*shape, 3)), cfa)
            shot = frame(light, camera, setting)
            clean = develop_linear(shot.clean_dn, camera, demosaic="bilinear") * camera.capacity_e
            wanted = colour * max(camera.rgb_response)
            worst = worse(worst, float(np.abs(clean / wanted - 1).max()))
    return worst


@PART.case("the three noise-free channels of a mosaic from darkness to 1e12 photons: one of them is in the raw frame",
           bound=2.5e-4, unit="DN", backends=BOTH)  # fmt: skip
def _(setting: Setting) -> float:
    """The width of float32 at 4095 DN. The reference is exact: fractions, of the full well with its droop."""
    worst, rng = 0.0, np.random.default_rng(5)
    light = np.concatenate([np.zeros((2, 9, 3)), 10.0 ** rng.uniform(-9, 12, (9, 9, 3))])
    for cfa in CFAS:
        camera = replace(PRESETS["imx900-hcg"], cfa=cfa, nonlinearity=0.02)
        full, dark, gain = Fraction(camera.mu_e_sat), Fraction(camera.dark_e(EXPOSURE)), Fraction(camera.gain)
        held = [min(Fraction(camera.eta) * Fraction(mu) + dark, full) for mu in light.ravel()]
        exact = [Fraction(camera.black_level) + gain * (q - Fraction(0.02) * q * q / full) for q in held]
        wanted = np.array([float(dn) for dn in exact]).reshape(light.shape)
        three = clean_response(light, replace(camera, cfa=None), EXPOSURE)
        seen = frame(mosaic(light, cfa), camera, setting).clean_dn
        worst = worse(worst, float(np.abs(three - wanted).max()), float(np.abs(seen - mosaic(wanted, cfa)).max()))
    return worst


@PART.case("the same frame on 1, 2 and 7 threads", bound=0, unit=DIFFER, backends=("numba",))
def _(setting: Setting) -> float:
    camera = replace(PRESETS["imx900-hcg-3chip"], sigma_row=1.0, tukey_lambda=-0.1)
    light = np.geomspace(0.01, 1e5, 3 * 400 * 301).reshape(400, 301, 3)
    one = frame(light, camera, Setting("numba", 1)).dn
    return sum(_differ(frame(light, camera, Setting("numba", n)).dn, one) for n in (setting.threads, 2, 7))


@PART.case("fast and exact sampler: the same codes from 1e-6 to 1e6 electrons", bound=0, unit=DIFFER,
           backends=("numba",))  # fmt: skip
def _(setting: Setting) -> float:
    light = np.geomspace(1e-6, 1e6, 100_000).reshape(250, 400)
    worst = 0.0
    for camera in (CAMERA, replace(CAMERA, tukey_lambda=-0.1), replace(CAMERA, mu_e_sat=math.inf, bits=16, gain=0.05)):
        plain = frame(light, camera, Setting("numpy", 1))
        worst = worse(worst, _differ(frame(light, camera, setting).dn, plain.dn))
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
