"""HDRSplat: its loss against a slow version in float64, its denoised targets, and both kinds of camera."""

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods import METHODS
from novags.methods.denoised.config import AdaptConfig, DenoiseConfig, parts
from novags.methods.denoised.denoiser import denoised
from novags.methods.denoised.measured import measured
from novags.methods.enhancers.applying import enhanced_light
from novags.methods.inputs import LacksInput
from novags.methods.light import BRIGHT
from novags.methods.rivals import hdrsplat
from novags.methods.rivals.hdrsplat import RelativeLoss, train
from novags.methods.rivals.rows.hdrsplat import HdrsplatConfig
from novags.settings import changed
from novags.splats.training.step import PixelLoss
from tests.novags.methods.rivals.le3d.photographed import CAMERAS, Camera, photographed
from tests.novags.methods.rivals.short import SHORT

EPSILON, WEIGHT = 0.02, 0.3
QUICK = DenoiseConfig(adapt=AdaptConfig(steps=2, batch=2, crop=16), turns=1)
CONFIG = changed(HdrsplatConfig(denoise=QUICK, init_scale=0.7), {"fit.iterations": 100, "fit.sh_degree": 1}, what="x")


def slowly(image: np.ndarray, target: np.ndarray, held: np.ndarray) -> float:
    """The loss by its definition, value by value, with the denominators of the render `held`."""
    height, width, _ = image.shape
    x, relative, likeness = image.clip(0, 1), [], []
    taps = [math.exp(-((k - 5) ** 2) / (2 * 1.5**2)) for k in range(11)]
    taps = [tap / sum(taps) for tap in taps]
    for row, column, c in np.ndindex(image.shape):
        shown, wanted = float(x[row, column, c]), float(target[row, column, c])
        relative.append(abs(shown - wanted) / (min(max(float(held[row, column, c]), 0), 1) + EPSILON))
        sums = [0.0] * 5
        for i, j in np.ndindex(11, 11):
            y, z = row + i - 5, column + j - 5
            if 0 <= y < height and 0 <= z < width:
                a, b, w = float(x[y, z, c]), float(target[y, z, c]), taps[i] * taps[j]
                for k, value in enumerate((a, b, a * a, b * b, a * b)):
                    sums[k] += w * value
        mean_a, mean_b, square_a, square_b, both = sums
        luminance = (2 * mean_a * mean_b + 0.01**2) / (mean_a**2 + mean_b**2 + 0.01**2)
        structure = 2 * (both - mean_a * mean_b) + 0.03**2
        likeness.append(luminance * structure / (square_a - mean_a**2 + square_b - mean_b**2 + 0.03**2))
    return (1 - WEIGHT) * math.fsum(relative) / image.size + WEIGHT * (1 - math.fsum(likeness) / image.size)


