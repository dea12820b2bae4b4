"""Light in physical units, electrons as the normalised axis, and light that changes while rows are read."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensor_model import (
    PRESETS,
    Exposure,
    Lens,
    electrons_from_luminance,
    expose,
    expose_burst,
    luminance_from_ev,
    luminance_from_lux,
    photons_for_electrons,
    photons_from_radiance,
    photons_from_spectrum,
    rolling_shutter,
)
from sensor_model.radiometry import channel_response

LENS = Lens(f_number=1.8, pixel_pitch=2.25e-6)
EXPOSURE = Exposure(time=0.01)
IDEAL = PRESETS["ideal"]
GRID = np.arange(400.0, 701.0, 5.0)


def test_photons_agree_with_the_number_emva_1288_prints():
    """EMVA 1288: mu_p = 50.34 A[um**2] t[ms] lambda[um] E[uW/cm**2]."""
    irradiance = 0.37  # uW/cm**2 on the sensor
    solid = math.pi / (4 * LENS.f_number**2)
    radiance = irradiance * 1e-2 / solid  # W/(m**2 sr)
    expected = 50.34 * 2.25**2 * 10 * 0.536 * irradiance
    assert float(photons_from_radiance(radiance, LENS, EXPOSURE, wavelength=536.0)) == pytest.approx(expected, rel=1e-4)


@settings(derandomize=True, deadline=None)
@given(st.floats(1.0, 22.0), st.floats(1e-6, 2e-5), st.floats(1e-4, 10.0))
def test_photons_scale_as_area_time_and_inverse_square_of_the_f_number(f_number, pitch, time):
    lens = Lens(f_number=f_number, pixel_pitch=pitch)
    photons = float(photons_from_radiance(1.0, lens, Exposure(time=time), wavelength=550.0))
    reference = float(photons_from_radiance(1.0, LENS, EXPOSURE, wavelength=550.0))
    scale = (pitch / LENS.pixel_pitch) ** 2 * (time / EXPOSURE.time) * (LENS.f_number / f_number) ** 2
    assert photons == pytest.approx(reference * scale, rel=1e-9)


def test_transmission_and_magnification_dim_the_sensor():
    assert Lens(f_number=1.8, pixel_pitch=2.25e-6, transmission=0.5).etendue == pytest.approx(LENS.etendue / 2)
    assert Lens(f_number=1.8, pixel_pitch=2.25e-6, magnification=1.0).etendue == pytest.approx(LENS.etendue / 4)


def test_a_narrow_line_in_the_spectrum_counts_as_its_wavelength():
    line = np.zeros(GRID.size)
    line[30] = 2.0  # 550 nm, five nm wide
    qe = np.stack([np.full(GRID.size, 0.1), np.full(GRID.size, 0.8), np.zeros(GRID.size)], 1)
    photons = photons_from_spectrum(np.tile(line, (4, 5, 1)), GRID, LENS, EXPOSURE, qe=qe, eta=0.8)
    expected = float(photons_from_radiance(10.0, LENS, EXPOSURE, wavelength=550.0))
    assert photons.shape == (4, 5, 3)
    np.testing.assert_allclose(photons[0, 0], [expected / 8, expected, 0], rtol=1e-12)


def test_quantum_efficiency_curves_give_eta_and_relative_responses():
    peaks, heights = np.array([600.0, 535.0, 460.0]), np.array([0.5, 0.7, 0.6])
    qe = heights * np.exp(-(((GRID[:, None] - peaks) / 40) ** 2))
    eta, response = channel_response(GRID, qe, 1 / GRID)  # the same number of photons at every wavelength
    assert eta == pytest.approx(0.7)
    np.testing.assert_allclose(response, heights / 0.7, rtol=0.02)


def test_spectra_on_an_uneven_grid_are_integrated_by_trapezoids():
    """Independent reference: numpy's own rule, on the photons times the quantum efficiency."""
    rng = np.random.default_rng(0)
    grid = np.sort(rng.uniform(400, 700, 17))
    radiance, qe = rng.random((2, 3, 17)), rng.random((17, 3))
    found = photons_from_spectrum(radiance, grid, LENS, EXPOSURE, qe=qe, eta=0.4)
    single = photons_from_radiance(1.0, LENS, EXPOSURE, wavelength=1.0)  # photons grow in proportion to the wavelength
    expected = np.trapezoid(radiance[..., None] * qe * grid[:, None], grid, axis=2) * single / 0.4
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    eta, response = channel_response(grid, qe, radiance[0, 0])
    charge = np.trapezoid(radiance[0, 0, :, None] * qe * grid[:, None], grid, axis=0)
    assert eta == qe[:, 1].max()
    np.testing.assert_allclose(response, charge / charge[1], rtol=1e-12)


