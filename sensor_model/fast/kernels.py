"""Vectorised numba twins of the samplers in `effects.py`: uniform, normal, Tukey-lambda. Poisson: poisson.py.

Everything works on CHUNK pixels at a time, in loops without branches or calls, which LLVM turns into SIMD code. All
operands live in one float64 scratch array `b` (it stays in the first-level cache), each at a fixed offset: U, W, MU ...
Distances known at compile time let LLVM vectorise without testing every pair of arrays for overlap. Only + - * / and
sqrt in float64 are used on the common path and nothing is re-associated, so results do not depend on the machine, the
vector width or the place in a chunk. Importing this module imports numba: do so inside functions only.
"""
# numba infers types itself, and its decorators are untyped.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, untyped-decorator"

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sensor_model.fast.machine_code import compiled, folder_for
from sensor_model.frame import streams

CHUNK = 512  # pixels at a time; even, because one Philox block serves two neighbours
U, W, MU, N, P, C, X = (CHUNK * i for i in range(7))  # uniform, its quantile, mean, count; P, C, X: scratch
SCRATCH = 7 * CHUNK
_M0, _M1 = np.uint64(streams.MULTIPLIERS[0]), np.uint64(streams.MULTIPLIERS[1])
_W0, _W1 = np.uint64(streams.WEYL[0]), np.uint64(streams.WEYL[1])
_MASK, _S16, _S32 = np.uint64(streams.MASK), np.uint64(16), np.uint64(32)
_S20, _S12, _TWO = np.uint64(20), np.uint64(12), np.uint64(2)
_ROUNDS = streams.ROUNDS
_LN2 = math.log(2)
_ATANH = tuple(1 / k for k in range(19, 1, -2))  # atanh(s) / s - 1 by s**2, over s**2
_EXP = tuple(1 / math.factorial(k) for k in range(11, -1, -1))
_SINH = tuple(1 / math.factorial(k) for k in range(17, 0, -2))  # sinh(z) / z by z**2
# Wichura, algorithm AS 241, Applied Statistics 37 (1988): PPND16, numerators and denominators
_CENTRAL_A = (2.5090809287301226727e3, 3.3430575583588128105e4, 6.7265770927008700853e4,
              4.5921953931549871457e4, 1.3731693765509461125e4, 1.9715909503065514427e3,
              1.3314166789178437745e2, 3.3871328727963666080)  # fmt: skip
_CENTRAL_B = (5.2264952788528545610e3, 2.8729085735721942674e4, 3.9307895800092710610e4,
              2.1213794301586595867e4, 5.3941960214247511077e3, 6.8718700749205790830e2,
              4.2313330701600911252e1, 1.0)  # fmt: skip
_TAIL_A = (7.74545014278341407640e-4, 2.27238449892691845833e-2, 2.41780725177450611770e-1,
           1.27045825245236838258, 3.64784832476320460504, 5.76949722146069140550,
           4.63033784615654529590, 1.42343711074968357734)  # fmt: skip
_TAIL_B = (1.05075007164441684324e-9, 5.47593808499534494600e-4, 1.51986665636164571966e-2,
           1.48103976427480074590e-1, 6.89767334985100004550e-1, 1.67638483018380384940,
           2.05319162663775882187, 1.0)  # fmt: skip
_FAR_A = (2.01033439929228813265e-7, 2.71155556874348757815e-5, 1.24266094738807843860e-3,
          2.65321895265761230930e-2, 2.96560571828504891230e-1, 1.78482653991729133580,
          5.46378491116411436990, 6.65790464350110377720)  # fmt: skip
_FAR_B = (2.04426310338993978564e-15, 1.42151175831644588870e-7, 1.84631831751005468180e-5,
          7.86869131145613259100e-4, 1.48753612908506148525e-2, 1.36929880922735805310e-1,
          5.99832206555887937690e-1, 1.0)  # fmt: skip

_HERE = Path(__file__).parent


def cache_folder() -> Path | None:
    """Where the machine code of these kernels is kept, see `folder_for`."""
    return folder_for([*sorted(_HERE.glob("*.py")), _HERE.parent / "frame" / "streams.py"])


CACHE = cache_folder()


def jit(function: Callable, **options: Any) -> Callable:
    """Compile to machine code, once for all processes."""
    # error model "python" would test every division, and so block SIMD
    return compiled(function, CACHE, nogil=True, error_model="numpy", **options)


def inline(function: Callable) -> Callable:
    """Put the function's body wherever it is called."""
    return jit(function, inline="always")


@inline
def philox(c0, c1, c2, c3, k0, k1):
    """Twin of `streams.philox` for one counter."""
    for _ in range(_ROUNDS):
        # Cut to 32 bits at the product only, where the SIMD multiplication does so by itself
        p0 = (c0 & _MASK) * _M0
        p1 = (c2 & _MASK) * _M1
        c0, c1, c2, c3 = (p1 >> _S32) ^ c1 ^ k0, p1, (p0 >> _S32) ^ c3 ^ k1, p0
        k0, k1 = k0 + _W0, k1 + _W1
    return c0 & _MASK, c1 & _MASK, c2 & _MASK, c3 & _MASK


