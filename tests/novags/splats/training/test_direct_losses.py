"""Losses of pictures, penalties of harmonics and refined cameras on the direct road: the gradients of autograd."""

import dataclasses
import importlib
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from novags.methods.nova.config import ConsistencyConfig
from novags.methods.nova.consistency import ConsistencyLoss
from novags.methods.rivals.gaussian_dk import Response, ResponseLoss
from novags.splats import FitConfig, Gaussians, McmcConfig, NotFinite, Views, fit
from novags.splats.training.checkpoint import TrainingState
from novags.splats.training.companion import Companion
from novags.splats.training.config import CameraRefinement
from novags.splats.training.direct import DirectFit
from novags.splats.training.iteration import backpropagate, default_photometric
from novags.splats.training.pictures import LossTerms
from novags.splats.training.step import HarmonicsPenalty, PictureLoss, Step
from novags.splats.training.updates.adam import Adam
from novags.splats.training.updates.camera_refinement import CameraState

loop = importlib.import_module("novags.splats.training.fit")  # the package has a function of that name
N, WIDTH, HEIGHT = 500, 37, 29
CONFIG = FitConfig(iterations=50, extent=2.0, sh_every=6, mcmc=McmcConfig(refine_start=10**6), checkpoint_every=10)
MOVING = dataclasses.replace(CONFIG, refine_cameras=CameraRefinement(start=0))


class OfPictures:
    """A loss of the pictures of a Step, with a parameter of its own."""

    def __init__(self, compute: Callable[[Step, Tensor], Tensor]) -> None:
        self.compute, self.own = compute, torch.tensor([0.3, -0.7], requires_grad=True)

    def trained_along(self) -> list[Tensor]:
        return [self.own]

    def __call__(self, step: Step) -> Tensor:
        return self.compute(step, self.own)


def of_depth(step: Step, own: Tensor) -> Tensor:
    weights = torch.linspace(0, 1, WIDTH)
    return (own[0] * step.depth * weights).square().mean() + own[1] * (step.depth / (1 + step.depth)).mean()


def of_alpha_and_render(step: Step, own: Tensor) -> Tensor:
    return (own[0] * step.alpha - step.render[..., 1]).abs().mean() + own[1].exp() * step.render[..., 2].square().mean()


def of_another_view(step: Step, own: Tensor) -> Tensor:
    """That view is a constant, its camera is not."""
    with torch.no_grad():
        render, depth, alpha, info = step.rasterize_view((step.view + 1) % 3)
    place = step.views.viewmats[(step.view + 1) % 3, :3, 3]
    return (step.render - render).square().mean() * (own[1] + depth.mean() * alpha.mean()) + 1e-3 * (
        own[0] * place
    ).sum()


def weights_of(step: Step) -> Tensor:
    return torch.where(step.visible, step.info["means2d"][0, :, 0].detach().abs() * 1e-4, 0.0)


LOSSES: dict[str, Callable[[Views, Tensor], list]] = {
    "depth": lambda views, images: [OfPictures(of_depth)],
    "alpha and render": lambda views, images: [OfPictures(of_alpha_and_render)],
    "another view": lambda views, images: [OfPictures(of_another_view)],
    "penalty": lambda views, images: [HarmonicsPenalty(weights_of)],
    "two penalties, one not due": lambda views, images: [
        HarmonicsPenalty(weights_of), HarmonicsPenalty(lambda step: None), HarmonicsPenalty(weights_of)
    ],
    "geometry with confidence": lambda views, images: [geometry(views, images)],
    "all": lambda views, images: [OfPictures(of_depth), geometry(views, images), HarmonicsPenalty(weights_of)],
}  # fmt: skip


def geometry(views: Views, images: Tensor) -> ConsistencyLoss:
    config = ConsistencyConfig(start=0.0, occlusion_tolerance=0.8, min_alpha=0.05, max_distance=10.0)
    return ConsistencyLoss(views, images.__getitem__, config, iterations=50, seed=3)


