"""The whole chain: moments, reproducibility, and inputs that must be refused."""

from dataclasses import replace

import numpy as np
import pytest

from sensor_model import PRESETS, Banding, Exposure, Sensor, expose, mosaic, plan_effects
from sensor_model.capture import expose_burst, mean_of

EXPOSURE = Exposure(time=0.02)


@pytest.mark.parametrize("name", list(PRESETS))
def test_every_preset_takes_a_frame(name):
    sensor = PRESETS[name]
    shape = (17, 23) if sensor.cfa else (17, 23, 3)
    frame = expose(np.full(shape, 20.0), sensor, EXPOSURE, seed=1, view=0)
    assert frame.dn.dtype == np.uint16
    assert frame.dn.shape == frame.mean_dn.shape == frame.variance_dn.shape == frame.saturated.shape == shape
    assert not frame.saturated.any()


@pytest.mark.parametrize("name", ["imx900-hcg", "a7s2-iso6400", "ideal"])
def test_mean_and_variance_match_repeated_frames(name):
    sensor, n = PRESETS[name], 600
    levels = np.concatenate([[0], np.geomspace(0.1, 1.2 * sensor.capacity_e, 60)]) / sensor.eta
    photons = np.tile(levels, (6, 1))
    frames = np.stack([expose(photons, sensor, EXPOSURE, seed=4, view=0, frame=i).dn for i in range(n)]).astype(float)
    frame = expose(photons, sensor, EXPOSURE, seed=4, view=0)
    centred = frames - frames.mean(0)
    variance = frames.var(0, ddof=1)
    error = np.abs(frames.mean(0) - frame.mean_dn) / np.sqrt(np.maximum(frame.variance_dn, 1e-6) / n)
    assert error.max() < 5
    spread = np.sqrt(np.maximum((centred**4).mean(0) - variance**2, 1e-9) / n)
    assert (np.abs(variance - frame.variance_dn) <= 5 * spread + 0.02).all()


def test_bad_light_is_refused_with_count_and_place():
    photons = np.ones((4, 5))
    photons[2, 3] = np.nan
    photons[3, 1] = -1
    with pytest.raises(ValueError, match=r"got nan at \(2, 3\) \(2 of 20 values\)"):
        expose(photons, PRESETS["ideal"], EXPOSURE, seed=0, view=0)


def test_switching_one_effect_off_leaves_the_other_draws():
    def sensor(**changes):
        fields = {"gain": 2.0, "eta": 0.5, "mu_e_sat": 1e4, "black_level": 100, "bits": 14, "sigma_d": 3.0, "dsnu": 2.0}
        return Sensor(**(fields | changes))

    photons = np.full((40, 50), 30.0)
    whole = expose(photons, sensor(), EXPOSURE, seed=1, view=1).dn.astype(float)
    silent = expose(photons, sensor(sigma_d=0.0), EXPOSURE, seed=1, view=1).dn.astype(float)
    dark = expose(0 * photons, sensor(), EXPOSURE, seed=1, view=1).dn.astype(float)
    pattern = expose(0 * photons, sensor(sigma_d=0.0), EXPOSURE, seed=1, view=1).dn.astype(float)
    # shot noise on its own is the same as shot noise within the whole chain, up to four roundings
    assert np.abs((whole - dark) - (silent - pattern)).max() <= 2


def test_views_differ_but_the_pattern_stays():
    sensor = PRESETS["imx900-lcg"]
    dark = np.zeros((200, 200))
    frames = [expose(dark, sensor, EXPOSURE, seed=0, view=v).dn.astype(float) for v in range(2)]
    covariance = ((frames[0] - frames[0].mean()) * (frames[1] - frames[1].mean())).mean()
    expected = (sensor.gain * sensor.dsnu) ** 2
    assert covariance == pytest.approx(expected, abs=5 * frames[0].var() / 200)


def test_mosaic_picks_each_filter_for_odd_sizes():
    rgb = np.arange(5 * 7 * 3).reshape(5, 7, 3)
    for cfa in ("RGGB", "GRBG", "GBRG", "BGGR"):
        picked = mosaic(rgb, cfa)
        for y in range(5):
            for x in range(7):
                assert picked[y, x] == rgb[y, x, "RGB".index(cfa[2 * (y % 2) + x % 2])]


