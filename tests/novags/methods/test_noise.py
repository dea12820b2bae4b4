"""Claims about the variance of a datum: from the camera, and from the pictures alone."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.noise import Variance, camera_noise
from novags.methods.noise_estimate import estimate_noise
from sensor_model import (
    PRESETS,
    Exposure,
    develop,
    expose,
    from_linear16,
    linear_noise,
    photons_for_electrons,
    raw_noise,
)
from sensor_model.params import DualGain

EXPOSURE = Exposure(time=1 / 30)
MATRIX = [[1.6, -0.5, -0.1], [-0.2, 1.4, -0.2], [0.0, -0.6, 1.6]]


@pytest.mark.parametrize("name", ["a7s2-iso6400-3chip", "imx900-hcg", "imx900-lcg-3chip"])
@pytest.mark.parametrize("matrix", [None, MATRIX])
def test_the_tensor_twin_is_the_cameras_own_curve(name: str, matrix: list[list[float]] | None) -> None:
    sensor = PRESETS[name]
    noise = camera_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=matrix)
    mean = np.random.default_rng(0).uniform(-0.02, 1.1, (40, 3))
    expected = linear_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=matrix).variance(mean)
    assert noise.linear16(torch.tensor(mean)).numpy() == pytest.approx(expected, rel=1e-12)
    dn = np.random.default_rng(1).uniform(sensor.black_level, sensor.white_dn, (40, 3))
    assert noise.raw is not None
    assert noise.raw(torch.tensor(dn)).numpy() == pytest.approx(raw_noise(sensor, EXPOSURE).variance(dn), rel=1e-12)


def test_of_a_mosaic_each_datum_has_its_own_channel() -> None:
    sensor = PRESETS["imx900-hcg"]
    curve = raw_noise(sensor, EXPOSURE)
    mean = np.full((2, 2), sensor.black_level + 50.0)
    channels = np.array([[0, 1], [1, 2]])
    found = Variance(curve)(torch.tensor(mean), torch.tensor(channels)).numpy()
    assert found == pytest.approx(curve.variance(mean, channels), rel=1e-12)


def test_the_variance_can_be_differentiated() -> None:
    noise = camera_noise(PRESETS["a7s2-iso6400-3chip"], EXPOSURE, demosaic="menon", color_matrix=None)
    mean = torch.tensor([[0.01, 0.02, 0.03]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(noise.linear16, (mean,))


def photographed(radiance: np.ndarray, sensor_name: str, electrons: float) -> torch.Tensor:
    """Linear pictures of four exposures of one scene."""
    sensor = PRESETS[sensor_name]
    photons = photons_for_electrons(radiance, electrons=electrons, mean_green=radiance[..., 1].mean(), sensor=sensor)
    frames = [expose(photons, sensor, EXPOSURE, seed=1, view=view) for view in range(4)]
    return torch.from_numpy(np.stack([from_linear16(develop(frame, sensor).linear16) for frame in frames]))


def steps(size: int = 96) -> np.ndarray:
    """Vertical bars of eight brightnesses, each flat."""
    levels = np.repeat(np.linspace(0.1, 2.0, 8), size // 8)
    return np.broadcast_to(levels[None, :, None], (size, size, 3)).astype(np.float32)


@pytest.mark.parametrize("electrons", [20.0, 200.0])
def test_pictures_alone_give_the_noise_of_the_camera(electrons: float) -> None:
    """Over flat parts and their edges, within 12 %: an edge is 1 of 12 columns, and its neighbours are not flat."""
    name = "a7s2-iso6400-3chip"
    linear = photographed(steps(), name, electrons)
    known = camera_noise(PRESETS[name], EXPOSURE, demosaic="menon", color_matrix=None)
    found = estimate_noise(linear)
    assert (found.origin, found.raw) == ("pictures", None)
    mean = linear.mean((0, 1, 2)).expand(1, 3).double()
    for factor in (0.3, 1.0, 1.8):
        ratio = (found.linear16(factor * mean) / known.linear16(factor * mean)).sqrt()
        assert ratio.numpy() == pytest.approx(1.0, abs=0.12)


def test_texture_is_not_taken_for_noise_where_half_of_the_picture_is_flat() -> None:
    g = torch.Generator().manual_seed(0)
    picture = torch.full((1, 64, 64, 3), 0.5, dtype=torch.float64)
    picture[:, :, :32] += 0.2 * torch.rand(1, 64, 32, 3, generator=g, dtype=torch.float64)
    picture = torch.nn.functional.avg_pool2d(picture.movedim(-1, 1), 3, 1, 1, count_include_pad=False).movedim(1, -1)
    noisy = picture + 0.01 * torch.randn(picture.shape, generator=g, dtype=torch.float64)
    sd = estimate_noise(noisy).linear16(torch.full((1, 3), 0.5, dtype=torch.float64)).sqrt()
    assert ((sd > 0.007) & (sd < 0.02)).all()


def test_a_noise_free_ramp_has_none() -> None:
    ramp = torch.linspace(0, 1, 32, dtype=torch.float64)[:, None, None].expand(1, 32, 32, 3)
    assert (estimate_noise(ramp).linear16(torch.full((1, 3), 0.5, dtype=torch.float64)) < 1e-20).all()


def test_small_pictures_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\[C, H >= 16, W >= 16, 3\], got \[1, 8, 20, 3\]"):
        estimate_noise(torch.zeros(1, 8, 20, 3))
    assert math.isfinite(float(estimate_noise(torch.zeros(1, 16, 16, 3)).linear16.curve.offset[0]))


@pytest.mark.parametrize("more", [{}, {"dual_gain": DualGain(threshold=1500.0, sigma_d=30.0, ratio=8)},
                                  {"nonlinearity": 0.05, "dark_current": 5e4, "prnu": 0.05}])  # fmt: skip
@pytest.mark.parametrize("matrix", [None, MATRIX])
@pytest.mark.parametrize("times", [4.0, 0.25])
def test_the_noise_of_a_view_exposed_so_many_times_as_long_is_divided_by_that_with_its_picture(
    more: dict[str, Any], matrix: list[list[float]] | None, times: float
) -> None:
    sensor = replace(PRESETS["a7s2-iso6400-3chip"], **more)
    noise = camera_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=matrix)
    taken = torch.tensor(np.random.default_rng(0).uniform(0.0, 0.9, (40, 3)))  # as of its own exposure
    evened = noise.at(times)
    assert evened.raw is None
    assert evened.linear16(taken / times).numpy() == pytest.approx(noise.linear16(taken).numpy() / times**2, rel=1e-9)
    assert noise.at(1) is noise
