"""What a method trains beside the Gaussians: it learns and resumes to the bit, and features follow their Gaussians."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from novags.splats import FitConfig, Gaussians, LearningRates, McmcConfig, NotFinite, Step, Views, fit, rasterize
from novags.splats.training.companion import Companion, masked_step

SIZE = 20
STILL = LearningRates(
    means=0, means_final=0, quats=0, log_scales=0, logit_opacities=0, sh_dc=0, sh_rest=0, features=0
)  # fmt: skip


class Gain(nn.Module):
    """A factor for each channel."""

    def __init__(self) -> None:
        super().__init__()
        self.logs = nn.Parameter(torch.zeros(3))

    def forward(self, image: Tensor) -> Tensor:
        return self.logs.exp() * image


def gain(rate: float = 0.05, cool_to: float = 1.0) -> Companion:
    network = Gain()
    return Companion(network=network, optimizer=torch.optim.Adam(network.parameters(), lr=rate), cool_to=cool_to)


def scene(n: int = 120, features: int | None = None) -> tuple[Gaussians, Views, Tensor]:
    g = torch.Generator().manual_seed(3)
    points = 2 * torch.rand(n, 3, generator=g) - 1
    gaussians = Gaussians.from_points(points, torch.rand(n, 3, generator=g), sh_degree=0, init_opacity=0.8)
    if features is not None:
        gaussians.features = torch.rand(n, features, generator=g)
    viewmats = torch.eye(4).repeat(3, 1, 1)
    viewmats[:, 0, 3] = torch.tensor([-0.3, 0.0, 0.3])
    viewmats[:, 2, 3] = 3.0
    K = torch.tensor([[22.0, 0, SIZE / 2], [0, 22.0, SIZE / 2], [0, 0, 1]])
    views = Views(viewmats, K.repeat(3, 1, 1), SIZE, SIZE)
    return gaussians, views, shown(gaussians, views)


def shown(g: Gaussians, views: Views, colors: Tensor | None = None) -> Tensor:
    with torch.no_grad():
        return rasterize(
            g.means, g.quats, g.scales, g.opacities, g.sh if colors is None else colors, views.viewmats, views.Ks, SIZE,
            SIZE, sh_degree=0 if colors is None else None,
        )[0]  # fmt: skip


def config(**changes: Any) -> FitConfig:
    plain = FitConfig(iterations=60, sh_degree=0, mcmc=None, opacity_reg=0, scale_reg=0, rates=STILL)
    return dataclasses.replace(plain, **changes)


def through(companion: Companion) -> Any:
    def loss(step: Step, target: Tensor) -> Tensor:
        return (companion.network(step.render) - target).square().mean()

    return loss


def test_a_companion_learns_what_lies_between_the_render_and_the_pictures() -> None:
    start, views, images = scene()
    factors, companion = torch.tensor([0.3, 0.5, 0.8]), gain()
    result = fit(
        start, views, lambda i: factors * images[i], config(iterations=200), photometric=through(companion),
        companion=companion,
    )  # fmt: skip
    torch.testing.assert_close(companion.network.logs.exp().detach(), factors, rtol=0.01, atol=0)  # type: ignore[operator, union-attr]
    assert torch.equal(result.gaussians.sh, start.sh)  # whose rates are 0


def test_its_steps_are_those_of_adam_with_rates_that_fall() -> None:
    companion, rates = gain(rate=0.1, cool_to=0.01), []
    value, first, second = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(8):
        gradient = np.array([1.0, -0.5, 0.2]) * (k - 3)
        companion.network.logs.grad = torch.tensor(gradient, dtype=torch.float32)  # type: ignore[union-attr, assignment]
        companion.step(k, 8)
        rates.append(0.1 * 0.01 ** (k / 8))
        first, second = 0.9 * first + 0.1 * gradient, 0.999 * second + 0.001 * gradient**2
        mean, square = first / (1 - 0.9 ** (k + 1)), second / (1 - 0.999 ** (k + 1))
        value -= rates[-1] * mean / (np.sqrt(square) + 1e-8)
        assert companion.network.logs.grad is None
    np.testing.assert_allclose(companion.network.logs.detach().numpy(), value, rtol=1e-4)  # type: ignore[union-attr, operator]


def test_features_go_wherever_their_gaussians_go() -> None:
    """Nothing but the population changes: whatever Gaussian was copied, the copy's feature is that of its colour."""
    start, views, images = scene()
    start.features = torch.cat([start.sh[:, 0], start.sh[:, 0, :1] ** 2], 1)
    start.logit_opacities[:10] = -9.0  # dead
    moves = McmcConfig(refine_start=1, refine_every=5, growth=1.2)
    result = fit(start, views, lambda i: images[i], config(mcmc=moves, cap_max=200)).gaussians
    assert len(result) == 200
    assert result.features is not None
    torch.testing.assert_close(result.features, torch.cat([result.sh[:, 0], result.sh[:, 0, :1] ** 2], 1))
    assert len(torch.unique(result.sh[:, 0], dim=0)) < len(start)  # the dead ones were moved


