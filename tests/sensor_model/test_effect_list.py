"""Every effect of the list has all its parts, and they agree: parameters, sampler, moments, planner, fused, noise.

`CASES` has a camera with each effect, the same camera without, and what the effect changes, worked out by hand. A new
effect needs a row in `EFFECT_LIST` and a case here; the tests below then fail until its other parts are there.
"""

import sys
from dataclasses import dataclass, field, fields, replace
from functools import cache, reduce
from importlib import import_module
from math import inf, nan, radians, sqrt, tan
from typing import Any

import numpy as np
import pytest
from scipy import stats

from sensor_model import (
    Banding,
    Defects,
    DualGain,
    Exposure,
    Limits,
    Sensor,
    SensorOptics,
    expose,
    plan_effects,
    raw_noise,
)
from sensor_model.effect_list import EFFECT_LIST, ELSEWHERE, SHARED, STRUCTURAL, EffectParts
from sensor_model.effects import excess_kurtosis
from sensor_model.files.camera_file import PARTS
from sensor_model.planner import BIAS, DISTANCE, KURTOSIS, REMOVE, ROOM, SD, SIGNAL, _costs, kept_variance

FIELDS = {name: parts for name, parts in EFFECT_LIST.items() if isinstance(parts, EffectParts)}
FRAMES = 300
SHAPE = (12, 16)
EXPOSURE = Exposure(time=0.5, temperature=32.0)
K = 2.0  # DN/e-
BASE: dict[str, Any] = {
    "gain": K, "eta": 0.5, "mu_e_sat": inf, "black_level": 200.0, "bits": 16, "sigma_d": 1.5, "cfa": None, "serial": 5,
}  # fmt: skip
EVERYWHERE = (slice(None), slice(None))


@dataclass(frozen=True, kw_only=True)
class Case:
    """One effect at work."""

    effect: str
    on: dict[str, Any] = field(default_factory=dict)  # fields of `Sensor` that switch it on
    base: dict[str, Any] = field(default_factory=dict)  # fields that both cameras have
    light: Any = 0.0  # charge that the light frees, e-; a number, or one per pixel
    shape: tuple[int, int] = SHAPE
    at: tuple[slice, slice] = EVERYWHERE  # where the change is as stated
    changes: dict[int, float]  # what it adds to the mean (1), and to the 2nd, 3rd and 4th central moment; DN**power
    shot: str = "poisson"  # of the frame without the effect
    bounded: bool = True  # whether the planner's cost, which is for the worst pixel, is for all pixels of `at`

    @property
    def cameras(self) -> tuple[Sensor, Sensor]:
        """With the effect and without."""
        return Sensor(**(BASE | self.base | self.on)), Sensor(**(BASE | self.base))

    @property
    def electrons(self):
        """Charge that the light frees in each pixel, e-."""
        return np.broadcast_to(np.asarray(self.light, float), self.shape)

    @property
    def signal(self) -> tuple[float, float]:
        """Lowest and highest."""
        return float(self.electrons.min()), float(self.electrons.max())


def point(electrons):
    """20 electrons everywhere but in one pixel."""
    light = np.full(SHAPE, 20.0)
    light[6, 8] = electrons
    return light


def bent_moments(mu, droop):
    """Mean and variance of n - droop n**2 over the Poisson distribution, summed, e- and e-**2."""
    n = np.arange(int(3 * mu))
    p, y = stats.poisson.pmf(n, mu), n - droop * n**2
    return p @ y, p @ y**2 - (p @ y) ** 2


BENT_MEAN, BENT_VARIANCE = bent_moments(800.0, 0.1 / 4000)
CORNER = np.hypot(5.5, 7.5) / np.hypot(6, 8)  # radius of the corner pixel, of the frame's
COS4 = (1 + (CORNER * tan(radians(15.0))) ** 2) ** -2
TABLE = np.interp(np.hypot(23.5, 31.5) / np.hypot(24, 32), [0, 0.5, 1], [1, 0.95, 0.9])
FIRST = (slice(0, 1), slice(0, 1))
RIGHT = (slice(6, 7), slice(9, 10))  # of the bright point
HOT = 20.0 * 4  # e- more in a pixel five times as hot: 10 e-/s in half a second, two doublings over 20 deg C

