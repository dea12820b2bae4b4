"""Single-precision twins of the kernels, twice as many pixels to a SIMD register; each states how far it may be off.

Code that rounds their result checks whether it lies so near to a step that the error could matter, and if so calls the
double-precision kernel. So frames equal float64 frames bit for bit, at nearly the speed of float32. `f` is a float32
scratch array with the offsets of `b`. Importing this module imports numba.
"""
# numba infers types itself, and its decorators are untyped.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np

from sensor_model.fast.kernels import P, U, W, X, inline, jit, polynomial

TAIL = 1e-7  # smallest tail probability of the quantiles here
NORMAL_ERROR = 1e-6  # of `normal32` down to TAIL (5.2 standard deviations), over 1 + |quantile|
_F = np.float32
_ONE, _HALF, _FOUR, _LN2, _ROOT2, _ROOT8 = _F(1), _F(0.5), _F(4), _F(np.log(2)), _F(np.sqrt(2)), _F(np.sqrt(8))
_EDGE, _SHIFT, _THREE = _F(5), _F(2.5), _F(3)
# Of a float32's bits: exponent unit and its inverse, bias, and the offset that makes the fraction lie in
# sqrt(1/2)..sqrt(2)
_EXPONENT, _STEP, _BIAS, _CUT = _F(2**23), _F(2**-23), _F(127), _F(127 - 0.0858)
_WHOLE = _F(1.5 * 2**23)  # adding and subtracting it rounds to the nearest whole
# Moshier's Cephes, logf: log(1 + x) = x - x**2/2 + x**3 p(x)
_LOG = tuple(map(_F, (7.0376836292e-2, -1.1514610310e-1, 1.1676998740e-1, -1.2420140846e-1, 1.4249322787e-1,
                      -1.6668057665e-1, 2.0000714765e-1, -2.4999993993e-1, 3.3333331174e-1)))  # fmt: skip
# Giles, "Approximating the erfinv function", GPU Computing Gems (2010): erfinv(x) / x, by w = -log(1 - x**2)
_MIDDLE = tuple(map(_F, (2.81022636e-08, 3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087,
                         -0.00125372503, -0.00417768164, 0.246640727, 1.50140941)))  # fmt: skip
_OUTER = tuple(map(_F, (-0.000200214257, 0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773,
                        -0.0076224613, 0.00943887047, 1.00167406, 2.83297682)))  # fmt: skip


def fast(function):
    """Fused multiply-adds, where the machine has them: the bound here is on the error, not on the last bit."""
    return jit(function, fastmath={"contract", "nnan", "ninf", "nsz"})


@inline
def log32(x):
    """Natural logarithm of a normal positive float32, to 2e-7 of the larger of itself and 1."""
    # numba computes integers in 64 bits, which halves the pixels to a register: so exponents stay floats
    e = (_F(_F(x).view(np.int32)) * _STEP - _CUT + _WHOLE) - _WHOLE
    m = x * np.int32((_BIAS - e) * _EXPONENT).view(_F)
    x = m - _ONE
    return ((polynomial(x, _LOG) * x - _HALF) * x * x + x) + e * _LN2


@fast
def normal32(b, f, n):
    """f[W:W + n] = standard normal quantiles of b[U:]; returns whether all lie within TAIL, where the bound holds."""
    outside = 0
    for i in range(n):
        u = b[U + i]
        f[P + i] = _F(min(u, 1.0 - u))
        outside += 1 if abs(u - 0.5) > 0.5 - TAIL else 0
        f[X + i] = _F(u - 0.5)
    for i in range(n):
        t = f[P + i]
        w = -log32(_FOUR * t * (_ONE - t))
        middle = polynomial(w - _SHIFT, _MIDDLE)
        outer = polynomial(np.sqrt(max(w, _EDGE)) - _THREE, _OUTER)
        f[W + i] = (middle if w < _EDGE else outer) * f[X + i] * _ROOT8
    return outside == 0
