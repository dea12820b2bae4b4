"""The whole chain: moments, reproducibility, and inputs that must be refused."""

import numpy as np
import pytest

from sensor_model import PRESETS, Exposure, Sensor, expose, mosaic

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