CASES = (
    Case(effect="photon_shot", light=400.0, changes={1: 0, 2: K**2 * 400}, shot="none"),
    Case(
        effect="poisson", base={"gain": 8.0, "sigma_d": 0.2, "black_level": 80.0}, light=3.0,
        changes={1: 0, 2: 0, 3: 8.0**3 * 3}, shot="normal",
    ),
    Case(effect="read_noise", base={"sigma_d": 0.0}, on={"sigma_d": 1.5}, changes={1: 0, 2: K**2 * 1.5**2 + 1 / 12}),
    Case(
        effect="read_tails", base={"sigma_d": 3.0, "black_level": 45.0}, on={"tukey_lambda": -0.05},
        changes={1: 0, 2: 0, 4: excess_kurtosis(-0.05) * (3.0 * K) ** 4},
    ),
    Case(
        effect="dark_current", on={"dark_current": 10.0, "dark_temperature": 26.0, "dark_doubling": 3.0},
        changes={1: K * 20, 2: K**2 * 20},
    ),
    Case(effect="dsnu", on={"dsnu": 4.0}, shape=(60, 80), changes={1: 0, 2: K**2 * 16}),
    Case(effect="prnu", on={"prnu": 0.05}, light=400.0, shape=(60, 80), changes={1: 0, 2: K**2 * 20.0**2}),
    Case(effect="row_noise", on={"sigma_row": 2.0}, changes={1: 0, 2: K**2 * 4}),
    Case(effect="column_noise", on={"sigma_column": 2.5}, changes={1: 0, 2: K**2 * 6.25}),
    Case(effect="banding", on={"banding": Banding(amplitude=6.0, period=7.0)}, changes={1: 0, 2: K**2 * 18}),
    Case(
        effect="black_bias", base={"cfa": "GBRG"}, on={"rgb_bias": (5.0, -3.0, 2.0)},
        at=(slice(1, None, 2), slice(0, None, 2)), changes={1: 5, 2: 0},
    ),
    Case(
        effect="nonlinearity", base={"mu_e_sat": 4000.0}, on={"nonlinearity": 0.1}, light=800.0,
        changes={1: K * (BENT_MEAN - 800), 2: K**2 * (BENT_VARIANCE - 800)},
    ),
    Case(
        effect="hot_pixels", base={"dark_current": 10.0}, on={"defects": Defects(hot_fraction=1.0, hot_factor=5.0)},
        changes={1: K * HOT, 2: K**2 * HOT},
    ),
    Case(
        effect="hot_pixels", base={"dark_current": 10.0}, on={"defects": Defects(hot_fraction=0.3, hot_factor=5.0)},
        changes={1: K * 0.3 * HOT, 2: K**2 * (0.3 * HOT + 0.3 * 0.7 * HOT**2)}, bounded=False,
    ),
    Case(
        effect="telegraph_noise", on={"defects": Defects(rts_fraction=0.4, rts_factor=3.0, rts_traps=2)},
        changes={1: 0, 2: K**2 * 0.4 * (3.0**2 - 1) * 1.5**2},
    ),
    Case(
        effect="vignetting", on={"optics": SensorOptics(corner_angle=15.0)}, light=400.0, at=FIRST,
        changes={1: K * 400 * (COS4 - 1), 2: K**2 * 400 * (COS4 - 1)},
    ),
    Case(
        effect="vignetting", on={"optics": SensorOptics(falloff=(1.0, 0.95, 0.9), sensor_shape=(48, 64))}, light=400.0,
        at=FIRST, changes={1: K * 400 * (TABLE - 1), 2: K**2 * 400 * (TABLE - 1)},
    ),
    Case(
        effect="crosstalk", on={"optics": SensorOptics(crosstalk=0.02)}, light=point(4000.0), at=RIGHT,
        changes={1: K * 0.02 * 3980, 2: K**2 * 0.02 * 3980},
    ),
    Case(
        effect="crosstalk", on={"optics": SensorOptics(psf=((0.0, 0.0, 0.0), (0.0, 0.95, 0.05), (0.0, 0.0, 0.0)))},
        light=point(4000.0), at=RIGHT, changes={1: K * 0.05 * 3980, 2: K**2 * 0.05 * 3980},
    ),
    Case(
        effect="coupling", on={"coupling": 0.03}, light=400.0, at=(slice(1, -1), slice(1, -1)),
        changes={1: 0, 2: K**2 * 400 * (0.88**2 + 4 * 0.03**2 - 1)},
    ),
    Case(effect="full_well", on={"mu_e_sat": 500.0}, light=1000.0, changes={1: -K * 500, 2: -(K**2) * 1000}),
    Case(
        effect="blooming", base={"mu_e_sat": 500.0}, on={"blooming": True}, light=point(40_000.0),
        at=(slice(7, 12), slice(8, 9)), changes={1: K * 480, 2: -(K**2) * 20},
    ),
    Case(
        effect="dual_gain", on={"dual_gain": DualGain(threshold=300.0, sigma_d=9.0, ratio=8.0)}, light=800.0,
        changes={1: 0, 2: K**2 * (81 - 2.25) + (8.0**2 - 1) / 12},
    ),
)  # fmt: skip
each_case = pytest.mark.parametrize("index", range(len(CASES)), ids=[case.effect for case in CASES])
each_effect = pytest.mark.parametrize("name", list(FIELDS))


