"""The planner's bounds in closed form: on cameras and exposures that nobody chose, planned against whole; and what it
counts, written out: each cost at its worst signal, in its own unit, at the gain that reads it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from sensor_model import (
    Banding,
    Defects,
    DualGain,
    Exposure,
    Limits,
    Plan,
    Sensor,
    SensorOptics,
    expose,
    plan_effects,
    planner,
)
from sensor_model.effect_list import EFFECT_LIST, OwnEffect
from sensor_model.frame import pattern
from sensor_model.planner import BIAS, SD, SIGNAL

SHAPE = (8, 12)
PIXELS = SHAPE[0] * SHAPE[1]
CAMERAS = 200
BATCHES = 10


def draw(rng: np.random.Generator) -> tuple[Sensor, Exposure, tuple[float, float], float]:
    """A camera, an exposure, the range of the signal in e-, a tolerance; extremes are as likely as anything."""

    def log(a: float, b: float) -> float:
        return float(np.exp(rng.uniform(math.log(a), math.log(b))))

    def maybe(value, off, p: float = 0.6):
        return value if rng.random() < p else off

    bits = int(rng.integers(8, 17))
    full = maybe(log(50, 1e5), math.inf, 0.85)
    sensor = Sensor(
        gain=log(0.02, 20), eta=float(rng.uniform(0.1, 1)), mu_e_sat=full, bits=bits, cfa=None,
        black_level=maybe(float(rng.uniform(0, 0.2)) * 2**bits, 0.0, 0.8), sigma_d=maybe(log(0.3, 30), 0.0, 0.9),
        tukey_lambda=maybe(float(rng.uniform(-0.24, 1)), None, 0.3),
        sigma_row=maybe(log(0.01, 3), 0.0), sigma_column=maybe(log(0.01, 3), 0.0),
        dsnu=maybe(log(0.01, 10), 0.0), prnu=maybe(log(1e-4, 0.1), 0.0), dark_current=maybe(log(1e-3, 1e3), 0.0, 0.8),
        nonlinearity=maybe(log(1e-4, 0.3), 0.0, 0.4) if math.isfinite(full) else 0.0,
        blooming=bool(rng.random() < 0.3), coupling=maybe(log(1e-5, 0.02), 0.0, 0.3),
        rgb_bias=(0.0, maybe(float(rng.uniform(-3, 3)), 0.0, 0.4), 0.0),
        banding=maybe(Banding(amplitude=log(0.01, 3), period=7.3), None, 0.3),
        defects=maybe(
            Defects(
                hot_fraction=log(0.02, 0.2), hot_factor=log(1, 1e4), rts_fraction=log(0.02, 0.2),
                rts_factor=log(1, 10), rts_traps=int(rng.integers(1, 5)),
            ),
            None, 0.7,
        ),
        optics=maybe(
            SensorOptics(corner_angle=float(rng.uniform(0, 30)), crosstalk=maybe(log(1e-5, 0.02), 0.0)), None, 0.3
        ),
        dual_gain=maybe(DualGain(threshold=log(20, 1e4), sigma_d=log(1, 30), ratio=log(1, 16)), None, 0.2),
        serial=int(rng.integers(1 << 30)),
    )  # fmt: skip
    exposure = Exposure(time=log(1e-4, 600), temperature=float(rng.uniform(-20, 60)))
    ends = min(sensor.capacity_e, 1e6) * np.exp(rng.uniform(math.log(1e-5), math.log(2), 2))
    return sensor, exposure, (float(ends.min()), float(ends.max())), float(rng.choice([0.01, 0.05, 0.3]))


def kinds(sensor: Sensor, exposure: Exposure) -> dict[str, np.ndarray]:
    """Pixels [h, w] that share a distribution but for their fixed pattern."""
    dark = pattern.dark_map(sensor, sensor.dark_e(exposure), (*SHAPE, 1), (0, 0))
    hot = np.zeros(SHAPE, bool) if dark is None else dark[..., 0] > dark.min()
    telegraph = np.zeros(SHAPE, bool)
    if (sites := pattern.telegraph_sites(sensor, (*SHAPE, 1), (0, 0))) is not None:
        telegraph[sites[:2]] = True
    return {"hot": hot & ~telegraph, "telegraph": telegraph & ~hot, "both": hot & telegraph, "rest": ~hot & ~telegraph}


def moments(light_e: np.ndarray, sensor: Sensor, exposure: Exposure, plan: Plan | None):
    frame = expose(light_e / sensor.eta, sensor, exposure, seed=1, view=0, plan=plan)
    return frame.mean_dn.astype(np.float64), frame.variance_dn.astype(np.float64)


def violations(sensor: Sensor, exposure: Exposure, signal: tuple[float, float], tolerance: float) -> list[str]:
    """What the plan's bounds promise and the closed form does not keep."""
    plan = plan_effects(sensor, exposure, signal, Limits(sd=tolerance, pixels=PIXELS))
    bias, slope = plan.biases["DN of bias"], plan.biases["relative signal"] * sensor.gain
    factor = sensor.defects.hot_factor if sensor.defects else 1.0
    charge = signal[1] * (1 + 5 * sensor.prnu) + factor * sensor.dark_e(exposure)
    # What fixed pattern was left out moves single pixels, and means over few; its variance is in the first budget
    pattern_dn = sensor.gain * math.hypot(
        0.0 if plan.is_on("dsnu") else sensor.dsnu, 0.0 if plan.is_on("prnu") else sensor.prnu * signal[1]
    )
    # DN, and relative: the closed form takes charge that reaches across pixels as normal, and its sums are float32
    rounding, spread = (0.02, 0.05) if sensor.coupling or sensor.blooming else (5e-3, 2e-3)
    found = []
    for level in signal:
        light = np.full(SHAPE, level)
        (mean, variance), (planned, planned_variance) = (moments(light, sensor, exposure, p) for p in (None, plan))
        for kind, members in kinds(sensor, exposure).items():
            if not members.any():
                continue
            off = abs((mean - planned)[members].mean())
            chance = 5 * pattern_dn / math.sqrt(members.sum())
            if off > bias + slope * charge + chance + rounding + 3e-5 * mean.max():
                found.append(f"{kind} at {level:.3g} e-: mean {off:.3g} DN off, stated {bias + slope * charge:.3g}")
            sd, planned_sd = (math.sqrt(v[members].mean()) for v in (variance, planned_variance))
            # A hundredth of a code is what is left of the noise of a full pixel
            if abs(sd - planned_sd) > (plan.bound + spread + slope / sensor.gain) * planned_sd + 1e-2 * (sd < 0.02):
                found.append(f"{kind} at {level:.3g} e-: deviation {sd / planned_sd - 1:.3g}, stated {plan.bound:.3g}")
    light = np.full(SHAPE, signal[0])
    light[2::4, 2::4] = light[:, 6:8] = signal[1]
    (mean, _), (planned, _) = (moments(light, sensor, exposure, p) for p in (None, plan))
    off = np.abs(mean - planned).max()
    if off > bias + slope * charge + 5.5 * pattern_dn + rounding + 3e-5 * mean.max():
        found.append(f"edges: {off:.3g} DN off, stated {bias + slope * charge:.3g}")
    return found


