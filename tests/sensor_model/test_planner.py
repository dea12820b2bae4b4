"""The planner's promise: what it leaves out changes the noise by no more than it says."""

import json
import math
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from sensor_model import (
    PRESETS,
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
)
from sensor_model.plan import Effect
from sensor_model.planner import kept_variance, simplify

EXPOSURE = Exposure(time=0.05)
CAMERAS = [name for name in PRESETS if not name.endswith("-3chip")]
LEVELS = (0.5, 2.0, 10.0, 50.0, 500.0)
EVERYTHING = Sensor(
    gain=2.0, eta=0.6, mu_e_sat=2000.0, black_level=200.0, bits=14, sigma_d=2.0, tukey_lambda=-0.1, cfa=None, serial=3,
    sigma_row=0.1, sigma_column=0.1, dsnu=0.3, prnu=0.005, dark_current=1.0, nonlinearity=0.001, rgb_bias=(0.1,) * 3,
    banding=Banding(amplitude=0.1, period=9), optics=SensorOptics(corner_angle=5, crosstalk=0.001), blooming=True,
    defects=Defects(hot_fraction=1e-4, hot_factor=30, rts_fraction=1e-3, rts_factor=1.1, rts_traps=2), coupling=2e-4,
)  # fmt: skip

DIM = math.cos(math.radians(5)) ** 4  # of even light, in its corners

LOUD = Sensor(
    gain=2.0, eta=0.6, mu_e_sat=2000.0, black_level=200.0, bits=14, sigma_d=4.0, tukey_lambda=-0.1, cfa=None, serial=3,
    sigma_row=5.0, sigma_column=5.0, dsnu=5.0, prnu=0.05, dark_current=200.0, nonlinearity=0.1, rgb_bias=(5.0,) * 3,
    banding=Banding(amplitude=5.0, period=9), optics=SensorOptics(corner_angle=20, crosstalk=0.05), blooming=True,
    defects=Defects(hot_fraction=0.05, hot_factor=30, rts_fraction=0.05, rts_factor=4), coupling=0.02,
    dual_gain=DualGain(threshold=500.0, sigma_d=9.0, ratio=8.0),
)  # fmt: skip
# What shapes another effect goes with it: there is nothing else to see it in
SHAPES = {("poisson", "photon_shot"), ("read_tails", "read_noise"), ("blooming", "full_well")}
NAMES = plan_effects(LOUD, EXPOSURE, [5.0, 50.0]).names


def flat_field(sensor, electrons, plan=None):
    """Codes of a uniform field; the same seed, so that plans share every draw they have in common."""
    light = np.full((300, 400), electrons / sensor.eta)
    return expose(light, sensor, EXPOSURE, seed=0, view=0, plan=plan).dn.astype(np.float64)


def chance(whole, planned):
    """Five standard errors of what two frames that share most draws differ by; row noise has one draw a row. DN."""
    difference = whole - planned
    parts = (
        difference.std() / whole.size**0.5,
        *(difference.mean(i).std() / whole.shape[1 - i] ** 0.5 for i in (0, 1)),
    )
    return 5 * math.hypot(*parts) + 1e-9


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("electrons", LEVELS)
def test_the_planned_noise_differs_from_the_whole_by_at_most_the_stated_bound(name, electrons):
    """Rationale: promise 3 to the user. Expectation: standard deviation within `bound`, mean within the bias bound."""
    sensor = PRESETS[name]
    plan = plan_effects(sensor, EXPOSURE, electrons, tolerance=0.05)
    whole, planned = flat_field(sensor, electrons), flat_field(sensor, electrons, plan)
    assert plan.bound <= 0.05
    assert abs(whole.std() - planned.std()) <= plan.bound * planned.std() + chance(whole, planned)
    assert abs((whole - planned).mean()) <= plan.biases["DN of bias"] + chance(whole, planned)


