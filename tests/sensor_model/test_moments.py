"""Analytic mean and variance per pixel against 10 000 simulated frames, from no light to 20 % over full well.

Where nothing differs between pixels, the rows of one tall frame serve as the frames; cameras with a fixed pattern, row
or column noise are exposed 10 000 times.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from sensor_model import PRESETS, Banding, Defects, DualGain, Exposure, Sensor, effects, expose, moments
from sensor_model.effect_list import EFFECT_LIST, OwnEffect
from sensor_model.frame.interpixel import coupled_variance, positive_part
from sensor_model.moments import code_moments

FRAMES = 10_000
EXPOSURE = Exposure(time=0.1)
BASE = {"gain": 1.3, "eta": 0.6, "mu_e_sat": 2500.0, "black_level": 100.0, "bits": 12, "sigma_d": 2.0, "cfa": None}
UNIFORM = {
    "plain": {},
    "adc saturates first": {"mu_e_sat": 1e5},
    "both saturate": {"mu_e_sat": 3073.0},
    "dual gain": {"dual_gain": DualGain(threshold=800, sigma_d=20, ratio=6)},
    "nonlinear": {"nonlinearity": 0.03},
    "no read noise": {"sigma_d": 0.0},
    "noise under a code": {"sigma_d": 0.2},
    "no black level": {"black_level": 0.0},
    "black level too low": {"black_level": 2.0, "gain": 0.8},
    "no black level, heavy tails": {"black_level": 0.0, "tukey_lambda": -0.1},
    "eight bits": {"bits": 8, "gain": 0.08, "black_level": 16.0},
    "coarse steps": {"gain": 0.1, "mu_e_sat": 40000.0},
    "several codes per electron": {"gain": 20.0, "mu_e_sat": 150.0},
    "ideal": PRESETS["ideal"],
    "imx385-iso25600": replace(PRESETS["imx385-iso25600"], sigma_row=0.0),
}
PATTERNED = {
    "fixed pattern": {"dsnu": 2.0, "prnu": 0.01},
    "rows, columns, bands": {"sigma_row": 1.0, "sigma_column": 0.5, "banding": Banding(amplitude=2.0, period=7)},
    "defects": {
        "dark_current": 20.0,
        "defects": Defects(hot_fraction=0.3, hot_factor=50, rts_fraction=0.3, rts_factor=3),
    },
    "coupling": {"coupling": 0.03, "mu_e_sat": 1e5, "gain": 0.04, "black_level": 200.0, "bits": 14},
    "coupling, bent": {"coupling": 0.05, "nonlinearity": 0.05, "mu_e_sat": 4000.0},
    "several traps": {"defects": Defects(rts_fraction=0.5, rts_factor=3, rts_traps=3)},
    "imx900-lcg": PRESETS["imx900-lcg"],
    "imx900-hcg": PRESETS["imx900-hcg"],
    "a7s2-iso1600": PRESETS["a7s2-iso1600"],
    "a7s2-iso25600": PRESETS["a7s2-iso25600"],
}


def camera(description):
    sensor = Sensor(**(BASE | description)) if isinstance(description, dict) else description
    return replace(sensor, cfa=None)


def levels(sensor):
    """64 levels of light from none to 20 % over saturation."""
    charge = np.concatenate([[0, 1e-3, 0.1], np.geomspace(0.5, 1.2 * sensor.capacity_e, 61)])
    return charge / sensor.eta


def assert_agree(samples, frame, sensor):
    mean, variance = (m.ravel().astype(np.float64) for m in (frame.mean_dn, frame.variance_dn))
    n = len(samples)
    found = samples.mean(0)
    # float32 maps; and a clip that no sample reached has an analytic variance but no sampled one
    rounding = 1e-6 * np.abs(mean) + 1e-3
    assert (np.abs(found - mean) <= 5 * np.sqrt(variance / n) + rounding).all()
    deviations = samples - found
    spread = np.sqrt(np.maximum((deviations**4).mean(0) - (deviations**2).mean(0) ** 2, 0) / n)
    rare = (5 * max(sensor.gain, 1)) ** 2 / n  # one sample five electrons off
    np.testing.assert_array_less(
        np.abs(samples.var(0, ddof=1) - variance), 5 * spread + 5 * np.sqrt(variance * rare) + 2e-3
    )


@pytest.mark.parametrize("name", list(UNIFORM))
def test_moments_match_frames_of_uniform_pixels(name):
    sensor = camera(UNIFORM[name])
    light = levels(sensor)
    tall = expose(np.tile(light, (FRAMES, 1)), sensor, EXPOSURE, seed=3, view=0)
    assert_agree(tall.dn.astype(np.float64), expose(light[None], sensor, EXPOSURE, seed=3, view=0), sensor)


@pytest.mark.parametrize("name", list(PATTERNED))
def test_moments_match_frames_of_one_camera_pixel_by_pixel(name):
    sensor = camera(PATTERNED[name])
    light = levels(sensor).reshape(8, 8)
    frames = [expose(light, sensor, EXPOSURE, seed=3, view=0, frame=i, threads=1) for i in range(FRAMES)]
    samples = np.stack([f.dn.ravel() for f in frames]).astype(np.float64)
    assert_agree(samples, frames[0], sensor)


@pytest.mark.parametrize("shot", ["normal", "none"])
def test_moments_follow_the_shot_noise_that_was_asked_for(shot):
    sensor = camera({})
    light = levels(sensor)
    tall = expose(np.tile(light, (FRAMES, 1)), sensor, EXPOSURE, seed=3, view=0, shot=shot)
    assert_agree(tall.dn.astype(np.float64), expose(light[None], sensor, EXPOSURE, seed=3, view=0, shot=shot), sensor)


def test_blooming_moments_match_frames():
    """Rationale: spilled charge carries the noise of its sources. Expectation: exact where nothing spills; where charge
    arrives, sums over pixels are taken as normal: the mean within 2 e- and the deviation within 5 %."""
    sensor = camera({"blooming": True})
    light = np.full((12, 5), 100.0)
    light[4, 1] = 4.3 * sensor.mu_e_sat / sensor.eta  # one bright pixel
    light[3:6, 2] = 1.7 * sensor.mu_e_sat / sensor.eta  # three side by side
    light[5, 3] = sensor.mu_e_sat / sensor.eta  # just full
    light[:, 4] = 0.97 * sensor.mu_e_sat / sensor.eta  # all nearly full
    frames = np.stack([expose(light, sensor, EXPOSURE, seed=1, view=0, frame=i).dn for i in range(FRAMES)]).astype(
        float
    )
    frame = expose(light, sensor, EXPOSURE, seed=1, view=0)
    mean, sd = frames.mean(0), frames.std(0)
    error = np.abs(mean - frame.mean_dn)
    assert (error[:, 0] < 5 * sd[:, 0] / FRAMES**0.5).all()
    assert error.max() < 2 * sensor.gain
    np.testing.assert_allclose(np.sqrt(frame.variance_dn), sd, rtol=0.05, atol=0.3 * sensor.gain)
    spilled = frame.variance_dn[:, 1] > 2 * frame.variance_dn[0, 0]
    assert spilled.sum() >= 1  # the last pixel that the charge reaches


@pytest.mark.parametrize("coupling", [0.0, 0.05])
def test_the_moments_of_coupled_pixels_bend_with_the_response(coupling):
    """Independent reference: n - a n**2 over the normal distribution of the charge, by Gauss-Hermite quadrature.
    Rationale: sampled frames leave the terms of second order in the spread unseen."""
    sensor = camera({"nonlinearity": 0.3, "mu_e_sat": 1200.0, "coupling": coupling or 1e-12})
    charge, droop = 700.0, 0.3 / 1200
    x, weight = np.polynomial.hermite_e.hermegauss(40)
    n = charge + np.sqrt(charge * ((1 - 4 * coupling) ** 2 + 4 * coupling**2)) * x
    signal, weight = n - droop * n**2, weight / weight.sum()
    frame = expose(np.full((5, 5), charge / 0.6), sensor, EXPOSURE, seed=0, view=0, shot="normal")
    mean = weight @ signal
    variance = weight @ (signal - mean) ** 2
    assert frame.mean_dn[2, 2] == pytest.approx(100 + 1.3 * mean, rel=1e-6)
    assert frame.variance_dn[2, 2] == pytest.approx(1.3**2 * (variance + 2.0**2) + 1 / 12, rel=3e-6)


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 5, 1), (4, 1, 2), (4, 5, 3)])
def test_coupled_variance_is_the_sum_of_the_squared_weights(shape):
    """Independent reference: what crosstalk makes of a single pixel gives the weights."""
    variance, share = np.random.default_rng(0).random(shape), 0.07
    expected = np.zeros(shape)
    for place in np.ndindex(shape):
        alone = np.zeros(shape)
        alone[place] = 1.0
        expected += effects.crosstalk(alone, share) ** 2 * variance[place]
    np.testing.assert_allclose(coupled_variance(variance, share), expected, rtol=1e-12)


@pytest.mark.parametrize("variance", [0.0, 1e-320, 1e-30])
def test_charge_with_a_trace_of_noise_overflows_or_it_does_not(variance):
    """Far down a column that blooms next to no noise is left. Warnings are errors here."""
    mean, spread = positive_part(np.array([5.0, -5.0]), np.full(2, variance))
    np.testing.assert_array_equal(mean, [5.0, 0.0])
    np.testing.assert_allclose(spread, 0.0, atol=1e-14)


@pytest.mark.parametrize("sd", [0.05, 0.2, 0.3, 0.5, 0.7999, 0.8, 3.0, 40.0])
def test_moments_of_a_rounded_clipped_normal_match_the_sum_over_codes(sd):
    """Independent reference: the probability of every code, summed."""
    from scipy.stats import norm

    top = 255.0
    level = np.array([-3.3 * sd, -0.5, 0.0, 0.31, 1.5, 127.2, 254.9, 255.0, 255 + 2.2 * sd])
    codes = np.arange(256.0)
    upper = norm.cdf((codes[:-1] + 0.5 - level[:, None]) / sd)
    p = np.diff(np.concatenate([np.zeros((9, 1)), upper, np.ones((9, 1))], 1), axis=1)
    mean = p @ codes
    variance = (p * (codes - mean[:, None]) ** 2).sum(1)
    found_mean, found_variance = code_moments(level, np.full(9, sd), top)
    # from 0.8 DN of noise on, Euler-Maclaurin: what its next end term would correct
    np.testing.assert_allclose(found_mean, mean, atol=0.002 if sd >= 0.8 else 1e-9)
    np.testing.assert_allclose(found_variance, variance, atol=0.01 if sd >= 0.8 else 1e-9, rtol=1e-6)


def test_the_clean_image_has_neither_noise_nor_pattern_and_saturates():
    sensor = camera({"dsnu": 3.0, "prnu": 0.02, "nonlinearity": 0.02})
    light = np.array([[0.0, 1000.0, 1e9]])
    clean = expose(light, sensor, EXPOSURE, seed=0, view=0).clean_dn
    droop = 600 * 600 * 0.02 / 2500
    np.testing.assert_allclose(clean, [[100, 100 + 1.3 * (600 - droop), 100 + 1.3 * 2450]], rtol=1e-6)


@pytest.mark.parametrize("name", ["imx385-iso25600", "imx686-iso6400", "ideal", "a7s2-iso25600"])
def test_tables_for_many_pixels_equal_the_integral_of_each(name):
    """Rationale: frames share one table per kind of pixel; expectation: within a thousandth of the noise."""
    sensor = camera(PRESETS[name])
    light = np.random.default_rng(0).gamma(0.7, 40, (250, 400))
    frame = expose(light, sensor, EXPOSURE, seed=0, view=0)
    rows = light[::25, :40]  # few enough to be integrated one by one
    alone = expose(rows, sensor, EXPOSURE, seed=0, view=0)
    sd = np.sqrt(alone.variance_dn) + 0.01
    assert (np.abs(frame.mean_dn[::25, :40] - alone.mean_dn) / sd).max() < 1e-3
    np.testing.assert_allclose(frame.variance_dn[::25, :40], alone.variance_dn, rtol=2e-3, atol=1e-4)


def test_no_list_of_electrons_is_longer_than_stated_where_hot_pixels_lie_beside_dark_ones(monkeypatch):
    """Rationale: 512 pixels share a list; from 10 to 900 000 electrons it would take 3.7 GB."""
    charge = np.array([10.0] * 300 + [2e4] * 5 + [4e5, 9e5])
    lists, computed = [], moments.integrated_moments

    def recorded(sensor, mu, *given):
        low, high, step = moments._span(mu[[0, -1]])
        lists.append((high - low) / step)
        return computed(sensor, mu, *given)

    monkeypatch.setattr(moments, "integrated_moments", recorded)
    deep = camera({"mu_e_sat": 2e6, "bits": 16, "gain": 0.05})
    mean, _ = moments._in_batches(deep, charge, np.full_like(charge, 100.0), np.zeros_like(charge), "poisson")
    assert max(lists) <= moments.LONGEST
    np.testing.assert_allclose(mean, 100 + 0.05 * charge, rtol=1e-3)


@pytest.mark.parametrize(("shot", "rounding"), [("poisson", 0.0), ("normal", 1 / 12)])
def test_whole_electrons_that_are_whole_codes_lose_nothing_in_rounding(shot, rounding):
    """Rationale: only a Poisson count is whole; normal shot noise falls between the codes."""
    sensor = Sensor(gain=1.0, eta=1.0, sigma_d=0.0, mu_e_sat=30_000.0, black_level=100.0, bits=16, cfa=None)
    frame = expose(np.full((1, 1), 1.3), sensor, EXPOSURE, seed=0, view=0, shot=shot)
    # a normal 1.1 codes wide is integrated in steps of 0.06 codes
    assert float(frame.mean_dn[0, 0]) == pytest.approx(101.3, abs=0.01)
    assert float(frame.variance_dn[0, 0]) == pytest.approx(1.3 + rounding, abs=0.03)


def test_few_electrons_of_many_codes_are_cut_off_at_white_though_white_is_eight_deviations_away():
    """Rationale: one electron in a hundred pixels is ten deviations of their noise."""
    sensor = camera({"gain": 100.0, "bits": 10, "black_level": 938.0, "sigma_d": 0.01})
    frame = expose(np.full((500, 600), 0.01 / sensor.eta), sensor, EXPOSURE, seed=2, view=0)
    dn = frame.dn.astype(np.float64)
    assert dn.max() == sensor.max_dn < sensor.black_level + sensor.gain
    assert frame.mean_dn.max() == pytest.approx(dn.mean(), abs=5 * dn.std() / dn.size**0.5)
    assert frame.variance_dn.max() == pytest.approx(dn.var(), rel=0.1)


@dataclass(frozen=True, kw_only=True)
class NoSettings:
    """Of an effect that has none."""


def test_an_effect_from_outside_moves_mean_and_variance_by_its_electrons_in_codes(monkeypatch):
    """At 1.3 DN/e-; the signal is the light's, cut at full well."""
    haze = OwnEffect(
        title="haze", config=NoSettings, sample=lambda signal, *_: 0 * signal,
        mean=lambda signal, *_: 20 + 0.1 * signal,
        variance=lambda signal, *_: 3 + 0.2 * signal, cost=lambda signal, *_: (0 * signal, 0 * signal),
    )  # fmt: skip
    monkeypatch.setitem(EFFECT_LIST, "haze", haze)
    charge = np.array([[0.0, 50.0, 400.0]])
    plain, hazy = (
        expose(charge / 0.6, Sensor(**BASE, effects=effects), EXPOSURE, seed=0, view=0)
        for effects in ({}, {"haze": {}})
    )
    np.testing.assert_allclose(hazy.mean_dn - plain.mean_dn, 1.3 * (20 + 0.1 * charge), rtol=1e-3)
    np.testing.assert_allclose(hazy.variance_dn - plain.variance_dn, 1.3**2 * (3 + 0.2 * charge), rtol=1e-2)
    full = [
        expose(np.full((1, 1), 4000 / 0.6), Sensor(**BASE, effects=effects), EXPOSURE, seed=0, view=0).mean_dn.item()
        for effects in ({}, {"haze": {}})
    ]
    assert full[1] - full[0] == pytest.approx(1.3 * (20 + 0.1 * BASE["mu_e_sat"]), rel=1e-3)


def test_how_near_a_limit_codes_are_counts_the_gain() -> None:
    """A Poisson number reaches a quarter of REACH**2 farther than its deviation says: in codes, times the gain."""
    for gain in (0.25, 4.0):
        sensor = Sensor(gain=gain, eta=0.5, mu_e_sat=np.inf, black_level=100.0, bits=16, sigma_d=1.0, cfa=None)
        sd, skew = np.array([50.0]), gain * moments.REACH**2 / 4
        edge = sensor.max_dn - moments.REACH * sd - skew - 1
        assert moments._near_a_limit(sensor, np.array([100.0]), edge + 0.01, sd).all()
        assert not moments._near_a_limit(sensor, np.array([100.0]), edge - 0.01, sd).any()