def test_lux_and_exposure_value_meet_in_luminance():
    """EV 0 at ISO 100 is 0.125 cd/m**2, and 2.5 lux on an 18 % card give 0.14: the rule of thumb of exposure tables."""
    assert luminance_from_ev(0) == 0.125
    assert luminance_from_ev(10) == 128
    assert luminance_from_lux(2.5, 0.18) == pytest.approx(0.1432, rel=1e-3)
    assert luminance_from_lux(math.pi, 1.0) == pytest.approx(1.0)


def test_electrons_from_luminance_drive_the_normalised_axis():
    sensor = PRESETS["imx900-hcg-3chip"]
    electrons = electrons_from_luminance(luminance_from_lux(1.0), LENS, EXPOSURE, eta=sensor.eta)
    # 1 lux, 18 % card, f/1.8, 10 ms, 2.25 um: L = 57 mcd/m**2 -> 0.5 electrons
    assert electrons == pytest.approx(0.0573 / 683 * LENS.etendue * 0.01 * 555e-9 / 1.986446e-25 * sensor.eta, rel=1e-3)
    photons = photons_for_electrons(np.full((2, 2, 3), 3.0), electrons=electrons, mean_green=3.0, sensor=sensor)
    np.testing.assert_allclose(photons[..., 1] * sensor.eta, electrons)
    np.testing.assert_allclose(photons[0, 0] / photons[0, 0, 1], sensor.rgb_response)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Lens(f_number=0.1, pixel_pitch=2e-6), "f_number"),
        (lambda: Lens(f_number=2, pixel_pitch=2.25), "pixel_pitch"),
        (lambda: photons_from_radiance([1.0, -1.0], LENS, EXPOSURE, wavelength=550.0), r"radiance .* at \(1,\)"),
        (
            lambda: photons_from_spectrum(np.ones(3), GRID, LENS, EXPOSURE, qe=np.ones((61, 3)), eta=1),
            "wavelengths",
        ),
        (
            lambda: photons_for_electrons(np.ones((2, 2, 3)), electrons=1, mean_green=0, sensor=PRESETS["ideal"]),
            "mean_g",
        ),
        (
            lambda: photons_for_electrons(np.ones((2, 2)), electrons=1, mean_green=1, sensor=PRESETS["ideal"]),
            "radiance",
        ),
        (lambda: rolling_shutter(np.ones((3, 4, 4)), [0, 0.1, 0.2], Exposure(time=0.5)), "times must be spanning"),
        (lambda: rolling_shutter(np.ones((2, 4, 4)), [0, 0.1, 0.2], EXPOSURE), "flux, times"),
    ],
)
def test_bad_quantities_are_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_steady_light_does_not_care_about_the_shutter():
    flux = np.full((5, 6, 7), 300.0)
    exposure = Exposure(time=0.02, line_time=0.001)
    np.testing.assert_allclose(rolling_shutter(flux, np.linspace(0, 0.1, 5), exposure), 6.0)