@pytest.mark.parametrize("batch", range(BATCHES))
def test_a_plan_keeps_its_bounds_for_any_camera_exposure_and_signal(batch: int) -> None:
    """Rationale: promise 3 to the user. Dark charge, hot pixels and clipping included."""
    for k in range(batch, CAMERAS, BATCHES):
        case = draw(np.random.default_rng([7, k]))
        assert violations(*case) == [], f"camera {k}: {case}"


def test_the_random_cameras_meet_every_regime() -> None:
    """Else the bounds would be kept for want of anything to plan."""
    plans = []
    for k in range(CAMERAS):
        sensor, exposure, signal, tolerance = draw(np.random.default_rng([7, k]))
        plans.append(plan_effects(sensor, exposure, signal, Limits(sd=tolerance, pixels=PIXELS)))
    for name in plans[0].names[2:]:
        assert any(plan.is_on(name) for plan in plans), name
    left_out = {e.name for plan in plans for e in plan.effects if not e.on and e.contribution > 0}
    assert {"dark_current", "hot_pixels", "prnu", "dsnu", "row_noise", "nonlinearity", "telegraph_noise"} <= left_out
    assert 20 < sum(plan["full_well"].on for plan in plans) < 180


def warm(**more) -> tuple[Sensor, Exposure]:
    """A minute at 60 degrees: 20 e-/s at 20 degrees double six times and more."""
    sensor = Sensor(
        gain=2.0, eta=0.6, mu_e_sat=2000.0, black_level=200.0, bits=13, sigma_d=2.0, cfa=None, dark_current=0.2, **more
    )
    return sensor, Exposure(time=60.0, temperature=60.0)


