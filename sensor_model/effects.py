"""One pure sampler per physical effect, in the order of the signal chain.

Every random effect is one uniform number per pixel (or row, or column) put through the inverse of its distribution
function: samplers take `u` in (0, 1) and keep no state. Closed forms of the same effects: `moments.py`; the fast twins
of the four that touch every pixel: `fast`. Light is in photons, charge and signal in electrons, [h, w, channels].
"""

from __future__ import annotations

import math

import numpy as np
import scipy  # its modules are loaded where they are used: `novags list` needs none
from numpy.typing import NDArray

from sensor_model.params import Banding, DualGain

Array = NDArray[np.float64]
APERY = 1.2020569031595942  # zeta(3)


def standard_normal(u: Array) -> Array:
    """Standard normal quantiles."""
    return scipy.special.ndtri(u)


def relative_illumination(
    shape: tuple[int, int],
    *,
    origin: tuple[int, int] = (0, 0),
    sensor_shape: tuple[int, int] | None = None,
    corner_angle: float = 0.0,
    falloff: tuple[float, ...] | None = None,
) -> Array:
    """Vignetting: the factor on the light of each pixel of an [h, w] frame, 1 in the middle of the sensor.

    Source: the cos**4 law of a thin lens, tan(theta) growing linearly from the centre to `corner_angle` (degrees) in
    the corners; or a measured table, interpolated linearly over that radius.
    """
    full = sensor_shape or (origin[0] + shape[0], origin[1] + shape[1])
    y = (np.arange(shape[0]) + origin[0] + 0.5 - full[0] / 2)[:, None]
    x = (np.arange(shape[1]) + origin[1] + 0.5 - full[1] / 2)[None, :]
    radius = np.hypot(y, x) / np.hypot(full[0] / 2, full[1] / 2)
    if falloff is not None:
        return np.interp(radius, np.linspace(0, 1, len(falloff)), falloff)
    return (1 + (radius * np.tan(np.radians(corner_angle))) ** 2) ** -2.0  # cos**2 = 1 / (1 + tan**2)


def crosstalk(light: NDArray, share: float) -> NDArray:
    """Each of the four neighbours receives `share` of a pixel's charge. The sum is kept; borders reflect.

    Optical crosstalk acts on the mean light: photons that scatter at random stay Poisson distributed and independent.
    Electrical crosstalk (capacitive coupling) acts on the collected charge, so it blurs the shot noise too.
    """
    moved = share * light
    out = light - 4 * moved
    for axis in (0, 1):
        here, there = out.swapaxes(0, axis), moved.swapaxes(0, axis)
        here[1:] += there[:-1]
        here[:-1] += there[1:]
        here[0] += there[0]
        here[-1] += there[-1]
    return out


def point_spread(light: NDArray, psf: tuple[tuple[float, ...], ...]) -> NDArray:
    """Crosstalk with any shares: psf[middle + dy][middle + dx] of the light goes dy rows down, dx to the right."""
    from scipy import ndimage  # for cameras that have such a table only

    return ndimage.convolve(light, np.asarray(psf)[..., None], mode="reflect").astype(light.dtype)


def pixel_response(normal: NDArray, prnu: float) -> NDArray:
    """Relative response of each pixel: normal around 1 with standard deviation `prnu`, never negative."""
    return np.maximum(1 + prnu * normal, 0)


def collect(photons: Array, *, eta: float, response: NDArray | float, dark_e: NDArray | float) -> Array:
    """Mean charge: light through the quantum efficiency of each pixel, plus dark signal.

    Source: EMVA 1288 linear model, mu_e = eta mu_p + mu_d. e-.
    """
    return eta * photons * response + dark_e


def shot_noise(u: Array, mu_e: Array) -> Array:
    """Whole electrons of one exposure: the Poisson quantile of `u`, exact at every level.

    Args:
        u: Uniform numbers in (0, 1).
        mu_e: Mean charge, finite and >= 0, e-.

    Returns:
        The smallest n with P(N <= n) >= u, as float64, e-.
    """
    shape, u, mu_e = np.shape(mu_e), np.ravel(u), np.ravel(mu_e)
    w, root = standard_normal(u), np.sqrt(mu_e)
    # Giles, "Algorithm 955", ACM TOMS 42 (2016): close to the quantile, the closer the larger mu; not below mu = 1
    m = np.maximum(mu_e, 1)
    series = -w * (2 + w * w) / (72 * np.sqrt(m)) + (w * w * (7 + 3 * w * w) - 16) / (810 * m)
    n = np.maximum(np.floor(mu_e + root * w + (2 + w * w) / 6 + series), 0)
    # From there each pixel walks to the n that brackets its u. Far out in large means the series is better than
    # scipy's distribution function, whose continued fraction stops too early.
    todo = np.flatnonzero((mu_e < 1e4) | (np.abs(w) < 4.4))
    while todo.size:
        too_low = scipy.special.pdtr(n[todo], mu_e[todo]) < u[todo]
        # pdtr is undefined at n = -1, where the distribution function is 0
        too_high = (n[todo] > 0) & (scipy.special.pdtr(np.maximum(n[todo] - 1, 0), mu_e[todo]) >= u[todo])
        n[todo] += too_low.astype(float) - too_high
        todo = todo[too_low | too_high]
    return n.reshape(shape)


