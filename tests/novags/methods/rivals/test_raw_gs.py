"""RawNeRF's loss on Gaussians: its values against a slow version, and light without the bias of clipped pictures."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.gaussian_scene import GaussianScene
from novags.methods.inputs import LacksInput
from novags.methods.light import BRIGHT, MeasuredLight, first_light
from novags.methods.rivals.raw_gs import RawLoss, train
from novags.methods.rivals.rows.raw_gs import RawGsConfig
from novags.splats import FitConfig, McmcConfig
from novags.splats.files.ply import read_ply
from sensor_model import linear_to_srgb, srgb_to_linear

CONFIG = RawGsConfig(
    fit=FitConfig(iterations=300, sh_degree=1, sh_every=50, opacity_reg=0, mcmc=McmcConfig(refine_start=50)),
    init_scale=0.7,
)
WHITE, EPSILON = (0.9, 1.5, 1.2), 0.05


def slowly(image: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray]:
    """The loss by its definition, and its gradient with the denominator held fixed, pixel by pixel."""
    count = sum(not np.isnan(t) for t in target.reshape(-1))
    total, gradient = 0.0, np.zeros(image.shape)
    for index in np.ndindex(image.shape):
        y, t, white = float(image[index]), float(target[index]), WHITE[index[-1]]
        if np.isnan(t):
            continue
        error = (min(y, white) - t) / (y + EPSILON)
        total += error**2 / count
        gradient[index] = 0.0 if y > white else 2 * error / (y + EPSILON) / count
    return total, gradient


def test_the_loss_and_its_gradient_are_those_of_the_definition() -> None:
    rng = np.random.default_rng(1)
    image, target = rng.uniform(0, 2, (7, 9, 3)).astype(np.float32), rng.normal(0.5, 0.5, (7, 9, 3)).astype(np.float32)
    target[rng.random(target.shape) < 0.4] = np.nan
    loss = RawLoss(torch.tensor(WHITE), EPSILON)
    want, slope = slowly(image, target)
    value, gradient = loss.compare(image.copy(), target)
    assert float(value) == pytest.approx(want, rel=1e-5)
    np.testing.assert_allclose(gradient, slope, rtol=1e-4, atol=1e-8)
    render = torch.from_numpy(image).requires_grad_()
    step: Any = SimpleNamespace(render=render)
    by_autograd = loss(step, torch.from_numpy(target))
    by_autograd.backward()
    assert float(by_autograd.detach()) == pytest.approx(want, rel=1e-5)
    assert render.grad is not None
    np.testing.assert_allclose(render.grad.numpy(), slope, rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("own_space", [False, True])
def test_first_points_have_the_light_that_pictures_show_there(own_space: bool) -> None:
    light = np.random.default_rng(2).uniform(0.02, 0.3, (6, 3))  # of the sensor, white-balanced
    matrix = np.array([[1.6, -0.4, -0.2], [-0.2, 1.5, -0.3], [0.1, -0.6, 1.5]]) if own_space else np.eye(3)
    shown = linear_to_srgb(light @ matrix.T)
    start: Any = SimpleNamespace(colors=torch.tensor(shown, dtype=torch.float32))
    own: Any = torch.tensor(matrix, dtype=torch.float32) if own_space else None
    noise: Any = None
    data = MeasuredLight(light=torch.zeros(1, 2, 2, 3), noise=noise, white=torch.ones(3), matrix=own)
    np.testing.assert_allclose(first_light(start, data).numpy(), light, rtol=1e-4)


def test_it_ends_in_the_light_of_the_scene_with_less_noise_than_its_data(dark: Any, tmp_path: Path) -> None:
    inputs, light = dark()
    result = train(inputs, dataclasses.replace(CONFIG, fit=dataclasses.replace(CONFIG.fit, iterations=800)))
    found = result.render(inputs.views)[0]
    inside = (slice(None), slice(4, -4), slice(4, -4))
    assert result.space == "linear"
    assert float(found[inside].mean() / light[inside].mean()) == pytest.approx(1, abs=0.02)
    clipped = inputs.linear16.clamp_min(0)  # what a picture would keep
    assert float((found - light)[inside].square().mean()) < 0.5 * float((clipped - light)[inside].square().mean())
    green = inputs.linear16[..., 1].double().flatten()
    assert result.found["unit"] == pytest.approx(float(torch.quantile(green, BRIGHT)))
    # the file holds colours of which 1 is that light, and the record says so
    result.save(tmp_path)
    scene: Any = result.scene
    matrix = torch.tensor(scene.facts()["matrix"])
    again = GaussianScene(read_ply(tmp_path / "point_cloud.ply"), scene.eps2d, scene.antialiased, matrix=matrix)
    torch.testing.assert_close(again.render(inputs.views)[0], found, rtol=1e-4, atol=1e-6)


def test_the_unit_of_the_light_changes_nothing_but_epsilon(dark: Any) -> None:
    """Light in another unit, with epsilon and white in that unit too, is the same problem."""
    inputs, _ = dark()
    short = dataclasses.replace(CONFIG, epsilon=0.01, fit=dataclasses.replace(CONFIG.fit, iterations=40))
    bright = float(inputs.linear16.quantile(0.8))  # a white that matters

    def saturating(white: float) -> Any:
        linear16 = inputs.noise.linear16
        curve = dataclasses.replace(linear16.curve, white=(white,) * 3)
        return dataclasses.replace(inputs.noise, linear16=dataclasses.replace(linear16, curve=curve))

    plain = train(dataclasses.replace(inputs, noise=saturating(bright)), short).render(inputs.views)[0]
    noise = saturating(bright / 2)
    dark_start = dataclasses.replace(
        inputs.start, colors=torch.from_numpy(linear_to_srgb(srgb_to_linear(inputs.start.colors.double().numpy()) / 2))
    )
    other = dataclasses.replace(inputs, linear16=inputs.linear16 / 2, noise=noise, start=dark_start)
    halved = train(other, dataclasses.replace(short, epsilon=short.epsilon / 2)).render(inputs.views)[0]
    assert float((2 * halved - plain).abs().mean() / plain.mean()) < 1e-3


def test_it_needs_no_known_noise(dark: Any) -> None:
    """Captures of less than 32 px do not know theirs."""
    inputs, _ = dark()
    short = dataclasses.replace(CONFIG, fit=dataclasses.replace(CONFIG.fit, iterations=20))
    known, unknown = (train(dataclasses.replace(inputs, noise=noise), short) for noise in (inputs.noise, None))
    assert torch.equal(known.render(inputs.views)[0], unknown.render(inputs.views)[0])


def test_what_it_cannot_use_is_said(dark: Any) -> None:
    inputs, _ = dark()
    with pytest.raises(LacksInput, match="raw frames or 16-bit linear pictures"):
        train(dataclasses.replace(inputs, linear16=None), CONFIG)
    with pytest.raises(ValueError, match="99% quantile of the green pixels must be above black, got -1"):
        train(dataclasses.replace(inputs, linear16=inputs.linear16 * 0 - 1), CONFIG)
    with pytest.raises(ValueError, match=r"epsilon must be > 0 .* got 0"):
        RawGsConfig(epsilon=0)
