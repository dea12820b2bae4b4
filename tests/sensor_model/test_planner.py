"""The planner's promise: what it leaves out changes the noise by no more than it says."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from sensor_model import PRESETS, Banding, Defects, Exposure, Limits, Optics, Plan, Sensor, expose, plan_effects
from sensor_model.planner import REMOVE, kept_variance, simplify

EXPOSURE = Exposure(time=0.05)
CAMERAS = [name for name in PRESETS if not name.endswith("-3chip")]
LEVELS = (0.5, 2.0, 10.0, 50.0, 500.0)
EVERYTHING = Sensor(
    gain=2.0, eta=0.6, mu_e_sat=2000.0, black_level=200.0, bits=14, sigma_d=2.0, tukey_lambda=-0.1, cfa=None, serial=3,
    sigma_row=0.1, sigma_column=0.1, dsnu=0.3, prnu=0.005, dark_current=1.0, nonlinearity=0.001, rgb_bias=(0.1,) * 3,
    banding=Banding(amplitude=0.1, period=9), optics=Optics(corner_angle=5, crosstalk=0.001), blooming=True,
    defects=Defects(hot_fraction=1e-4, hot_factor=30, rts_fraction=1e-3, rts_factor=1.1, rts_traps=2), coupling=2e-4,
)  # fmt: skip


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
        (replace(EVERYTHING, bits=12), [1.0, 1900.0], "full_well"),  # the ADC
        (EVERYTHING, [1.0, 1990.0], "blooming"),
        (replace(EVERYTHING, nonlinearity=0.2), [1.0, 1000.0], "nonlinearity"),
        (replace(EVERYTHING, optics=Optics(corner_angle=30)), 5.0, "vignetting"),
        (replace(EVERYTHING, optics=Optics(crosstalk=0.05)), [1.0, 500.0], "crosstalk"),
        (
            replace(EVERYTHING, optics=Optics(psf=((0.0, 0.1, 0.0), (0.1, 0.6, 0.1), (0.0, 0.1, 0.0)))),
            [1, 500],
            "crosstalk",
        ),
        (replace(EVERYTHING, coupling=0.01), 5.0, "coupling"),
        (replace(EVERYTHING, rgb_bias=(0.0, 0.0, -9.0)), 5.0, "black_bias"),
        (replace(EVERYTHING, dark_current=300.0), 5.0, "dark_current"),
        (replace(EVERYTHING, defects=Defects(hot_fraction=0.01, hot_factor=1e4)), 5.0, "hot_pixels"),
        (replace(EVERYTHING, defects=Defects(rts_fraction=0.01, rts_factor=3)), 5.0, "telegraph_noise"),
        (replace(EVERYTHING, banding=Banding(amplitude=3.0, period=8)), 5.0, "banding"),
        (EVERYTHING, 0.5, "read_tails"),
        (EVERYTHING, 2.0, "poisson"),
    ],
)
def test_each_effect_is_kept_where_it_shows(sensor, signal, effect):
    assert plan_effects(sensor, EXPOSURE, signal, 0.01).is_on(effect)


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


@pytest.mark.parametrize("name", list(REMOVE))
def test_any_effect_can_be_forced_off_by_name(name):
    plan = plan_effects(EVERYTHING, EXPOSURE, [5.0, 50.0], 0.05)
    plan = plan.force(on=set(plan.names) - {name}, off=[name])
    assert plan[name].forced
    assert not plan[name].on
    bare = simplify(EVERYTHING, plan)
    assert (bare == EVERYTHING) is (name == "dual_gain")
    expose(np.ones((4, 4)), EVERYTHING, EXPOSURE, seed=0, view=0, plan=plan)


def test_forcing_everything_off_leaves_a_noiseless_camera_and_on_restores_it():
    plan = plan_effects(EVERYTHING, EXPOSURE, [5.0, 50.0], 0.05)
    off = plan.force(off=plan.names)
    assert flat_field(EVERYTHING, 20.0, off).std() == 0
    on = plan.force(on=plan.names)
    np.testing.assert_array_equal(flat_field(EVERYTHING, 20.0, on), flat_field(EVERYTHING, 20.0))
    with pytest.raises(ValueError, match="effect name must be one of .* got 'gamma_rays'"):
        plan.force(off=["gamma_rays"])


def test_a_plan_prints_as_a_table_and_survives_json():
    plan = plan_effects(EVERYTHING, EXPOSURE, [5.0, 50.0], 0.05).force(on=["dsnu"])
    table = str(plan)
    assert len(table.splitlines()) == len(plan.effects) + 2
    assert "on*" in table
    assert f"{plan.bound:.3g}" in table.splitlines()[-1]
    assert Plan.from_dict(json.loads(json.dumps(plan.to_dict()))) == plan


@pytest.mark.parametrize(("signal", "tolerance"), [([], 0.05), ([-1.0], 0.05), ([math.nan], 0.05), ([5.0], 0.0)])
def test_bad_signals_and_limits_are_refused(signal, tolerance):
    with pytest.raises(ValueError, match="must be"):
        plan_effects(EVERYTHING, EXPOSURE, signal, tolerance)