def test_features_learn_from_what_a_loss_makes_of_them() -> None:
    start, views, _ = scene(features=2)
    truth = torch.rand(len(start), 2, generator=torch.Generator().manual_seed(9))
    images = shown(start, views, truth)

    def loss(step: Step, target: Tensor) -> Tensor:
        assert step.gaussians.features is not None
        return (step.splat(step.gaussians.features) - target).square().mean()

    rates = dataclasses.replace(STILL, features=0.02)
    result = fit(start, views, lambda i: images[i], config(iterations=400, rates=rates), photometric=loss).gaussians
    assert result.features is not None
    before = (shown(start, views, start.features) - images).square().mean()
    assert float((shown(start, views, result.features) - images).square().mean()) < 0.01 * float(before)


def test_splatting_other_values_shows_them_as_rasterize_does() -> None:
    start, views, images = scene()
    values = torch.rand(len(start), 5, generator=torch.Generator().manual_seed(2))
    want, seen = shown(start, views, values), []

    def loss(step: Step, target: Tensor) -> Tensor:
        seen.append((step.view, step.splat(values).detach(), step.splat(2 * step.gaussians.sh).detach()))
        return (step.render - target).square().mean()

    fit(start, views, lambda i: images[i], config(iterations=3, eps2d=0.3), photometric=loss)
    doubled = shown(dataclasses.replace(start, sh=2 * start.sh), views)
    for view, found, harmonics in seen:
        torch.testing.assert_close(found, want[view], rtol=1e-5, atol=1e-6)
        torch.testing.assert_close(harmonics, doubled[view], rtol=1e-5, atol=1e-6)


def test_a_stopped_run_resumes_to_the_same_bits_companion_and_features_too(tmp_path: Path) -> None:
    start, views, images = scene(features=1)
    settings = config(rates=LearningRates(), checkpoint_every=25)

    def loss_of(companion: Companion) -> Any:
        def loss(step: Step, target: Tensor) -> Tensor:
            assert step.gaussians.features is not None
            return (companion.network(step.render) - target).square().mean() + step.gaussians.features.square().mean()

        return loss

    def run(companion: Companion, stop: int | None, path: Path | None) -> Gaussians:
        def before(iteration: int) -> None:
            if iteration == stop:
                raise KeyboardInterrupt

        return fit(
            start, views, lambda i: 0.5 * images[i], settings, photometric=loss_of(companion), companion=companion,
            before_step=before, checkpoint=path,
        ).gaussians  # fmt: skip

    whole_companion, path = gain(cool_to=0.1), tmp_path / "fit.safetensors"
    whole = run(whole_companion, None, None)
    with pytest.raises(KeyboardInterrupt):
        run(gain(cool_to=0.1), 41, path)
    again = gain(cool_to=0.1)
    resumed = run(again, None, path)
    assert torch.equal(again.network.logs, whole_companion.network.logs)  # type: ignore[arg-type]
    assert all(torch.equal(t, whole.tensors()[name]) for name, t in resumed.tensors().items())
    assert "features" in resumed.tensors()
    with pytest.raises(ValueError, match="nothing is now, or the other way round.*delete it to start again"):
        fit(start, views, lambda i: images[i], settings, checkpoint=path)
    other = nn.Linear(3, 3)
    wrong = Companion(network=other, optimizer=torch.optim.Adam(other.parameters()))
    with pytest.raises(ValueError, match="companion has another shape"):
        fit(start, views, lambda i: images[i], settings, companion=wrong, checkpoint=path)


def test_a_companion_that_goes_wrong_is_named() -> None:
    start, views, images = scene()
    companion = gain()

    def loss(step: Step, target: Tensor) -> Tensor:
        logs: Any = companion.network.logs
        return (step.render - target).square().mean() + (logs * 0).sqrt().sum()  # whose slope is 0 * inf

    with pytest.raises(NotFinite, match="gradient of companion logs must be finite, got nan"):
        fit(start, views, lambda i: images[i], config(), photometric=loss, companion=companion)


def test_wrong_companions_and_features_are_refused() -> None:
    network = Gain()
    with pytest.raises(ValueError, match="all parameters of its network, and no others"):
        Companion(network=network, optimizer=torch.optim.Adam(nn.Linear(1, 1).parameters()))
    with pytest.raises(ValueError, match=r"cool_to must lie in \(0, 1\], got 0"):
        Companion(network=network, optimizer=torch.optim.Adam(network.parameters()), cool_to=0)
    start, _, _ = scene()
    with pytest.raises(ValueError, match=r"features must be \[N=120, F\] or None, got \[119, 2\]"):
        dataclasses.replace(start, features=torch.zeros(119, 2))


def test_a_masked_step_changes_no_parameter_of_any_group() -> None:
    both = [nn.Parameter(torch.zeros(2)) for _ in range(2)]
    adam = torch.optim.Adam([{"params": [one], "lr": 0.1} for one in both])
    for bad, moved in ((1.0, False), (0.0, True)):
        for one in both:
            one.grad = torch.ones(2)
        masked_step(adam, torch.tensor(bad))
        assert [bool(one.any()) for one in both] == [moved, moved]
