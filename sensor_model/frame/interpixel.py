"""Analytic mean and variance of charge that reaches across pixels: blooming, and capacitive coupling.

Charges are taken as normal, and charge that arrives in a pixel as independent of its own. Arrays are [h, w, c], units
e-, variances e-**2.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy
from numpy.typing import NDArray

from sensor_model import effects
from sensor_model.params import Sensor

Array = NDArray[np.float64]


def held_moments(s: Sensor, mu: Array, shot: str) -> tuple[Array, Array]:
    """Mean and variance of the charge each pixel shows, from the mean charge it collects."""
    variance = np.zeros_like(mu) if shot == "none" else mu
    if np.isinf(s.mu_e_sat):
        held, spread = mu, variance
    elif s.blooming:
        held, spread = bloomed(mu, variance, s.mu_e_sat)
    else:
        room, spread = positive_part(s.mu_e_sat - mu, variance)
        held = s.mu_e_sat - room
    if s.coupling:
        held, spread = effects.crosstalk(held, s.coupling), coupled_variance(spread, s.coupling)
    return held, spread


def bloomed(mu: Array, variance: Array, mu_e_sat: float) -> tuple[Array, Array]:
    """Moments of `effects.blooming`: an excess goes half down, half up, and charge that finds no room goes on."""
    excess, excess_variance = positive_part(mu - mu_e_sat, variance)
    total, spread = (
        mu.copy(),
        variance.copy(),
    )  # charge collected by a pixel and given to it, before full well cuts it
    rows = range(mu.shape[0])
    for order in (rows, reversed(rows)):
        _pass_on(total, spread, excess / 2, excess_variance / 4, mu_e_sat, order)
    room, spread = positive_part(mu_e_sat - total, spread)
    return mu_e_sat - room, spread


def _pass_on(
    total: Array, spread: Array, half: Array, half_variance: Array, mu_e_sat: float, order: Iterable[int]
) -> None:
    moving, uncertainty = np.zeros_like(half[0]), np.zeros_like(half[0])
    for row in order:
        before, before_variance = positive_part(total[row] - mu_e_sat, spread[row])
        total[row] += moving
        spread[row] += uncertainty
        after, after_variance = positive_part(total[row] - mu_e_sat, spread[row])
        # A full pixel adds half its own excess, one that is not keeps charge up to its full well
        moving = after - before + half[row]
        uncertainty = np.maximum(after_variance - before_variance + half_variance[row], 0)


def coupled_variance(variance: Array, share: float) -> Array:
    """Variance of `effects.crosstalk` of independent pixels: the squares of its weights."""
    given = np.full(variance.shape, 4.0)  # how many neighbours receive a share
    for edge in (given[0], given[-1], given[:, 0], given[:, -1]):
        edge -= 1  # reflected at the border
    own = (1 - given * share) ** 2
    return effects.crosstalk(variance, share**2) + (own - (1 - given * share**2)) * variance


def positive_part(mean: Array, variance: Array) -> tuple[Array, Array]:
    """Mean and variance of max(X, 0) for normal X."""
    sd = np.sqrt(variance)
    z = np.divide(mean, sd, out=np.copysign(np.inf, mean), where=sd > 0)
    z = np.clip(z, -40, 40)  # where density and tail are 0 already; the square of a much larger z overflows
    above, density = scipy.special.ndtr(z), np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    first = mean * above + sd * density
    second = (mean * mean + variance) * above + mean * sd * density
    return first, np.maximum(second - first * first, 0)
