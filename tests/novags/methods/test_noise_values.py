"""The variance of each datum: against the camera's own curve, and against noise of known strength."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.light import MeasuredLight, brightness, first_light, measured_light
from novags.methods.noise import Noise, Variance, camera_noise
from novags.methods.noise_estimate import _binned, _line, estimate_noise
from novags.methods.problem import RawPictures
from sensor_model import Exposure, NoiseCurve, Sensor, linear_noise, raw_noise, srgb_to_linear
from sensor_model.noise import Bend

CURVE = NoiseCurve(
    black=(1.0, 2.0, 3.0), white=(20.0, 22.0, 24.0), offset=(0.5, 0.6, 0.7), slope=(0.3, 0.2, 0.1),
    quadratic=(-0.002, -0.003, -0.001), switch=(12.0, 13.0, math.inf), step=(2.0, 3.0, 4.0), rounding=0.04,
)  # fmt: skip
BEND = Bend(factor=(0.01, 0.011, 0.0), offset=(0.2, 0.0, 0.1))
MATRIX = ((1.5, -0.4, -0.1), (-0.2, 1.4, -0.2), (0.1, -0.6, 1.5))


def means() -> np.ndarray:
    """From below black to above white."""
    return np.random.default_rng(0).uniform(-3, 30, (5, 7, 3))


@pytest.mark.parametrize("bend", [None, BEND])
@pytest.mark.parametrize("matrix", [None, MATRIX])
def test_tensors_have_the_variance_of_the_cameras_curve(matrix, bend):
    curve = replace(CURVE, matrix=matrix, bend=bend)
    found = Variance(curve)(torch.from_numpy(means()))
    np.testing.assert_allclose(found, curve.variance(means()), rtol=1e-9)


def test_a_mosaic_reads_the_curve_of_each_pixels_channel():
    mosaic, channels = means()[..., 0], np.random.default_rng(1).integers(0, 3, (5, 7))
    found = Variance(CURVE)(torch.from_numpy(mosaic), torch.from_numpy(channels))
    np.testing.assert_allclose(found, CURVE.variance(mosaic, channels), rtol=1e-9)


def test_the_variance_in_numbers():
    # x = 5 - 1; 0.5 + (0.3 - 0.002 * 4) * 4 + 0.04, and above the switch 2 more
    variance = Variance(CURVE)
    assert float(variance(torch.tensor([5.0, 5.0, 5.0]))[0]) == pytest.approx(0.5 + 0.292 * 4 + 0.04)
    assert float(variance(torch.tensor([13.0, 5.0, 5.0]))[0]) == pytest.approx(0.5 + (0.3 - 0.024) * 12 + 2.04)


def test_the_variance_behind_a_bend_in_numbers():
    # y = 5 of x = 4.75 = 5 - 0.01 * 25, where the slope is 0.9
    expected = 0.5 - 0.2 + 0.9**2 * (0.2 + 0.3 * 5 - 0.002 * 25) + 0.04
    curve = replace(CURVE, bend=BEND)
    assert float(Variance(curve)(torch.full((3,), 5.75))[0]) == pytest.approx(expected)
    assert curve.variance(np.full(3, 5.75))[0] == pytest.approx(expected)


def test_a_known_camera_gives_the_noise_of_its_pictures_and_its_raw_frames():
    sensor = Sensor(gain=2.0, eta=0.5, sigma_d=3.0, mu_e_sat=10_000.0, black_level=256.0, bits=14)
    exposure = Exposure(time=0.01)
    noise = camera_noise(sensor, exposure, demosaic="bilinear", color_matrix=None)
    assert noise.origin == "camera"
    assert noise.linear16.curve == linear_noise(sensor, exposure, demosaic="bilinear", color_matrix=None)
    assert noise.raw.curve == raw_noise(sensor, exposure)


def pictures(offset: float, slope: float, seed: int = 0) -> torch.Tensor:
    """Smooth ramps with noise of variance offset + slope * mean."""
    rng = np.random.default_rng(seed)
    ramp = np.linspace(0.02, 0.5, 160)[None, :, None] * np.linspace(0.6, 1, 128)[:, None, None]
    mean = np.broadcast_to(ramp, (2, 128, 160, 3))
    return torch.from_numpy(mean + rng.normal(0, np.sqrt(offset + slope * mean)))


@pytest.mark.parametrize(("offset", "slope"), [(1e-4, 1e-3), (4e-4, 0.0), (2e-5, 4e-3)])
def test_the_line_through_flat_pixels_recovers_shot_and_read_noise(offset, slope):
    noise = estimate_noise(pictures(offset, slope))
    assert (noise.origin, noise.raw) == ("pictures", None)
    for mean in (0.05, 0.2, 0.45):
        found = noise.linear16(torch.full((3,), mean, dtype=torch.float64))
        # 16 bins of some 700 pixels a channel, whose neighbours overlap: about 3 % of standard error after the line
        np.testing.assert_allclose(found, offset + slope * mean, rtol=0.15)


def test_channels_have_lines_of_their_own():
    mixed = torch.stack([pictures(1e-4, 0.0)[..., 0], pictures(4e-4, 0.0)[..., 1], pictures(9e-4, 0.0)[..., 2]], -1)
    found = estimate_noise(mixed).linear16(torch.full((3,), 0.2, dtype=torch.float64))
    np.testing.assert_allclose(found, [1e-4, 4e-4, 9e-4], rtol=0.15)


@pytest.mark.parametrize("across", [False, True])
def test_texture_counts_less_than_flat_parts(across):
    noisy = pictures(1e-4, 0.0)
    if across:
        noisy = noisy.transpose(1, 2).contiguous()
    noisy[:, :, :60] += 0.3 * torch.linspace(0, 12, 60)[:, None].sin() ** 2
    noisy[:, :40] += 0.3 * torch.linspace(0, 9, 40)[:, None, None].sin() ** 2
    found = estimate_noise(noisy).linear16(torch.full((3,), 0.2, dtype=torch.float64))
    np.testing.assert_allclose(found, 1e-4, rtol=0.3)


def test_bins_pair_the_mean_of_a_place_with_the_noise_of_that_place():
    """Rationale: a plane has no noise wherever it is steep, and a step in brightness separates two noise levels."""
    rng = np.random.default_rng(0)
    plane = np.where(np.arange(200)[:, None] < 100, 0.1, 0.4) * np.ones((200, 64))
    sigma = np.where(plane < 0.2, 0.01, 0.03)
    mean, variance = _binned(torch.from_numpy(plane + rng.normal(0, sigma))[None], 1)
    dark, bright = mean < 0.2, mean > 0.3
    np.testing.assert_allclose(variance[dark][:-1].median(), 1e-4, rtol=0.2)
    np.testing.assert_allclose(variance[bright][1:].median(), 9e-4, rtol=0.2)


def test_the_line_weighs_each_bin_by_its_own_variance():
    mean = np.array([0.0, 0.1, 0.3, 0.6])
    variance = np.array([1e-4, 2.5e-4, 3.0e-4, 8e-4])
    design = np.stack([np.ones(4), mean], 1) / variance[:, None]
    expected = np.linalg.lstsq(design, np.ones(4), rcond=None)[0]
    found = _line(torch.from_numpy(mean), torch.from_numpy(variance))
    np.testing.assert_allclose([float(v) for v in found], expected, rtol=1e-6)


def test_a_line_that_would_begin_below_zero_is_the_best_one_through_zero():
    mean, variance = torch.tensor([1.0, 2.0, 4.0]).double(), torch.tensor([0.3, 2.2, 5.0]).double()
    offset, slope = _line(mean, variance)
    slopes = np.linspace(0.1, 3.0, 290_001)
    scatter = sum((1 - slopes * m / v) ** 2 for m, v in zip(mean.tolist(), variance.tolist(), strict=True))
    assert float(offset) == 0
    assert float(slope) == pytest.approx(slopes[scatter.argmin()], abs=2e-5)


def test_a_falling_line_is_replaced_by_a_constant_and_an_offset_is_never_negative():
    mean = torch.tensor([0.1, 0.2, 0.3], dtype=torch.float64)
    offset, slope = _line(mean, torch.tensor([3e-4, 2e-4, 1e-4], dtype=torch.float64))
    assert (float(offset), float(slope)) == (pytest.approx(2e-4), 0.0)
    offset, slope = _line(mean, torch.tensor([1e-5, 1e-4, 2e-4], dtype=torch.float64))
    assert float(offset) == 0
    assert float(slope) > 0


@pytest.mark.parametrize("shape", [(1, 15, 16, 3), (1, 16, 15, 3), (16, 16, 3), (1, 16, 16, 1)])
def test_pictures_too_small_to_measure_are_refused(shape):
    with pytest.raises(ValueError, match="linear must be"):
        estimate_noise(torch.zeros(shape))


def test_a_constant_picture_has_no_noise():
    found = estimate_noise(torch.full((1, 16, 16, 3), 0.3)).linear16(torch.full((3,), 0.3, dtype=torch.float64))
    np.testing.assert_allclose(found, 0, atol=1e-12)


BLACK, FILES, WHITE = 110.0, 100.0, 1100.0  # DN: where the noise model and where the files have their zero
BALANCE = (2.0, 1.0, 1.6)


def curve(black: float, white: float, **more: tuple[float, ...]) -> NoiseCurve:
    never = (float("inf"),) * 3
    parts = {"offset": (4.0, 5.0, 6.0), "slope": (2.0, 3.0, 4.0), "quadratic": (0.0,) * 3, "step": (0.0,) * 3} | more
    return NoiseCurve(black=(black,) * 3, white=(white,) * 3, switch=never, **parts)


def frames(dn: torch.Tensor) -> RawPictures:
    return RawPictures(dn=dn, cfa=None, black=FILES, white=WHITE, balance=BALANCE)


def test_light_of_raw_frames_is_zero_at_the_models_black_and_one_is_the_files_range_over_the_balance() -> None:
    unit = torch.tensor([500.0, 1000.0, 625.0])
    dn = torch.stack([torch.full((2, 2, 3), BLACK), BLACK + unit.expand(2, 2, 3), BLACK + 2 * unit.expand(2, 2, 3)])
    noise = Noise(Variance(curve(0.0, 1.0)), Variance(curve(BLACK, WHITE)), "camera")
    found = measured_light(noise, frames(dn), None, ())
    torch.testing.assert_close(found.light, torch.tensor([0.0, 1.0, 2.0])[:, None, None, None].expand(3, 2, 2, 3))
    # White, 1100 DN, lies 990 DN above the model's zero.
    torch.testing.assert_close(found.white, 990 / unit)
    torch.testing.assert_close(torch.tensor(found.noise.curve.white), 990 / unit)
    variance = found.noise(torch.tensor([[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]]))
    electrons = torch.tensor([[0.0] * 3, (0.5 * unit).tolist()])
    expected = (torch.tensor([4.0, 5.0, 6.0]) + torch.tensor([2.0, 3.0, 4.0]) * electrons) / unit**2
    torch.testing.assert_close(variance, expected, check_dtype=False)


def test_light_of_a_mosaic_is_unknown_in_the_channels_that_a_filter_hides_in_every_view() -> None:
    noise = Noise(Variance(curve(0.0, 1.0)), Variance(curve(BLACK, WHITE)), "camera")
    dn = BLACK + torch.arange(32.0).reshape(2, 4, 4)
    light = measured_light(noise, replace(frames(dn), cfa="RGGB"), None, ()).light
    red, blue = torch.zeros(4, 4, dtype=torch.bool), torch.zeros(4, 4, dtype=torch.bool)
    red[::2, ::2], blue[1::2, 1::2] = True, True
    seen = torch.stack([red, ~(red | blue), blue], -1).expand(2, 4, 4, 3)
    assert torch.equal(~light.isnan(), seen)
    unit = torch.tensor([500.0, 1000.0, 625.0])
    torch.testing.assert_close(light[seen], ((dn - BLACK)[..., None] / unit)[seen])


def test_points_begin_with_the_light_of_the_camera_behind_its_matrix() -> None:
    """The display shows matrix @ camera: of a mixing matrix the inverse leads back."""
    matrix = torch.tensor([[1.6, -0.4, -0.2], [-0.3, 1.5, -0.2], [0.1, -0.6, 1.5]])
    colors = torch.rand(5, 3, generator=torch.Generator().manual_seed(0))
    shown = torch.from_numpy(np.asarray(srgb_to_linear(colors.numpy()), np.float32))
    start = SimpleNamespace(colors=colors)
    data = SimpleNamespace(matrix=matrix)
    torch.testing.assert_close(first_light(start, data) @ matrix.T, shown)  # type: ignore[arg-type]
    data.matrix = None
    torch.testing.assert_close(first_light(start, data), shown)  # type: ignore[arg-type]


def test_the_mean_of_light_is_that_of_all_data_there_are_whatever_the_views_hold() -> None:
    light = torch.rand((3, 4, 6, 3), generator=torch.Generator().manual_seed(0)) - 0.2
    light[0, :, ::2, 1] = light[1] = torch.nan
    nothing: Any = None
    data = MeasuredLight(light=light, noise=nothing, white=torch.ones(3), matrix=None)
    assert data.mean() == pytest.approx(float(np.nanmean(light.double().numpy())), rel=1e-9)
    assert np.isnan(replace(data, light=torch.full_like(light, torch.nan)).mean())


def test_brightness_is_near_the_brightest_measured_green() -> None:
    light = torch.linspace(0, 1, 3000).reshape(1, 10, 100, 3)
    light[..., 0] = 50.0
    light[0, 0, 0, 1] = torch.nan
    found = brightness(light)
    assert 0.9 < found < 1.0
    with pytest.raises(ValueError, match="must be above black"):
        brightness(-light.abs())


def test_dark_and_bright_views_have_one_brightness_whichever_is_the_first() -> None:
    dark, bright = torch.linspace(0, 1, 6000).reshape(2, 1, 10, 100, 3)
    both = brightness(torch.cat([dark, bright]))
    assert both == brightness(torch.cat([bright, dark]))
    assert brightness(dark) < both < brightness(bright)


@pytest.mark.parametrize("bend", [None, BEND])
def test_the_noise_of_linear_pictures_above_their_black_is_that_of_the_pictures(bend):
    """Expectation: the datum decides, also above the switch of the gains and at white."""
    curve = replace(CURVE, bend=bend)
    noise = SimpleNamespace(raw=None, linear16=Variance(curve))
    found = measured_light(noise, None, torch.zeros(1, 1, 1, 3), ())
    datum = means()
    np.testing.assert_allclose(found.noise.curve.variance(datum - np.array(curve.black)), curve.variance(datum))


def test_white_of_linear_pictures_is_that_of_the_camera_or_the_end_of_the_files():
    curve = replace(CURVE, black=(0.01, 0.02, 0.03), white=(0.5, 0.9, 1.7))
    found = measured_light(SimpleNamespace(raw=None, linear16=Variance(curve)), None, torch.zeros(1, 1, 1, 3), ())
    torch.testing.assert_close(found.white, torch.tensor([0.49, 0.88, 0.97]))
