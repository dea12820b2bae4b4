"""Which effects an exposure calls for.

An effect may be left out if its contribution stays within three budgets, each for the sum of all omitted effects: the
relative standard deviation (epsilon), a bias in DN, and a relative error of the signal. Leaving out a variance v
changes the standard deviation by sqrt(1 + v/V) - 1 <= v / 2V, where V = S + R**2 + 1/(12 K**2) is the variance that
every plan keeps: shot noise of the signal S, read noise, rounding. The cheapest effects are left out first. Where the
charge of any pixel, its dark charge included, comes within five standard deviations of black or white, clipping shapes
the noise, no such bound holds, and nothing that contributes is left out: give quantiles without the highlights to plan
for the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import cos, exp, inf, pi, radians, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sensor_model.effects import excess_kurtosis
from sensor_model.frame import own
from sensor_model.params import Exposure, Sensor, require
from sensor_model.plan import Effect, Plan

SD, BIAS, SIGNAL = "relative standard deviation", "DN of bias", "relative signal"
Costs = dict[str, tuple[dict[str, float], str]]  # effect -> the cost of leaving it out in each budget, and where
CLEAR = 5.0  # standard deviations
ROOM, KURTOSIS, DISTANCE = "standard deviations short of 5", "excess kurtosis", "Kolmogorov distance"


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The allowed cost of leaving effects out."""

    sd: float  # relative standard deviation, at any signal in the range
    bias_dn: float | None = None  # DN; None: `sd` standard deviations of the darkest signal
    kurtosis: float = 0.1  # excess kurtosis of the darkest pixels
    distance: float = 0.01  # Kolmogorov distance between the Poisson distribution and its replacement
    row_length: int = 1  # pixels of a row that later get averaged (1: pixels count singly): row noise adds up
    shared_views: int = 1  # views in which a scene point meets the same pixel (1: moving camera): fixed pattern adds up
    pixels: int = 1_000_000  # of all frames of one camera: below 0.01 defects expected, none are simulated

    def __post_init__(self) -> None:
        """Check every field."""
        for name in ("sd", "kurtosis", "distance"):
            require(getattr(self, name) > 0, name, "> 0", getattr(self, name))
        require(self.bias_dn is None or self.bias_dn >= 0, "bias_dn", "None or >= 0 DN", self.bias_dn)
        for name in ("row_length", "shared_views", "pixels"):
            require(getattr(self, name) >= 1, name, ">= 1", getattr(self, name))


def plan_effects(sensor: Sensor, exposure: Exposure, signal_e: ArrayLike, tolerance: float | Limits = 0.05) -> Plan:
    """Decide for each effect whether to simulate it.

    Args:
        sensor: The camera.
        exposure: How it is used.
        signal_e: Quantiles of the mean signal in the views, e-; the lowest and the highest are used.
        tolerance: Relative error of the standard deviation that may be made at any signal in that range, or all limits.

    Returns:
        A plan whose `bound` and `biases` bound the error of all omitted effects. Force effects by `Plan.force`.

    Raises:
        ValueError: if the signal is negative or not finite, or a limit is out of range.
    """
    limits = tolerance if isinstance(tolerance, Limits) else Limits(sd=tolerance)
    signal = np.asarray(signal_e, np.float64).ravel()
    ok = signal.size > 0 and bool(np.isfinite(signal).all()) and signal.min() >= 0
    require(ok, "signal_e", "finite, >= 0 and not empty", signal_e)
    dimmest, brightest = _illumination(sensor)
    low, high = dimmest * float(signal.min()), brightest * float(signal.max())

    dark = kept_variance(sensor, low)
    bias = limits.sd * sensor.gain * sqrt(dark) if limits.bias_dn is None else limits.bias_dn
    budgets = {SD: limits.sd, BIAS: bias, SIGNAL: limits.sd}
    always = [
        _decided("photon_shot", True, _ratio(low, 2 * dark), limits.sd, SD, "never left out"),
        _decided("read_noise", True, _ratio(sensor.sigma_d**2, 2 * dark), limits.sd, SD, "never left out"),
    ]
    most = _most_charge(sensor, exposure, high, limits)
    lower = own.reach(sensor, exposure, low, CLEAR)
    clips = _sd_to_white(sensor, most, limits) < CLEAR or _sd_to_black(sensor, low, lower, limits) < CLEAR
    exempt = "near clipping" if clips else "codes are coarser than the noise" if _is_coarse(sensor, low, most) else None
    chosen, spent = _choose(_costs(sensor, exposure, low, high, limits), budgets, exempt)
    effects = (*always, *chosen, *_shapes(sensor, low, most, limits, exempt is not None))
    return Plan(effects=effects, bound=spent[SD], unit=SD, biases={u: spent[u] for u in (BIAS, SIGNAL)})