@pytest.mark.parametrize("axis", [0, 1])
def test_row_and_column_noise_move_whole_lines_and_change_with_every_frame(axis):
    """Rationale: inside one pixel's variance it hides; means of rows (columns) show it. Three chips are independent."""
    name = ("sigma_row", "sigma_column")[axis]
    sensor = Sensor(gain=2.0, eta=0.5, mu_e_sat=1e4, black_level=200, bits=14, sigma_d=2.0, cfa=None, **{name: 1.5})
    h, w = 400, 300
    frames = [expose(np.full((h, w, 3), 8.0), sensor, EXPOSURE, seed=0, view=0, frame=i).dn / 2.0 for i in range(2)]
    lines, length = ((h, w), (w, h))[axis]
    means = [f.mean(1 - axis) for f in frames]
    pixel = 4 + 4 + 1 / 48
    for channel in range(3):
        expected = 1.5**2 + pixel / length
        assert means[0][:, channel].var(ddof=1) == pytest.approx(expected, abs=5 * expected * np.sqrt(2 / lines))
        assert abs(np.corrcoef(means[0][:, channel], means[1][:, channel])[0, 1]) < 5 / np.sqrt(lines)
    assert abs(np.corrcoef(means[0][:, 0], means[0][:, 1])[0, 1]) < 5 / np.sqrt(lines)
    across = frames[0].mean(axis)[:, 0].var(ddof=1)
    assert across == pytest.approx(pixel / lines, abs=5 * pixel / lines * np.sqrt(2 / length))


def test_black_level_errors_of_the_colours_show_in_their_pixels():
    sensor = Sensor(
        gain=2.0, eta=0.5, mu_e_sat=1e4, black_level=200, bits=14, sigma_d=2.0, cfa="GBRG", rgb_bias=(5.0, -1.0, 2.0)
    )
    dn = expose(np.zeros((200, 200)), sensor, EXPOSURE, seed=0, view=0).dn.astype(float)
    for (y, x), bias in (((0, 0), -1), ((0, 1), 2), ((1, 0), 5), ((1, 1), -1)):
        assert dn[y::2, x::2].mean() == pytest.approx(200 + bias, abs=5 * 4.01 / 100)


def test_seeds_views_and_frames_give_frames_of_their_own_and_repeat():
    sensor, light = PRESETS["a7s2-iso6400"], np.full((30, 40), 10.0)
    keys = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (2**64 - 1, 0, 0), (0, 2**32 - 1, 0)]
    frames = [expose(light, sensor, EXPOSURE, seed=s, view=v, frame=f).dn for s, v, f in keys]
    for i, frame in enumerate(frames):
        s, v, f = keys[i]
        np.testing.assert_array_equal(frame, expose(light, sensor, EXPOSURE, seed=s, view=v, frame=f).dn)
        assert all((frame != other).mean() > 0.5 for other in frames[:i])


def test_light_in_physical_order_filter_before_quantum_efficiency_before_noise():
    """System test. Rationale: every stage once, in order. Expectation: the EMVA linear model, mean and variance."""
    sensor = Sensor(gain=1.7, eta=0.55, mu_e_sat=3e4, black_level=100, bits=16, sigma_d=4.0, dark_current=200.0)
    photons = np.full((500, 500), 300.0)
    dn = expose(photons, sensor, Exposure(time=0.1), seed=0, view=0).dn.astype(float)
    charge = 0.55 * 300 + 20
    variance = 1.7**2 * (charge + 16) + 1 / 12
    assert dn.mean() == pytest.approx(100 + 1.7 * charge, abs=5 * np.sqrt(variance) / 500)
    assert dn.var() == pytest.approx(variance, rel=5 * np.sqrt(2 / 250_000))


@pytest.mark.parametrize(
    ("photons", "cfa", "message"),
    [
        (np.zeros((4, 4, 3)), "RGGB", r"photons must be of shape \[h, w\]"),
        (np.zeros((4, 4, 2)), None, "photons must be of shape"),
        (np.zeros((0, 4)), None, "photons must be of shape"),
        (np.zeros((4, 4), complex), None, "photons must be real numbers"),
        (np.full((4, 4), True), None, "photons must be real numbers"),
    ],
)
def test_light_of_the_wrong_shape_or_type_is_refused(photons, cfa, message):
    sensor = Sensor(gain=1.0, eta=1.0, mu_e_sat=100.0, black_level=0, bits=8, cfa=cfa)
    with pytest.raises(ValueError, match=message):
        expose(photons, sensor, EXPOSURE, seed=0, view=0)
    with pytest.raises(ValueError, match="shot must be one of"):
        expose(np.zeros((4, 4)), sensor, EXPOSURE, seed=0, view=0, shot="gauss")


def test_a_crop_has_its_own_part_of_the_banding():
    sensor = Sensor(
        gain=2.0, eta=0.5, mu_e_sat=1800.0, black_level=64, bits=12, sigma_d=1.5, cfa=None,
        banding=Banding(amplitude=4.0, period=7.3),
    )  # fmt: skip
    photons = np.full((40, 30), 200.0)
    whole = expose(photons, sensor, EXPOSURE, seed=7, view=1)
    part = expose(photons[3:, 5:], sensor, Exposure(time=EXPOSURE.time, origin=(3, 5)), seed=7, view=1)
    np.testing.assert_array_equal(part.dn, whole.dn[3:, 5:])