@pytest.mark.parametrize(
    ("sensor", "signal", "tolerance", "on", "off"),
    [
        (
            Sensor(
                gain=2.0, eta=0.6, mu_e_sat=2000.0, black_level=200.0, bits=14, sigma_d=2.0, cfa=None, dark_current=0.2,
                defects=Defects(hot_fraction=0.01, hot_factor=1e4),
            ),
            (20.0, 40.0), 0.05, "hot_pixels", "dark_current",
        ),
        (
            Sensor(
                gain=2.0, eta=0.6, mu_e_sat=20_000.0, black_level=200.0, bits=16, sigma_d=2.0, cfa=None,
                nonlinearity=0.2,
            ),
            (20.0, 5000.0), 0.05, "nonlinearity", "full_well",
        ),
        (PRESETS["prime-95b"], (20.0, 20_000.0), 0.001, "nonlinearity", "full_well"),
    ],
)  # fmt: skip
def test_an_effect_that_stays_keeps_what_it_shares_with_one_that_is_left_out(sensor, signal, tolerance, on, off):
    """Rationale: hot pixels multiply the dark current, non-linearity is relative to full well."""
    plan = plan_effects(sensor, EXPOSURE, signal, tolerance)
    assert plan.is_on(on)
    assert not plan.is_on(off)
    for electrons in signal:
        whole, planned = flat_field(sensor, electrons), flat_field(sensor, electrons, plan)
        assert abs((whole - planned).mean()) <= plan.biases["DN of bias"] + chance(whole, planned)
        assert planned.max() == pytest.approx(whole.max(), rel=0.01)


@pytest.mark.parametrize("tolerance", [0.002, 0.01, 0.05, 0.3])
def test_every_effect_at_once_stays_within_the_bound(tolerance):
    plan = plan_effects(EVERYTHING, EXPOSURE, [5.0, 50.0], tolerance)
    for electrons in (5.0, 50.0):
        whole, planned = flat_field(EVERYTHING, electrons), flat_field(EVERYTHING, electrons, plan)
        slack = chance(whole, planned) / planned.std()
        shading = plan.biases["relative signal"] * electrons * EVERYTHING.gain / planned.std()
        assert abs(whole.std() / planned.std() - 1) <= plan.bound + slack + shading
    assert plan.bound <= tolerance


def test_a_tighter_tolerance_never_leaves_more_out():
    counts = [
        sum(e.on for e in plan_effects(EVERYTHING, EXPOSURE, [5.0, 50.0], t).effects)
        for t in (1e-6, 1e-3, 0.01, 0.1, 0.9)
    ]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > counts[-1] + 5


@pytest.mark.parametrize("electrons", [0.0, 1e-6, 0.01])
def test_no_distance_between_distributions_exceeds_one(electrons):
    plan = plan_effects(PRESETS["a7s2-iso6400"], EXPOSURE, [electrons, 5.0], 0.05)
    (poisson,) = (effect for effect in plan.effects if effect.name == "poisson")
    assert poisson.on
    assert poisson.contribution <= 1


def test_effects_a_camera_has_not_are_off_and_cost_nothing():
    plan = plan_effects(PRESETS["ideal"], EXPOSURE, [1.0, 100.0], 1e-9)
    assert [e.name for e in plan.effects if e.on] == ["photon_shot", "read_noise", "poisson"]
    assert plan.bound == 0


def test_prnu_rule_matches_its_closed_form():
    """S_hi <= 2 eps / p**2 suffices for one view: 1562 e- at 5 % and 0.8 %; read noise lets a little more through."""
    sensor = replace(EVERYTHING, prnu=0.008, mu_e_sat=1e5, sigma_d=0.0, gain=100.0, bits=16)
    below, above = (plan_effects(sensor, EXPOSURE, s, Limits(sd=0.05)) for s in (1560.0, 1565.0))
    assert below["prnu"].contribution < 0.05 < above["prnu"].contribution
    assert above.is_on("prnu")
    shared = plan_effects(sensor, EXPOSURE, 1560.0, Limits(sd=0.05, shared_views=30))
    assert shared["prnu"].contribution == pytest.approx(30 * below["prnu"].contribution)
    assert shared.is_on("prnu")


