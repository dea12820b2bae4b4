"""Development: levels, white balance, demosaicing, curves, and the three outputs of one exposure."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensor_model import (
    PRESETS,
    Exposure,
    develop,
    develop_linear,
    expose,
    from_linear16,
    isp,
    linear_to_srgb,
    mosaic,
    photons_for_electrons,
    srgb_to_linear,
)
from sensor_model.isp import to_linear16
from sensor_model.params import CFAS

EXPOSURE = Exposure(time=0.01)
CAMERA = replace(PRESETS["imx900-hcg"], dark_current=0.0)
QUIET = replace(CAMERA, sigma_d=0.0, dsnu=0.0, prnu=0.0)


def ramp(shape=(40, 60)):
    """A smooth coloured radiance."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]] / max(shape)
    return np.stack([0.3 + x, 0.5 + 0.4 * y, 1.0 - 0.6 * x], -1)


@settings(derandomize=True, deadline=None)
@given(st.floats(-0.5, 2.0))
def test_srgb_curve_and_its_inverse_cancel(x):
    assert float(srgb_to_linear(linear_to_srgb(x))) == pytest.approx(x, abs=1e-6)


def test_srgb_curve_has_the_values_of_the_standard_and_keeps_the_width():
    np.testing.assert_allclose(linear_to_srgb([0, 0.0031308, 0.18, 1.0]), [0, 0.04045, 0.46135613, 1], atol=2e-5)
    assert linear_to_srgb(np.float32([0.5])).dtype == np.float32
    assert srgb_to_linear(np.array([0, 1])).dtype == np.float64


@pytest.mark.parametrize("demosaic", ["menon", "malvar", "bilinear"])
@pytest.mark.parametrize("cfa", CFAS)
def test_a_smooth_scene_survives_mosaic_and_demosaic(cfa, demosaic):
    sensor = replace(QUIET, cfa=cfa)
    photons = photons_for_electrons(ramp(), electrons=500, mean_green=1.0, sensor=sensor)
    clean = expose(mosaic(photons, cfa), sensor, EXPOSURE, seed=0, view=0).clean_dn
    expected = ramp() * 500 / sensor.capacity_e
    # Linear interpolation of a linear ramp is exact, Menon's refinement stays within half a step from pixel to pixel;
    # at the border the mirror image bends the ramp by some steps
    error = np.abs(develop_linear(clean, sensor, demosaic=demosaic) - expected)
    step = 500 / sensor.capacity_e / 60
    assert error[2:-2, 2:-2].max() < (0.5 if demosaic == "menon" else 0.02) * step
    assert error.max() < 3 * step


@pytest.mark.parametrize("cfa", CFAS)
def test_demosaicing_has_the_bits_of_the_package_that_it_is_after(cfa):
    with warnings.catch_warnings():
        # colour-demosaicing 0.2.7 imports scipy.ndimage under a name that scipy 2 will drop
        warnings.simplefilter("ignore", DeprecationWarning)
        import colour_demosaicing as library
    theirs = {
        "menon": library.demosaicing_CFA_Bayer_Menon2007, "malvar": library.demosaicing_CFA_Bayer_Malvar2004,
        "bilinear": library.demosaicing_CFA_Bayer_bilinear,
    }  # fmt: skip
    for height, width in ((40, 61), (17, 18)):
        frame = np.random.default_rng(height).random((height, width))
        surrounded = np.pad(frame, isp.BORDER, mode="reflect")
        inside = np.s_[isp.BORDER : -isp.BORDER, isp.BORDER : -isp.BORDER]
        for name, function in theirs.items():
            np.testing.assert_array_equal(isp.interpolate(frame, cfa, name), function(surrounded, cfa)[inside])