@pytest.fixture(scope="module")
def problem() -> tuple[Gaussians, Views, Tensor]:
    """500 Gaussians with harmonics, three cameras that see them from three sides, and unrelated pictures."""
    g = torch.Generator().manual_seed(5)
    start = Gaussians.from_points(torch.randn(N, 3, generator=g), torch.rand(N, 3, generator=g), sh_degree=3)
    noise = {name: torch.randn(t.shape, generator=g) for name, t in start.tensors().items()}
    start.sh, start.quats = start.sh + 0.1 * noise["sh"], noise["quats"]
    start.log_scales = start.log_scales + 0.3 * noise["log_scales"]  # a sphere has no slope in its rotation
    viewmats = torch.eye(4).repeat(3, 1, 1)
    for i, angle in enumerate((0.0, 0.2, -0.15)):
        c, s = torch.cos(torch.tensor(angle)), torch.sin(torch.tensor(angle))
        viewmats[i, :3, :3] = torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        viewmats[i, :3, 3] = torch.tensor([0.1 * i, 0.0, 5.0 + i / 2])
    K = torch.tensor([[40.0, 0, 18.5], [0, 42.0, 14.5], [0, 0, 1]])
    return start, Views(viewmats, K.repeat(3, 1, 1), WIDTH, HEIGHT), torch.rand(3, HEIGHT, WIDTH, 3, generator=g)


def state_of(start: Gaussians, views: Views, moving: bool) -> TrainingState:
    copy = Gaussians(**{name: t.clone() for name, t in start.tensors().items()})
    twists = 1e-3 * torch.randn(3, 6, generator=torch.Generator().manual_seed(2))
    cameras = dataclasses.replace(CameraState.of(views.viewmats), twists=twists) if moving else None
    return TrainingState(gaussians=copy, adam=Adam(copy), cameras=cameras)


@pytest.mark.parametrize("moving", [False, True], ids=["fixed", "moving"])
@pytest.mark.parametrize("name", LOSSES)
def test_gradients_are_those_of_autograd(problem, name, moving):
    """After one step, Adam's first moment of every parameter is a tenth of its gradient."""
    start, views, images = problem
    config, gradients, values = MOVING if moving else CONFIG, [], []
    for direct in (True, False):
        state, losses = state_of(start, views, moving), LOSSES[name](views, images)
        if direct:
            terms = LossTerms.of(None, losses, config.dssim_weight)
            road = DirectFit(views, config, 2.0, terms)
            assert road.takes(state.gaussians, images[1], config.rates)
            values.append(road.step(state, 25, images[1], config.rates, 1e-4, True))
        else:
            value = backpropagate(
                state, views, 25, config, 2.0, with_depth=True, extra_losses=losses,
                photometric=lambda step: default_photometric(config.dssim_weight, step, images[1]),
            )  # fmt: skip
            values.append([float(x) for x in value])
            state.adam.step(state.gaussians, config.rates, 1e-4, 3)
        found = {name: 10 * moment for name, moment in state.adam.first.items()}
        if state.cameras is not None:
            found["twists"] = state.cameras.twists.grad
        beside = [p for loss in losses if isinstance(loss, PictureLoss) for p in loss.trained_along()]
        gradients.append(found | {f"beside {i}": p.grad for i, p in enumerate(beside)})
    assert values[0] == pytest.approx(values[1], rel=1e-5)
    assert gradients[0].keys() == gradients[1].keys()
    for key, expected in gradients[1].items():
        assert float(expected.abs().max()) > 0, key
        error = torch.linalg.vector_norm(gradients[0][key] - expected) / torch.linalg.vector_norm(expected)
        assert float(error) < 1e-5, key


@pytest.mark.parametrize("config", [CONFIG, MOVING], ids=["fixed", "moving"])
def test_fifty_iterations_are_those_of_autograd(problem, config, monkeypatch):
    start, views, images = problem
    results = []
    for direct in (True, False):
        losses = LOSSES["all"](views, images)
        if direct:
            monkeypatch.setattr(loop, "backpropagate", None)  # nothing is left to it
        else:
            monkeypatch.undo()
            losses.append(lambda step: None)  # may depend on anything
        results.append(fit(start, views, lambda i: images[i], config, extra_losses=losses, needs_depth=True))
    for a, b in zip(results[0].losses, results[1].losses, strict=True):
        assert a["loss"] == pytest.approx(b["loss"], rel=1e-4)
        assert a["photometric"] == pytest.approx(b["photometric"], rel=1e-4)
    torch.testing.assert_close(results[0].viewmats, results[1].viewmats, rtol=0, atol=1e-4)
    assert torch.equal(results[0].viewmats, views.viewmats) == (config is CONFIG)
    for name, tensor in results[0].gaussians.tensors().items():
        expected = getattr(results[1].gaussians, name)
        assert float(torch.linalg.vector_norm(tensor - expected) / torch.linalg.vector_norm(expected)) < 1e-4, name
        assert not torch.equal(tensor, getattr(start, name))