def test_dark_charge_counts_towards_full_well() -> None:
    """The light alone stays far below saturation; with 1,219 e- of dark charge the brightest pixels are full."""
    sensor, exposure = warm()
    assert sensor.dark_e(exposure) == pytest.approx(12 * 2 ** (40 / 6))
    plan = plan_effects(sensor, exposure, [5.0, 900.0], 0.05)
    assert plan.is_on("full_well")
    light = np.full(SHAPE, 900.0)
    whole, planned = (moments(light, sensor, exposure, p)[0] for p in (None, plan))
    np.testing.assert_allclose(planned, whole, atol=1e-3)
    assert not plan_effects(sensor, Exposure(time=1 / 30), [5.0, 900.0], 0.05).is_on("full_well")


def test_hot_pixels_count_towards_full_well_where_there_are_any() -> None:
    sensor, exposure = warm(defects=Defects(hot_fraction=0.05, hot_factor=3.0))
    limits = Limits(sd=0.05, pixels=PIXELS)
    assert plan_effects(sensor, exposure, [5.0, 100.0], limits).is_on("full_well")
    sensor, exposure = warm(defects=Defects(hot_fraction=1e-6, hot_factor=3.0))
    assert not plan_effects(sensor, exposure, [5.0, 100.0], limits).is_on("full_well")


def test_hot_pixels_beside_dark_ones_take_little_memory() -> None:
    """Their codes are summed over the electrons they may hold: not over all from the darkest to the hottest pixel."""
    import tracemalloc

    sensor, exposure = warm(defects=Defects(hot_fraction=0.1, hot_factor=3000.0), blooming=True, dsnu=0.1)
    tracemalloc.start()
    try:
        moments(np.full(SHAPE, 5.0), sensor, exposure, None)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 500e6