def take(case, sensor, frame=0, **how):
    return expose(case.electrons / sensor.eta, sensor, EXPOSURE, seed=2, view=0, frame=frame, threads=1, **how)


@cache
def samples(index, on):
    """Codes [frames, h, w] of one case with or without its effect."""
    case = CASES[index]
    sensor, shot = (case.cameras[0], "poisson") if on else (case.cameras[1], case.shot)
    return np.stack([take(case, sensor, i, shot=shot).dn for i in range(FRAMES)]).astype(np.float64)


def central_moment(values, power):
    """Mean (power 1) or central moment of all values [frames, h, w], and a standard error that allows for noise which
    frames, pixels, rows or columns have in common."""
    terms = values if power == 1 else (values - values.mean()) ** power
    n, h, w = terms.shape
    parts = [(terms.mean((1, 2)), n), (terms.mean(0), h * w), (terms.mean((0, 2)), h), (terms.mean((0, 1)), w)]
    return terms.mean(), sqrt(sum(part.var() / count for part, count in parts))


def resolve(path):
    """The module or class, and the name in it, of a function given relative to the package."""
    owner, name = path.rsplit(".", 1)
    try:
        return import_module(f"sensor_model.{owner}"), name
    except ModuleNotFoundError:
        module, kind = owner.rsplit(".", 1)
        return getattr(import_module(f"sensor_model.{module}"), kind), name


def calls(monkeypatch, path, action):
    """How often `action` calls a function of the package, under whatever name its modules have imported it."""
    owner, name = resolve(path)
    original, count = getattr(owner, name), []

    def counting(*args, **kwargs):
        count.append(name)
        return original(*args, **kwargs)

    modules = [m for key, m in sys.modules.items() if key.startswith("sensor_model")]
    with monkeypatch.context() as patch:
        for place in (owner, *modules):
            if getattr(place, name, None) is original:
                patch.setattr(place, name, counting)
        action()
    return len(count)


def flat(sensor):
    """All parameters by name, those of parts with a dot; parts that are off have none."""
    own = {f.name: getattr(sensor, f.name) for f in fields(sensor) if f.name not in PARTS}
    parts = {name: getattr(sensor, name) for name in PARTS if getattr(sensor, name) is not None}
    return own | {f"{name}.{f.name}": getattr(part, f.name) for name, part in parts.items() for f in fields(part)}


def switched(case):
    """Names of the parameters in which its two cameras differ."""
    on, off = (flat(sensor) for sensor in case.cameras)
    default = {f"{name}.{f.name}": f.default for name, kind in PARTS.items() for f in fields(kind)}
    return {name for name, value in on.items() if value != off.get(name, default.get(name))}


def test_every_parameter_of_the_camera_belongs_to_one_effect_or_to_the_camera_itself():
    known = [name for parts in FIELDS.values() for name in parts.fields] + [*STRUCTURAL, *ELSEWHERE]
    plain = {f.name for f in fields(Sensor) if f.name not in PARTS}
    inside = {f"{name}.{f.name}" for name, kind in PARTS.items() for f in fields(kind)}
    assert sorted(known) == sorted(plain | inside)


