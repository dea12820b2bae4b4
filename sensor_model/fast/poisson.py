"""Poisson quantiles, all exact; twin of `effects.shot_noise`.

Single precision finds the count; where its error could matter, the distribution function decides in double precision.
Importing this module imports numba.
"""
# numba infers types itself, and its decorators are untyped.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from functools import partial

import numpy as np

from sensor_model.fast.kernels import MU, C, N, P, U, W, X, exp16, jit, quantile
from sensor_model.fast.kernels32 import NORMAL_ERROR, TAIL, fast, normal32

SMALL_MEAN = 4.0  # below: count through the distribution function; above: invert its asymptotic series
SMALL_SLACK = np.float32(4e-6)  # bound on the error of the distribution function in float32, u rounded to it
_F = np.float32
_ZERO, _ONE, _TWO, _THREE, _SEVEN, _SIXTEEN = (_F(i) for i in (0, 1, 2, 3, 7, 16))
_SIXTH, _72TH, _810TH, _SLACK1, _SLACK2 = _F(1 / 6), _F(1 / 72), _F(1 / 810), _F(0.05), _F(0.004)
_ROUNDING, _NORMAL = _F(1e-6), _F(NORMAL_ERROR)


@jit
def poisson(b, f, n, where):
    """b[N:N + n] = quantiles of b[U:] for means b[MU:] >= 0."""
    large = 0
    for i in range(n):
        large += 1 if b[MU + i] >= SMALL_MEAN else 0
        f[MU + i] = _F(b[MU + i])
    if large > 0:
        normal32(b, f, n)
        _large(b, f, n, where)
    if large < n:
        _small(b, f, n, where)


@partial(jit, fastmath={"contract", "nnan", "ninf", "nsz", "reassoc"})
def _count_up(f, n):
    """Count k = 0, 1, 2, ... up the distribution function C, all pixels side by side; X: how near u came to it."""
    for k in range(1, 100):  # P(N >= 100) < 1e-98 at mean 4
        inverse = _F(1.0 / k)
        higher = _ZERO  # a float: a 64-bit integer would halve the pixels to a register
        for i in range(n):
            away = f[U + i] - f[C + i]
            up = away > _ZERO
            f[N + i] += _ONE if up else _ZERO
            higher += _ONE if up else _ZERO
            away = abs(away)
            f[X + i] = away if away < f[X + i] else f[X + i]
            f[P + i] *= f[MU + i] * inverse
            f[C + i] += f[P + i]
        if higher == _ZERO:
            break


@jit
def _small(b, f, n, where):
    for i in range(n):
        small = b[MU + i] < SMALL_MEAN
        f[U + i] = _F(b[U + i])
        p = exp16(-b[MU + i]) if small else 0.0
        f[P + i] = _F(p)
        f[C + i] = _F(p if small else 2.0)  # 2 is above any u: larger means do not change
        f[N + i] = _ZERO
        f[X + i] = _ONE
    _count_up(f, n)
    near = 0
    for i in range(n):
        b[N + i] = np.float64(f[N + i]) if b[MU + i] < SMALL_MEAN else b[N + i]
        near += 1 if f[X + i] < SMALL_SLACK else 0
    if near == 0:
        return
    for i in range(n):
        if f[X + i] < SMALL_SLACK:
            b[N + i] = _counted(b[U + i], b[MU + i])


@jit
def _counted(u, mu):
    """The same count for one pixel, in double precision."""
    p = exp16(-mu)
    cdf, k = p, 0.0
    while u > cdf and k < 100.0:
        k += 1.0
        p *= mu * (1.0 / k)
        cdf += p
    return k


