"""The noise that methods may see, against the analytic moments of frames and against exposures of flat fields."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from sensor_model import (
    PRESETS,
    Banding,
    DualGain,
    Exposure,
    Sensor,
    develop,
    expose,
    from_linear16,
    linear_noise,
    plan_effects,
    raw_noise,
)
from sensor_model.capture import expose_burst, mean_of
from sensor_model.effect_list import EFFECT_LIST, OwnEffect
from sensor_model.mosaicking import channel_index

EXPOSURE = Exposure(time=0.05)
NOISY = Sensor(
    gain=1.7, eta=0.6, mu_e_sat=6000.0, black_level=300.0, bits=14, sigma_d=3.0, sigma_row=0.9, sigma_column=0.6,
    dsnu=2.0, prnu=0.02, dark_current=400.0, rgb_response=(0.5, 1.0, 0.7), rgb_bias=(4.0, -3.0, 2.0), cfa=None,
    banding=Banding(amplitude=1.2, period=9),
)  # fmt: skip
EVEN = {"dsnu": 0.0, "defects": None}
CAMERAS = {name: replace(s, **EVEN) for name, s in PRESETS.items() if not name.endswith("-3chip")} | {
    "rows, columns, bands, dark, bias": replace(NOISY, dsnu=0.0),
    "uneven response": replace(NOISY, dsnu=0.0, prnu=0.1),
    "bent": replace(NOISY, dsnu=0.0, nonlinearity=0.05),
    "bent by two fifths": replace(NOISY, dsnu=0.0, nonlinearity=0.4),
    "coupled": replace(NOISY, dsnu=0.0, prnu=0.0, coupling=0.04),
    "coarse codes": Sensor(gain=0.5, eta=1.0, mu_e_sat=8000.0, black_level=64.0, bits=12, sigma_d=2.0, cfa=None),
    "two gains": replace(NOISY, dsnu=0.0, prnu=0.0, dual_gain=DualGain(threshold=1500.0, sigma_d=30.0, ratio=8)),
}
MATRIX = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.1, -0.6, 1.5]])


@dataclass(frozen=True, kw_only=True)
class NoSettings:
    """Of an effect that has none."""


def assert_variance(samples, expected, *, axis=None):
    """Sample variance within five standard errors, from the sample's own fourth moment."""
    n = samples.size if axis is None else samples.shape[axis]
    deviations = samples - samples.mean(axis, keepdims=True)
    square = (deviations**2).mean(axis)
    error = np.sqrt(((deviations**4).mean(axis) - square**2) / n)
    assert (np.abs(square - expected) < 5 * error).all(), (square, expected, error)


@pytest.mark.parametrize("name", list(CAMERAS))
def test_the_curve_is_the_analytic_variance_over_the_analytic_mean(name):
    """Rationale: the moments of frames are the truth. Flat rows, clear of black, white and of the switch of the gains;
    dark current, PRNU, row noise and rounding are in. To first order in the bend over a standard deviation: 0.1 %."""
    sensor = CAMERAS[name]
    curve = raw_noise(sensor, EXPOSURE, channels=3 if sensor.cfa else 1, fixed_pattern=False)
    channels = channel_index((6, 8), sensor.cfa) if sensor.cfa else np.zeros((6, 8), int)
    inner = np.zeros((6, 8), bool)
    inner[1:-1, 1:-1] = True  # coupling reflects at the border
    assert min(curve.black) >= 5 * max(curve.offset) ** 0.5  # shot noise does not reach below black
    compared = 0
    for charge in (0.0, 2.0, 9.0, *(share * sensor.capacity_e for share in (0.04, 0.1, 0.2, 0.5, 0.85))):
        frame = expose(np.full((6, 8), charge / sensor.eta), sensor, EXPOSURE, seed=0, view=0)
        mean, sd = frame.mean_dn, np.sqrt(frame.variance_dn)
        clear = inner & (sensor.white_dn - mean > 7 * sd)
        found = curve.variance(mean, channels)
        rtol = 1e-3 if sensor.nonlinearity > 0.01 else 1e-4
        np.testing.assert_allclose(found[clear], frame.variance_dn[clear], rtol=rtol, atol=1e-3)
        compared += clear.any()
    assert compared >= 5