def _choose(candidates: Costs, budgets: dict[str, float], exempt: str | None) -> tuple[list[Effect], dict[str, float]]:
    """Leave out the cheapest effects until a budget is spent; nothing that costs where no bound holds, and why."""
    spent, effects = dict.fromkeys(budgets, 0.0), []
    for name in sorted(candidates, key=lambda n: _worst(candidates[n][0], budgets)[0]):
        cost, reason = candidates[name]
        costly = any(cost.values())
        fits = not (exempt and costly) and all(spent[unit] + value <= budgets[unit] for unit, value in cost.items())
        if fits:
            spent = {unit: total + cost.get(unit, 0.0) for unit, total in spent.items()}
        _, unit = _worst(cost, budgets)
        fitting = "fits the budget" if fits else exempt or "exceeds the rest of the budget"
        why = f"{reason}; {fitting}" if costly else "this camera has none"
        effects.append(_decided(name, not fits, cost[unit], budgets[unit], unit, why))
    return effects, spent


def kept_variance(sensor: Sensor, signal_e: float) -> float:
    """The variance of one pixel that every plan keeps: shot, read, rounding. e-**2."""
    return signal_e + sensor.sigma_d**2 + 1 / (12 * sensor.gain**2)


def _illumination(s: Sensor) -> tuple[float, float]:
    """The least and the most that the lens makes of even light in any pixel, as factors; 1 lies between them."""
    o = s.optics
    table = () if o is None else o.falloff or (cos(radians(o.corner_angle)) ** 4,)
    return min((1.0, *table)), max((1.0, *table))


def _most_charge(s: Sensor, exposure: Exposure, high: float, limits: Limits) -> float:
    """Mean charge of the fullest pixel: the brightest light on the most sensitive pixel, plus dark charge. e-."""
    charge = high * (1 + CLEAR * s.prnu) + s.dark_e(exposure) + _hot_e(s, exposure, limits)
    return charge + own.reach(s, exposure, min(charge, s.capacity_e), CLEAR)


def _hot_e(s: Sensor, exposure: Exposure, limits: Limits) -> float:
    """Dark charge of a hot pixel beyond the other pixels', if there are hot ones. e-."""
    d = s.defects
    return (d.hot_factor - 1) * s.dark_e(exposure) if d and d.hot_fraction * limits.pixels >= 0.01 else 0.0


def _telegraph_variance(s: Sensor, limits: Limits) -> float:
    """The variance that telegraph noise adds in a pixel that has it, if there are any. e-**2."""
    d = s.defects
    return (d.rts_factor**2 - 1) * s.sigma_d**2 if d and d.rts_fraction * limits.pixels >= 0.01 else 0.0


def _least_kept(s: Sensor, signal_e: float, most: float) -> float:
    """`kept_variance` at the gain that reads with less noise, among the gains in use at charges from `signal_e` up.
    e-**2.
    """
    kept, gains = kept_variance(s, signal_e), s.dual_gain
    if gains is None or not _switches(s, most):
        return kept
    return min(kept, max(signal_e, gains.threshold) + gains.sigma_d**2 + gains.ratio**2 / (12 * s.gain**2))


def _switches(s: Sensor, most: float) -> bool:
    """Whether any charge is read at the low gain."""
    return s.dual_gain is not None and s.dual_gain.threshold - most < CLEAR * sqrt(most)