EXPOSURE = Exposure(time=0.05)
LOW, HIGH = 20.0, 700.0
DIM = 0.8  # of even light, in the dimmest pixels behind the lens of CAMERA
LIMITS = Limits(sd=0.05, row_length=7, shared_views=3)
CAMERA = Sensor(
    gain=3.0, eta=0.6, mu_e_sat=2000.0, black_level=200.0, bits=14, sigma_d=4.0, cfa=None, sigma_row=5.0,
    sigma_column=2.0, dsnu=1.5, prnu=0.05, dark_current=200.0, nonlinearity=0.1, rgb_bias=(5.0, -7.0, 1.0),
    banding=Banding(amplitude=5.0, period=9), optics=SensorOptics(falloff=(1.0, DIM, 0.9), crosstalk=0.05),
    defects=Defects(hot_fraction=0.05, hot_factor=30, rts_fraction=0.05, rts_factor=4), coupling=0.02,
    dual_gain=DualGain(threshold=500.0, sigma_d=1.0, ratio=8.0),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class NoSettings:
    """Of an effect that has none."""


@pytest.fixture
def glow() -> Iterator[str]:
    """An effect from outside that costs most at the signal that is brightest: it brings 0.01 S darker by 0.1 S."""
    EFFECT_LIST["glow"] = OwnEffect(
        title="glow", config=NoSettings, sample=lambda signal, pixels, settings: -0.1 * signal,
        mean=lambda signal, pixels, settings: -0.1 * signal, variance=lambda signal, pixels, settings: 0.01 * signal,
        cost=lambda signal, kept, exposure, settings: (0.01 * signal / kept, 0.1 * signal),
    )  # fmt: skip
    yield "glow"
    del EFFECT_LIST["glow"]


def test_every_cost_is_the_one_written_out(glow: str) -> None:
    """At 20 e- the high gain reads with less noise, at 700 e- the low one."""
    dark_e, hot = 10.0, 290.0
    most = HIGH * (1 + 5 * 0.05) + dark_e + hot
    most += 0.1 * most + 5 * math.sqrt(0.01 * most)
    dark = 2 * (LOW + 16 + 1 / 108)
    bright = 2 * (HIGH + 1 + 64 / 108)
    spill, shown = 4 * 0.05 * (HIGH - LOW), 4 * 0.02 * (most - LOW)
    found = planner._costs(replace(CAMERA, effects={glow: {}}), EXPOSURE, LOW, HIGH, LIMITS)
    wanted = {
        "dark_current": {SD: dark_e / dark, BIAS: 3 * dark_e},
        "dsnu": {SD: 3 * 1.5**2 / dark},
        "prnu": {SD: 3 * (0.05 * HIGH) ** 2 / bright},
        "row_noise": {SD: 7 * 25 / dark},
        "column_noise": {SD: 7 * 4 / dark},
        "banding": {SD: 7 * 12.5 / dark},
        "black_bias": {BIAS: 7},
        "nonlinearity": {SD: 2 * 5e-5 * (most + 1), SIGNAL: 5e-5 * (most + 1)},
        "hot_pixels": {SD: hot / dark, BIAS: 3 * hot},
        "telegraph_noise": {SD: 15 * 16 / dark},
        "vignetting": {SD: 0.1, SIGNAL: 0.2},
        "crosstalk": {SD: spill**2 / bright, BIAS: 3 * spill},
        "coupling": {SD: 0.08 + shown**2 / bright, BIAS: 3 * shown},
        "glow": {SD: 0.01 * HIGH / (bright / 2), BIAS: 3 * 0.1 * HIGH},
    }
    assert found.keys() == wanted.keys()
    for name, cost in wanted.items():
        assert found[name][0] == pytest.approx(cost, rel=1e-6), name


def test_an_effect_from_outside_that_costs_most_in_the_dark_counts_there(monkeypatch: pytest.MonkeyPatch) -> None:
    def cost(signal: Any, kept: Any, exposure: Exposure, settings: Any) -> tuple[Any, Any]:
        return 1 / kept, 5 / (1 + signal)

    row = OwnEffect(title="haze", config=NoSettings, sample=lambda signal, *_: 0 * signal,
                    mean=lambda signal, *_: 0 * signal, variance=lambda signal, *_: 0 * signal, cost=cost)  # fmt: skip
    monkeypatch.setitem(EFFECT_LIST, "haze", row)
    found = planner._costs(replace(CAMERA, effects={"haze": {}}), EXPOSURE, LOW, HIGH, LIMITS)["haze"][0]
    assert found == pytest.approx({SD: 1 / (LOW + 16 + 1 / 108), BIAS: 3 * 5 / (1 + LOW)}, rel=1e-6)


def test_shapes_count_at_the_darkest_signal_and_room_at_the_fullest_pixel() -> None:
    plan = plan_effects(replace(CAMERA, tukey_lambda=-0.1, dual_gain=None), EXPOSURE, [LOW / DIM, HIGH], LIMITS)
    kept = LOW + 16 + 1 / 108
    excess = planner.excess_kurtosis(-0.1)
    wanted: dict[str, Any] = {
        "photon_shot": LOW / (2 * kept), "read_noise": 16 / (2 * kept), "read_tails": abs(excess) * (16 / kept) ** 2,
        "poisson": 0.0665 / math.sqrt(LOW), "full_well": 0, "blooming": 0, "dual_gain": 0,
    }  # fmt: skip
    assert {name: plan[name].contribution for name in wanted} == pytest.approx(wanted)


@pytest.mark.parametrize("signal", [[-1.0, 5.0], [5.0, -1.0]])
def test_one_negative_signal_among_others_is_refused(signal: list[float]) -> None:
    with pytest.raises(ValueError, match="must be"):
        plan_effects(CAMERA, EXPOSURE, signal)


def test_room_above_black_is_that_of_the_darkest_channel_of_the_darkest_pixel() -> None:
    """In electrons, in units of all noise that one pixel can have."""
    variance = LOW + 16 + 1 / 108 + 1.5**2 + 5.0**2 + 2.0**2 + 5.0**2 + 15 * 16
    found = planner._sd_to_black(CAMERA, LOW, 3.0, LIMITS)
    assert found == pytest.approx(((200 - 7) / 3 + LOW - 3) / math.sqrt(variance))
    calm = replace(CAMERA, dual_gain=None, defects=None)
    assert not plan_effects(calm, EXPOSURE, [LOW, HIGH], 0.99).is_on("row_noise")
    assert plan_effects(replace(calm, black_level=50.0), EXPOSURE, [LOW, HIGH], 0.99).is_on("row_noise")


@pytest.mark.parametrize(
    ("signal", "gain", "read", "coarse"),
    [
        (6.0, 0.25, 0.0, True), (8.0, 0.25, 0.0, False),  # a cosine of 0: the signal alone says it
        (0.0, 0.2, 2.9, True), (0.0, 0.2, 3.0, False),  # no signal: the read noise alone does
    ],
)  # fmt: skip
def test_codes_are_coarse_where_shot_and_read_noise_leave_more_than_a_thousandth(
    signal: float, gain: float, read: float, coarse: bool
) -> None:
    sensor = replace(CAMERA, gain=gain, sigma_d=read, dual_gain=None)
    assert planner._is_coarse(sensor, signal, 100.0) == coarse


@pytest.mark.parametrize(("threshold", "coarse"), [(6.0, True), (8.0, False)])
def test_codes_of_the_low_gain_are_coarse_or_fine_from_its_threshold_on(threshold: float, coarse: bool) -> None:
    """The high gain, of 4 DN/e-, reads 1 e- with more noise than that; the low one has 0.25 DN/e-."""
    low = DualGain(threshold=threshold, sigma_d=0.0, ratio=16.0)
    sensor = replace(CAMERA, gain=4.0, dual_gain=low)
    assert planner._is_coarse(sensor, 1.0, 100.0) == coarse
    assert not planner._is_coarse(sensor, 8.0, 100.0)  # where no signal is as low as the threshold


@pytest.mark.parametrize(("signal", "coarse"), [(6.0, True), (8.0, False)])
def test_codes_of_the_high_gain_are_coarse_though_the_low_gain_reads_with_much_noise(
    signal: float, coarse: bool
) -> None:
    sensor = replace(CAMERA, gain=0.25, sigma_d=0.0, dual_gain=DualGain(threshold=20.0, sigma_d=30.0, ratio=4.0))
    assert planner._is_coarse(sensor, signal, 100.0) == coarse


def test_coarse_codes_of_the_darkest_signal_count_beside_bright_ones() -> None:
    sensor = replace(CAMERA, gain=0.25, sigma_d=0.0, dual_gain=None, defects=None, coupling=0.0, prnu=0.0, optics=None)
    on = [plan_effects(sensor, EXPOSURE, signal, 0.99).is_on("dsnu") for signal in ([6.0, 50.0], [8.0, 50.0])]
    assert on == [True, False]


def test_an_effect_that_makes_dark_pixels_darker_brings_them_near_to_black(glow: str) -> None:
    """By a tenth of 20 e- and 5 standard deviations of their noise, not by a tenth of 700 e-."""
    sensor = replace(CAMERA, effects={glow: {}}, dual_gain=None)
    lower = 0.1 * LOW + 5 * math.sqrt(0.01 * LOW)
    room = planner._sd_to_black(sensor, LOW, lower, LIMITS)
    black = sensor.black_level - sensor.gain * (room - 5.01) * math.sqrt(planner._whole_variance(sensor, LOW, LIMITS))
    for level, clips in ((black, False), (black - 0.1 * sensor.gain, False), (black - 9 * sensor.gain, True)):
        plan = plan_effects(replace(sensor, black_level=float(np.ceil(level))), EXPOSURE, [LOW / DIM, HIGH], 0.99)
        assert plan.is_on("row_noise") == clips
