"""Analytic mean and variance of the chain in `capture.py`: what its samples are tested against.

Everything here is temporal: for one pixel of one camera, over frames of the same light.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import special

Array = NDArray[np.float64]


def charge_moments(mu_e: Array, mu_e_sat: float) -> tuple[Array, Array]:
    """Mean and variance of min(N, mu_e_sat), N Poisson with mean `mu_e`. e-, e-**2.

    Uses sum_{n <= k} n p(n) = mu P(k - 1) and sum_{n <= k} n (n - 1) p(n) = mu**2 P(k - 2), P(n) the probability of
    at most n.
    """
    mu = np.asarray(mu_e, np.float64)
    mean, variance = mu.copy(), mu.copy()
    # Below full well by 9 sigma the clipped share is under 1e-18
    near = mu + 9 * np.sqrt(mu) + 20 > mu_e_sat
    if near.any():
        mean[near], variance[near] = _clipped_poisson(mu[near], mu_e_sat)
    return mean, variance


def _clipped_poisson(mu: Array, top: float) -> tuple[Array, Array]:
    k = np.floor(top)

    def cdf(n: float) -> Array:
        return special.pdtr(n, mu) if n >= 0 else np.zeros_like(mu)

    # Moments of the shortfall top - N. Terms of order top**2 cancel: the variance is good to 1e-15 top**2.
    p0, p1, p2 = cdf(k), cdf(k - 1), cdf(k - 2)
    first = top * p0 - mu * p1
    second = top**2 * p0 - (2 * top - 1) * mu * p1 + mu**2 * p2
    return top - first, np.maximum(second - first**2, 0)


def adc_moments(mean_dn: Array, variance_dn: Array, max_dn: int) -> tuple[Array, Array]:
    """Mean and variance after rounding and clipping a normal signal to [0, max_dn]. DN, DN**2.

    Clipping: the censored normal distribution. Rounding: the Euler-Maclaurin end terms of
    E[Z] = sum_{j=1}^{max} P(y > j - 1/2), accurate while the noise is 0.5 DN or more.
    """
    mean, variance = np.array(mean_dn, np.float64), np.array(variance_dn, np.float64)
    sd = np.sqrt(variance)
    near = (mean < 8 * sd + 1) | (mean > max_dn - 8 * sd - 1)
    quiet = sd == 0
    out_mean = np.where(quiet, np.clip(np.rint(mean), 0, max_dn), mean)
    out_variance = np.where(quiet, 0.0, variance + 1 / 12)
    near &= ~quiet
    if near.any():
        out_mean[near], out_variance[near] = _censored_normal(mean[near], sd[near], float(max_dn))
    return out_mean, out_variance


def _censored_normal(m: Array, s: Array, top: float) -> tuple[Array, Array]:
    a, b = -m / s, (top - m) / s
    pdf_a, pdf_b = (np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) for z in (a, b))
    below, above = special.ndtr(a), special.ndtr(-b)  # P(y < 0), P(y > top)
    lift = s * (pdf_a + a * below)  # E[(0 - y)+]
    cut = s * (pdf_b - b * above)  # E[(y - top)+]
    lift2 = s * s * ((1 + a * a) * below + a * pdf_a)
    cut2 = s * s * ((1 + b * b) * above - b * pdf_b)
    shift = lift - cut
    # With e = y - m, L and U the two excesses: E[(e + L - U)**2], where eL = (0-m)L - L**2 and eU = U**2 + (top-m)U
    second = s * s - lift2 - 2 * m * lift - cut2 - 2 * (top - m) * cut
    rounding_mean = (pdf_b - pdf_a) / (24 * s)
    # the same end terms for E[(Z - m)**2] = sum of 2 (j - 1/2 - m) P(y > j - 1/2) ...
    rounding_second = ((1 - below) - above) / 12 + ((top - m) * pdf_b + m * pdf_a) / (12 * s)
    shift = shift + rounding_mean
    variance = second + rounding_second - shift**2
    return np.clip(m + shift, 0, top), np.maximum(variance, 0)