def normal_shot_noise(u: Array, mu_e: Array) -> Array:
    """The approximation for large signals: normal with variance `mu_e`; not whole, not bounded below. e-."""
    return mu_e + np.sqrt(mu_e) * standard_normal(u)


def blooming(charge: Array, mu_e_sat: float) -> Array:
    """Charge over full well spills up and down its column until it finds room or leaves the sensor. e-.

    One half of each excess moves down, the other up; a pixel passes on charge that it cannot hold. Charge is conserved
    except over the first and the last row.
    """
    held = np.minimum(charge, mu_e_sat)
    if not (charge > mu_e_sat).any():
        return held
    half = 0.5 * (charge - held)
    for order in (range(charge.shape[0]), range(charge.shape[0] - 1, -1, -1)):
        moving = np.zeros_like(charge[0])
        for row in order:
            room = np.minimum(mu_e_sat - held[row], moving)
            held[row] += room
            moving += half[row] - room
    return held


def full_well(charge: Array, mu_e_sat: float) -> Array:
    """Charge that a pixel can hold, e-."""
    return np.minimum(charge, mu_e_sat)


def nonlinear(charge: Array, droop: float) -> Array:
    """Signal of a pixel whose response falls with its charge: q - droop q**2, e-."""
    return charge - droop * charge * charge


def _beta(a: float, b: float) -> float:
    return math.gamma(a) * math.gamma(b) / math.gamma(a + b)


def tukey_sd(lam: float) -> float:
    """Standard deviation of Tukey's lambda distribution of scale 1: published "scales" times this are sigmas."""
    if abs(lam) < 1e-4:  # the bracket below vanishes as lam**2 and loses its digits: the logistic limit and its slope
        return float(np.pi / np.sqrt(3) * (1 - lam * (1 + 6 * APERY / np.pi**2)))
    return float(np.sqrt(2 / lam**2 * (1 / (1 + 2 * lam) - _beta(lam + 1, lam + 1))))


def excess_kurtosis(lam: float) -> float:
    """Excess kurtosis of Tukey's lambda distribution; infinite from -1/4 down."""
    if lam <= -0.25:
        return float("inf")
    if abs(lam) < 1e-3:  # the bracket below vanishes as lam**4: the logistic limit, to 0.02
        return 1.2
    even, odd = _beta(2 * lam + 1, 2 * lam + 1), _beta(3 * lam + 1, lam + 1)
    fourth = 2 / lam**4 * (1 / (1 + 4 * lam) - 4 * odd + 3 * even)
    return float(fourth / tukey_sd(lam) ** 4 - 3)


def tukey_quantile(u: Array, lam: float) -> Array:
    """(u**lam - (1 - u)**lam)/lam, the logistic quantile log(u/(1 - u)) at lam = 0."""
    # boxcox(u, lam) is (u**lam - 1)/lam without cancellation
    return scipy.special.boxcox(u, lam) - scipy.special.boxcox1p(-u, lam)


def read_noise(u: Array, sigma_d: Array | float, tukey_lambda: float | None) -> Array:
    """Read noise of standard deviation `sigma_d`: normal, or Tukey-lambda with its heavier tails. e-."""
    if tukey_lambda is None:
        return sigma_d * standard_normal(u)
    return sigma_d / tukey_sd(tukey_lambda) * tukey_quantile(u, tukey_lambda)


def select_gain(charge: Array, sigma_d: float, dual_gain: DualGain | None) -> tuple[Array | float, Array | float]:
    """Read noise (e-) and code width (DN) of each pixel, by the gain at which it is read."""
    if dual_gain is None:
        return sigma_d, 1.0
    low = charge > dual_gain.threshold
    return np.where(low, dual_gain.sigma_d, sigma_d), np.where(low, dual_gain.ratio, 1.0)


def telegraph(u: Array, level: Array | float, traps: int = 1) -> Array:
    """Random telegraph signal after double sampling, e-; variance traps * level**2/2.

    One trap gives -level, 0 or +level with odds 1:2:1. Several add up: level * (binomial(2 traps, 1/2) - traps).
    """
    odds = scipy.special.bdtr(np.arange(2 * traps), 2 * traps, 0.5)
    return level * (np.searchsorted(odds, u).astype(np.float64) - traps)


def telegraph_level(sigma_d: float, factor: float, traps: int = 1) -> float:
    """The level that raises the standard deviation of a pixel from sigma_d to factor * sigma_d, e-."""
    return sigma_d * float(np.sqrt(2 * (factor**2 - 1) / traps))


def bands(u: Array, rows: NDArray, banding: Banding) -> Array:
    """Periodic row pattern of one frame; `u` sets its phase. e-, one value per row and phase."""
    return banding.amplitude * np.sin(2 * np.pi * (rows / banding.period + u))


def digitise(signal_dn: Array, max_dn: int, code_width: Array | float = 1.0) -> NDArray[np.uint16]:
    """Signal over black level, plus black level -> codes: round half to even, clip, and only then cast. DN."""
    return np.clip(np.rint(np.rint(signal_dn * (1 / code_width)) * code_width), 0, max_dn).astype(np.uint16)
