"""Claims about 3DGS4LL's branches: what their targets are, how dark pictures come in, what a fit makes of both."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter, uniform_filter
from torch import Tensor

from novags.methods.calibrated import luma, trainer
from novags.methods.calibrated.camera_model import CameraModel, read_calibration
from novags.methods.calibrated.config import AmplifiedConfig
from novags.methods.calibrated.luma import luma_targets
from novags.methods.calibrated.luma_row import LumaConfig
from novags.methods.calibrated.trainer import DarkLoss, amplified_targets
from novags.methods.enhancers.networks.retinexformer import Retinexformer
from novags.methods.enhancers.networks.rows.retinexformer import RetinexformerConfig
from novags.methods.inputs import LacksInput
from novags.methods.problem import Problem
from novags.splats.training.losses import ssim
from tests.novags.methods.rivals.short import SHORT

AMPLIFIED = AmplifiedConfig(fit=SHORT, init_scale=0.7)
PUBLISHED = dataclasses.replace(AMPLIFIED, gain=2.75, gamma=2.25, balance=(1.2, 1.0, 1.05))


def codes(seed: int, *shape: int) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def test_targets_of_the_first_branch_are_amplified_clipped_and_smoothed() -> None:
    dark = 0.3 * codes(0, 2, 12, 9, 3)
    root = 2.75 * (dark.double().numpy() + 1e-6) ** (1 / 2.25)
    wanted = np.clip(np.minimum(root, 1) * (1.2, 1.0, 1.05), 0, 1)
    assert (wanted == 1).any()
    wanted = gaussian_filter(wanted, (0, 1, 1, 0), mode="nearest", truncate=3)
    np.testing.assert_allclose(amplified_targets(dark, PUBLISHED).numpy(), wanted, atol=2e-6)
    known = read_calibration(None)
    like = dataclasses.replace(AMPLIFIED, gain=known.gain, gamma=known.gamma, balance=known.balance)
    assert torch.equal(amplified_targets(dark, AMPLIFIED), amplified_targets(dark, like))


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "retinexformer.pt"
    with torch.random.fork_rng([]):
        torch.manual_seed(3)
        torch.save(Retinexformer().state_dict(), path)
    return path


def test_targets_of_the_second_have_the_models_colours_and_the_networks_details(weights: Path) -> None:
    dark = 0.2 * codes(1, 1, 16, 12, 3) + 0.02
    config = LumaConfig(fit=SHORT, enhance=RetinexformerConfig(weights=(weights,)))
    found = luma_targets(dark, config)[0].double().numpy()
    known = read_calibration(None)
    shown = known.to_lit(known.amplified(dark[0].double())).numpy()
    network = Retinexformer().eval()
    network.load_state_dict(torch.load(weights))
    with torch.no_grad():
        enhanced = network(dark.movedim(-1, 1))[0].movedim(0, -1).clamp(0, 1).double().numpy()
    red, blue = 0.299, 0.114  # BT.601: Cb = (B - Y) / (2 - 2 * .114), Cr = (R - Y) / (2 - 2 * .299)
    luma = np.array([red, 1 - red - blue, blue])
    y, detail = shown @ luma, enhanced @ luma
    cb, cr = (shown[..., 2] - y) / (2 - 2 * blue), (shown[..., 0] - y) / (2 - 2 * red)
    mean = {"size": 3, "mode": "nearest"}
    y = uniform_filter(y, **mean) + 2.0 * (detail - uniform_filter(detail, **mean))
    r, b = y + (2 - 2 * red) * cr, y + (2 - 2 * blue) * cb
    wanted = np.clip(np.stack([r, (y - red * r - blue * b) / (1 - red - blue), b], -1), 0, 1)
    np.testing.assert_allclose(found, wanted, atol=2e-5)


def test_the_loss_takes_the_dark_pictures_in_as_they_grow() -> None:
    """Against L1 and SSIM of the two comparisons by hand; the camera's model is not the identity."""
    model = dataclasses.replace(CameraModel.first(), gain=torch.tensor([0.3, 0.2, 0.25], dtype=torch.float64))
    dark, render, target = 0.3 * codes(2, 3, 9, 8, 3), codes(3, 9, 8, 3), codes(4, 9, 8, 3)
    loss = DarkLoss(model, dark, AMPLIFIED)
    weight = AMPLIFIED.fit.dssim_weight

    def compared(a: Tensor, b: Tensor) -> float:
        return float((1 - weight) * (a - b).abs().mean() + weight * (1 - ssim(a, b)))

    seen = render * torch.tensor([0.3, 0.2, 0.25])
    for iteration, share in ((0, 0.0), (100, 0.25), (200, 0.5), (900, 0.5)):
        step: Any = SimpleNamespace(render=render, iteration=iteration, iterations=1000, view=1)
        wanted = (1 - share) * compared(render, target) + share * compared(seen, dark[1])
        assert float(loss(step, target)) == pytest.approx(wanted, rel=1e-5)
    whole = DarkLoss(model, dark, dataclasses.replace(AMPLIFIED, growing=0.0))
    assert whole.share(0, 1000) == 0.5


