"""Hard cases beside those of `tests/stability/sensor`: claims about what a frame looks like."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sensor_model import (
    PRESETS,
    Banding,
    Defects,
    DualGain,
    Exposure,
    Sensor,
    SensorOptics,
    develop,
    develop_linear,
    expose,
    mosaic,
    photons_for_electrons,
)
from sensor_model.params import CFAS

EXPOSURE = Exposure(time=0.02)
SENSOR = Sensor(gain=2.0, eta=0.5, mu_e_sat=1800.0, black_level=64, bits=12, sigma_d=1.5, cfa=None)


@pytest.mark.parametrize("backend", ["numba", "numpy"])
@pytest.mark.parametrize("optics", [None, SensorOptics(corner_angle=20, crosstalk=0.02)])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0, -1e-12])
def test_light_that_is_no_light_is_refused_with_count_and_place(bad, optics, backend):
    photons = np.full((30, 40), 5.0)
    photons[7, 11] = photons[20, 0] = bad
    with pytest.raises(
        ValueError, match=rf"photons must be finite and >= 0, got {bad} at \(7, 11\) \(2 of 1200 values\)"
    ):
        expose(photons, replace(SENSOR, optics=optics), EXPOSURE, seed=0, view=0, backend=backend)
    with pytest.raises(ValueError, match=r"radiance must be finite .* at \(7, 11, 0\) \(6 of 3600 values\)"):
        photons_for_electrons(np.repeat(photons[..., None], 3, 2), electrons=5, mean_green=1, sensor=SENSOR)


def test_electrons_are_not_clipped_at_zero_before_the_offset():
    frame = expose(np.zeros((1000, 1000)), SENSOR, EXPOSURE, seed=0, view=0)
    deviation = SENSOR.gain * SENSOR.sigma_d
    assert frame.dn.mean() == pytest.approx(SENSOR.black_level, abs=5 * deviation / 1000)
    assert frame.dn.std() == pytest.approx(np.sqrt(deviation**2 + 1 / 12), rel=0.005)


@pytest.mark.parametrize(("noise", "bound"), [(0.0, 0.5), (0.2, 0.145), (0.3, 0.054), (0.5, 0.0023)])
def test_noise_below_a_code_leaves_the_stated_error_of_the_mean(noise, bound):
    """exp(-2 pi**2 s**2) / pi codes of error at s codes of noise, on signals between two codes."""
    sensor = replace(SENSOR, gain=0.01, eta=1.0, mu_e_sat=math.inf, sigma_d=noise / 0.01, black_level=64)
    light = np.linspace(0, 300, 31)
    frame = expose(light[None], sensor, EXPOSURE, seed=0, view=0, shot="none")
    error = np.abs(frame.mean_dn - (64 + 0.01 * light))
    assert error.max() <= bound + 1e-4
    tall = expose(np.tile(light, (40_000, 1)), sensor, EXPOSURE, seed=0, view=0, shot="none").dn
    assert np.abs(tall.mean(0) - frame.mean_dn[0]).max() <= 5 * np.sqrt(frame.variance_dn.max() / 40_000) + 1e-5


def test_eight_bits_after_a_high_gain_keep_the_mean():
    sensor = Sensor(gain=200.0, eta=1.0, mu_e_sat=1.15, black_level=16, bits=8, sigma_d=0.02, cfa=None)
    frame = expose(np.full((300, 300), 0.1), sensor, EXPOSURE, seed=0, view=0)
    assert frame.dn.max() <= 255
    assert frame.dn.mean() == pytest.approx(frame.mean_dn.mean(), abs=5 * float(frame.variance_dn.mean()) ** 0.5 / 300)


def test_no_noise_at_all_is_plain_rounding():
    sensor = replace(SENSOR, sigma_d=0.0)
    light = np.arange(0, 400, 0.37)[None]
    frame = expose(light, sensor, EXPOSURE, seed=0, view=0, shot="none")
    np.testing.assert_array_equal(frame.dn, np.rint(64 + light))
    np.testing.assert_array_equal(frame.mean_dn, frame.dn)
    np.testing.assert_array_equal(frame.variance_dn, 0)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 3), (31, 33)])
@pytest.mark.parametrize("cfa", CFAS)
def test_odd_sizes_with_every_filter_pattern(cfa, shape):
    sensor = replace(PRESETS["imx900-hcg"], cfa=cfa)
    colour = np.array([30.0, 50.0, 20.0]) * sensor.rgb_response / sensor.eta
    light = mosaic(np.broadcast_to(colour, (*shape, 3)), cfa)
    frame = expose(light, sensor, EXPOSURE, seed=0, view=0)
    assert frame.dn.shape == shape
    if min(shape) < 2:
        with pytest.raises(ValueError, match="at least 2 x 2"):
            develop(frame, sensor)
        return
    clean = develop_linear(frame.clean_dn, replace(sensor, dark_current=0.0), demosaic="bilinear")
    np.testing.assert_allclose(
        clean * sensor.capacity_e, np.broadcast_to([30, 50, 20], clean.shape), rtol=1e-3, atol=0.06
    )


@pytest.mark.parametrize("backend", ["numba", "numpy"])
@pytest.mark.parametrize(
    "noise",
    [
        {},
        {"sigma_column": 200.0},
        {"banding": Banding(amplitude=600.0, period=9)},
        {"sigma_d": 5.0, "defects": Defects(rts_fraction=0.02, rts_factor=100.0)},
        {"dual_gain": DualGain(threshold=100.0, sigma_d=300.0, ratio=4)},
        {"rgb_bias": (-500.0, -500.0, -500.0)},
    ],
    ids=lambda noise: "".join(noise) or "none",
)
def test_very_bright_light_saturates_under_any_noise(noise, backend):
    """Noise of thousands of electrons below a signal of ten million; up to all of these pixels were dark."""
    sensor = Sensor(gain=1.0, eta=1.0, mu_e_sat=1e6, black_level=0, bits=8, cfa=None, **noise)
    frame = expose(np.full((100, 100), 1e7), sensor, EXPOSURE, seed=0, view=0, backend=backend)
    assert (frame.dn == 255).all()
    assert frame.saturated.all()
    assert (frame.mean_dn == 255).all()


@pytest.mark.parametrize("lam", [0.0, -1e-12, 1e-12])
def test_tukey_lambda_zero_is_the_logistic_distribution(lam):
    sensor = replace(SENSOR, tukey_lambda=lam, sigma_d=3.0)
    dn = expose(np.zeros((400, 400)), sensor, EXPOSURE, seed=0, view=0).dn
    logistic = expose(np.zeros((400, 400)), replace(sensor, tukey_lambda=0.0), EXPOSURE, seed=0, view=0).dn
    np.testing.assert_array_equal(dn, logistic)
    assert dn.std() == pytest.approx(np.sqrt(36 + 1 / 12), rel=0.02)


@pytest.mark.parametrize("demosaic", ["menon", "malvar", "bilinear", "half"])
@pytest.mark.parametrize("response", [(0.5, 1.0, 0.6), (1.4, 1.0, 0.7)])
@pytest.mark.parametrize("gain", [1.0, 0.5])
def test_saturated_highlights_are_white_not_pink(demosaic, response, gain):
    sensor = replace(PRESETS["imx900-hcg"], rgb_response=response, prnu=0.0, dsnu=0.0)
    light = np.full((24, 26), 1e6)
    light[:, :12] = 1.0
    frame = expose(light, sensor, EXPOSURE, seed=0, view=0)
    srgb = develop(frame, sensor, demosaic=demosaic, digital_gain=gain).srgb8
    bright = srgb[:, -srgb.shape[1] // 3 :]
    # charge clips, then the ADC, then the white balance: read noise of a full pixel is all that is left below white
    assert bright.min() >= (253 if gain == 1 else 186)
    assert bright.max() == (255 if gain == 1 else 188)  # and grey below a gain of 1: the sRGB code of 0.5


def test_dark_noise_keeps_its_sign_in_16_bits():
    sensor = PRESETS["a7s2-iso25600-3chip"]
    frame = expose(np.zeros((300, 300, 3)), sensor, EXPOSURE, seed=0, view=0)
    linear = develop_linear(frame.dn, sensor)
    codes = develop(frame, sensor).linear16
    assert codes.min() > 0
    assert codes.mean() == pytest.approx(4096 + 61439 * linear.mean(), abs=0.05)