def test_rounding_counts_on_average_where_no_noise_blurs_it():
    """0.2 DN of noise: one level of light may lie on a code or between two, all of them together err by 1/12 DN**2."""
    sensor = Sensor(gain=0.01, eta=1.0, mu_e_sat=1e6, black_level=64.0, bits=14, sigma_d=20.0, cfa=None)
    plan = plan_effects(sensor, EXPOSURE, 1e4).force(off=["photon_shot"])
    light = np.random.default_rng(0).uniform(1e4, 2e4, (400, 500))
    dn = expose(light, sensor, EXPOSURE, seed=0, view=0, plan=plan).dn
    expected = raw_noise(sensor, EXPOSURE, channels=1, plan=plan).variance(150.0)
    assert expected == pytest.approx(0.2**2 + 1 / 12)
    assert_variance(dn - (64 + 0.01 * light), expected)


def test_what_a_plan_leaves_out_is_not_in_the_curve():
    plan = plan_effects(NOISY, EXPOSURE, [20.0, 300.0]).force(
        on=["dsnu", "read_noise"], off=["photon_shot", "row_noise", "column_noise", "banding", "prnu"]
    )
    curve = raw_noise(NOISY, EXPOSURE, plan=plan)
    np.testing.assert_allclose(curve.variance(np.full(3, 500.0)), 1.7**2 * (9 + 4) + 1 / 12)
    bent = raw_noise(replace(NOISY, nonlinearity=0.1), EXPOSURE, plan=plan)
    np.testing.assert_allclose(bent.variance(np.full(3, 5000.0)), curve.variance(np.full(3, 500.0)))


@pytest.mark.parametrize("nonlinearity", [0.0, 0.2])
def test_the_low_gain_adds_its_noise_from_its_threshold_on(nonlinearity):
    low = DualGain(threshold=1500.0, sigma_d=30.0, ratio=8)
    sensor = replace(NOISY, prnu=0.0, nonlinearity=nonlinearity, dual_gain=low)
    balance, white = np.array([2.0, 1.0, 1 / 0.7]), sensor.white_dn - 300
    at = 1.7 * (1500 - nonlinearity / 6000 * 1500**2) + np.array([4.0, -3.0, 2.0])
    added = 1.7**2 * (900 - 9) + 63 / 12
    for curve, mean, unit in (
        (raw_noise(sensor, EXPOSURE), 300 + at, np.ones(3)),
        (linear_noise(sensor, EXPOSURE), balance * at / white, balance / white),
    ):
        step = curve.variance(mean * (1 + 1e-9)) - curve.variance(mean * (1 - 1e-9))
        np.testing.assert_allclose(step, unit**2 * added, rtol=1e-4)


@pytest.mark.parametrize("nonlinearity", [0.0, 0.3])
@pytest.mark.parametrize("charge", [0.0, 40.0, 1500.0])
def test_the_fixed_pattern_of_the_pixels_is_noise_to_a_method(charge, nonlinearity):
    """One frame of a flat field: pixels differ by temporal noise, DSNU and PRNU, which acts on light and not on dark
    charge, before the response bends. Noise of whole rows and columns, whose few draws make a sample variance of its
    own, is left out."""
    sensor = replace(NOISY, sigma_row=0.0, sigma_column=0.0, banding=None, rgb_bias=(0.0,) * 3, dark_current=8000.0,
                     nonlinearity=nonlinearity)  # fmt: skip
    dn = expose(np.full((700, 700), charge / sensor.eta), sensor, EXPOSURE, seed=0, view=0).dn.astype(np.float64)
    mean = 300 + 1.7 * (charge + 400 - sensor.droop * (charge + 400) ** 2)
    slope = 1 - 2 * sensor.droop * (charge + 400)
    curves = [raw_noise(sensor, EXPOSURE, channels=1, fixed_pattern=f) for f in (True, False)]
    assert_variance(dn, curves[0].variance(mean))
    added = curves[0].variance(mean) - curves[1].variance(mean)
    assert added == pytest.approx(1.7**2 * (2.0**2 + (0.02 * charge * slope) ** 2))