@pytest.mark.parametrize("cfa", CFAS)
def test_half_resolution_averages_each_cell_and_keeps_noise_independent(cfa):
    sensor = replace(CAMERA, cfa=cfa)
    photons = photons_for_electrons(np.ones((401, 600, 3)), electrons=50, mean_green=1.0, sensor=sensor)
    linear = develop_linear(expose(mosaic(photons, cfa), sensor, EXPOSURE, seed=1, view=0).dn, sensor, demosaic="half")
    assert linear.shape == (200, 300, 3)
    np.testing.assert_allclose(linear.mean((0, 1)) * sensor.capacity_e, 50, atol=5 * 15 / np.sqrt(60_000))
    for channel in range(3):
        noise = linear[..., channel] - linear[..., channel].mean()
        neighbours = (noise[:, 1:] * noise[:, :-1]).mean() / noise.var()
        assert abs(neighbours) < 5 / np.sqrt(60_000)


def test_half_resolution_takes_each_value_from_its_own_cell():
    sensor = replace(QUIET, cfa="GBRG", rgb_response=(1.0, 1.0, 1.0))
    dn = 240 + np.arange(35.0).reshape(5, 7)
    span = sensor.white_dn - 240
    found = develop_linear(dn, sensor, demosaic="half") * span
    for y in range(2):
        for x in range(3):
            g, b, r, g2 = dn[2 * y : 2 * y + 2, 2 * x : 2 * x + 2].ravel() - 240
            np.testing.assert_allclose(found[y, x], [r, (g + g2) / 2, b], rtol=1e-5)


def test_what_is_above_white_is_white_before_a_colour_matrix():
    """Rationale: a clipped highlight would come out coloured."""
    sensor = replace(QUIET, cfa=None)  # white balance lifts red and blue of a full pixel to 1.8 and 1.5
    mixing = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.0, -0.6, 1.6]])
    full = np.full((2, 2, 3), sensor.white_dn)
    np.testing.assert_allclose(develop_linear(full, sensor, color_matrix=mixing), 1.0, rtol=1e-6)
    np.testing.assert_allclose(develop_linear(full, sensor)[0, 0], 1 / np.array(sensor.rgb_response), rtol=1e-6)
    partly = 240 + np.array([0.1, 0.2, 2.0]) * (sensor.white_dn - 240) * sensor.rgb_response
    expected = mixing @ [0.1, 0.2, 1.0]
    np.testing.assert_allclose(
        develop_linear(partly[None, None], sensor, color_matrix=mixing)[0, 0], expected, rtol=1e-5
    )


def test_jpeg_keeps_the_order_of_the_channels():
    """Independent reference: JPEG has colour at half resolution, and luminance, 0.299 R + 0.587 G + 0.114 B, at full.
    So of a chequerboard in one channel its luminance remains, in all three."""
    from sensor_model.isp import through_jpeg

    board = np.indices((32, 32)).sum(0) % 2 * 100 + 80
    for channel, weight in ((0, 0.299), (2, 0.114)):
        picture = np.full((32, 32, 3), 128, np.uint8)
        picture[..., channel] = board
        green = through_jpeg(picture, 95)[..., 1].astype(float)
        assert green.std() == pytest.approx(50 * weight, rel=0.1)


@pytest.mark.parametrize("demosaic", ["menon", "malvar", "bilinear"])
def test_what_lies_beyond_the_mirrored_border_changes_nothing(demosaic, monkeypatch):
    """Of this frame "menon" changed 140 of 576 pixels, by up to 0.19, where it had 4 pixels of border."""
    frame = np.random.default_rng(0).random((24, 24))
    found = isp.interpolate(frame, "RGGB", demosaic)
    monkeypatch.setattr(isp, "BORDER", isp.BORDER + 8)
    np.testing.assert_allclose(isp.interpolate(frame, "RGGB", demosaic), found, rtol=0, atol=1e-12)


def test_three_chips_need_no_demosaicing():
    sensor = replace(QUIET, cfa=None)
    photons = photons_for_electrons(ramp(), electrons=500, mean_green=1.0, sensor=sensor)
    clean = expose(photons, sensor, EXPOSURE, seed=0, view=0).clean_dn
    np.testing.assert_allclose(develop_linear(clean, sensor), ramp() * 500 / sensor.capacity_e, rtol=1e-5)