def _costs(s: Sensor, exposure: Exposure, low: float, high: float, limits: Limits) -> Costs:
    """The cost of leaving out each effect, per budget, at the worst signal in the range; and its description."""
    most = _most_charge(s, exposure, high, limits)
    dark, bright = (2 * _least_kept(s, x, most) for x in (low, high))
    dark_e = s.dark_e(exposure)
    views, width = limits.shared_views, limits.row_length
    costs: Costs = {
        "dark_current": ({SD: dark_e / dark, BIAS: s.gain * dark_e}, "shot noise and mean of the dark charge"),
        "dsnu": ({SD: views * s.dsnu**2 / dark}, f"fixed pattern, met in {views} views"),
        "prnu": ({SD: views * (s.prnu * high) ** 2 / bright}, f"fixed pattern, met in {views} views"),
        "row_noise": ({SD: width * s.sigma_row**2 / dark}, f"averaged over {width} pixels"),
        "column_noise": ({SD: width * s.sigma_column**2 / dark}, f"averaged over {width} pixels"),
        "banding": ({SD: width * (s.banding.amplitude**2 / 2 if s.banding else 0) / dark}, "row pattern"),
        "black_bias": ({BIAS: max(map(abs, s.rgb_bias))}, "error of the black level"),
        # E[N**2] = q**2 + q; the slope, which scales the noise, errs by twice as much as the signal
        "nonlinearity": ({SD: 2 * s.droop * (most + 1), SIGNAL: s.droop * (most + 1)}, "at the largest charge"),
    }
    o = s.optics
    hot = _hot_e(s, exposure, limits)
    costs["hot_pixels"] = ({SD: hot / dark, BIAS: s.gain * hot}, "in a hot pixel")
    costs["telegraph_noise"] = ({SD: _telegraph_variance(s, limits) / dark}, "in a pixel with telegraph noise")
    dimmest, brightest = _illumination(s)
    uneven = max(1 - dimmest, brightest - 1)
    costs["vignetting"] = ({SD: uneven / 2, SIGNAL: uneven}, "in the corners")
    kept = o.psf[len(o.psf) // 2][len(o.psf[0]) // 2] if o and o.psf else 1.0
    spill = (4 * o.crosstalk + (1 - kept)) * (high - low) if o else 0.0
    # of the light alone; bias of the brightest edge against its own noise: 4 c dS <= sqrt(2 eps V) in the first budget
    costs["crosstalk"] = ({SD: spill**2 / bright, BIAS: s.gain * spill}, "at the strongest edge")
    shown = 4 * s.coupling * (most - low)  # of any charge, a hot pixel's too
    # it also smooths the noise: (1 - 4 c)**2 + 4 c**2 of the variance, 1 - 4 c of the deviation
    costs["coupling"] = ({SD: 4 * s.coupling + shown**2 / bright, BIAS: s.gain * shown}, "at the strongest edge")
    levels = np.geomspace(low + 1, high + 1, 9) - 1
    least = np.array([_least_kept(s, level, most) for level in levels])
    for name, (sd, mean, title) in own.costs(s, exposure, levels, least).items():
        costs[name] = ({SD: sd, BIAS: s.gain * mean}, title)
    return costs


def _shapes(s: Sensor, low: float, most: float, limits: Limits, exempt: bool) -> list[Effect]:
    """Effects that a variance does not measure: tails, and effects near saturation, by the fullest pixel."""
    tails = 0.0
    if s.tukey_lambda is not None and s.sigma_d:
        tails = abs(excess_kurtosis(s.tukey_lambda)) * (s.sigma_d**2 / kept_variance(s, low)) ** 2
    # Skewness (1 / (6 sqrt(2 pi)) of it, by Edgeworth's expansion), plus the steps of whole electrons where the read
    # noise does not blur them; the largest possible distance, without any light, is 1
    skew = (0.0665 + 0.2 * exp(-2 * (pi * s.sigma_d) ** 2)) / sqrt(low) if low > 0 else inf
    full = max(0.0, CLEAR - _sd_to_white(s, most, limits))
    switch = inf if s.dual_gain is None else _ratio(s.dual_gain.threshold - most, sqrt(most))
    gains = max(0.0, CLEAR - switch)
    keep_tails, keep_poisson = tails > (0 if exempt else limits.kurtosis), exempt or skew > limits.distance
    return [
        _decided("read_tails", keep_tails, tails, limits.kurtosis, KURTOSIS, "Gaussian read noise without"),
        _decided("poisson", keep_poisson, min(skew, 1.0), limits.distance, DISTANCE, "normal shot noise without"),
        _decided("full_well", full > 0, full, 0.0, ROOM, "room between the brightest signal and saturation"),
        _decided("blooming", s.blooming and full > 0, full * s.blooming, 0.0, ROOM, "follows full well"),
        _decided("dual_gain", gains > 0, gains, 0.0, ROOM, "room below the switch of the gains"),
    ]


def _sd_to_white(s: Sensor, charge_e: float, limits: Limits) -> float:
    return _ratio(s.capacity_e - charge_e, sqrt(_whole_variance(s, charge_e, limits)))


def _sd_to_black(s: Sensor, charge_e: float, lower: float, limits: Limits) -> float:
    """Of a pixel that effects from outside bring lower by so many electrons."""
    room = (s.black_level + min(s.rgb_bias)) / s.gain + charge_e - lower
    return _ratio(room, sqrt(_whole_variance(s, charge_e, limits)))


def _is_coarse(s: Sensor, low: float, most: float) -> bool:
    """Whether the noise is too small to blur the codes: the effect of rounding then depends on where between codes it
    lies.

    The mean of a code errs by at most f/pi DN, where f = exp(-S (1 - cos 2 pi K) - 2 (pi K R)**2) is the characteristic
    function of shot and read noise at one cycle per code. Below f = exp(-7), 0.0003 DN, rounding just adds 1/12 DN**2.
    """
    reads = [(low, s.gain, s.sigma_d)]
    if s.dual_gain and _switches(s, most):
        reads += [(max(low, s.dual_gain.threshold), s.gain / s.dual_gain.ratio, s.dual_gain.sigma_d)]
    return any(e * (1 - cos(2 * pi * gain)) + 2 * (pi * gain * sd) ** 2 < 7 for e, gain, sd in reads)


def _whole_variance(s: Sensor, charge_e: float, limits: Limits) -> float:
    """Variance of the worst pixel with all that the camera adds, at a mean charge. e-**2."""
    lines = s.sigma_row**2 + s.sigma_column**2 + (s.banding.amplitude**2 if s.banding else 0.0)
    return kept_variance(s, charge_e) + s.dsnu**2 + lines + _telegraph_variance(s, limits)


def simplify(sensor: Sensor, plan: Plan | None) -> Sensor:
    """The camera without the effects its plan leaves out; the others do not change."""
    off = {effect.name for effect in plan.effects if not effect.on} if plan else set[str]()
    if off & sensor.effects.keys():
        sensor = replace(sensor, effects={name: of for name, of in sensor.effects.items() if name not in off})
    for name, without in REMOVE.items():
        if name in off:
            sensor = without(sensor)
    return sensor


FAINT = 2.0**-60  # of an amplitude that another effect multiplies: no frame shows it, and scaling back is exact


def _without_dark_current(sensor: Sensor) -> Sensor:
    """Hot pixels, which multiply it, keep theirs."""
    d = sensor.defects
    if d is None or d.hot_fraction == 0 or d.hot_factor == 1:
        return replace(sensor, dark_current=0.0)
    hot = replace(d, hot_factor=d.hot_factor / FAINT)
    return replace(sensor, dark_current=FAINT * sensor.dark_current, defects=hot)


def _without_read_noise(sensor: Sensor) -> Sensor:
    """Telegraph pixels, which multiply it, keep their jumps, and a dual gain its steps."""
    d, gains = sensor.defects, sensor.dual_gain
    sensor = replace(sensor, dual_gain=replace(gains, sigma_d=0.0) if gains else None)
    if d is None or d.rts_fraction == 0 or d.rts_factor == 1:
        return replace(sensor, sigma_d=0.0)
    jumps = replace(d, rts_factor=sqrt(d.rts_factor**2 - 1) / FAINT)
    return replace(sensor, sigma_d=FAINT * sensor.sigma_d, defects=jumps)


def _without_full_well(sensor: Sensor) -> Sensor:
    """A non-linearity, which is relative to it, bends on: to where more light would give no more signal."""
    if sensor.nonlinearity == 0:
        return replace(sensor, mu_e_sat=inf, blooming=False)
    further = 0.499 / sensor.nonlinearity  # `Sensor` takes less than a half
    return replace(sensor, mu_e_sat=further * sensor.mu_e_sat, nonlinearity=0.499, blooming=False)


def _clear(**fields: Any) -> Callable[[Sensor], Sensor]:
    return lambda sensor: replace(sensor, **fields)


def _clear_part(part: str, **fields: Any) -> Callable[[Sensor], Sensor]:
    def without(sensor: Sensor) -> Sensor:
        value = getattr(sensor, part)
        return sensor if value is None else replace(sensor, **{part: replace(value, **fields)})

    return without


# Order matters: an effect that depends on another is removed before it
REMOVE: dict[str, Callable[[Sensor], Sensor]] = {
    "hot_pixels": _clear_part("defects", hot_fraction=0.0),
    "dark_current": _without_dark_current,
    "telegraph_noise": _clear_part("defects", rts_fraction=0.0),
    "dual_gain": _clear(dual_gain=None),
    "read_tails": _clear(tukey_lambda=None),
    "read_noise": _without_read_noise,
    "nonlinearity": _clear(nonlinearity=0.0),
    "blooming": _clear(blooming=False),
    "full_well": _without_full_well,
    "dsnu": _clear(dsnu=0.0),
    "prnu": _clear(prnu=0.0),
    "row_noise": _clear(sigma_row=0.0),
    "column_noise": _clear(sigma_column=0.0),
    "banding": _clear(banding=None),
    "black_bias": _clear(rgb_bias=(0.0, 0.0, 0.0)),
    "vignetting": _clear_part("optics", corner_angle=0.0, falloff=None),
    "crosstalk": _clear_part("optics", crosstalk=0.0, psf=None),
    "coupling": _clear(coupling=0.0),
}


def _decided(name: str, on: bool, contribution: float, bound: float, unit: str, reason: str) -> Effect:
    return Effect(name=name, on=on, forced=False, contribution=contribution, bound=bound, unit=unit, reason=reason)


def _worst(cost: dict[str, float], budgets: dict[str, float]) -> tuple[float, str]:
    """The largest share of a budget that a cost takes, and that budget."""
    return max((_ratio(value, budgets[unit]), unit) for unit, value in cost.items())


def _ratio(a: float, b: float) -> float:
    return a / b if b else (inf if a > 0 else 0.0)