def test_a_photometric_loss_with_a_network_trains_both_as_autograd_does(problem, monkeypatch):
    """The response of a camera, learned beside the Gaussians."""
    start, views, images = problem
    results = []
    for direct in (True, False):
        torch.manual_seed(0)
        response = Response()
        losses = [] if direct else [lambda step: None]
        companion = Companion(network=response, optimizer=torch.optim.Adam(response.parameters(), lr=1e-3))
        if direct:
            monkeypatch.setattr(loop, "backpropagate", None)
        else:
            monkeypatch.undo()
        result = fit(
            start, views, lambda i: images[i], CONFIG, photometric=ResponseLoss(response, 0.2), companion=companion,
            extra_losses=losses,
        )  # fmt: skip
        results.append((result, torch.nn.utils.parameters_to_vector(response.parameters()).detach()))
    torch.testing.assert_close(results[0][1], results[1][1], rtol=0, atol=1e-4)
    for a, b in zip(results[0][0].losses, results[1][0].losses, strict=True):
        assert a["loss"] == pytest.approx(b["loss"], rel=1e-4)
        assert a["photometric"] == a["loss"] or a["photometric"] == pytest.approx(b["photometric"], rel=1e-4)


@pytest.mark.parametrize("where", ["value", "gradient of the picture", "gradient of the network", "weights"])
def test_a_loss_that_is_not_finite_is_named_as_by_autograd_and_its_network_is_asked_once(problem, where):
    start, views, images = problem

    def broken(step: Step, own: Tensor) -> Tensor:
        plain = of_depth(step, own)
        if step.iteration < 7:
            return plain
        if where == "value":
            return plain / 0
        if where == "gradient of the network":
            return plain + (own[0] - own[0].detach()).abs().sqrt()
        return plain + (step.render - step.render.detach()).abs().sqrt().sum()

    def bad(step: Step) -> Tensor:
        return weights_of(step) * (torch.inf if where == "weights" and step.iteration == 7 else 1)

    messages, kept = [], []
    for direct in (True, False):
        loss = OfPictures(of_depth if where == "weights" else broken)
        losses = [loss, HarmonicsPenalty(bad), *([] if direct else [lambda step: None])]
        before: list[Tensor | None] = []

        def clear(iteration: int, loss: OfPictures = loss, before: list = before) -> None:
            before.append(loss.own.grad)
            loss.own.grad = None

        if where == "gradient of the network":  # which its own optimiser looks at, as `ConsistencyLoss.update` does
            fit(start, views, lambda i: images[i], dataclasses.replace(CONFIG, iterations=9), extra_losses=losses,
                needs_depth=True, before_step=clear)  # fmt: skip
            kept.append([None if g is None else g.isfinite().all().item() for g in before])
            continue
        with pytest.raises(NotFinite) as error:
            fit(start, views, lambda i: images[i], CONFIG, extra_losses=losses, needs_depth=True, before_step=clear)
        messages.append(str(error.value))
        kept.append([None if g is None else g.tolist() for g in before])
    if where == "gradient of the network":
        assert kept[0] == kept[1] == [None, *[True] * 7, False]
        return
    assert messages[0].split(":")[0].split(" got ")[0] == messages[1].split(":")[0].split(" got ")[0]
    assert "iteration 7" in messages[0]
    assert len(kept[0]) == len(kept[1]) == 8
    for a, b in zip(kept[0][1:], kept[1][1:], strict=True):
        assert a == pytest.approx(b, rel=1e-3)


def test_a_picture_loss_cannot_splat_other_values(problem):
    start, views, images = problem
    loss = OfPictures(lambda step, own: step.splat(torch.ones(N, 1)).mean())
    with pytest.raises(ValueError, match="without `trained_along`"):
        fit(start, views, lambda i: images[i], dataclasses.replace(CONFIG, iterations=1), extra_losses=[loss])