@pytest.mark.parametrize("frames", [1, 2, 16])
def test_the_mean_of_a_burst_has_less_temporal_noise_and_the_whole_pattern(frames):
    """In each of three channels. Without lines and bands, whose few draws make a sample variance of their own."""
    sensor = replace(NOISY, sigma_row=0.0, sigma_column=0.0, banding=None)
    light = np.broadcast_to(np.array([50.0, 400.0, 2500.0]) / sensor.eta, (200, 200, 3))
    mean = mean_of(expose_burst(light, sensor, EXPOSURE, frames=frames, seed=0, view=0))
    levels = mean.dn.mean((0, 1))
    curve = raw_noise(sensor, EXPOSURE, frames=frames)
    assert_variance(mean.dn.reshape(-1, 3).astype(np.float64), curve.variance(levels), axis=0)
    with_pattern, without = (raw_noise(sensor, EXPOSURE, fixed_pattern=of, frames=frames) for of in (True, False))
    alone = [raw_noise(sensor, EXPOSURE, fixed_pattern=of) for of in (True, False)]
    pattern = [more.variance(levels) - less.variance(levels) for more, less in ((with_pattern, without), alone)]
    np.testing.assert_allclose(*pattern, rtol=1e-9)
    rounding = 1 / 12 if frames > 1 else 0.0  # of the mean, beside a share of each frame's
    np.testing.assert_allclose(without.variance(levels), alone[1].variance(levels) / frames + rounding, rtol=1e-9)


@pytest.mark.parametrize("nonlinearity", [0.02, 0.1, 0.2])
def test_close_to_a_full_well_a_bent_response_shrinks_shot_noise_and_pattern(nonlinearity):
    """Both arise before the bend. Taken as of the bent signal, the variance was 2, 12 and 36 % too large here."""
    sensor = Sensor(gain=0.3, eta=1.0, mu_e_sat=1e4, black_level=100.0, bits=16, sigma_d=3.0, prnu=0.01, cfa=None,
                    nonlinearity=nonlinearity)  # fmt: skip
    frames = [expose(np.full((300, 300), 9000.0), sensor, EXPOSURE, seed=0, view=v).dn for v in range(2)]
    mean = 100 + 0.3 * (9000 - nonlinearity / 1e4 * 9000**2)
    found = raw_noise(sensor, EXPOSURE, channels=1).variance(mean)
    assert found == pytest.approx(np.mean([dn.var() for dn in frames]), rel=0.02)


@pytest.mark.parametrize("name", ["bent", "two gains", "uneven response", "rows, columns, bands, dark, bias"])
def test_the_curve_of_linear_pictures_is_that_of_the_codes_in_their_unit(name):
    sensor = CAMERAS[name]
    unit = 1.3 * np.array([2.0, 1.0, 1 / 0.7]) / (sensor.white_dn - 300)
    raw, linear = raw_noise(sensor, EXPOSURE), linear_noise(sensor, EXPOSURE, digital_gain=1.3)
    for charge in (0.0, 200.0, 3000.0, 5500.0, 1e5):
        codes = np.array(raw.black) + 1.7 * charge
        found = linear.variance(unit * (codes - 300))
        np.testing.assert_allclose(found - linear.rounding, unit**2 * raw.variance(codes), rtol=1e-9)


def test_a_threshold_of_the_low_gain_beyond_the_full_well_lies_on_the_bend_of_the_full_well():
    low = DualGain(threshold=8000.0, sigma_d=30.0, ratio=8)
    found = raw_noise(replace(NOISY, nonlinearity=0.2, dual_gain=low), EXPOSURE)
    np.testing.assert_allclose(np.array(found.switch) - found.black, 1.7 * (8000 - 0.2 / 6000 * 6000**2))


def test_an_effect_from_outside_adds_its_electrons_in_codes(monkeypatch):
    haze = OwnEffect(
        title="haze", config=NoSettings, sample=lambda signal, pixels, settings: 0 * signal,
        mean=lambda signal, pixels, settings: 5 + 0 * signal,
        variance=lambda signal, pixels, settings: 2 + 0.1 * signal, cost=lambda signal, *_: (0 * signal, 0 * signal),
    )  # fmt: skip
    monkeypatch.setitem(EFFECT_LIST, "haze", haze)
    clear = replace(NOISY, prnu=0.0, dark_current=0.0)
    plain, hazy = raw_noise(clear, EXPOSURE), raw_noise(replace(clear, effects={"haze": {}}), EXPOSURE)
    np.testing.assert_allclose(np.array(hazy.black) - plain.black, 1.7 * 5)
    for charge in (0.0, 100.0, 2000.0):
        more, less = (curve.variance(np.array(curve.black) + 1.7 * charge) for curve in (hazy, plain))
        np.testing.assert_allclose(more - less, 1.7**2 * (2 + 0.1 * charge), rtol=1e-6)


