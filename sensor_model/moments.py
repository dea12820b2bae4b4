"""Analytic mean and variance of the chain in `capture.py`: the reference for tests of its samples.

Everything here is temporal: for one pixel of one camera, over frames of the same light.

Far from any clipping, the moments are closed forms. Near one (black, white, full well, the switch of a dual gain), or
where the noise is too small to round out the steps of the ADC, the charge is integrated: E[f(N)] over its distribution,
f(n) being the closed form for a fixed charge n. There a Tukey-lambda noise is taken as a mixture of two normals with
its variance and kurtosis.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from sensor_model import effects
from sensor_model.frame import own, pattern
from sensor_model.frame.interpixel import held_moments
from sensor_model.frame.prepare import Prepared
from sensor_model.params import ROUNDING, Sensor

Array = NDArray[np.float64]

REACH = 8.0  # standard deviations beyond which a normal tail (1e-15) is negligible
SMOOTH = 0.8  # DN of noise from which rounding just adds 1/12 DN**2 (the mean errs by 1e-6 DN)
FEW = 16  # different pixels up to which each kind gets a table of its own
GRID = 0.01  # sqrt(e-), spacing of such a table: linear interpolation errs by GRID**2 / 4 = 0.00003 e-
BATCH = 512  # pixels that are integrated together
LONGEST = 8192  # electrons in their list: 32 MiB an array


def frame_moments(inputs: Prepared, shot: str = "poisson") -> tuple[Array, Array]:
    """Mean (DN) and variance (DN**2) of every pixel, [h, w, c]."""
    s, charge = inputs.sensor, inputs.mean_charge
    mu = charge.ravel()
    extra = np.broadcast_to(extra_variance(inputs), inputs.light.shape).ravel()
    offset = 0.0 if inputs.offset is None else inputs.offset.astype(np.float64)
    base = (inputs.black_dn + s.gain * (np.zeros(inputs.light.shape) + offset)).ravel()

    charge_variance = np.zeros_like(mu) if shot == "none" else mu
    mean_e, variance_e = response_moments(mu, charge_variance, s.droop)
    if s.effects:
        signal = np.minimum(mean_e, s.mu_e_sat * (1 - s.nonlinearity)).reshape(inputs.light.shape)
        more, spread = (part.ravel() for part in own.moments(signal, s, inputs.exposure))
        base, extra = base + s.gain * more, extra + spread
    mean = base + s.gain * mean_e
    read_sd = s.gain * np.sqrt(s.sigma_d**2 + extra)
    variance = s.gain**2 * variance_e + read_sd**2
    stepless = (read_sd == 0) & (s.gain % 1 == 0) & (base % 1 == 0) & (s.droop == 0) & (shot == "poisson")
    hard = _near_a_limit(s, mu, mean, np.sqrt(variance)) | ((read_sd < SMOOTH) & ~stepless)
    variance += np.where(stepless, 0, 1 / 12)  # whole electrons that are whole codes lose nothing in rounding
    if hard.any():
        mean[hard], variance[hard] = _many_integrals(s, mu[hard], base[hard], extra[hard], shot)
    shape = inputs.light.shape
    mean, variance = mean.reshape(shape), variance.reshape(shape)
    if s.coupling or s.blooming:
        # without coupling only columns with a pixel that may overflow
        columns = np.broadcast_to(True if s.coupling else (charge + _reach(charge) > s.mu_e_sat).any(0), shape[1:])
        spilled = _spilled(s, charge, base.reshape(shape), extra.reshape(shape), shot)
        mean, variance = (np.where(columns, *pair) for pair in zip(spilled, (mean, variance), strict=True))
    return mean, variance


def _spilled(s: Sensor, charge: Array, base: Array, extra: Array, shot: str) -> tuple[Array, Array]:
    """Moments of pixels whose charge depends on other pixels: sums over pixels, taken as normal. [h, w, c]."""
    held, spread = held_moments(s, charge, shot)
    sigma_d, width = effects.select_gain(held, s.sigma_d, s.dual_gain)
    level = base + s.gain * (effects.nonlinear(held, s.droop) - s.droop * spread)
    slope = 1 - 2 * s.droop * held
    sd = s.gain * np.sqrt(slope**2 * spread + 2 * (s.droop * spread) ** 2 + sigma_d**2 + extra)
    mean, variance = code_moments(level / width, sd / width, s.max_dn / width)
    return width * mean, width**2 * variance


def extra_variance(inputs: Prepared) -> Array:
    """Variance of row, column, banding and telegraph noise, or of dark frames, [h, w, c] or [1, 1, 1], e-**2."""
    s = inputs.sensor
    if inputs.variance is not None:
        return inputs.variance
    variance = np.full((1, 1, 1), s.sigma_row**2 + s.sigma_column**2)
    if s.banding:
        variance += s.banding.amplitude**2 / 2
    sites = pattern.telegraph_sites(s, inputs.light.shape, inputs.draws.origin)
    if sites is not None and s.defects is not None:
        variance = np.broadcast_to(variance, inputs.light.shape).copy()
        variance[sites] += (s.defects.rts_factor**2 - 1) * s.sigma_d**2
    return variance


def response_moments(mu: Array, variance: Array, droop: float) -> tuple[Array, Array]:
    """Mean and variance of N - droop N**2 where N has Poisson moments (variance = mu) or is fixed (variance = 0).

    Source: the Poisson moments E[N**2] = mu**2 + mu, var(N**2) = 4 mu**3 + 6 mu**2 + mu, cov(N, N**2) = 2 mu**2 + mu.
    """
    if droop == 0:
        return mu, variance
    random = variance > 0
    mean = mu - droop * (mu**2 + variance)
    spread = mu - 2 * droop * (2 * mu**2 + mu) + droop**2 * (4 * mu**3 + 6 * mu**2 + mu)
    return mean, np.where(random, spread, 0.0)


def _reach(mu: Array) -> Array:
    """How far from its mean a Poisson number gets, generously, e-."""
    return REACH * np.sqrt(mu) + REACH**2 / 4


def _near_a_limit(s: Sensor, mu: Array, mean: Array, sd: Array) -> NDArray[np.bool_]:
    skew = s.gain * REACH**2 / 4
    near = (mean < REACH * sd + 1) | (mean > s.max_dn - REACH * sd - skew - 1) | (mu + _reach(mu) > s.mu_e_sat)
    return near | (mu + _reach(mu) > s.dual_gain.threshold) if s.dual_gain else near


def _many_integrals(s: Sensor, mu: Array, base: Array, extra: Array, shot: str) -> tuple[Array, Array]:
    """`integrated_moments` of any number of pixels.

    Where many share base and extra, as without DSNU all do, they are interpolated in the square root of the charge: on
    that axis shot noise is 0.5 wide, for any charge, and smooths everything over that width.
    """
    mean, variance = np.empty_like(mu), np.empty_like(mu)
    kinds, which = np.unique(base + 1j * extra, return_inverse=True)
    if kinds.size > FEW or shot == "none":
        kinds, which = kinds[:1], np.zeros(mu.size, np.intp)
    for kind in range(kinds.size):
        members = np.flatnonzero(which == kind)
        root = np.sqrt(mu[members])
        grid = np.arange(root.min(), root.max() + 2 * GRID, GRID)
        if grid.size < members.size and np.ptp(base[members]) == np.ptp(extra[members]) == 0 and shot != "none":
            same = np.ones(grid.size)
            table = _in_batches(s, grid**2, base[members[0]] * same, extra[members[0]] * same, shot)
            mean[members], variance[members] = (np.interp(root, grid, column) for column in table)
        else:
            mean[members], variance[members] = _in_batches(s, mu[members], base[members], extra[members], shot)
    return mean, variance


def _in_batches(s: Sensor, mu: Array, base: Array, extra: Array, shot: str) -> tuple[Array, Array]:
    """`integrated_moments`, pixels of similar charge together, so that one list of electrons serves them all."""
    mean, variance = np.empty_like(mu), np.empty_like(mu)
    parts = np.array_split(np.argsort(mu, kind="stable"), -(-mu.size // BATCH))
    while parts:
        part = parts.pop()
        ends = mu[part[[0, -1]]]
        low, high, step = _span(ends)
        if part.size > 1 and high - low > LONGEST * step:  # hot pixels beside others
            cut = np.searchsorted(mu[part], np.sqrt((ends[0] + 1) * (ends[1] + 1)) - 1, side="right")
            parts += [part[:cut], part[cut:]]
        else:
            mean[part], variance[part] = integrated_moments(s, mu[part], base[part], extra[part], shot)
    return mean, variance


def integrated_moments(s: Sensor, mu: Array, base: Array, extra: Array, shot: str) -> tuple[Array, Array]:
    """Mean and variance of the codes of pixels with mean charge `mu`, by summing over the charge. DN, DN**2.

    Args:
        s: The camera.
        mu: Mean charge [p], e-.
        base: Code of zero charge [p], DN.
        extra: Variance added to the read noise [p], e-**2.
        shot: As in `expose`.
    """
    # Full in every frame: its charge is practically fixed
    fixed = shot == "none" or mu.min() - _reach(mu.min()) > s.capacity_e / (1 - s.nonlinearity) + REACH * s.sigma_d
    charge, weight = (mu[:, None], np.ones((mu.size, 1))) if fixed else _charges(mu, shot)
    held = effects.full_well(charge, s.mu_e_sat)
    sigma_d, width = effects.select_gain(held, s.sigma_d, s.dual_gain)
    level = base[:, None] + s.gain * effects.nonlinear(held, s.droop)
    # Moments about the level of the mean charge: squares stay small, differences exact
    centre = base + s.gain * effects.nonlinear(effects.full_well(mu, s.mu_e_sat), s.droop)
    shift, square = np.zeros_like(mu), np.zeros_like(mu)
    for share, factor in _normal_components(s.tukey_lambda):
        sd = s.gain * np.sqrt((factor * sigma_d) ** 2 + extra[:, None])
        first, second = code_moments(level / width, sd / width, s.max_dn / width)
        away = width * first - centre[:, None]
        shift += share * (weight * away).sum(1) / weight.sum(1)
        square += share * (weight * (width**2 * second + away**2)).sum(1) / weight.sum(1)
    return centre + shift, np.maximum(square - shift**2, 0)


def _normal_components(lam: float | None) -> list[tuple[float, float]]:
    """Shares and standard deviations of normals that make up the read noise; together of variance 1."""
    # Beyond 8 the wider component would leave nothing to the narrow one; light tails (below 0) have no such mixture
    kurtosis = 0.0 if lam is None else min(max(effects.excess_kurtosis(lam), 0.0), 8.0)
    if kurtosis == 0:
        return [(1.0, 1.0)]
    narrower = float(np.sqrt(kurtosis / 12))  # 0.8 (1 - a) + 0.2 (1 + 4 a) = 1, 0.8 a**2 + 0.2 (4 a)**2 = kurtosis / 3
    return [(0.8, float(np.sqrt(1 - narrower))), (0.2, float(np.sqrt(1 + 4 * narrower)))]


def _charges(mu: Array, shot: str) -> tuple[Array, Array]:
    """Charges that pixels of about the same mean `mu` may hold [1 or p, k], and how likely each is [p, k]."""
    if shot == "normal":
        w = np.linspace(-REACH, REACH, 321)
        return mu[:, None] + np.sqrt(mu)[:, None] * w, np.broadcast_to(np.exp(-0.5 * w * w), (mu.size, w.size))
    n = np.arange(*_span(np.array([mu.min(), mu.max()])))[None]
    return n, np.exp(scipy.special.xlogy(n, mu[:, None]) - mu[:, None] - scipy.special.gammaln(n + 1))


def _span(ends: Array) -> tuple[float, float, float]:
    """The fewest and the most electrons that means from ends[0] to ends[1] give, and the step between those listed.

    The step is 1; in large means 20 to a standard deviation, over which nothing changes.
    """
    low, high = np.floor(ends + _reach(ends) * [-1, 1])
    step = max(1.0, float(np.floor(np.sqrt(ends[0]) / 20)))
    return max(0.0, float(low)), float(high) + 2 * step, step


def code_moments(level: Array, sd: Array, top: Array | float) -> tuple[Array, Array]:
    """Mean and variance of round(level + sd * normal), clipped to [0, top]. DN, DN**2.

    Source: E[Z] = sum_{j=1}^{top} P(y > j - 1/2). With sd >= 0.8 the Euler-Maclaurin formula gives the sum from the
    censored normal distribution and its end terms; with less, the few terms that matter are summed.
    """
    level, sd, top = np.broadcast_arrays(level, sd, top)
    mean, variance = np.clip(np.rint(level), 0, top), np.zeros(level.shape)
    quiet, loud = (sd > 0) & (sd < SMOOTH), sd >= SMOOTH
    if quiet.any():
        mean[quiet], variance[quiet] = _summed(level[quiet], sd[quiet], top[quiet])
    if loud.any():
        mean[loud], variance[loud] = _censored(level[loud], sd[loud], top[loud])
    return mean, variance


def burst_moments(mean: Array, variance: Array, frames: int) -> tuple[Array, Array]:
    """Mean and variance of the rounded mean of so many codes of this mean and variance. DN, DN**2.

    That mean is a multiple of 1 / frames, and halves, which an even number of frames has, are rounded to even codes.
    With the noise of a code 1/12 is added; with less, the few codes that matter are summed, as of a normal distribution
    that was rounded to such multiples.
    """
    halves = frames % 2 == 0
    rounded = variance / frames + ROUNDING
    sd = np.sqrt(np.maximum(variance / frames - 1 / (12 * frames**2), 1e-12))  # 0 of no noise: 0 / 0
    mean, quiet = mean.copy(), np.flatnonzero(sd < SMOOTH)
    for part in np.array_split(quiet, -(-quiet.size // LONGEST)) if quiet.size else ():
        near = np.rint(mean.flat[part])[:, None]
        codes = near + np.arange(-7, 8)  # as for `_summed`
        first = codes - 0.5 + ((codes % 2 - 0.5) / frames if halves else 0.0)  # what is above becomes this code
        above = scipy.special.ndtr((mean.flat[part][:, None] - first) / sd.flat[part][:, None])
        probability = above - np.append(above[:, 1:], np.zeros_like(near), 1)
        shift = (probability * (codes - near)).sum(1)
        mean.flat[part] = near[:, 0] + shift
        rounded.flat[part] = (probability * (codes - near) ** 2).sum(1) - shift**2
    return mean, rounded


def _summed(level: Array, sd: Array, top: Array) -> tuple[Array, Array]:
    codes = np.rint(level)[..., None] + np.arange(-7, 8)  # 8 standard deviations of 0.8 DN
    above = scipy.special.ndtr((level[..., None] - codes + 0.5) / sd[..., None])  # P(y > code - 1/2)
    probability = above - np.append(above[..., 1:], np.zeros_like(above[..., :1]), -1)
    clipped = np.clip(codes, 0, top[..., None]) - np.clip(np.rint(level), 0, top)[..., None]
    first = (probability * clipped).sum(-1)
    return np.clip(np.rint(level), 0, top) + first, (probability * clipped**2).sum(-1) - first**2


def _censored(m: Array, s: Array, top: Array) -> tuple[Array, Array]:
    a, b = -m / s, (top - m) / s
    pdf_a, pdf_b = (np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) for z in (a, b))
    below, above = scipy.special.ndtr(a), scipy.special.ndtr(-b)  # P(y < 0), P(y > top)
    lift, cut = s * (pdf_a + a * below), s * (pdf_b - b * above)  # E[(0 - y)+], E[(y - top)+]
    lift2 = s * s * ((1 + a * a) * below + a * pdf_a)
    cut2 = s * s * ((1 + b * b) * above - b * pdf_b)
    # With e = y - m and L, U the two excesses: E[(e + L - U)**2], where e L = -m L - L**2 and e U = U**2 + (top - m) U
    second = s * s - lift2 - 2 * m * lift - cut2 - 2 * (top - m) * cut
    # Euler-Maclaurin end terms of E[Z] and of E[(Z - m)**2] = m**2 + sum of 2 (j - 1/2 - m) P(y > j - 1/2)
    shift = lift - cut + (pdf_b - pdf_a) / (24 * s)
    second = second + (1 - below - above) / 12 + ((top - m) * pdf_b + m * pdf_a) / (12 * s)
    # Deep in a clip all terms vanish against m**2 and only rounding errors are left of the variance
    return np.clip(m + shift, 0, top), np.maximum(second - shift**2, 0)
