"""Elementary functions of vectors. Minimax polynomials, fitted for relative error; no tables, no special cases."""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline
from .simd import exponent, floor, maximum, minimum, select, shift_exponent

_HALF, _ONE, _SQRT2 = np.float32(0.5), np.float32(1.0), np.float32(np.sqrt(2.0))
_LOG2E = np.float32(np.log2(np.e))

# 2^(x/8) on [-8, 0], relative error 7e-8
_A0, _A1, _A2 = np.float32(0.9999999250672567), np.float32(0.08664278158071038), np.float32(0.003752690460096807)
_A3, _A4, _A5 = (
    np.float32(0.00010796820868748897),
    np.float32(2.2433134359915706e-06),
    np.float32(2.864954588746977e-08),
)

# 2^x on [-1/2, 1/2], relative error 2e-9
_B0, _B1, _B2, _B3 = (
    np.float32(1.0),
    np.float32(0.693147205737455),
    np.float32(0.240226468906063),
    np.float32(0.05550328777),
)
_B4, _B5, _B6 = np.float32(0.009618488958638195), np.float32(0.001339993138570495), np.float32(0.00015345811986301327)

# log2((1 + t) / (1 - t)) / t, a polynomial in t^2 for |t| <= 3 - 2 sqrt(2), relative error 7e-10
_C0, _C1, _C2, _C3 = (
    np.float32(2.885390079915),
    np.float32(0.961798813213),
    np.float32(0.576716725),
    np.float32(0.431690408),
)


@inline
def exp2_alpha(x):
    """2^x on [-8, 0], where every alpha that counts lies: relative error 3e-6. Large far outside, but never nan."""
    p = _A0 + x * (_A1 + x * (_A2 + x * (_A3 + x * (_A4 + x * _A5))))
    p = p * p
    p = p * p
    return p * p


@inline
def exp(x):
    """e^x for |x| < 87 (limited beyond): relative error 1e-6 at |x| = 10, growing with |x| like the rounding of x."""
    y = minimum(maximum(x * _LOG2E, np.float32(-126.0)), np.float32(126.0))
    n = floor(y + _HALF)
    f = y - n
    p = _B0 + f * (_B1 + f * (_B2 + f * (_B3 + f * (_B4 + f * (_B5 + f * _B6)))))
    return shift_exponent(p, n)


@inline
def log2(x):
    """log2 of normal positive numbers: absolute error 1e-7 near 1, else one float32 rounding."""
    e = exponent(x)
    m = shift_exponent(x, -e)
    high = m > _SQRT2
    m = select(high, m * _HALF, m)
    e = select(high, e + _ONE, e)
    t = (m - _ONE) / (m + _ONE)
    tt = t * t
    return e + t * (_C0 + tt * (_C1 + tt * (_C2 + tt * _C3)))