@fast
def _series(f, n):
    """N = quantile less mean, of f[MU:] and the normal quantiles f[W:]; C = by how much it may be wrong.

    Source: Giles, "Algorithm 955", ACM TOMS 42 (2016), the series to order 1/mu; the first slack is a bound on the rest
    of it, found by comparison with the incomplete gamma function.
    """
    for i in range(n):
        w = f[W + i]
        s = w * w
        size = abs(w)
        root = np.sqrt(f[MU + i])
        root = root if root > _TWO else _TWO
        r = _ONE / root
        third = w * (_TWO + s) * r * _72TH
        fourth = (s * (_SEVEN + _THREE * s) - _SIXTEEN) * r * r * _810TH
        f[N + i] = root * w + (_TWO + s) * _SIXTH - third + fourth
        slack = (_SLACK1 + s * s * size * _SLACK2) * r * r * r
        slack += _ROUNDING * (root * size + _TWO + s + abs(third) + abs(fourth)) + _NORMAL * (_ONE + size) * (
            root + _TWO + size
        )
        # In the far lower tail, where the quantile nears 0, the series fails; far out, the normal quantile
        reach = root if root > _THREE else _THREE
        f[C + i] = _ONE if (w + reach < _ZERO) | (f[P + i] < _F(TAIL)) else slack


@jit
def _large(b, f, n, where):
    """Round down the asymptotic quantile; where its error could matter, decide by the distribution function."""
    _series(f, n)
    near = 0
    for i in range(n):
        mu = b[MU + i]
        x = mu + np.float64(f[N + i])
        k = np.floor(x)
        b[N + i] = k
        # 2e-15: rounding of x, which could cross a whole number unseen
        b[C + i] = min(x - k, k + 1.0 - x) - np.float64(f[C + i]) - 2e-15 * mu
        near += 1 if b[C + i] < 0.0 else 0
    if near == 0:
        return
    count = 0
    for i in range(n):
        where[count] = i
        count += 1 if b[C + i] < 0.0 else 0
    for j in range(count):
        if b[MU + where[j]] >= SMALL_MEAN:
            b[N + where[j]] = _rounded(b[U + where[j]], b[MU + where[j]])


@jit
def _rounded(u, mu):
    """The same for one pixel, in double precision."""
    w = quantile(u)
    s, size, root = w * w, abs(w), math.sqrt(mu)
    third = w * (2.0 + s) / root / 72.0
    fourth = (s * (7.0 + 3.0 * s) - 16.0) / mu / 810.0
    x = mu + root * w + (2.0 + s) / 6.0 - third + fourth
    k = math.floor(x)
    slack = (0.05 + s * s * size * 0.004) / (mu * root) + 2e-15 * (mu + root * size)
    if w + max(3.0, root) > 0.0 and min(x - k, k + 1.0 - x) > slack:
        return k
    return _decided(u, mu, k)


@jit
def _decided(u, mu, guess):
    """The smallest k with P(N <= k) >= u, walking from a guess near it; the smaller of the two tails is summed."""
    k = max(guess, 0.0)
    p = _pmf(k, mu)
    if u < 0.5:
        cdf, term, j = p, p, k  # P(N <= k)
        while j > 0.0 and term > 1e-17 * cdf:
            term *= j / mu
            cdf += term
            j -= 1.0
        while cdf < u:
            k += 1.0
            p *= mu / k
            cdf += p
        while k > 0.0 and cdf - p >= u:
            cdf -= p
            p *= k / mu
            k -= 1.0
        return k
    v = 1.0 - u
    j = k + 1.0
    term = p * mu / j
    above = term  # P(N > k)
    while term > 1e-17 * above:
        j += 1.0
        term *= mu / j
        above += term
    while above > v:
        k += 1.0
        p *= mu / k
        above -= p
    while k > 0.0 and above + p <= v:
        above += p
        p *= k / mu
        k -= 1.0
    return k


@jit
def _pmf(k, mu):
    """P(N = k) by Loader's saddle point form: no large terms that cancel. Loader, "Fast and accurate ..." (2000)."""
    if k == 0.0:
        return math.exp(-mu)
    if k < 16.0:
        stirling = math.lgamma(k + 1.0) - (k + 0.5) * math.log(k) + k - 0.9189385332046727
    else:
        s = 1.0 / (k * k)
        stirling = (1 / 12 - s * (1 / 360 - s * (1 / 1260 - s * (1 / 1680)))) / k
    d = (mu - k) / k
    deviance = k * (d - math.log1p(d))
    return math.exp(-stirling - deviance) / math.sqrt(2.0 * math.pi * k)
