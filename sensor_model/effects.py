"""One pure sampler per physical effect, in the order of the signal chain.

Every random effect is one uniform number per pixel (or per row) put through the inverse of its distribution function,
so each sampler takes `u` in (0, 1) and has no state. Closed forms of the same effects: `moments.py`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]


def standard_normal(u: Array) -> Array:
    """Standard normal numbers, by inversion."""
    return special.ndtri(u)


def collect(photons: Array, *, eta: float, response: Array | float, dark_e: Array | float) -> Array:
    """Mean charge of each pixel: light through the quantum efficiency, plus dark signal.

    Args:
        photons: Mean photons per pixel behind the filter.
        eta: Quantum efficiency.
        response: Relative response of each pixel (PRNU), 1 on average.
        dark_e: Mean dark charge of the exposure, e-.

    Returns:
        mu_e, e-. Source: EMVA 1288 linear model, mu_e = eta mu_p + mu_d.
    """
    return eta * photons * response + dark_e


def pixel_response(u: Array, prnu: float) -> Array:
    """Relative response of each pixel: normal around 1 with standard deviation `prnu`, never negative."""
    return np.maximum(1 + prnu * standard_normal(u), 0)


def shot_noise(u: Array, mu_e: Array) -> Array:
    """Whole electrons of one exposure: the Poisson quantile of `u`, exact at every level.

    Args:
        u: Uniform numbers in (0, 1).
        mu_e: Mean charge, finite and >= 0, e-.

    Returns:
        The smallest n with P(N <= n) >= u, as float64, e-.
    """
    shape, u, mu_e = np.shape(mu_e), np.ravel(u), np.ravel(mu_e)
    n = np.maximum(np.floor(poisson_guess(standard_normal(u), mu_e)), 0)
    # The guess is off by one at most now and then: walk each pixel to the n that brackets its u.
    todo = np.arange(n.size)
    while todo.size:
        too_low = special.pdtr(n[todo], mu_e[todo]) < u[todo]
        # pdtr is undefined at n = -1, where the distribution function is 0
        too_high = (n[todo] > 0) & (special.pdtr(np.maximum(n[todo] - 1, 0), mu_e[todo]) >= u[todo])
        n[todo] += too_low.astype(float) - too_high
        todo = todo[too_low | too_high]
    return n.reshape(shape)


def poisson_guess(w: Array, mu_e: Array) -> Array:
    """Continuous Poisson quantile for the normal quantile `w`; its floor is the quantile, or one off.

    Source: the Cornish-Fisher terms of Giles, "Algorithm 955: approximation of the inverse Poisson cumulative
    distribution function", ACM TOMS 42 (2016), eq. 8.
    """
    root = np.sqrt(mu_e)
    with np.errstate(divide="ignore", invalid="ignore"):
        third = np.where(mu_e > 1, (-w / 36 - w**3 / 72) / root, 0.0)
    return mu_e + root * w + (1 / 3 + w * w / 6) + third


def normal_shot_noise(u: Array, mu_e: Array) -> Array:
    """The approximation of large signals: normal with variance `mu_e`, neither whole nor bounded below. e-."""
    return mu_e + np.sqrt(mu_e) * standard_normal(u)


def full_well(charge: Array, mu_e_sat: float) -> Array:
    """Charge that a pixel can hold, e-."""
    return np.minimum(charge, mu_e_sat)


def tukey_sd(lam: float) -> float:
    """Standard deviation of Tukey's lambda distribution of scale 1: published "scales" times this are sigmas."""
    if abs(lam) < 1e-4:  # 2/lam**2 * (difference that vanishes) cancels; the logistic limit is within 1e-4
        return float(np.pi / np.sqrt(3))
    return float(np.sqrt(2 / lam**2 * (1 / (1 + 2 * lam) - special.beta(lam + 1, lam + 1))))


def read_noise(u: Array, sigma_d: float, tukey_lambda: float | None) -> Array:
    """Read noise of standard deviation `sigma_d`: normal, or Tukey-lambda with its heavier tails. e-."""
    if tukey_lambda is None:
        return sigma_d * standard_normal(u)
    # boxcox(u, lam) = (u**lam - 1) / lam, the logarithm at 0: no cancellation for small lambda
    quantile = special.boxcox(u, tukey_lambda) - special.boxcox1p(-u, tukey_lambda)
    return sigma_d / tukey_sd(tukey_lambda) * quantile


def digitise(signal_dn: Array, max_dn: int) -> NDArray[np.uint16]:
    """Analogue signal including black level -> codes: round half to even, clip, and only then cast. DN."""
    return np.clip(np.rint(signal_dn), 0, max_dn).astype(np.uint16)