@pytest.mark.parametrize("gain", [0.5, 3.0])
@pytest.mark.parametrize("backend", ["numpy", "numba"])
def test_codes_are_black_level_plus_gain_times_electrons(gain, backend):
    """Of a camera whose read noise is a hundredth of a code: all that is left is shot noise, known to the electron."""
    sensor = Sensor(gain=gain, eta=0.5, mu_e_sat=1e6, black_level=64.0, bits=16, sigma_d=0.01 / gain, cfa=None)
    light = np.full((40, 50), 800.0)
    frame = expose(light, sensor, Exposure(time=0.01), seed=1, view=0, backend=backend)
    electrons = (frame.dn - 64.0) / gain
    assert electrons.mean() == pytest.approx(400, abs=5 * np.sqrt(400 / light.size))
    assert electrons.var() == pytest.approx(400, rel=5 * np.sqrt(2 / light.size))
    np.testing.assert_allclose(frame.clean_dn, 64 + 400 * gain, rtol=1e-6)


def test_the_noise_free_exposure_ends_where_codes_end():
    """A well of 4000 e- at a gain of 3 is more than 10 bits have; without that, the whole signal is there."""
    light = np.array([[40.0, 4e5]])
    for bits, most in ((10, 1023.0), (16, 100 + 3 * 4000.0)):
        sensor = Sensor(gain=3.0, eta=0.5, mu_e_sat=4000.0, black_level=100.0, bits=bits, sigma_d=1.0, cfa=None)
        frame = expose(light, sensor, Exposure(time=0.01), seed=1, view=0)
        np.testing.assert_allclose(frame.clean_dn, [[160, most]], rtol=1e-6)


def test_every_frame_of_a_burst_is_in_its_mean_and_a_pixel_that_any_of_them_cut_off_is_saturated():
    sensor = PRESETS["a7s2-iso6400"]
    light = np.full((3, 16, 16), 40.0)
    for k, row in enumerate((2, 7, 12)):
        light[k, row] = 2 * sensor.capacity_e / sensor.eta
    burst = expose_burst(light, sensor, EXPOSURE, frames=3, seed=1, view=0)
    mean = mean_of(burst)
    assert np.flatnonzero(mean.saturated.all(1)).tolist() == [2, 7, 12]
    assert mean.saturated.sum() == 3 * 16
    assert mean.frames == 3
    assert np.array_equal(mean.dn, np.rint(np.mean([frame.dn for frame in burst], axis=0)))
    alone = mean_of(burst[:1])
    assert alone is burst[0]


@pytest.mark.parametrize("frames", [3, 4, 16])
def test_the_moments_of_a_burst_are_those_of_its_rounded_mean(frames):
    """Where its noise is a third of a code, rounding moves the mean and takes variance away, not adds 1/12."""
    sensor = replace(PRESETS["a7s2-iso100-3chip"], cfa=None, sigma_row=0.0, sigma_d=3.0 * frames**0.5)

    def taken(electrons, shape):
        light = np.full(shape, electrons / sensor.eta)
        return mean_of(expose_burst(light, sensor, Exposure(time=0.01), frames=frames, seed=0, view=0))

    for electrons in (20.0, 22.0, 24.0):
        burst = taken(electrons, (200, 100))
        assert burst.dn.mean() == pytest.approx(burst.mean_dn.mean(), abs=0.01)
        assert burst.dn.var() == pytest.approx(burst.variance_dn.mean(), rel=0.1)
    full = taken(1e6, (8, 8))
    assert (full.dn == sensor.max_dn).all()
    assert (full.mean_dn == sensor.max_dn).all()
    assert full.variance_dn.max() < 1e-6


def test_no_shot_noise_is_none_whatever_the_plan_takes_for_it():
    """Of so much light the plan takes normal shot noise."""
    sensor, light = PRESETS["a7s2-iso100-3chip"], np.full((50, 50, 3), 5000.0)
    plan = plan_effects(sensor, Exposure(time=0.01), [3000.0])
    assert not plan.is_on("poisson")
    frame = expose(light, sensor, Exposure(time=0.01), seed=0, view=0, plan=plan, shot="none")
    assert frame.dn.var() == pytest.approx(sensor.gain**2 * (sensor.sigma_d**2 + sensor.sigma_row**2) + 1 / 12, rel=0.1)
    assert frame.shot == "none"


@pytest.mark.parametrize("times", [4.0, 0.25])
def test_the_truth_of_a_view_that_was_exposed_for_another_time_is_the_common_exposure(times):
    """Dark charge grows with the time, so it is not enough to divide the light."""
    sensor = Sensor(gain=2.0, eta=0.5, mu_e_sat=1e4, black_level=200, bits=14, dark_current=900.0)
    light, common = np.linspace(5.0, 400.0, 64).reshape(8, 8), Exposure(time=0.1)
    taken = expose(times * light, sensor, replace(common, time=times * common.time), seed=0, view=0)
    alone = expose(light, sensor, common, seed=0, view=0)
    np.testing.assert_allclose(replace(taken, times=times).clean_dn, alone.clean_dn, rtol=1e-6)