def test_noise_that_rows_or_views_share_counts_as_often_as_it_is_shared():
    once, often = (
        plan_effects(EVERYTHING, EXPOSURE, [50.0, 500.0], limits)
        for limits in (Limits(sd=0.05), Limits(sd=0.05, row_length=7, shared_views=3))
    )
    times = {"row_noise": 7, "column_noise": 7, "banding": 7, "dsnu": 3, "prnu": 3}
    assert all(once[name].contribution > 0 for name in times)
    for effect in once.effects:
        assert often[effect.name].contribution == pytest.approx(times.get(effect.name, 1) * effect.contribution)


def test_the_most_sensitive_hot_pixel_says_what_the_droop_costs():
    s, low, high = EVERYTHING, 50.0, 500.0
    found = plan_effects(s, EXPOSURE, [low, high], Limits(sd=0.05))["nonlinearity"]
    most = high * (1 + 5 * s.prnu) + 30 * s.dark_e(EXPOSURE)
    want = {"relative standard deviation": 2 * s.droop * (most + 1), "relative signal": s.droop * (most + 1)}
    assert found.contribution == pytest.approx(want[found.unit])


@pytest.mark.parametrize("falloff", [(1.0, 1.3), (2.0, 2.0), (1.0, 0.5, 1.1)])
def test_a_lens_that_makes_pixels_brighter_is_simulated(falloff):
    sensor = Sensor(gain=2.0, eta=0.6, mu_e_sat=1e5, black_level=512, bits=16, sigma_d=2.0, cfa=None)
    plan = plan_effects(replace(sensor, optics=SensorOptics(falloff=falloff)), EXPOSURE, [200.0, 300.0])
    assert plan["vignetting"].on
    assert plan["vignetting"].contribution == pytest.approx(max(abs(1 - factor) for factor in falloff))
    assert plan.bound >= 0


@pytest.mark.parametrize("optics", [SensorOptics(falloff=(1.0, 0.5, 0.1)), SensorOptics(corner_angle=55.0)])
def test_bounds_hold_for_the_light_that_reaches_the_corners(optics):
    """There the fixed pattern is beside a tenth of the shot noise."""
    sensor = Sensor(gain=2.0, eta=0.6, mu_e_sat=1e5, black_level=512, bits=16, sigma_d=1.0, cfa=None)
    corner = plan_effects(replace(sensor, dsnu=0.95), EXPOSURE, [10 * 0.1, 20.0])
    plan = plan_effects(replace(sensor, dsnu=0.95, optics=optics), EXPOSURE, [10.0, 20.0])
    assert corner["dsnu"].on
    assert plan["dsnu"].on
    assert plan["dsnu"].contribution == pytest.approx(corner["dsnu"].contribution, rel=0.1)


def test_banding_adds_half_of_its_amplitudes_square():
    found = plan_effects(EVERYTHING, EXPOSURE, [50.0 / DIM, 500.0], Limits(sd=0.05, row_length=7))["banding"]
    assert found.contribution == pytest.approx(7 * 0.1**2 / 2 / (2 * kept_variance(EVERYTHING, 50.0)))


def test_crosstalk_is_counted_to_and_from_four_neighbours():
    s, low, high = EVERYTHING, 50.0, 500.0
    found = plan_effects(s, EXPOSURE, [low / DIM, high], Limits(sd=0.05))["crosstalk"]
    spill = 4 * 0.001 * (high - low)
    want = {"relative standard deviation": spill**2 / (2 * kept_variance(s, high)), "DN of bias": s.gain * spill}
    assert found.contribution == pytest.approx(want[found.unit])


def test_row_noise_counts_by_the_length_of_the_rows_that_get_averaged():
    """One per cent of a pixel's variance is six times the variance of a row mean of 500 pixels."""
    sensor = replace(PRESETS["imx900-hcg"], sigma_row=0.1 * math.sqrt(kept_variance(PRESETS["imx900-hcg"], 20)))
    assert not plan_effects(sensor, EXPOSURE, 20, 0.05).is_on("row_noise")
    plan = plan_effects(sensor, EXPOSURE, 20, Limits(sd=0.05, row_length=500))
    assert plan.is_on("row_noise")
    dn = flat_field(sensor, 20.0)
    ratio = dn.mean(1).var() / flat_field(replace(sensor, sigma_row=0.0), 20.0).mean(1).var()
    assert ratio == pytest.approx(1 + 0.01 * 400, rel=0.4)