def test_the_loss_and_its_gradient_are_those_of_the_definition() -> None:
    rng = np.random.default_rng(1)
    image = rng.uniform(-0.2, 1.2, (7, 6, 3)).astype(np.float32)  # black and white clip some of it
    target = rng.uniform(0, 1, image.shape).astype(np.float32)
    loss, exact = RelativeLoss(EPSILON, WEIGHT), image.astype(np.float64)
    want, slope = slowly(exact, target, exact), np.zeros(image.shape)
    places = [tuple(int(rng.integers(n)) for n in image.shape) for _ in range(16)]
    for place in places:
        ends = []
        for step in (1e-6, -1e-6):
            moved = exact.copy()
            moved[place] += step
            ends.append(slowly(moved, target, exact))
        slope[place] = (ends[0] - ends[1]) / 2e-6
    assert {bool(0 < image[place] < 1) for place in places} == {False, True}
    assert isinstance(loss, PixelLoss)
    value, gradient = loss.compare(image.copy(), target)
    render = torch.from_numpy(image).requires_grad_()
    step: Any = SimpleNamespace(render=render)
    by_autograd = loss(step, torch.from_numpy(target))
    by_autograd.backward()
    assert render.grad is not None
    for found, slopes in ((value, gradient), (by_autograd.detach(), render.grad.numpy())):
        assert float(found) == pytest.approx(want, rel=1e-5)
        for place in places:
            assert float(slopes[place]) == pytest.approx(slope[place], rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("camera", CAMERAS)
def test_it_fits_the_denoised_light_of_either_camera(camera: Camera) -> None:
    inputs, light = photographed(camera)
    steps: list[tuple[int, int]] = []
    result = train(inputs, CONFIG, progress=lambda done, total, _: steps.append((done, total)))
    assert result.space == "linear"
    assert steps[:2] == [(1, 102), (2, 102)]
    assert steps[-1] == (102, 102)
    assert result.seconds.keys() >= {"denoise", "fit"}
    found = result.render(inputs.views)[0]
    assert float(found.mean() / light.mean()) == pytest.approx(1, abs=0.1)

    def error(pictures: torch.Tensor) -> float:
        return float((pictures - light).square().mean())

    assert error(found) < 0.3 * error(inputs.linear16)  # type: ignore[arg-type]
    pictures = torch.stack(list(denoised(measured(inputs), CONFIG.denoise, seed=inputs.seed)))
    shown = torch.stack(list(enhanced_light(inputs, pictures, CONFIG.enhance, CONFIG.pictures)))
    assert torch.equal(result.targets, shown)  # type: ignore[arg-type]


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_stopped_run_ends_as_if_it_had_not_been(camera: Camera, tmp_path: Path) -> None:
    inputs, _ = photographed(camera)
    config = dataclasses.replace(CONFIG, fit=dataclasses.replace(SHORT, rates=CONFIG.fit.rates))

    def stop(done: int, _: int, __: Any) -> None:
        if done == 42:  # 40 of the fit
            raise KeyboardInterrupt

    whole = train(inputs, config)
    with pytest.raises(KeyboardInterrupt):
        train(inputs, config, progress=stop, checkpoint=tmp_path / "fit.safetensors")
    resumed = train(inputs, config, checkpoint=tmp_path / "fit.safetensors")
    assert torch.equal(whole.render(inputs.views)[0], resumed.render(inputs.views)[0])
    assert torch.equal(whole.targets, resumed.targets)  # type: ignore[arg-type]


def test_its_rates_and_its_loss_are_those_published() -> None:
    config = METHODS["hdrsplat"].config()
    rates = config.fit.rates
    assert (rates.means, rates.log_scales, rates.logit_opacities, rates.sh_dc) == (8e-5, 1e-3, 5e-3, 5e-4)
    assert (rates.quats, rates.sh_rest, rates.means_final) == (1e-3, 5e-4 / 20, 1.6e-6)  # 3DGS's
    assert (config.epsilon, config.fit.dssim_weight, config.fit.sh_degree) == (1e-3, 0.2, 3)
    naive = METHODS["naive"].config()
    assert dataclasses.replace(config.fit, rates=naive.fit.rates) == naive.fit
    assert METHODS["hdrsplat"].parts is parts


def test_targets_lie_between_black_and_white(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    light = torch.rand(inputs.srgb8.shape, generator=torch.Generator().manual_seed(3)) * 2 - 0.5
    monkeypatch.setattr(hdrsplat, "denoised_pictures", lambda *_: (light, 0.0))
    seen: list[np.ndarray] = []

    def compare(self: RelativeLoss, image: np.ndarray, target: np.ndarray) -> tuple[np.float32, np.ndarray]:
        seen.append(target)
        return np.float32(0), np.zeros_like(image)

    monkeypatch.setattr(RelativeLoss, "compare", compare)
    train(inputs, changed(CONFIG, {"fit.iterations": 4}, what="x"))
    assert len(seen) == 4
    for target in seen:  # of one of the views each
        assert any(np.array_equal(target, view.clip(0, 1)) for view in light.numpy())


@pytest.mark.parametrize("share", [1.0, 1 / 64])
def test_dark_captures_are_amplified_and_shown_in_their_own_light(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs, light = photographed("a7s2-iso6400-3chip")
    bright = share * float(light[..., 1].double().flatten().quantile(BRIGHT))
    monkeypatch.setattr(hdrsplat, "denoised_pictures", lambda *_: (share * light, 0.0))
    seen: list[float] = []
    compare = RelativeLoss.compare

    def watched(self: RelativeLoss, image: np.ndarray, target: np.ndarray) -> tuple[np.float32, np.ndarray]:
        seen.append(float(target.mean()))
        return compare(self, image, target)

    monkeypatch.setattr(RelativeLoss, "compare", watched)
    result = train(inputs, changed(CONFIG, {"least_bright": 0.004}, what="x"))
    unit = min(1.0, bright / 0.004)
    assert (unit == 1) is (share == 1)
    assert result.found == {"unit": pytest.approx(unit)}
    assert np.mean(seen[-4:]) == pytest.approx(share / unit * float(light.mean()), rel=1e-3)  # one of each view
    assert float(result.render(inputs.views)[0].mean() / (share * light.mean())) == pytest.approx(1, abs=0.1)


def test_epsilon_and_the_weight_of_ssim_are_those_of_the_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    monkeypatch.setattr(hdrsplat, "denoised_pictures", lambda *_: (inputs.linear16, 0.0))
    short = changed(CONFIG, {"fit.iterations": 2}, what="x")
    seen: list[tuple[float, float]] = []
    compare = RelativeLoss.compare

    def watched(self: RelativeLoss, image: np.ndarray, target: np.ndarray) -> tuple[np.float32, np.ndarray]:
        seen.append((self.epsilon, self.dssim_weight))
        return compare(self, image, target)

    monkeypatch.setattr(RelativeLoss, "compare", watched)
    train(inputs, changed(short, {"epsilon": 0.03, "fit.dssim_weight": 0.4}, what="x"))
    assert seen == [(0.03, 0.4)] * 2


def test_data_that_cannot_be_denoised_are_refused() -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    with pytest.raises(LacksInput, match="denoising needs the noise of the data"):
        train(dataclasses.replace(inputs, noise=None), CONFIG)
    with pytest.raises(ValueError, match=r"epsilon must be > 0 .* got 0"):
        HdrsplatConfig(epsilon=0)
    with pytest.raises(ValueError, match=r"least_bright must lie in \(0, 1\], got 0"):
        HdrsplatConfig(least_bright=0)