def test_each_row_integrates_over_its_own_window():
    """Light that rises linearly: row r collects the integral of t over [r, r + time]."""
    times = np.array([0.0, 0.013, 0.05, 0.1])
    flux = np.broadcast_to(times[:, None, None], (4, 9, 3))
    exposure = Exposure(time=0.02, line_time=0.004, origin=(2, 0))
    start = 0.004 * (np.arange(9) + 2)
    expected = ((start + 0.02) ** 2 - start**2) / 2
    np.testing.assert_allclose(rolling_shutter(flux, times, exposure), np.repeat(expected[:, None], 3, 1), rtol=1e-12)


def test_mains_flicker_makes_bands_with_a_rolling_shutter_only():
    times = np.linspace(0, 0.1, 2001)
    flux = np.broadcast_to((1 + np.sin(2 * np.pi * 100 * times))[:, None, None], (2001, 60, 2))
    rolling = rolling_shutter(flux, times, Exposure(time=0.004, line_time=0.001))
    still = rolling_shutter(flux, times, Exposure(time=0.004))
    assert still.std() == pytest.approx(0, abs=1e-12)
    assert rolling[:, 0].std() > 0.5 * rolling.mean()
    np.testing.assert_allclose(rolling[10:], rolling[:-10], atol=1e-6)  # ten rows are one period


def test_a_burst_shares_light_and_pattern_but_no_noise():
    sensor = PRESETS["imx900-hcg-3chip"]
    light = np.full((40, 50, 3), 20.0)
    burst = expose_burst(light, sensor, EXPOSURE, frames=3, seed=1, view=4)
    np.testing.assert_array_equal(burst[2].dn, expose(light, sensor, EXPOSURE, seed=1, view=4, frame=2).dn)
    assert (burst[0].dn != burst[1].dn).any()
    np.testing.assert_array_equal(burst[0].mean_dn, burst[1].mean_dn)
    moving = expose_burst(np.stack([light, 2 * light]), sensor, EXPOSURE, frames=2, seed=1, view=4)
    np.testing.assert_array_equal(moving[0].dn, burst[0].dn)
    assert moving[1].dn.mean() > burst[1].dn.mean()
    with pytest.raises(ValueError, match="photons must be one light or 3"):
        expose_burst(np.stack([light, light]), sensor, EXPOSURE, frames=3, seed=1, view=4)


@pytest.mark.parametrize("shape", [(4, 8, 8), (4, 8, 3, 3)])
def test_each_frame_of_a_burst_without_filters_may_have_its_light(shape):
    sensor = PRESETS["imx900-hcg-3chip"]
    light = np.random.default_rng(0).uniform(10, 500, shape)
    burst = expose_burst(light, sensor, EXPOSURE, frames=4, seed=1, view=4)
    for i, frame in enumerate(burst):
        np.testing.assert_array_equal(frame.dn, expose(light[i], sensor, EXPOSURE, seed=1, view=4, frame=i).dn)
    three_chips = expose_burst(np.ones((3, 9, 3)), sensor, EXPOSURE, frames=3, seed=1, view=4)
    assert [frame.dn.shape for frame in three_chips] == [(3, 9, 3)] * 3


def test_times_that_do_not_increase_or_do_not_span_every_row_are_refused():
    flux, exposure = np.ones((3, 5, 4)), Exposure(time=0.02, line_time=0.01)
    # the first row opens at 0 s, the last one closes at 4 * 0.01 + 0.02 s
    rolling_shutter(flux, [0.0, 0.03, 0.06], exposure)
    for times, message in (
        ([0.0, 0.07, 0.06], "increasing"),
        ([0.0, 0.0, 0.06], "increasing"),
        ([0.005, 0.03, 0.06], "spanning"),
        ([0.0, 0.03, 0.059], "spanning"),
    ):
        with pytest.raises(ValueError, match=message):
            rolling_shutter(flux, times, exposure)