@pytest.mark.parametrize(
    ("sensor", "signal", "effect"),
    [
        (replace(EVERYTHING, mu_e_sat=5000.0), [1.0, 4900.0], "full_well"),
        (EVERYTHING, [1.0, 1990.0], "blooming"),
        (replace(EVERYTHING, nonlinearity=0.2), [1.0, 1000.0], "nonlinearity"),
        (replace(EVERYTHING, optics=SensorOptics(corner_angle=30)), 5.0, "vignetting"),
        (replace(EVERYTHING, optics=SensorOptics(crosstalk=0.05)), [1.0, 500.0], "crosstalk"),
        (
            replace(EVERYTHING, optics=SensorOptics(psf=((0.0, 0.1, 0.0), (0.1, 0.6, 0.1), (0.0, 0.1, 0.0)))),
            [1, 500],
            "crosstalk",
        ),
        (replace(EVERYTHING, coupling=0.01), 5.0, "coupling"),
        (replace(EVERYTHING, rgb_bias=(0.0, -9.0, 0.0)), 5.0, "black_bias"),
        (replace(EVERYTHING, dark_current=300.0), 5.0, "dark_current"),
        (replace(EVERYTHING, defects=Defects(hot_fraction=0.01, hot_factor=1e4)), 5.0, "hot_pixels"),
        (replace(EVERYTHING, defects=Defects(rts_fraction=0.01, rts_factor=3)), 5.0, "telegraph_noise"),
        (replace(EVERYTHING, banding=Banding(amplitude=3.0, period=8)), 5.0, "banding"),
        (EVERYTHING, 0.5, "read_tails"),
        (EVERYTHING, 2.0, "poisson"),
    ],
)
def test_each_effect_is_kept_where_it_shows_and_then_is_in_the_frame(sensor, signal, effect):
    plan = plan_effects(sensor, EXPOSURE, signal, 0.01)
    assert plan.is_on(effect)
    light = np.tile(np.linspace(np.min(signal), np.max(signal), 400), (100, 1)) / sensor.eta
    kept, without = (expose(light, sensor, EXPOSURE, seed=0, view=0, plan=p) for p in (plan, plan.force(off=[effect])))
    assert (kept.dn != without.dn).any()


def test_room_below_saturation_counts_to_the_adc_where_that_saturates_first():
    assert plan_effects(replace(EVERYTHING, bits=12), EXPOSURE, [1.0, 1900.0], 0.01).is_on("full_well")


def test_near_clipping_nothing_that_contributes_is_left_out():
    plan = plan_effects(EVERYTHING, EXPOSURE, [5.0, 1950.0], 0.3)
    off = [e.name for e in plan.effects if not e.on]
    assert set(off) <= {"dual_gain"}
    np.testing.assert_array_equal(flat_field(EVERYTHING, 1950.0, plan), flat_field(EVERYTHING, 1950.0))
    dark = replace(EVERYTHING, black_level=1.0)
    assert plan_effects(dark, EXPOSURE, [0.5, 5.0], 0.3).is_on("row_noise")


def test_defects_too_rare_to_occur_are_left_out():
    sensor = replace(EVERYTHING, defects=Defects(hot_fraction=1e-9, hot_factor=1e4, rts_fraction=1e-9, rts_factor=9))
    plan = plan_effects(sensor, EXPOSURE, 5.0, Limits(sd=0.01, pixels=1000))
    assert not plan.is_on("hot_pixels")
    assert not plan.is_on("telegraph_noise")


