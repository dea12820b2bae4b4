"""The chain of `capture.py`, fused: blocks of rows on threads, each pixel's arithmetic in the first-level cache.

Bit for bit the same frame as the numpy reference, for any number of threads and any size of block, because every pixel
owns its random numbers and nothing is summed across pixels. Importing this module imports numba.
"""
# numba infers types itself, and its decorators are untyped.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, untyped-decorator"

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sensor_model import effects
from sensor_model.fast.blocks import STEP, address, in_blocks, load, row_uniform, scratch, store, store_whole
from sensor_model.fast.kernels import MU, C, N, P, W, inline, jit, normal, tukey
from sensor_model.fast.kernels32 import NORMAL_ERROR, normal32
from sensor_model.fast.poisson import poisson
from sensor_model.frame import streams
from sensor_model.frame.prepare import Prepared

QUIET, NORMAL, TUKEY = range(3)
SHOTS = {"poisson": 0, "normal": 1, "none": 2}
_NOTHING = np.zeros(1, np.float32)  # stands in for a map that is off
_NOTHING.flags.writeable = False  # as the maps are: numba compiles once more for writable arrays
_ROUND = 6755399441055744.0  # 1.5 * 2**52: adding and subtracting it rounds to the nearest whole, halves to even


def capture(
    inputs: Prepared, shot: str, precision: str, threads: int | None
) -> tuple[NDArray[np.uint16], NDArray[np.bool_], int]:
    """Codes and saturation of one frame, [h, w, c], and how many values of the light are not finite and >= 0."""
    s, shape = inputs.sensor, inputs.light.shape
    h, w, channels = shape
    dn, saturated = np.empty(h * w * channels, np.uint16), np.empty(h * w * channels, np.uint8)
    light = inputs.light.ravel()
    maps = (inputs.response, inputs.dark, inputs.offset)
    response, dark, offset = (_NOTHING if m is None else m.ravel() for m in maps)
    columns = np.ascontiguousarray(inputs.columns.T)
    scale = 1.0 if s.tukey_lambda is None else effects.tukey_sd(s.tukey_lambda)
    low = s.dual_gain
    merge = (np.inf, 0.0, 1.0) if low is None else (low.threshold, low.sigma_d / scale, low.ratio)
    # All floats: numba unpacks a tuple only if all items have one type
    read = (*map(float, (s.mu_e_sat, s.droop, s.sigma_d / scale, s.tukey_lambda or 0, s.gain, s.max_dn)), *merge)
    given = [m is not None for m in maps]
    single = precision == "float32"
    before = (
        light,
        response,
        dark,
        *given[:2],
        s.eta,
        inputs.dark_e,
        inputs.cap,
        SHOTS[shot],
        single,
    )
    after = (offset, given[2], inputs.rows, columns, inputs.black, read, *_noise(read, s.tukey_lambda, single))
    where = (*inputs.draws.origin, *address(inputs.draws))

    def shoot(y0: int, y1: int, charge: NDArray) -> int:
        return _shoot(*before, charge, shape, y0, y1, *where, *scratch())

    def read_out(y0: int, y1: int, charge: NDArray) -> int:
        return _read_out(charge, *after, dn, saturated, shape, y0, y1, *where, *scratch())

    def both(y0: int, y1: int) -> int:
        charge = np.empty((y1 - y0) * w * channels)
        bad = shoot(y0, y1, charge)
        read_out(y0, y1, charge)
        return bad

    if s.blooming or s.coupling:  # the effects that reach across rows
        charge = np.empty(shape)
        bad = sum(in_blocks(lambda y0, y1: shoot(y0, y1, charge[y0:y1].ravel()), shape, threads))
        held = effects.blooming(charge, s.mu_e_sat) if s.blooming else effects.full_well(charge, s.mu_e_sat)
        shown = effects.crosstalk(held, s.coupling) if s.coupling else held
        in_blocks(lambda y0, y1: read_out(y0, y1, shown[y0:y1].ravel()), shape, threads)
        saturated |= (held >= s.mu_e_sat).ravel()
    else:
        bad = sum(in_blocks(both, shape, threads))
    return dn.reshape(shape), saturated.view(np.bool_).reshape(shape), bad


def _noise(read: tuple[float, ...], lam: float | None, single: bool) -> tuple[int, float]:
    """Kind of the read noise; and how near to the next code a code must be for float32 to matter, DN."""
    _, _, sigma, _, gain, _, _, sigma_low, _ = read
    loudest = max(sigma, sigma_low)
    kind = QUIET if loudest == 0 else NORMAL if lam is None else TUKEY
    # The quantile's own error grows with it, up to 5.3 deviations; the rest is computed in float64
    return kind, -1.0 if single else gain * loudest * NORMAL_ERROR * 6.3


