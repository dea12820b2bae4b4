"""Demosaiced pictures: neighbours share their noise, and held-out data would speak for whoever fits it."""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.noise import camera_noise
from novags.methods.nova_plus.bandwidth import choose_bandwidth
from novags.methods.nova_plus.data import LightMeasurements, exposures
from novags.methods.nova_plus.judge import compare
from novags.methods.nova_plus.trainer import train
from novags.methods.problem import Problem
from novags.methods.tone import ToneCurve, tone_curve
from novags.splats.views import Views
from sensor_model import PRESETS, Exposure, develop_linear, expose, mosaic
from tests.novags.methods.nova_plus.test_trainer import CONFIG

SIDE, VIEWS, SENSOR, EXPOSURE = 96, 3, PRESETS["a7s2-iso6400"], Exposure(time=1 / 30)


@pytest.fixture(scope="module")
def menon() -> tuple[LightMeasurements, ToneCurve, torch.Tensor, Problem]:
    """Smooth light behind a Bayer mosaic, interpolated by Menon, without raw frames; and its true tones."""
    y, x = np.mgrid[:SIDE, :SIDE] / 16.0
    photons = 0.25 * np.stack([30 + 14 * np.sin(x), 40 + 16 * np.sin(y), 34 + 12 * np.cos(x + y)], -1) / SENSOR.eta
    frames = [expose(mosaic(photons, SENSOR.cfa), SENSOR, EXPOSURE, seed=3, view=i) for i in range(VIEWS)]
    noisy, clean = (torch.from_numpy(np.stack([develop_linear(dn, SENSOR) for dn in given])).float()
                    for given in ([f.dn for f in frames], [f.clean_dn for f in frames]))  # fmt: skip
    start: Any = SimpleNamespace(points=torch.zeros(2, 3), colors=torch.zeros(2, 3), extent=1.0)
    problem = Problem(
        views=Views(torch.eye(4).repeat(VIEWS, 1, 1), torch.eye(3).repeat(VIEWS, 1, 1), SIDE, SIDE), start=start,
        seed=0, srgb8=noisy.clamp(0, 1), linear16=noisy, channels_share=("demosaicing",),
        noise=camera_noise(SENSOR, EXPOSURE, demosaic="menon", color_matrix=None),
    )  # fmt: skip
    assert problem.noise is not None
    data = exposures(problem, problem.noise, 0.25)
    curve = tone_curve(data.greens)
    return data, curve, torch.as_tensor(curve.tone(clean)).float(), problem


def test_no_verdict_prefers_noise_to_the_truth(menon: Any) -> None:
    """Rationale: a mean of 3 x 3 noisy pixels without the one in the middle has its noise in it all the same."""
    data, curve, truth, problem = menon
    around = torch.full((3, 1, 3, 3), 1 / 8)
    around[:, :, 1, 1] = 0
    mean = torch.nn.functional.conv2d(problem.linear16.movedim(-1, 1), around, padding=1, groups=3).movedim(1, -1)
    overfit = torch.as_tensor(curve.tone(mean)).float()
    verdict = compare(overfit, truth, data, curve, torch.ones_like(truth))
    assert verdict.excess >= -2 * verdict.deviation
    assert not verdict.worse
    assert not bool(data.held.any())
    assert bool(data.fitted.isfinite().all())


def test_the_bandwidth_is_a_sixth_of_the_noise(menon: Any) -> None:
    data, curve, truth, _ = menon
    noise = data.noise(curve.light(truth)).sqrt() / curve.slope(truth)
    h, tried = choose_bandwidth(truth, data, curve)
    assert h == pytest.approx(math.sqrt(float(noise.square().mean())) / 6, rel=1e-5)
    assert tried == []
    silent = dataclasses.replace(data.noise.curve, offset=(0.0,) * 3, slope=(0.0,) * 3, quadratic=(0.0,) * 3)
    still = dataclasses.replace(data, noise=dataclasses.replace(data.noise, curve=silent))
    assert choose_bandwidth(truth, still, curve)[0] == 0.007


@pytest.mark.parametrize("shared", [(), ("demosaicing",)])
@pytest.mark.parametrize("known", [True, False])
def test_the_record_says_where_the_noise_is_from_and_what_shares_it(
    dark: Any, known: bool, shared: tuple[str, ...]
) -> None:
    inputs = dataclasses.replace(dark()[0], channels_share=shared)
    found = train(inputs if known else dataclasses.replace(inputs, noise=None), CONFIG).found
    assert found["noise"] == {"origin": "camera" if known else "pictures", "shared": list(shared)}
    assert (found["structure"] is None) == (found["merged"] is None) == bool(shared)
    assert (found["held_out_pixels"] == 0) == ("bandwidths" not in found) == bool(shared)