def steep_field(sensor, off=(), peak=1e5):
    """Codes of light from none to `peak` e-, some effects forced off and all others on."""
    light = np.append(0.0, np.geomspace(0.5, peak, 48 * 32 - 1)).reshape(48, 32).T / sensor.eta  # columns bloom
    plan = plan_effects(sensor, EXPOSURE, [5.0, 50.0])
    plan = plan.force(on=set(plan.names) - set(off), off=off)
    return expose(light, sensor, EXPOSURE, seed=0, view=0, plan=plan).dn.astype(np.float64)


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_that_is_on_shows_in_the_frame_whatever_else_is_off(name):
    for other in NAMES:
        off = {other} - {name}
        shown = (steep_field(LOUD, off) != steep_field(LOUD, off | {name})).any()
        assert shown == ((name, other) not in SHAPES), f"without {other}"


@pytest.mark.parametrize(("first", "second"), list(permutations(["full_well", "nonlinearity", "blooming"], 2)))
def test_what_is_left_out_does_not_depend_on_the_order_of_the_table(first, second):
    plan = plan_effects(LOUD, EXPOSURE, [5.0, 50.0]).force(on=NAMES, off=[first, second])
    turned = replace(plan, effects=plan.effects[::-1])
    assert simplify(LOUD, plan) == simplify(LOUD, turned)


def test_without_dark_current_hot_pixels_keep_theirs():
    sensor = replace(PRESETS["ideal"], cfa=None, dark_current=20.0, defects=Defects(hot_fraction=0.2, hot_factor=300))
    plan = plan_effects(sensor, EXPOSURE, 5.0).force(on=["hot_pixels"], off=["dark_current"])
    dark = np.zeros((200, 300))
    whole, planned = (expose(dark, sensor, EXPOSURE, seed=0, view=0, plan=p) for p in (None, plan))
    hot = whole.mean_dn > whole.mean_dn.min() + 1
    np.testing.assert_array_equal(planned.dn[hot], whole.dn[hot])
    assert (planned.dn[~hot] == sensor.black_level).all()
    assert whole.dn[~hot].max() > sensor.black_level


def test_without_full_well_the_response_bends_as_before_and_nothing_saturates_at_it():
    sensor = replace(EVERYTHING, nonlinearity=0.1, bits=16, blooming=False, defects=None)
    np.testing.assert_array_equal(steep_field(sensor, {"full_well"}, peak=1500.0), steep_field(sensor, peak=1500.0))
    assert steep_field(sensor, {"full_well"}, peak=4000.0).max() > 1.3 * steep_field(sensor, peak=4000.0).max()


def test_without_read_noise_telegraph_pixels_jump_and_a_dual_gain_keeps_its_codes():
    defects = Defects(rts_fraction=0.5, rts_factor=3)
    sensor = replace(
        PRESETS["ideal"], cfa=None, gain=16.0, bits=16, black_level=6400.0, sigma_d=2.0, defects=defects,
        dual_gain=DualGain(threshold=50.0, sigma_d=9.0, ratio=16.0),
    )  # fmt: skip
    plan = plan_effects(sensor, EXPOSURE, 5.0).force(off=["read_noise", "photon_shot"])
    frame = expose(np.zeros((300, 300)), sensor, EXPOSURE, seed=0, view=0, plan=plan.force(on=["telegraph_noise"]))
    jumps = 16.0 * math.sqrt(2 * (3**2 - 1)) * 2.0
    np.testing.assert_array_equal(np.unique(frame.dn), np.rint(6400 + np.array([-jumps, 0, jumps])))
    np.testing.assert_allclose(np.unique(frame.variance_dn), [0, jumps**2 / 2], rtol=1e-3, atol=1e-3)
    bright = np.linspace(60.0, 90.0, 300)[None] / sensor.eta
    codes = expose(bright, sensor, EXPOSURE, seed=0, view=0, plan=plan.force(on=["dual_gain"], off=["telegraph_noise"]))
    assert (codes.dn % 16 == 0).all()


