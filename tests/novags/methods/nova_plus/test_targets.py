"""Targets of stage 2: guided averages mixed with their guide, and data through the denoiser, held-out data unseen."""

from collections.abc import Iterable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.denoised.config import AdaptConfig, DenoiseConfig
from novags.methods.denoised.denoiser import denoised
from novags.methods.denoised.measured import measured
from novags.methods.noise import Variance, camera_noise
from novags.methods.nova_plus import trainer
from novags.methods.nova_plus.average import averages
from novags.methods.nova_plus.config import NovaPlusConfig
from novags.methods.nova_plus.data import LightMeasurements, exposures
from novags.methods.nova_plus.targets import LEFT, denoised_light, guided_light, towards
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


def noisy(truth: torch.Tensor, sigma: float) -> LightMeasurements:
    """Data of equal noise everywhere; every third row is held out."""
    noise = NoiseCurve(
        black=(0.0,) * 3, white=(1.0,) * 3, offset=(sigma**2,) * 3, slope=(0.0,) * 3, quadratic=(0.0,) * 3,
        switch=(np.inf,) * 3, step=(0.0,) * 3,
    )  # fmt: skip
    light = truth + sigma * torch.randn(truth.shape, generator=torch.Generator().manual_seed(0))
    held = torch.zeros(truth.shape[:3], dtype=torch.bool)
    held[:, ::3] = True
    return LightMeasurements(light=light, held=held, noise=Variance(noise), white=torch.full((3,), 10.0), matrix=None)


@pytest.mark.parametrize("least", [0.0, 0.9, 1.0])
def test_guided_light_is_a_mixture_of_averages_and_guide_in_light(least: float) -> None:
    curve, sigma, level = ToneCurve(top=1.0, k=4.0), 0.1, 0.01
    data = noisy(torch.full((2, 24, 24, 3), level), sigma)
    guide = curve.tone(torch.full_like(data.light, level))
    sums = averages(guide, data.fitted, h=0.05, patch=1)
    found = guided_light(guide, data, curve, 0.05, 0.25, least)
    slope = 4 * (level + 1 / np.expm1(4))
    share = (0.01 / (0.01 + sigma**2 * sums.variance / slope**2)).clamp_min(least)
    assert least == 1 or float(share.min()) < 0.99
    torch.testing.assert_close(found, level + 0.25 * share * (sums.mean(data.light) - level), rtol=1e-4, atol=1e-5)


def test_light_moves_to_an_estimate_as_far_as_its_variance_in_tone_allows() -> None:
    curve = ToneCurve(top=2.0, k=5.0)
    light, estimate = torch.tensor([0.0, 0.3, 1.5]), torch.tensor([-0.1, 0.5, 1.0])
    knee = 2.0 / np.expm1(5.0)
    for variance in (0.0, 1e-4, 1.0):
        for least in (0.0, 0.2):
            found = towards(light, estimate, torch.full((3,), variance), curve, least)
            for i in range(3):
                slope = 5.0 * (float(light[i]) + knee)
                share = max(least, 0.01 / (0.01 + variance / slope**2))
                want = float(light[i]) + share * float(estimate[i] - light[i])
                assert float(found[i]) == pytest.approx(want, rel=1e-5, abs=1e-7)


def test_denoised_data_count_with_a_sixteenth_of_the_variance_of_the_data() -> None:
    curve = ToneCurve(top=1.0, k=4.0)
    data = noisy(torch.full((2, 12, 12, 3), 0.05), 0.1)
    guide, clean = curve.tone(torch.full_like(data.light, 0.05)), torch.full_like(data.light, -0.02)
    config = NovaPlusConfig(least_share=0.0)
    work: Any = SimpleNamespace(data=data, curve=curve, config=config, found={}, denoised=lambda _: iter(clean))
    found = trainer._Work.targets(work, guide, 0.05)
    light = guided_light(guide, data, curve, 0.05, 0.5, 0.0)
    share = 0.01 / (0.01 + 0.1**2 / 16 / (4 * (light + curve.knee)).square())
    assert 0.2 < float(share.mean()) < 0.8
    torch.testing.assert_close(found, curve.tone(light + share / 3 * (clean - light)), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("share", [-0.1, 1.1])
def test_a_floor_beyond_all_or_nothing_is_refused(share: float) -> None:
    with pytest.raises(ValueError, match=f"and {share}"):
        NovaPlusConfig(least_share=share)


@pytest.mark.parametrize(("level", "gain"), [(0.002, 10.0), (0.3, 0.9)], ids=["dark", "bright"])
def test_shares_by_variance_keep_dark_targets_near_the_guide_and_leave_bright_ones(level: float, gain: float) -> None:
    """The logarithm falls fastest below zero, where noisy estimates of the dark lie: squared error in tone."""
    curve, truth = ToneCurve(top=1.0, k=6.0), torch.full((2, 24, 24, 3), level)
    data = noisy(truth, 0.02)
    guide = curve.tone(truth) + 0.02

    def error(least: float) -> float:
        light = guided_light(guide, data, curve, 0.02, 0.5, least)
        light = light + (towards(light, data.light, LEFT * data.noise(light), curve, least) - light) / 3
        return float((curve.tone(light) - curve.tone(truth)).square().mean())

    assert error(1.0) / error(0.0) > gain
    assert error(0.0) <= error(0.2) <= error(1.0) or level > 0.1