def test_planner_and_list_know_the_same_effects():
    names = plan_effects(Sensor(**BASE), EXPOSURE, 10.0).names
    assert sorted(names) == sorted(FIELDS)
    assert sorted(REMOVE) == sorted(set(FIELDS) - {"photon_shot", "poisson"})  # these two are settings of `expose`


@each_effect
def test_the_cases_switch_every_parameter_of_the_effect_and_no_other(name):
    cases = [switched(case) for case in CASES if case.effect == name]
    assert cases
    assert reduce(set.union, cases) == set(FIELDS[name].fields)


BAD = {
    "blooming": "yes", "rgb_bias": (nan,) * 3, "optics.falloff": (1.0, nan), "optics.psf": ((nan,),),
    "optics.sensor_shape": (0, 5),
}  # fmt: skip


@pytest.mark.parametrize("parameter", [name for parts in FIELDS.values() for name in parts.fields])
def test_every_parameter_is_validated(parameter):
    camera = next(case.cameras[0] for case in CASES if parameter in switched(case))
    part, _, name = parameter.rpartition(".")
    with pytest.raises(ValueError, match=rf"^{name} must be .* got"):
        replace(getattr(camera, part) if part else camera, **{name: BAD.get(parameter, nan)})


@each_case
def test_switching_an_effect_on_changes_the_frames_as_stated(index):
    case = CASES[index]
    on, off = (samples(index, switch)[:, case.at[0], case.at[1]] for switch in (True, False))
    noticed = False
    for power, change in case.changes.items():
        (with_it, error), (without, error_off) = central_moment(on, power), central_moment(off, power)
        assert with_it - without == pytest.approx(change, abs=5 * np.hypot(error, error_off) + 1e-9), power
        noticed |= abs(change) > 5 * np.hypot(error, error_off)
    assert noticed, "too few frames to see the effect"


@each_case
def test_sampled_frames_have_the_analytic_mean_and_variance(index):
    case = CASES[index]
    frame, values = take(case, case.cameras[0]), samples(index, True)
    mean, variance = (m.astype(np.float64)[case.at] for m in (frame.mean_dn, frame.variance_dn))
    values = values[:, case.at[0], case.at[1]]
    assert (np.abs(values.mean(0) - mean) <= 5 * np.sqrt(variance / FRAMES) + 1e-3).all()
    # of each pixel, and more sharply of all together: a term of a few per cent would hide in the former
    square = (values - values.mean(0)) ** 2 * FRAMES / (FRAMES - 1)
    error = np.sqrt((square**2).mean(0) - square.mean(0) ** 2) / np.sqrt(FRAMES)
    assert (np.abs(square.mean(0) - variance) <= 5 * error + 0.05 * variance + 2e-3).all()
    per_frame = square.mean((1, 2))
    assert square.mean() == pytest.approx(variance.mean(), abs=5 * per_frame.std() / np.sqrt(FRAMES) + 1e-3)


@each_case
def test_the_functions_of_the_list_are_the_ones_at_work(index, monkeypatch):
    case = CASES[index]
    parts, camera = FIELDS[case.effect], case.cameras[0]
    assert calls(monkeypatch, parts.sampled, lambda: take(case, camera, backend="numpy"))
    assert calls(monkeypatch, parts.moments, lambda: take(case, camera).mean_dn)
    if parts.fused != SHARED:
        owner, name = resolve(parts.fused)
        assert callable(getattr(owner, name))


@pytest.mark.parametrize("shot", ["poisson", "normal", "none"])
@each_case
def test_the_fused_chain_gives_the_frame_of_the_reference(index, shot):
    case = CASES[index]
    fast, plain = (take(case, case.cameras[0], shot=shot, backend=b) for b in ("numba", "numpy"))
    np.testing.assert_array_equal(fast.dn, plain.dn)
    np.testing.assert_array_equal(fast.saturated, plain.saturated)


@each_case
def test_a_plan_without_the_effect_gives_the_frame_of_the_camera_without_it(index):
    case = CASES[index]
    on, off = case.cameras
    plan = plan_effects(on, EXPOSURE, case.signal, 0.01)
    assert plan.is_on(case.effect)
    without = plan.force(on=plan.names, off=[case.effect])
    np.testing.assert_array_equal(take(case, on, plan=without).dn, take(case, off, shot=case.shot).dn)
    assert (take(case, on).dn != take(case, off, shot=case.shot).dn).any()