def test_all_outputs_come_from_one_exposure():
    sensor = replace(CAMERA, cfa=None)
    photons = photons_for_electrons(ramp(), electrons=300, mean_green=1.0, sensor=sensor)
    frame = expose(photons, sensor, EXPOSURE, seed=0, view=0)
    picture = develop(frame, sensor)
    linear = develop_linear(frame.dn, sensor)
    np.testing.assert_allclose(from_linear16(picture.linear16), linear, atol=0.51 / 61439)
    expected = np.rint(255 * linear_to_srgb(np.clip(linear, 0, 1)))
    np.testing.assert_array_equal(picture.srgb8, expected)
    np.testing.assert_array_equal(develop(frame.dn, sensor).srgb8, picture.srgb8)


def test_sixteen_bits_keep_black_white_and_sign():
    linear = np.array([-1.0, -0.01, 0.0, 0.5, 1.0, 3.0], np.float32)
    np.testing.assert_array_equal(to_linear16(linear), [0, 3482, 4096, 34816, 65535, 65535])
    np.testing.assert_allclose(from_linear16(to_linear16(linear))[1:5], linear[1:5], atol=1e-5)


def test_digital_gain_and_colour_matrix_act_before_the_clip():
    sensor = replace(QUIET, cfa=None)
    dn = np.full((2, 2, 3), sensor.black_level + 0.1 * (sensor.white_dn - sensor.black_level))
    plain = develop_linear(dn, sensor)
    swap = np.eye(3)[[2, 1, 0]]
    np.testing.assert_allclose(develop_linear(dn, sensor, color_matrix=swap), plain[..., ::-1])
    mixing = np.array([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.0, -0.6, 1.6]])  # white stays white
    white = develop_linear(np.full_like(dn, sensor.white_dn), sensor, color_matrix=mixing)
    np.testing.assert_allclose(white, 1.0, rtol=1e-6)
    lifted = develop(dn, sensor, digital_gain=5.0, color_matrix=swap)
    np.testing.assert_allclose(from_linear16(lifted.linear16), np.minimum(5 * plain[..., ::-1], 1), atol=1e-4)
    assert lifted.srgb8.min() > develop(dn, sensor).srgb8.max()


def test_jpeg_costs_a_little_and_less_at_high_quality():
    sensor = replace(CAMERA, cfa=None)
    photons = photons_for_electrons(ramp(), electrons=900, mean_green=1.0, sensor=sensor)
    frame = expose(photons, sensor, EXPOSURE, seed=0, view=0)
    whole = develop(frame, sensor).srgb8.astype(float)
    errors = [np.abs(develop(frame, sensor, jpeg_quality=q).srgb8 - whole).mean() for q in (30, 70, 98)]
    assert 0 < errors[2] < errors[1] < errors[0] < 12
    grey = develop(frame.dn[..., 0], sensor, jpeg_quality=90).srgb8
    assert grey.shape == whole.shape[:2]


@pytest.mark.parametrize(
    ("dn", "options", "message"),
    [
        (np.zeros((4, 4, 3)), {}, "dn must be"),
        (np.zeros((4, 4)), {"demosaic": "ahd"}, "demosaic must be one of"),
        (np.zeros((1, 6)), {}, "at least 2 x 2"),
        (np.zeros((4, 4)), {"jpeg_quality": 0}, "jpeg_quality"),
        (np.zeros((4, 4)), {"digital_gain": 0.0}, "digital_gain"),
        (np.zeros((4, 4)), {"color_matrix": np.eye(4)}, "color_matrix"),
    ],
)
def test_bad_requests_are_refused(dn, options, message):
    with pytest.raises(ValueError, match=message):
        develop(dn, CAMERA, **options)