@jit
def _shoot(
    light, response, dark, with_response, with_dark, eta, dark_e, cap, shot, single, out, shape, y0, y1,
    row0, col0, view, frame, k0, k1, b, f, where,
):  # fmt: skip
    """Light -> electrons of rows y0..y1, into out; returns the number of pixels whose light is not finite and >= 0."""
    bad = 0
    _, w, channels = shape
    for y in range(y0, y1):
        for c in range(channels):
            for x0 in range(0, w, STEP):
                n = min(STEP, w - x0)
                start = (y * w + x0) * channels + c
                load(b, MU, light, start, channels, n)
                for i in range(n):
                    good = (b[MU + i] >= 0.0) & (b[MU + i] < np.inf)
                    bad += 0 if good else 1
                    b[MU + i] = eta * b[MU + i] if good else 0.0
                if with_response:
                    load(b, P, response, start, channels, n)
                    for i in range(n):
                        b[MU + i] *= b[P + i]
                if with_dark:
                    load(b, P, dark, start, channels, n)
                else:
                    for i in range(n):
                        b[P + i] = dark_e
                for i in range(n):
                    b[MU + i] = min(b[MU + i] + b[P + i], cap)
                    b[N + i] = b[MU + i]
                if shot < 2:
                    row_uniform(b, n, streams.SHOT, c, row0 + y, col0 + x0, view, frame, k0, k1)
                if shot == 0:
                    poisson(b, f, n, where)
                elif shot == 1:
                    if single and normal32(b, f, n):
                        for i in range(n):
                            b[W + i] = np.float64(f[W + i])
                    else:
                        normal(b, n, where)
                    for i in range(n):
                        b[N + i] = b[MU + i] + np.sqrt(b[MU + i]) * b[W + i]
                store(out, ((y - y0) * w + x0) * channels + c, channels, b, N, n)
    return bad


@inline
def _read_noise(b, f, n, noise, single, lam, where):
    """W = the read noise of U, over its scale; returns whether the error of float32 is as stated."""
    bounded = True
    if noise == QUIET:
        for i in range(n):
            b[W + i] = 0.0
    elif noise == TUKEY:
        tukey(b, n, lam)
    elif single:
        bounded = normal32(b, f, n)
        for i in range(n):
            b[W + i] = np.float64(f[W + i])
    else:
        normal(b, n, where)
    return bounded


@inline
def _codes(b, n, even, odd, read, slack):
    """Charge C, noise W and offset N -> codes N and saturation C; returns how many are within slack of another."""
    full, droop, sigma, _, gain, top, threshold, sigma_low, ratio = read
    near = 0
    if threshold == np.inf:
        for i in range(n):
            held = min(b[C + i], full)
            signal = (held - droop * held * held) + sigma * b[W + i] + b[N + i]
            exact = gain * signal + (odd if i & 1 else even)
            code = (exact + _ROUND) - _ROUND
            near += 1 if 0.5 - abs(exact - code) < slack else 0
            code = min(max(code, 0.0), top)
            b[N + i] = code
            b[C + i] = 1.0 if (held >= full) | (code == top) else 0.0
        return near
    for i in range(n):
        held = min(b[C + i], full)
        low = held > threshold
        signal = (held - droop * held * held) + (sigma_low if low else sigma) * b[W + i] + b[N + i]
        exact = (gain * signal + (odd if i & 1 else even)) * (1.0 / ratio if low else 1.0)
        step = (exact + _ROUND) - _ROUND
        near += 1 if 0.5 - abs(exact - step) < slack else 0
        code = min(max((step * (ratio if low else 1.0) + _ROUND) - _ROUND, 0.0), top)
        b[N + i] = code
        b[C + i] = 1.0 if (held >= full) | (code == top) else 0.0
    return near


@jit
def _read_out(
    charge, offset, with_offset, rows, columns, black, read, noise, slack, dn, saturated, shape, y0, y1,
    row0, col0, view, frame, k0, k1, b, f, where,
):  # fmt: skip
    """Electrons of rows y0..y1 -> codes and saturation."""
    lam = read[3]
    _, w, channels = shape
    for y in range(y0, y1):
        for c in range(channels):
            even, odd = black[y % 2, 0, c], black[y % 2, 1, c]
            for x0 in range(0, w, STEP):
                n = min(STEP, w - x0)
                start = (y * w + x0) * channels + c
                row, column = rows[y, c], columns[c, x0 : x0 + n]
                if noise != QUIET:
                    row_uniform(b, n, streams.READ, c, row0 + y, col0 + x0, view, frame, k0, k1)
                single, again = noise == NORMAL and slack < 0.01, True
                while again:
                    bounded = _read_noise(b, f, n, noise, single, lam, where)
                    for i in range(n):
                        b[N + i] = row + column[i]
                    if with_offset:
                        load(b, P, offset, start, channels, n)
                        for i in range(n):
                            b[N + i] += b[P + i]
                    load(b, C, charge, ((y - y0) * w + x0) * channels + c, channels, n)
                    near = _codes(b, n, even, odd, read, slack)
                    again, single = single and (near > 0 or not bounded), False  # all of them again, in float64
                store_whole(dn, start, channels, b, N, n)
                store_whole(saturated, start, channels, b, C, n)
    return 0