@jit
def uniform(b, n, row, col, effect, view, frame, k0, k1):
    """b[U:U + n] = uniforms of columns col.. of one row, col even; twin of `streams.Draws.uniforms`."""
    base = np.uint64(row) << _S16
    first = np.uint64(col) // _TWO
    for j in range((n + 1) // 2):
        w0, w1, w2, w3 = philox(base | (first + np.uint64(j)), effect, view, frame, k0, k1)
        b[U + 2 * j] = (np.float64((w0 << _S20) | (w1 >> _S12)) + 0.5) * 2.0**-52
        b[U + 2 * j + 1] = (np.float64((w2 << _S20) | (w3 >> _S12)) + 0.5) * 2.0**-52


@inline
def polynomial(x, coefficients):
    """The highest power first, by Horner's rule; LLVM unrolls it."""
    p = coefficients[0]
    for i in range(1, len(coefficients)):
        p = p * x + coefficients[i]
    return p


@inline
def log(x):
    """Natural logarithm of a normal positive float64, to 1e-15: 2 atanh((m - 1)/(m + 1)) + e ln 2."""
    bits = np.float64(x).view(np.int64)
    e = (bits >> 52) - 1023
    m = np.int64((bits & 0xFFFFFFFFFFFFF) | 0x3FF0000000000000).view(np.float64)
    big = m > 1.4142135623730951
    m = m * 0.5 if big else m
    e = e + 1 if big else e
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    return 2.0 * s * (1.0 + z * polynomial(z, _ATANH)) + np.float64(e) * _LN2


@inline
def exp16(x):
    """exp(x) for |x| <= 4, to 1e-14: the Taylor series of exp(x/16), squared four times."""
    p = polynomial(x * 0.0625, _EXP)
    p = p * p
    p = p * p
    p = p * p
    return p * p


@jit
def quantile(u):
    """One standard normal quantile."""
    q = u - 0.5
    if abs(q) <= 0.425:
        return _central(q)
    r = math.sqrt(-math.log(min(u, 1.0 - u)))
    value = _tail(r - 1.6) if r <= 5.0 else _far_tail(r - 5.0)
    return -value if q < 0.0 else value


@inline
def _central(q):
    """PPND16 for |q| <= 0.425, q = u - 1/2."""
    r = 0.180625 - q * q
    return q * polynomial(r, _CENTRAL_A) / polynomial(r, _CENTRAL_B)


@inline
def _tail(r):
    """PPND16 for 1.6 <= r + 1.6 <= 5, r = sqrt(-log(tail probability)) - 1.6."""
    return polynomial(r, _TAIL_A) / polynomial(r, _TAIL_B)


@inline
def _far_tail(r):
    """PPND16 beyond r = 5 (probabilities under 1e-11), r = sqrt(-log(tail probability)) - 5."""
    return polynomial(r, _FAR_A) / polynomial(r, _FAR_B)


@jit
def normal(b, n, where):
    """b[W:W + n] = standard normal quantiles of b[U:]; twin of `effects.standard_normal`. where: CHUNK integers."""
    for i in range(n):
        b[W + i] = _central(b[U + i] - 0.5)
    # 15 % of the numbers lie in the tails: collect them, so that their loop is as tight as the first
    count = 0
    for i in range(n):
        u = b[U + i]
        where[count] = i
        b[X + count] = min(u, 1.0 - u)
        count += 1 if abs(u - 0.5) > 0.425 else 0
    for j in range(count):
        r = math.sqrt(-log(b[X + j]))
        b[X + j] = r
        b[P + j] = _tail(r - 1.6)
    for j in range(count):
        value = b[P + j] if b[X + j] <= 5.0 else _far_tail(b[X + j] - 5.0)
        b[W + where[j]] = -value if b[U + where[j]] < 0.5 else value


@jit
def tukey(b, n, lam):
    """b[W:W + n] = Tukey-lambda quantiles, scale 1, of b[U:]; twin of `effects.tukey_quantile`.

    (u**lam - v**lam)/lam with v = 1 - u equals exp(lam m) (a - c) sinh(z)/z, a = log u, c = log v, m = (a + c)/2,
    z = lam (a - c)/2: nothing cancels at small lambda, and lambda = 0 (the logistic distribution) needs no branch.
    """
    for i in range(n):
        a = log(b[U + i])
        c = log(1.0 - b[U + i])
        z = 0.5 * lam * (a - c)
        b[W + i] = exp16(0.5 * lam * (a + c)) * (a - c) * polynomial(z * z, _SINH)
    # The series end at |z| = 2 and exp16 at 4: further out, which takes |lambda| > 0.1, use the library functions
    edge = 1.0 / (1.0 + math.exp(4.0 / abs(lam))) if abs(lam) > 0.1 else 0.0
    if edge > 0.0:
        for i in range(n):
            u = b[U + i]
            if min(u, 1.0 - u) < edge:
                b[W + i] = (math.exp(lam * math.log(u)) - math.exp(lam * math.log1p(-u))) / lam