def test_a_fit_ends_between_its_targets_and_what_the_dark_pictures_say(
    problem: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The camera's model makes a quarter of the lit codes, and the targets are half of what that asks for."""
    inputs = problem(sigma=0.0)
    model = dataclasses.replace(CameraModel.first(), gain=torch.full((3,), 0.25, dtype=torch.float64))
    calibration = dataclasses.replace(read_calibration(None), to_dark=model, gain=2.0, gamma=1.0, balance=(1, 1, 1))
    monkeypatch.setattr(trainer, "read_calibration", lambda _: calibration)
    quick = dataclasses.replace(AMPLIFIED.fit, iterations=250, dssim_weight=0.0)
    inside = (slice(None), slice(4, -4), slice(4, -4))
    means = {}
    for weight in (0.0, 0.5, 1.0):
        config = dataclasses.replace(AMPLIFIED, fit=quick, dark_weight=weight, growing=0.0)
        result = trainer.train(inputs, config)
        assert result.space == "lit"
        means[weight] = float(result.render(inputs.views)[0][inside].mean() / inputs.srgb8[inside].mean())
    assert means[0.0] == pytest.approx(2.0, rel=0.06)
    assert means[1.0] == pytest.approx(4.0, rel=0.06)
    assert means[0.0] < means[0.5] + 0.05 < means[1.0]


def test_an_interrupted_fit_ends_as_if_it_had_not_been(problem: Callable[..., Problem], tmp_path: Path) -> None:
    inputs, path = problem(), tmp_path / "checkpoint.safetensors"

    def stopped(done: int, *_: Any) -> None:
        if done >= 30:
            raise KeyboardInterrupt

    whole = trainer.train(inputs, AMPLIFIED)
    with pytest.raises(KeyboardInterrupt):
        trainer.train(inputs, AMPLIFIED, progress=stopped, checkpoint=path)
    found = trainer.train(inputs, AMPLIFIED, checkpoint=path)
    assert torch.equal(found.render(inputs.views)[0], whole.render(inputs.views)[0])
    assert found.found["calibrated_on"]["lit"].startswith("tabletop")
    assert torch.equal(found.targets, amplified_targets(inputs.srgb8, AMPLIFIED))


def test_the_second_branch_fits_its_targets_and_says_whose_weights_it_lacks(
    problem: Callable[..., Problem], weights: Path
) -> None:
    inputs = problem()
    with pytest.raises(LacksInput, match="Retinexformer"):
        luma.train(inputs, LumaConfig(fit=SHORT))
    config = LumaConfig(fit=SHORT, init_scale=0.7, enhance=RetinexformerConfig(weights=(weights,)))
    result = luma.train(inputs, config)
    assert result.space == "lit"
    assert result.targets is not None
    assert torch.equal(result.targets, luma_targets(inputs.srgb8, config))
    assert result.losses[-1]["photometric"] < 0.7 * result.losses[0]["photometric"]


@pytest.mark.parametrize(
    ("change", "said"),
    [({"gain": 0.0}, "gain must be > 0, got 0"), ({"gamma": -1.0}, "gamma must be > 0, got -1"),
     ({"balance": (1.0, 0.0, 1.0)}, "balance must be three factors > 0"), ({"blur": -1.0}, "blur must be >= 0 px"),
     ({"dark_weight": 1.5}, "dark_weight and growing must lie in 0..1, got 1.5 and 0.2")],
)  # fmt: skip
def test_wrong_settings_are_refused(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        AmplifiedConfig(**change)
