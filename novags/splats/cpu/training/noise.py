"""Langevin noise of 3DGS-MCMC: counter-based, so any number of threads draws the same numbers."""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..raster.project import _rotation
from ..vectors.simd import LANES, load, maximum, minimum, select, sqrt, store
from ..vectors.transpose import add3, gather3, to_columns4
from ..vectors.vector_math import exp, log2

ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
INPUTS = 8  # quaternion, log scales, logit opacity
COLUMNS = INPUTS + 6  # and six uniform numbers, which the three displacements replace
SHARPNESS, DEAD = np.float32(100.0), np.float32(0.005)
LN2 = np.float32(np.log(2.0))
# logit of the opacity 0.3, from which on sigmoid(100 (0.005 - o)) < 2e-13: the step is lost in the rounding of the mean
OPAQUE = np.float32(-0.8472978603872037)
# cos(2 pi t) for |t| <= 1/2, a polynomial in t^2, absolute error 1e-8 before rounding
D0, D1, D2, D3 = (
    np.float32(1.0),
    np.float32(-19.739204532793902),
    np.float32(64.93911900594462),
    np.float32(-85.450165848),
)
D4, D5, D6 = np.float32(60.16783368173958), np.float32(-25.968319433915596), np.float32(6.5296178256591055)
STEP, MIX1, MIX2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
LOW24 = np.uint64(0xFFFFFF)
UNIT = np.float32(2.0**-24)


@inline
def _bits(key, counter):
    """SplitMix64 (Steele, Lea, Flood 2014) as a function of its counter."""
    z = key + (counter + np.uint64(1)) * STEP
    z = (z ^ (z >> np.uint64(30))) * MIX1
    z = (z ^ (z >> np.uint64(27))) * MIX2
    return z ^ (z >> np.uint64(31))


@inline
def _normal(u, t):
    """Box and Muller: u uniform in (0, 1], t in [-1/2, 1/2)."""
    tt = t * t
    cosine = D0 + tt * (D1 + tt * (D2 + tt * (D3 + tt * (D4 + tt * (D5 + tt * D6)))))
    return sqrt(log2(u) * (-TWO * LN2)) * cosine


@inline
def _displace(b, amount, limit):
    """Replace the uniform columns by Sigma xi amount sigmoid(100 (0.005 - o)), or zero where that is lost.

    No step along an axis of the Gaussian is longer than the limit.
    """
    at = INPUTS * LANES
    xi0 = _normal(load(b, at), load(b, at + LANES))
    xi1 = _normal(load(b, at + 2 * LANES), load(b, at + 3 * LANES))
    xi2 = _normal(load(b, at + 4 * LANES), load(b, at + 5 * LANES))
    r = _rotation(load(b, 0), load(b, LANES), load(b, 2 * LANES), load(b, 3 * LANES))
    s0, s1, s2 = exp(load(b, 4 * LANES) * TWO), exp(load(b, 5 * LANES) * TWO), exp(load(b, 6 * LANES) * TWO)
    logit = load(b, 7 * LANES)
    o = ONE / (exp(-logit) + ONE)
    gate = select(logit < OPAQUE, amount / (exp((o - DEAD) * SHARPNESS) + ONE), ZERO)
    l0 = maximum(-limit, minimum((r[0] * xi0 + r[3] * xi1 + r[6] * xi2) * s0 * gate, limit))
    l1 = maximum(-limit, minimum((r[1] * xi0 + r[4] * xi1 + r[7] * xi2) * s1 * gate, limit))
    l2 = maximum(-limit, minimum((r[2] * xi0 + r[5] * xi1 + r[8] * xi2) * s2 * gate, limit))
    store(b, at, r[0] * l0 + r[1] * l1 + r[2] * l2)
    store(b, at + LANES, r[3] * l0 + r[4] * l1 + r[5] * l2)
    store(b, at + 2 * LANES, r[6] * l0 + r[7] * l1 + r[8] * l2)


@inline
def _draw(key, first, columns):
    """Six columns of uniform numbers for Gaussians first..first+15."""
    for j in range(3):
        for lane in range(LANES):
            random = _bits(key, np.uint64(3 * (first + lane) + j))
            columns[(INPUTS + 2 * j) * LANES + lane] = np.float32(np.int64(random >> np.uint64(40)) + 1) * UNIT
            columns[(INPUTS + 2 * j + 1) * LANES + lane] = np.float32(np.int64(random & LOW24) - 8388608) * UNIT


@inline
def _gather(quats, log_scales, logit_opacities, first, count, columns):
    gather3(log_scales, first, count, columns, 4)
    if count == LANES:
        to_columns4(quats.reshape(-1), 4 * first, columns, 0)
        store(columns, 7 * LANES, load(logit_opacities, first))
        return
    for lane in range(count):
        for j in range(4):
            columns[j * LANES + lane] = quats[first + lane, j]
        columns[7 * LANES + lane] = logit_opacities[first + lane]


@inline
def _any_moves(logit_opacities, first, count):
    for i in range(first, first + count):
        if logit_opacities[i] < OPAQUE:
            return True
    return False


@kernel
def add(begin, end, means, quats, log_scales, logit_opacities, amount, limit, key):
    """Means += noise for Gaussians begin..end-1, with the stream `key` (uint64); amount and limit are float32."""
    columns = np.ones(COLUMNS * LANES, np.float32)
    for first in range(begin, end, LANES):
        count = min(LANES, end - first)
        if not _any_moves(logit_opacities, first, count):
            continue
        _gather(quats, log_scales, logit_opacities, first, count, columns)
        _draw(key, first, columns)
        _displace(columns, amount, limit)
        add3(columns, INPUTS, first, count, means)
