"""Electrons out of captures of every kind, and back to linear light."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.denoised.measured import measured
from novags.methods.inputs import LacksInput
from novags.methods.light import measured_light
from novags.methods.noise import Noise, Variance, camera_noise
from novags.methods.noise_estimate import estimate_noise
from novags.methods.nova_plus.data import FULL
from novags.methods.problem import Problem, RawPictures
from novags.splats import Views
from sensor_model import PRESETS, Exposure, Sensor, develop, expose, from_linear16, mosaic
from sensor_model.isp import white_balance

EXPOSURE = Exposure(time=1 / 30)
MATRIX = [[1.4, -0.3, -0.1], [-0.2, 1.3, -0.1], [0.0, -0.4, 1.4]]


def problem(sensor: Sensor, *, matrix: list[list[float]] | None = None, level: float = 40.0, **more: Any) -> Problem:
    """Two views of a ramp."""
    height, width = 12, 14
    light = np.linspace(0.2, 2, width)[None, :, None] * np.array([0.6, 1.0, 0.7]) * np.ones((height, 1, 1)) * level
    photons = light / sensor.eta
    frames = [expose(photons if sensor.cfa is None else mosaic(photons, sensor.cfa), sensor, EXPOSURE, seed=1, view=i)
              for i in range(2)]  # fmt: skip
    developed = [develop(f, sensor, color_matrix=matrix) for f in frames]
    linear = torch.from_numpy(np.stack([from_linear16(d.linear16) for d in developed]))
    raw = torch.from_numpy(np.stack([f.dn for f in frames]).astype(np.float32))
    views = Views(torch.eye(4).expand(2, 4, 4), torch.eye(3).expand(2, 3, 3), width, height)
    red, green, blue = white_balance(sensor).tolist()
    settings: dict[str, Any] = {
        "views": views, "start": None, "seed": 0, "linear16": linear,
        "srgb8": torch.from_numpy(np.stack([d.srgb8 for d in developed]) / 255).float(),
        "raw": RawPictures(
            dn=raw, cfa=sensor.cfa, black=sensor.black_level, white=sensor.white_dn, balance=(red, green, blue),
            matrix=None if matrix is None else tuple(map(tuple, matrix)),
        ),
        "noise": camera_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=matrix),
    }  # fmt: skip
    return Problem(**settings | more)


@pytest.mark.parametrize("matrix", [None, MATRIX])
def test_raw_frames_of_three_chips_give_the_linear_pictures_back(matrix: list[list[float]] | None) -> None:
    given = problem(PRESETS["a7s2-iso6400-3chip"], matrix=matrix)
    found = measured(given)
    assert given.linear16 is not None
    torch.testing.assert_close(found.linear(found.electrons), given.linear16, atol=2e-5, rtol=0)  # 16 bits


def test_what_exceeds_white_is_cut_before_the_colour_matrix_and_what_is_below_black_is_not() -> None:
    pictures = measured(problem(PRESETS["a7s2-iso6400-3chip"], matrix=MATRIX))
    light = torch.tensor([2.0, 0.5, -0.1])
    electrons = (light / pictures.unit)[None, :, None, None]
    want = [row[0] * 1.0 + row[1] * 0.5 + row[2] * -0.1 for row in MATRIX]
    assert pictures.linear(electrons)[0, 0, 0].tolist() == pytest.approx(want, rel=1e-5)


def test_raw_frames_of_a_mosaic_give_what_was_measured_and_zero_elsewhere() -> None:
    sensor = PRESETS["a7s2-iso6400"]
    given = problem(sensor)
    found = measured(given)
    assert given.raw is not None
    assert given.linear16 is not None
    electrons = (given.raw.dn - sensor.black_level) / sensor.gain
    torch.testing.assert_close(found.electrons.sum(1), electrons, rtol=1e-5, atol=1e-4)
    assert bool((found.electrons * (1 - found.mask) == 0).all())
    light = found.linear(found.electrons).movedim(-1, 1)
    torch.testing.assert_close(light * found.mask, given.linear16.movedim(-1, 1) * found.mask, atol=2e-5, rtol=0)


def test_the_variance_in_electrons_is_that_of_photons_and_readout() -> None:
    sensor = PRESETS["a7s2-iso6400-3chip"]
    found = measured(problem(sensor))
    read = sensor.sigma_d**2 + sensor.sigma_row**2 + 1 / 12 / sensor.gain**2
    torch.testing.assert_close(found.read_variance, torch.full((3,), read), rtol=1e-4, atol=0)
    mean = torch.tensor([0.0, 7.0, 300.0])[:, None, None].expand(1, 3, 2, 2)
    torch.testing.assert_close(found.variance(mean), mean + read, rtol=1e-3, atol=0)


@pytest.mark.parametrize("with_raw", [True, False])
def test_a_bent_response_lets_shot_noise_and_pattern_shrink(with_raw: bool) -> None:
    sensor = replace(PRESETS["a7s2-iso6400-3chip"], mu_e_sat=2000.0, nonlinearity=0.2, prnu=0.01)
    given = problem(sensor)
    found = measured(given if with_raw else replace(given, raw=None))
    charge = 1500.0
    seen, slope = charge - 1e-4 * charge**2, 1 - 2e-4 * charge
    read = sensor.sigma_d**2 + sensor.sigma_row**2 + 1 / 12 / sensor.gain**2
    want = read + slope**2 * (charge + (0.01 * charge) ** 2)
    assert found.variance(torch.full((1, 3, 1, 1), seen)).flatten().tolist() == pytest.approx([want] * 3, rel=1e-3)


def test_linear_pictures_serve_where_there_are_no_raw_frames() -> None:
    given = problem(PRESETS["a7s2-iso6400-3chip"])
    raw, linear = measured(given), measured(replace(given, raw=None))
    torch.testing.assert_close(linear.electrons, raw.electrons, atol=0.03, rtol=0)  # they were rounded to 16 bits
    torch.testing.assert_close(linear.linear(linear.electrons), given.linear16)


def test_after_a_colour_matrix_the_noise_is_that_of_grey_light_from_black_to_half_of_white() -> None:
    given = problem(PRESETS["a7s2-iso6400-3chip"], matrix=MATRIX)
    assert given.noise is not None
    found = measured_light(given.noise, None, given.linear16, ())
    for level in (0.0, 0.1, 0.4):
        grey = torch.full((3,), level, dtype=torch.float64)
        torch.testing.assert_close(found.noise(grey), given.noise.linear16(grey), rtol=1e-3, atol=0)


@pytest.mark.parametrize("with_raw", [True, False])
def test_what_is_saturated_reaches_white_in_every_channel(with_raw: bool) -> None:
    """Rationale: white balance takes red and blue beyond 1, where 16-bit files end."""
    sensor = PRESETS["a7s2-iso6400-3chip"]
    given = problem(sensor, level=50 * sensor.mu_e_sat)
    assert given.noise is not None
    found = measured_light(given.noise, given.raw if with_raw else None, given.linear16, ())
    assert bool((found.light >= FULL * found.white).all())
    assert bool((found.light <= found.white + 1e-3).all())


@pytest.mark.parametrize("matrix", [None, MATRIX])
@pytest.mark.parametrize("with_raw", [True, False])
def test_a_known_error_of_the_black_level_is_no_light(matrix: list[list[float]] | None, with_raw: bool) -> None:
    even = replace(PRESETS["a7s2-iso6400-3chip"], sigma_d=0.0, sigma_row=0.0, tukey_lambda=None)
    off = replace(even, rgb_bias=(12.0, -30.0, 25.0))
    found = []
    for sensor in (even, off):
        given = problem(sensor, matrix=matrix)
        assert given.noise is not None
        raw = given.raw if with_raw else None
        found.append(measured_light(given.noise, raw, given.linear16, given.channels_share))
    right, wrong = found
    torch.testing.assert_close(wrong.light, right.light, atol=1e-4, rtol=0)  # a code, and 16 bits; off by 2e-3 else
    mean = torch.full((3,), 0.1)
    torch.testing.assert_close(wrong.noise(mean), right.noise(mean), rtol=1e-3, atol=0)
    assert wrong.noise.curve.black == (0.0,) * 3
    assert right.white[1] < wrong.white[1]  # a black that is lower leaves more room below white


def test_noise_that_does_not_grow_with_the_signal_is_taken_as_read_noise() -> None:
    given = problem(PRESETS["a7s2-iso6400-3chip"])
    assert given.noise is not None
    flat = replace(given.noise.linear16.curve, slope=(0.0,) * 3, offset=(4e-6,) * 3)
    found = measured(replace(given, raw=None, noise=Noise(Variance(flat), None, "pictures")))
    torch.testing.assert_close(found.read_variance, torch.full((3,), 1e4), rtol=1e-4, atol=0)
    torch.testing.assert_close(found.linear(found.electrons), given.linear16)


def without(what: str) -> Problem:
    chips, bayer = problem(PRESETS["a7s2-iso6400-3chip"]), problem(PRESETS["a7s2-iso6400"])
    silent = replace(chips.noise.linear16.curve, slope=(0.0,) * 3, offset=(0.0,) * 3) if chips.noise else None
    return {
        "noise": replace(chips, noise=None),
        "raw frames": replace(bayer, raw=None, channels_share=("demosaicing",)),
        "JPEG": replace(chips, raw=None, channels_share=("JPEG",)),
        "resampling": replace(chips, raw=None, pixels_share=("resampling",)),
        "neither": replace(chips, raw=None, linear16=None),
        "variance > 0": replace(chips, raw=None, noise=Noise(Variance(silent), None, "pictures")),  # type: ignore[arg-type]
    }[what]


@pytest.mark.parametrize("what", ["noise", "raw frames", "JPEG", "resampling", "neither", "variance > 0"])
def test_what_a_denoiser_cannot_do_without_is_named(what: str) -> None:
    with pytest.raises(LacksInput, match=what) as refused:
        measured(without(what))
    assert "\n" not in str(refused.value)


def test_noise_that_was_estimated_from_the_pictures_will_do() -> None:
    given = problem(PRESETS["a7s2-iso6400-3chip"])
    assert given.linear16 is not None
    large = given.linear16.repeat(1, 3, 3, 1)
    views = replace(given.views, width=large.shape[2], height=large.shape[1])
    noise = estimate_noise(large)
    found = measured(replace(given, views=views, srgb8=large.clamp(0, 1), linear16=large, raw=None, noise=noise))
    torch.testing.assert_close(found.linear(found.electrons), large)
