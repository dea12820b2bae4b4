"""A training stops at the first number that is not finite, and a resume from its checkpoint stops there again."""

import dataclasses
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor

from novags.methods import METHODS, chosen
from novags.methods.nova.consistency import ConsistencyLoss
from novags.methods.nova.denoiser import Denoiser
from novags.splats import FitConfig, Gaussians, NotFinite, Views, fit
from novags.splats.training.checkpoint import load_checkpoint
from novags.splats.training.guard import require_finite
from novags.splats.training.step import Step
from tests.stability.wall import problem

FITTING = sys.modules["novags.splats.training.fit"]  # the package's `fit` is the function


class Poison(torch.autograd.Function):
    """The value as it is, and a NaN for one number of its gradient."""

    @staticmethod
    def forward(ctx, value: Tensor) -> Tensor:
        return value.clone()

    @staticmethod
    def backward(ctx, gradient: Tensor) -> Tensor:
        gradient = gradient.clone(memory_format=torch.contiguous_format)
        gradient.view(-1)[7] = math.nan
        return gradient


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Tensors this small are slower on two."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def scene() -> tuple[Gaussians, Views, Tensor]:
    made = problem()
    start = Gaussians.from_points(made.start.points, made.start.colors, sh_degree=1, init_scale=0.7)
    return start, made.views, made.srgb8


def config(**changes: object) -> FitConfig:
    return FitConfig(**{"iterations": 40, "sh_degree": 1, "sh_every": 5, "checkpoint_every": 10, **changes})


def stop_of(run: Callable[[], object]) -> str:
    with pytest.raises(NotFinite) as stopped:
        run()
    text = str(stopped.value)
    assert "\n" not in text
    return text


def bad_target(images: Tensor, at: int) -> Callable[[int], Tensor]:
    """Targets that are NaN from the `at`-th call on."""
    calls = iter(range(10**6))
    return lambda i: images[i] * (math.nan if next(calls) >= at else 1.0)


def test_a_loss_that_is_not_finite_is_named_and_met_again(scene, tmp_path: Path) -> None:
    start, views, images = scene
    path = tmp_path / "checkpoint.safetensors"
    first = stop_of(lambda: fit(start, views, bad_target(images, 23), config(), checkpoint=path))
    assert first.startswith("the loss must be finite, got nan at iteration 23, view ")
    assert "photometric nan, regulariser 0." in first
    assert first.endswith(f"; {path} leads there again")
    again = stop_of(lambda: fit(start, views, bad_target(images, 0), config(), checkpoint=path))
    assert again == first


def test_the_extra_loss_to_blame_is_named(scene) -> None:
    start, views, images = scene

    def wild(step: Step) -> Tensor | None:
        return step.render.mean() * math.inf if step.iteration == 3 else None

    assert "wild inf" in stop_of(lambda: fit(start, views, lambda i: images[i], config(), extra_losses=[wild]))


def test_a_gradient_that_is_not_finite_is_named_before_it_does_harm(scene, tmp_path: Path) -> None:
    start, views, images = scene
    path = tmp_path / "checkpoint.safetensors"

    def poison(step: Step) -> Tensor | None:
        return Poison.apply(step.gaussians.log_scales).mean() if step.iteration == 17 else None

    def run() -> None:
        fit(start, views, lambda i: images[i], config(), extra_losses=[poison], checkpoint=path)

    first = stop_of(run)
    assert first.startswith(
        "gradient of log_scales must be finite, got nan at [2, 1] (1 of 360 values) at iteration 17"
    )
    assert stop_of(run) == first
    saved = load_checkpoint(path, fitting_settings(scene), torch.device("cpu"))
    assert saved.iteration == 17
    assert all(bool(torch.isfinite(t).all()) for t in saved.gaussians.tensors().values())


def fitting_settings(scene) -> dict[str, object]:
    start, views, _ = scene
    return FITTING._identity(start, views, dataclasses.replace(config(), extent=views.extent))


@pytest.mark.parametrize("name", ["means", "quats", "log_scales", "logit_opacities", "sh"])
def test_a_parameter_that_is_damaged_is_named_and_the_last_good_checkpoint_leads_there(
    scene, tmp_path: Path, monkeypatch, name: str
) -> None:
    start, views, images = scene
    path = tmp_path / "checkpoint.safetensors"
    move = FITTING._move

    def damaging(state, iteration, *rest) -> None:
        move(state, iteration, *rest)
        if iteration == 24:
            getattr(state.gaussians, name).view(-1)[0] = math.nan

    monkeypatch.setattr(FITTING, "_move", damaging)

    def run() -> None:
        fit(start, views, lambda i: images[i], config(), checkpoint=path)

    first = stop_of(run)
    assert first.startswith(f"parameter {name} must be finite, got nan at [0")
    # the activations of the kernels turn NaN into a number: only the check in every tenth iteration sees it
    assert f"at iteration {29 if name in ('log_scales', 'logit_opacities') else 25}, view " in first
    assert load_checkpoint(path, fitting_settings(scene), torch.device("cpu")).iteration == 20
    assert stop_of(run) == first