# What is the same in every pixel, which their costs say to the digit: an effect that costs too much is never left out
EVEN = ("dark_current", "dsnu", "prnu", "row_noise", "column_noise", "banding", "hot_pixels")


def costs_cover(case):
    """Whether what leaving an effect out costs, by the planner, is at least what the case says that it changes."""
    on, off = case.cameras
    cost, _ = _costs(on, EXPOSURE, *case.signal, Limits(sd=0.01))[case.effect]
    mean, variance = abs(case.changes[1]), case.changes[2]
    if BIAS in cost:
        assert mean <= cost[BIAS]
    elif SIGNAL in cost:
        assert mean <= 1.01 * cost[SIGNAL] * K * case.signal[1]  # of first order in the bend of the response
    else:
        variance += mean**2
    kept = K**2 * kept_variance(off, case.signal[1])
    if case.effect in EVEN:
        assert cost[SD] == pytest.approx(case.changes[2] / (2 * kept))
    assert abs(sqrt(1 + variance / kept) - 1) <= 1.01 * cost.get(SD, 0.0)
    return True


def distance_from_normal(mu, sigma_d):
    """Kolmogorov distance of Poisson and read noise from the normal distribution of their variance."""
    k, x = np.arange(60), np.linspace(-5, 25, 20_001)[:, None]
    exact = stats.norm.cdf((x - k) / sigma_d) @ stats.poisson.pmf(k, mu)
    return np.abs(exact - stats.norm.cdf(x[:, 0], mu, np.hypot(np.sqrt(mu), sigma_d))).max()


@pytest.mark.parametrize("index", [i for i, c in enumerate(CASES) if c.bounded], ids=lambda i: CASES[i].effect)
def test_what_the_planner_says_an_effect_costs_covers_what_it_changes(index):
    case = CASES[index]
    on, off = case.cameras
    planned = plan_effects(on, EXPOSURE, case.signal, 0.01)[case.effect]
    if case.effect in ("photon_shot", "read_noise"):
        assert plan_effects(on, EXPOSURE, case.signal, 1e9).is_on(case.effect)
        own = case.signal[0] if case.effect == "photon_shot" else on.sigma_d**2
        assert planned.contribution == pytest.approx(own / (2 * kept_variance(on, case.signal[0])))
    elif planned.unit == KURTOSIS:
        spread = K**2 * kept_variance(on, case.signal[0])
        assert planned.contribution >= 0.999 * case.changes[4] / spread**2
    elif planned.unit == DISTANCE:
        assert planned.contribution >= distance_from_normal(case.signal[0], on.sigma_d) > 0
    elif planned.unit == ROOM:
        dim = replace(case, light=30.0)
        assert planned.contribution > 0
        assert plan_effects(on, EXPOSURE, dim.signal, 0.01)[case.effect].contribution == 0
        np.testing.assert_array_equal(take(dim, on).dn, take(dim, off).dn)
    else:
        assert costs_cover(case)


@pytest.mark.parametrize(
    "index",
    [i for i, c in enumerate(CASES) if c.effect in FIELDS and FIELDS[c.effect].in_noise],
    ids=lambda i: CASES[i].effect,
)
def test_the_noise_that_methods_see_changes_as_stated(index):
    """At the means of the sampled frames, which have an error of their own."""
    case = CASES[index]
    on, off = case.cameras
    plans = [plan_effects(s, EXPOSURE, case.signal) for s in (on, off)]
    names = plans[0].names
    dark = {"none": ["photon_shot"], "normal": ["poisson"], "poisson": []}[case.shot]
    plans = [plans[0].force(on=names), plans[1].force(on=names, off=dark)]
    with_it, without = (
        raw_noise(s, EXPOSURE, channels=3 if s.cfa else 1, plan=plan).variance(
            np.full(3 if s.cfa else 1, samples(index, switch)[:, case.at[0], case.at[1]].mean())
        )[0]
        for s, plan, switch in zip((on, off), plans, (True, False), strict=True)
    )
    error = 5 * on.gain * central_moment(samples(index, True)[:, case.at[0], case.at[1]], 1)[1]
    assert with_it - without == pytest.approx(case.changes[2], abs=2 * error + 0.01 * abs(case.changes[2]) + 1e-6)
