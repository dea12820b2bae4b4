"""Targets of stage 2: guided averages mixed with their guide, and data through the denoiser, held-out data unseen."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
import torch

from novags.methods.denoised.config import AdaptConfig, DenoiseConfig
from novags.methods.denoised.denoiser import denoised
from novags.methods.denoised.measured import measured
from novags.methods.noise import Variance, camera_noise
from novags.methods.nova_plus.average import averages
from novags.methods.nova_plus.data import LightMeasurements, exposures
from novags.methods.nova_plus.targets import denoised_light, guided_light
from novags.methods.problem import Problem, RawPictures
from novags.methods.tone import ToneCurve
from novags.splats.views import Views
from sensor_model import PRESETS, Exposure, NoiseCurve, develop, expose, from_linear16, mosaic
from sensor_model.isp import white_balance

HEIGHT, WIDTH, VIEWS = 32, 40, 2
PLAIN = DenoiseConfig(adapt=None, turns=1)
CAMERAS = ["a7s2-iso6400-3chip", "a7s2-iso6400"]


def stacked(views: Iterable[torch.Tensor]) -> torch.Tensor:
    return torch.stack(list(views))


def photographed(name: str, electrons: float = 20.0) -> tuple[Problem, torch.Tensor]:
    """Two views of a smooth ramp, and its true light [C, H, W, 3]."""
    sensor, exposure = PRESETS[name], Exposure(time=1 / 30)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    light = (0.3 + x / WIDTH)[..., None] * [0.8, 1.0, 0.6] * (1 + 0.3 * np.sin(y / 7))[..., None]
    photons = (light * electrons / sensor.eta).astype(np.float32)
    seen = photons if sensor.cfa is None else mosaic(photons, sensor.cfa)
    frames = [expose(seen, sensor, exposure, seed=3, view=i) for i in range(VIEWS)]
    red, green, blue = white_balance(sensor).tolist()
    raw = RawPictures(
        dn=torch.from_numpy(np.stack([f.dn for f in frames]).astype(np.float32)), cfa=sensor.cfa,
        black=float(sensor.black_level), white=sensor.white_dn, balance=(red, green, blue),
    )  # fmt: skip
    linear = np.stack([from_linear16(develop(f, sensor).linear16) for f in frames])
    problem = Problem(
        views=Views(torch.eye(4).repeat(VIEWS, 1, 1), torch.eye(3).repeat(VIEWS, 1, 1), WIDTH, HEIGHT),
        start=None, seed=0, srgb8=torch.zeros(VIEWS, HEIGHT, WIDTH, 3), linear16=torch.from_numpy(linear), raw=raw,
        noise=camera_noise(sensor, exposure, demosaic="menon", color_matrix=None),
    )  # type: ignore[arg-type]  # fmt: skip
    unit = [(raw.white - raw.black) / factor for factor in (red, green, blue)]
    truth = photons * sensor.eta * sensor.gain / np.array(unit)
    return problem, torch.from_numpy(truth).float().repeat(VIEWS, 1, 1, 1)


@pytest.mark.parametrize("config", [PLAIN, DenoiseConfig(adapt=AdaptConfig(steps=2, batch=2, crop=16), turns=2)])
@pytest.mark.parametrize("name", CAMERAS)
def test_data_are_denoised_as_by_the_method_that_only_denoises(name: str, config: DenoiseConfig) -> None:
    """Whose unit is the electron, and whose pictures are those of the camera."""
    problem, _ = photographed(name)
    assert problem.noise is not None
    data = exposures(problem, problem.noise, 0.0)
    found = stacked(denoised_light(data, torch.zeros_like(data.light), config, seed=5))
    torch.testing.assert_close(found, stacked(denoised(measured(problem), config, seed=5)), rtol=2e-3, atol=2e-5)


@pytest.mark.parametrize("name", CAMERAS)
def test_denoised_light_is_the_true_one_with_less_noise_in_all_channels(name: str) -> None:
    problem, truth = photographed(name)
    assert problem.noise is not None
    data = exposures(problem, problem.noise, 0.05)
    found = stacked(denoised_light(data, truth, PLAIN, seed=0))
    noisy = data.noise(truth)  # variance of a datum
    assert float(((found - truth).square() / noisy).mean()) < (0.1 if name.endswith("3chip") else 0.2)
    assert float(found.mean() / truth.mean()) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("name", CAMERAS)
def test_the_denoiser_sees_neither_what_is_held_out_nor_what_was_not_measured(name: str) -> None:
    problem, truth = photographed(name)
    assert problem.noise is not None
    data = exposures(problem, problem.noise, 0.1)
    other = torch.where(data.held[..., None], 9.0 * data.light + 1.0, data.light)
    config = DenoiseConfig(adapt=AdaptConfig(steps=1, batch=1, crop=16), turns=1)
    found = [stacked(denoised_light(each, truth, config, seed=1)) for each in (data, replace(data, light=other))]
    assert torch.equal(*found)
    expected = torch.where(data.held[..., None], truth, 7.0)  # where data were measured and are fitted, it is not asked
    assert torch.equal(stacked(denoised_light(data, expected, config, seed=1)), found[0])
    assert not torch.equal(stacked(denoised_light(data, 2 * truth, config, seed=1)), found[0])


def test_guided_light_is_a_mixture_of_averages_and_guide_in_light() -> None:
    curve, sigma = ToneCurve(top=1.0, k=4.0), 0.05
    noise = NoiseCurve(
        black=(0.0,) * 3, white=(1.0,) * 3, offset=(sigma**2,) * 3, slope=(0.0,) * 3, quadratic=(0.0,) * 3,
        switch=(np.inf,) * 3, step=(0.0,) * 3,
    )  # fmt: skip
    light = 0.5 + sigma * torch.randn(2, 24, 24, 3, generator=torch.Generator().manual_seed(0))
    held = torch.zeros(2, 24, 24, dtype=torch.bool)
    held[:, ::3] = True
    data = LightMeasurements(light=light, held=held, noise=Variance(noise), white=torch.full((3,), 10.0), matrix=None)
    guide = curve.tone(torch.full_like(light, 0.5))
    average = averages(guide, torch.where(held[..., None], torch.nan, light), h=0.05, patch=1).mean(curve.light(guide))
    found = guided_light(guide, data, curve, 0.05, 0.25)
    torch.testing.assert_close(found, 0.25 * average + 0.75 * 0.5, rtol=1e-4, atol=1e-5)