def test_norms_of_every_group_are_on_record(scene) -> None:
    start, views, images = scene
    found = fit(start, views, lambda i: images[i], config(iterations=10))
    for name, tensor in found.gaussians.tensors().items():
        assert found.losses[-1][f"norm_{name}"] == pytest.approx(float(tensor.double().square().sum().sqrt()), rel=1e-5)


def test_large_numbers_whose_sum_overflows_are_finite() -> None:
    require_finite("parameter", {"means": torch.full((4,), 3e38)}, "", resumable=True)


def nova(**changes: object):
    variant = chosen("nova")
    settings = {
        "init_scale": 0.7, "fit.iterations": 14, "fit.sh_degree": 1, "fit.sh_every": 5, "fit.checkpoint_every": 5,
        "denoiser.warmup_steps": 6, "denoiser.network.widths": (4, 8), "denoiser.network.bottleneck": 8,
        "denoiser.crop": 12, "denoiser.denoise_every": 1, "consistency.every": 1, "consistency.start": 0.1,
    }  # fmt: skip
    return variant.config(METHODS["nova"].config(), {**settings, **changes})


def plant(patch: pytest.MonkeyPatch, where: str, at: int) -> None:
    """Make what the denoiser or the geometric loss returns NaN in one step, or a gradient that passes through it."""
    if where == "denoiser":
        loss = Denoiser.loss
        patch.setattr(Denoiser, "loss", lambda self: loss(self) * (math.nan if self.step == at else 1))
    elif where == "denoiser gradient":
        predict = Denoiser.predict

        def poisoned(self: Denoiser, images: Tensor) -> Tensor:
            found = predict(self, images)
            return Poison.apply(found) if self.step == at and found.requires_grad else found

        patch.setattr(Denoiser, "predict", poisoned)
    else:
        call = ConsistencyLoss.__call__

        def term(self: ConsistencyLoss, step: Step) -> Tensor | None:
            found = call(self, step)
            if found is None or step.iteration != at:
                return found
            return found + (Poison.apply(self.network.layers[0].weight).sum() if "gradient" in where else math.nan)

        patch.setattr(ConsistencyLoss, "__call__", term)


@pytest.mark.parametrize(
    ("where", "at", "message"),
    [
        ("denoiser", 4, "the denoiser's loss must be finite, got nan at denoiser step 4, view "),
        ("denoiser gradient", 17, "denoiser gradient of "),
        ("consistency", 11, "the loss must be finite, got nan at iteration 11, view "),
        ("consistency gradient", 11, "confidence gradient of layers.0.weight must be finite, got nan at [0, 0, 2, 1]"),
    ],
)
def test_networks_stop_too_and_are_saved_with_the_splats(
    monkeypatch, tmp_path: Path, where: str, at: int, message: str
) -> None:
    plant(monkeypatch, where, at)
    path = tmp_path / "checkpoint.safetensors"
    seen: list[int] = []

    def run() -> None:
        METHODS["nova"].train(problem(), nova(), checkpoint=path, progress=lambda done, n, entry: seen.append(done))

    first = stop_of(run)
    assert first.startswith(message)
    assert "leads there again" in first
    seen.clear()
    assert stop_of(run) == first
    assert not [done for done in seen if done % 10 == 0 and done < at]  # nothing is done twice


def test_a_denoiser_that_lets_the_fit_reach_it_keeps_the_gradient_that_waits(monkeypatch, tmp_path: Path) -> None:
    plant(monkeypatch, "denoiser", 17)
    path = tmp_path / "checkpoint.safetensors"

    def run() -> None:
        METHODS["nova"].train(problem(), nova(detach_target=False), checkpoint=path)

    first = stop_of(run)
    assert first.startswith("the denoiser's loss must be finite, got nan at denoiser step 17, view ")
    assert stop_of(run) == first


@pytest.fixture(scope="module")
def straight() -> Gaussians:
    return METHODS["nova"].train(problem(), nova()).scene.gaussians


@pytest.mark.parametrize("where", ["denoiser gradient", "consistency"])
def test_a_run_whose_cause_to_stop_is_gone_ends_as_one_that_never_stopped(straight, tmp_path: Path, where: str) -> None:
    path = tmp_path / "checkpoint.safetensors"
    with pytest.MonkeyPatch.context() as patch:
        plant(patch, where, 11)
        stop_of(lambda: METHODS["nova"].train(problem(), nova(), checkpoint=path))
    resumed = METHODS["nova"].train(problem(), nova(), checkpoint=path).scene.gaussians
    for name, tensor in straight.tensors().items():
        assert torch.equal(tensor, resumed.tensors()[name]), name