def linear_frames(sensor, photons, **how):
    """Pictures [48, h, w, 3] of one light as a method reads them, 48 exposures."""
    frames = (expose(photons, sensor, EXPOSURE, seed=3, view=0, frame=i) for i in range(48))
    return np.stack([from_linear16(develop(frame, sensor, **how).linear16) for frame in frames]).astype(np.float64)


SENSORS = {
    "even": replace(NOISY, sigma_row=0.0, sigma_column=0.0, banding=None, prnu=0.0, dsnu=0.0),
    "a7s2": replace(PRESETS["a7s2-iso6400-3chip"], sigma_row=0.0),
    "imx385": replace(PRESETS["imx385-iso6400-3chip"], sigma_row=0.0),
}


@pytest.mark.parametrize("how", [{}, {"digital_gain": 1.5}, {"color_matrix": MATRIX, "digital_gain": 1.2}])
@pytest.mark.parametrize("name", list(SENSORS))
def test_linear_pictures_of_three_chips_have_the_variance_of_the_curve(name, how):
    sensor = SENSORS[name]
    for electrons in (0.0, 8.0, 90.0 if name == "imx385" else 400.0):
        light = np.broadcast_to(electrons * np.array([0.6, 1.0, 0.3]) / sensor.eta, (40, 50, 3))
        pictures = linear_frames(sensor, light, **how).reshape(-1, 3)
        assert_variance(pictures, linear_noise(sensor, EXPOSURE, **how).variance(pictures.mean(0)), axis=0)


@pytest.mark.parametrize("demosaic", ["menon", "malvar", "bilinear", "half"])
def test_a_developed_mosaic_has_the_variance_of_the_curve_where_it_was_measured(demosaic):
    sensor = replace(SENSORS["even"], cfa="GBRG")
    pictures = linear_frames(sensor, np.full((32, 40), 150.0), demosaic=demosaic)
    curve = linear_noise(sensor, EXPOSURE, demosaic=demosaic)
    assert curve.interpolated == (demosaic != "half")
    for channel in range(3):
        measured = channel_index((32, 40), "GBRG") == channel if curve.interpolated else np.ones((16, 20), bool)
        values = pictures[..., channel][:, measured]
        mean = np.zeros(3)
        mean[channel] = values.mean()
        assert_variance(values, curve.variance(mean)[channel])


def test_a_monochrome_picture_has_no_white_balance():
    sensor = replace(SENSORS["even"], prnu=0.0)
    frames = [
        develop(expose(np.full((300, 300), 200.0), sensor, EXPOSURE, seed=1, view=0, frame=i), sensor).linear16
        for i in range(2)
    ]
    values = from_linear16(np.stack(frames)).astype(np.float64)
    assert_variance(values, linear_noise(sensor, EXPOSURE, channels=1).variance(values.mean()))


def test_below_black_and_above_white_the_variance_stays_that_of_black_and_white():
    curve = linear_noise(NOISY, EXPOSURE)
    black, white = np.array(curve.black), np.array(curve.white)
    np.testing.assert_array_equal(curve.variance(black - 0.3), curve.variance(black))
    np.testing.assert_array_equal(curve.variance(white + 2.0), curve.variance(white))
    np.testing.assert_allclose(white, [2.0, 1.0, 1 / 0.7])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: raw_noise(replace(NOISY, cfa="RGGB"), EXPOSURE, channels=1), "channels must be 3, or 1 without"),
        (lambda: raw_noise(NOISY, EXPOSURE).variance(np.zeros((4, 5))), r"mean must be of shape \[..., 3\]"),
        (lambda: raw_noise(NOISY, EXPOSURE).variance(np.zeros((4, 5)), np.zeros(3, int)), "channels must be of shape"),
        (lambda: linear_noise(NOISY, EXPOSURE, demosaic="ahd"), "demosaic must be one of"),
        (lambda: linear_noise(NOISY, EXPOSURE, digital_gain=0.0), "digital_gain must be > 0"),
        (lambda: linear_noise(NOISY, EXPOSURE, color_matrix=np.ones((3, 3))), "color_matrix must be finite and of"),
        (lambda: linear_noise(NOISY, EXPOSURE, color_matrix=np.eye(4)), r"color_matrix must be \[3, 3\]"),
        (
            lambda: linear_noise(NOISY, EXPOSURE, color_matrix=MATRIX).variance(np.zeros(3), np.zeros(3, int)),
            "channels must be None for pictures after",
        ),
    ],
)
def test_what_does_not_fit_the_camera_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()