def test_forcing_everything_off_leaves_a_noiseless_camera_and_on_restores_it():
    plan = plan_effects(EVERYTHING, EXPOSURE, [5.0, 50.0], 0.05)
    off = plan.force(off=plan.names)
    assert all(e.forced and not e.on for e in off.effects)
    assert flat_field(EVERYTHING, 20.0, off).std() == 0
    on = plan.force(on=plan.names)
    np.testing.assert_array_equal(flat_field(EVERYTHING, 20.0, on), flat_field(EVERYTHING, 20.0))
    with pytest.raises(ValueError, match="effect name must be one of .* got 'gamma_rays'"):
        plan.force(off=["gamma_rays"])


def test_a_plan_prints_as_a_table_and_survives_json():
    plan = plan_effects(EVERYTHING, EXPOSURE, [5.0, 50.0], 0.05).force(on=["dsnu"])
    table = str(plan)
    places = {line.rindex(effect.reason) for line, effect in zip(table.splitlines()[1:], plan.effects, strict=False)}
    assert places == {table.splitlines()[0].rindex("reason")}  # reasons stand below each other and below their heading
    assert len(table.splitlines()) == len(plan.effects) + 2
    assert "on*" in table
    assert f"{plan.bound:.3g}" in table.splitlines()[-1]
    assert Plan.from_dict(json.loads(json.dumps(plan.to_dict()))) == plan


@pytest.mark.parametrize(("signal", "tolerance"), [([], 0.05), ([-1.0], 0.05), ([math.nan], 0.05), ([5.0], 0.0)])
def test_bad_signals_and_limits_are_refused(signal, tolerance):
    with pytest.raises(ValueError, match="must be"):
        plan_effects(EVERYTHING, EXPOSURE, signal, tolerance)


DARKNESS = {"dark_current", "dsnu", "row_noise", "column_noise", "banding", "hot_pixels", "telegraph_noise"}


def test_what_does_not_grow_with_the_light_costs_most_at_the_darkest_signal():
    """Expectation: brighter pixels beside dark ones change no such cost."""
    limits = Limits(sd=0.05, bias_dn=1e9)  # of no cost is the bias the worst
    alone, beside = (plan_effects(EVERYTHING, EXPOSURE, signal, limits) for signal in ([2.0], [2.0, 500.0]))
    for name in DARKNESS:
        assert beside[name].contribution == pytest.approx(alone[name].contribution) != 0, name


@pytest.mark.parametrize("gain", [0.5, 3.0])
def test_a_bias_is_allowed_that_share_of_the_noise_in_codes(gain):
    """Expectation: in codes the noise of a pixel is gain times its electrons, with the steps of the codes in it."""
    sensor = replace(EVERYTHING, gain=gain)
    found = plan_effects(sensor, EXPOSURE, [20.0 / DIM, 500.0], Limits(sd=0.05))["black_bias"]
    noise = math.sqrt(gain**2 * (20.0 + sensor.sigma_d**2) + 1 / 12)
    assert found.bound == pytest.approx(0.05 * noise)


def printed(*, on: bool = False, forced: bool = False, contribution: float = 0.001) -> tuple[str, str]:
    """The row and the last line of a plan of one effect that may cost 0.004."""
    effect = Effect(
        name="fog", on=on, forced=forced, contribution=contribution, bound=0.004, unit="of all light", reason="so"
    )
    _, row, last = str(Plan(effects=(effect,), bound=contribution, unit="of all light")).splitlines()
    return row, last


@pytest.mark.parametrize(
    ("on", "forced", "contribution", "mark"),
    [(False, False, 0.001, "off "), (False, False, 0.005, "off!"), (False, True, 0.005, "off*!"),
     (False, True, 0.001, "off*"), (True, True, 0.005, "on*"), (True, False, 0.005, "on ")],
)  # fmt: skip
def test_what_is_left_out_above_its_allowance_and_what_is_forced_is_marked_and_the_marks_are_explained(
    on: bool, forced: bool, contribution: float, mark: str
) -> None:
    row, last = printed(on=on, forced=forced, contribution=contribution)
    assert row.split("fog")[1].lstrip().startswith(mark.rstrip() + "  ")
    assert ("! left out above its allowance" in last) == ("!" in mark)
    assert ("* forced by name" in last) == ("*" in mark)
