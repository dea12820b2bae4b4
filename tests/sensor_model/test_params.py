"""The parameters of a camera: out of range they are named, and what follows from them."""

from dataclasses import replace

import numpy as np
import pytest

from sensor_model import Banding, Defects, DualGain, Exposure, Sensor, SensorOptics, expose

BASE = {"gain": 0.8, "eta": 0.5, "mu_e_sat": 5000.0, "black_level": 60.0, "bits": 12}


@pytest.mark.parametrize(
    ("field", "bad"),
    [
        ("gain", 0.0), ("gain", np.nan), ("eta", 60.0), ("eta", 0.0), ("mu_e_sat", 0.0), ("bits", 7), ("bits", 12.5),
        ("black_level", 4095.0), ("black_level", -1.0), ("sigma_d", -1.0), ("sigma_row", np.inf), ("prnu", 0.8),
        ("sigma_column", -1.0), ("dsnu", np.nan), ("dark_current", 1e16),
        ("tukey_lambda", -0.5), ("nonlinearity", 0.5), ("cfa", "RGBG"), ("rgb_response", (0.5, 0.9, 0.5)),
        ("rgb_bias", (0.0, 0.0)), ("serial", -1), ("dark_doubling", 0.0),
    ],
)  # fmt: skip
def test_a_parameter_out_of_range_is_named_with_its_value(field, bad):
    with pytest.raises(ValueError, match=rf"{field} must be .* got"):
        Sensor(**(BASE | {field: bad}))


@pytest.mark.parametrize(
    "build",
    [
        lambda: SensorOptics(corner_angle=95), lambda: SensorOptics(crosstalk=0.3),
        lambda: SensorOptics(falloff=(1.0,)), lambda: SensorOptics(psf=((0.5, 0.5),)),
        lambda: SensorOptics(psf=((0.2,), (0.5,), (0.2,))), lambda: Defects(rts_traps=0),
        lambda: SensorOptics(psf=((0.1, 0.9, 0.0),), crosstalk=0.1), lambda: Sensor(**BASE, coupling=0.3),
        lambda: SensorOptics(corner_angle=20, falloff=(1.0, 0.5)), lambda: Defects(hot_fraction=2),
        lambda: Defects(rts_factor=0.5), lambda: Banding(amplitude=1, period=1),
        lambda: DualGain(threshold=5, sigma_d=1, ratio=0.5), lambda: Exposure(time=-1),
        lambda: DualGain(threshold=5, sigma_d=-1, ratio=2), lambda: Exposure(time=1, line_time=-1e-5),
        lambda: SensorOptics(psf=((0.5, 0.6, -0.1),)),
        lambda: SensorOptics(psf=((-0.1, 0.6, 0.5),)), lambda: SensorOptics(psf=((0.0, 1.0, 0.0), (0.0,), (0.0,))),
        lambda: SensorOptics(psf=((0.2, 0.5, 0.2),)), lambda: SensorOptics(falloff=(1.0, -0.1)),
        lambda: Exposure(time=1, origin=(-1, 0)), lambda: Exposure(time=1, temperature=np.nan),
        lambda: Sensor(**BASE, nonlinearity=0.1) and Sensor(**(BASE | {"mu_e_sat": np.inf}), nonlinearity=0.1),
    ],
)  # fmt: skip
def test_impossible_parts_are_refused(build):
    with pytest.raises(ValueError, match="must be"):
        build()


def test_dark_current_doubles_with_its_temperature():
    sensor = Sensor(**BASE, dark_current=2.0, dark_temperature=20.0, dark_doubling=6.0)
    assert sensor.dark_e(Exposure(time=3.0)) == 6.0
    assert sensor.dark_e(Exposure(time=3.0, temperature=32.0)) == pytest.approx(24.0)
    assert sensor.dark_e(Exposure(time=3.0, temperature=14.0)) == pytest.approx(3.0)
    warm = expose(np.zeros((300, 300)), sensor, Exposure(time=3.0, temperature=44.0), seed=0, view=0)
    assert (warm.dn.mean() - 60) / 0.8 == pytest.approx(96.0, abs=5 * np.sqrt(96 / 90_000) + 0.01)


def test_hot_and_telegraph_pixels_belong_to_the_camera():
    defects = Defects(hot_fraction=0.01, hot_factor=100, rts_fraction=0.02, rts_factor=4)
    sensor = Sensor(**BASE, dark_current=10.0, sigma_d=2.0, defects=defects, cfa=None)
    stacks = [
        np.stack([expose(np.zeros((150, 200)), s, Exposure(time=1.0), seed=v, view=v, frame=f).dn for f in range(20)])
        for v, s in ((0, sensor), (1, sensor), (0, replace(sensor, serial=1)))
    ]
    hot = [np.flatnonzero(stack.mean(0) > 60 + 0.8 * 500) for stack in stacks]
    assert hot[0].size == pytest.approx(300, abs=5 * np.sqrt(300))
    np.testing.assert_array_equal(hot[0], hot[1])
    assert np.intersect1d(hot[0], hot[2]).size < 20
    noisy = [np.flatnonzero(stack.std(0) > 0.8 * 5.8) for stack in stacks]
    assert np.isin(noisy[0], noisy[1]).mean() > 0.6


@pytest.mark.parametrize(
    ("changes", "white", "capacity"),
    [
        ({}, 4060.0, 5000.0),  # full well: 60 + 0.8 * 5000
        ({"nonlinearity": 0.1}, 3660.0, 4500.0),
        ({"bits": 11}, 2047.0, 1987 / 0.8),  # the ADC comes first
        ({"mu_e_sat": np.inf}, 4095.0, 4035 / 0.8),
    ],
)
def test_a_pixel_is_full_by_its_charge_or_by_the_adc_whichever_comes_first(changes, white, capacity):
    sensor = Sensor(**(BASE | changes))
    assert (sensor.white_dn, sensor.capacity_e) == pytest.approx((white, capacity))


def test_light_that_goes_to_neighbours_may_go_to_one_side_of_any_odd_table():
    for psf in (((0.0, 0.7, 0.3),), ((0.1,), (0.9,), (0.0,)), ((0.0, 0.1, 0.0), (0.1, 0.6, 0.1), (0.0, 0.1, 0.0))):
        assert SensorOptics(psf=psf).psf == psf
