"""Which effects an exposure calls for.

Leaving out a variance v changes the standard deviation by sqrt(1 + v/V) - 1 <= v / 2V, V being the variance of the
complete chain. The tolerance epsilon on the standard deviation is therefore a budget: the variances left out may add up
to 2 epsilon V. Effects are left out cheapest first until the budget is spent, so the bound holds for their sum.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sensor_model.params import Exposure, Sensor, require
from sensor_model.plan import Effect, Plan

UNIT = "relative standard deviation"
# Leaving these out only widens or narrows the noise: name -> (what it is, the fields to clear)
VARIANCES = {"prnu": "fixed pattern", "dsnu": "fixed pattern", "row_noise": "per row", "dark_current": "per pixel"}


def plan_effects(
    sensor: Sensor,
    exposure: Exposure,
    signal_e: ArrayLike,
    tolerance: float = 0.05,
    *,
    row_length: int = 1,
    shared_views: int = 1,
) -> Plan:
    """Decide, effect by effect, what to simulate.

    Args:
        sensor: The camera.
        exposure: How it is used.
        signal_e: Quantiles of the mean signal in the views, e-; the lowest and the highest are used.
        tolerance: Relative error of the standard deviation that may be made at any signal in that range.
        row_length: Pixels of a row that are averaged by what follows (1: single pixels matter): row noise adds up.
        shared_views: Views in which one scene point meets the same pixel (1: moving camera): fixed pattern adds up.

    Returns:
        A plan whose `bound` is the error of everything left out together; force effects by `Plan.force`.

    Raises:
        ValueError: if the signal is negative or not finite, or the tolerance is not positive.
    """
    signal = np.asarray(signal_e, np.float64).ravel()
    ok = signal.size > 0 and bool(np.isfinite(signal).all()) and signal.min() >= 0
    require(ok, "signal_e", "finite, >= 0 and not empty", signal_e)
    require(tolerance > 0, "tolerance", "> 0", tolerance)
    require(row_length >= 1 and shared_views >= 1, "row_length, shared_views", ">= 1", (row_length, shared_views))
    low, high = float(signal.min()), float(signal.max())
    skipped = {
        "prnu": (shared_views * (sensor.prnu * high) ** 2, high),
        "dsnu": (shared_views * sensor.dsnu**2, low),
        "row_noise": (row_length * sensor.sigma_row**2, low),
        "dark_current": (sensor.dark_current * exposure.time, low),
    }
    shares = {name: v / (2 * total_variance(sensor, exposure, at)) for name, (v, at) in skipped.items()}
    effects = [_always("photon_shot", 1.0, tolerance, "never left out")]
    spent = 0.0
    for name in sorted(shares, key=lambda n: shares[n]):
        leave_out = spent + shares[name] <= tolerance
        spent += shares[name] if leave_out else 0.0
        effects.append(
            Effect(
                name=name,
                on=not leave_out,
                forced=False,
                contribution=shares[name],
                bound=tolerance,
                unit=UNIT,
                reason=f"{VARIANCES[name]}; {'within' if leave_out else 'over'} what is left of the budget",
            )
        )
    effects.append(_tails(sensor, exposure, low, tolerance))
    effects.append(_clipping(sensor, exposure, high))
    return Plan(effects=tuple(effects), bound=spent, unit=UNIT)


def total_variance(sensor: Sensor, exposure: Exposure, signal_e: float) -> float:
    """Temporal variance of one pixel, e-**2: shot, dark shot, read, rounding."""
    rounding = 1 / (12 * sensor.gain**2)
    return signal_e + sensor.dark_current * exposure.time + sensor.sigma_d**2 + rounding


def simplify(sensor: Sensor, plan: Plan | None) -> Sensor:
    """The camera without the effects its plan leaves out: the chain has no other switch."""
    if plan is None:
        return sensor
    cleared: dict[str, dict[str, Any]] = {
        "prnu": {"prnu": 0.0},
        "dsnu": {"dsnu": 0.0},
        "row_noise": {"sigma_row": 0.0},
        "dark_current": {"dark_current": 0.0},
        "read_tails": {"tukey_lambda": None},
        "full_well": {"mu_e_sat": float("inf")},
    }
    left_out = [effect.name for effect in plan.effects if not effect.on]
    return replace(sensor, **{k: v for name in left_out for k, v in cleared.get(name, {}).items()})


def _always(name: str, contribution: float, tolerance: float, reason: str) -> Effect:
    return Effect(
        name=name, on=True, forced=False, contribution=contribution, bound=tolerance, unit=UNIT, reason=reason
    )


def _tails(sensor: Sensor, exposure: Exposure, low: float, tolerance: float) -> Effect:
    excess = 0.0 if sensor.tukey_lambda is None else excess_kurtosis(sensor.tukey_lambda)
    share = excess * sensor.sigma_d**4 / total_variance(sensor, exposure, low) ** 2 if excess else 0.0
    return Effect(
        name="read_tails",
        on=share > tolerance,
        forced=False,
        contribution=share,
        bound=tolerance,
        unit="excess kurtosis",
        reason="tails of the read noise; without them it is Gaussian",
    )


def excess_kurtosis(lam: float) -> float:
    """Excess kurtosis of Tukey's lambda distribution."""
    from scipy.stats import tukeylambda

    # the fourth moment diverges at -1/4
    return float(tukeylambda.stats(lam, moments="k")) if lam > -0.25 else float("inf")


def _clipping(sensor: Sensor, exposure: Exposure, high: float) -> Effect:
    sd = sqrt(total_variance(sensor, exposure, high))
    margin = (sensor.capacity_e - high) / sd if sd > 0 else inf
    return Effect(
        name="full_well",
        on=margin < 5,
        forced=False,
        contribution=max(0.0, 5 - margin),
        bound=0.0,
        unit="standard deviations",
        reason="the brightest signal keeps 5 standard deviations from saturation" if margin >= 5 else "it saturates",
    )
