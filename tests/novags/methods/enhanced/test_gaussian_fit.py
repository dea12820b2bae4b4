"""What methods hand to the fit that aim at pictures which stay as they are, and what they give back."""

import dataclasses
import time
from types import SimpleNamespace

import pytest
import torch

from novags import methods
from novags.methods.enhanced import clean_fit, enhance_then_fit, gaussian_fit
from novags.methods.enhanced.config import EnhancedFitConfig
from novags.methods.enhanced.oracle import OracleConfig
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import enhance
from novags.methods.enhancers.networks.rows.zero_dce import ZeroDceConfig
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.nerf import fitting
from novags.methods.problem import Problem
from novags.splats import FitConfig, Gaussians, Views
from novags.splats.training.config import CameraRefinement
from novags.splats.training.fit import FitResult

CONFIG = EnhancedFitConfig(
    enhance=EnhanceConfig(window=5), init_scale=0.3, fit=FitConfig(iterations=4, sh_degree=1, seed=1)
)


def problem() -> Problem:
    g = torch.Generator().manual_seed(0)
    dark, clean = 0.05 + 0.2 * torch.rand(2, 2, 10, 12, 3, generator=g)
    viewmats = torch.eye(4).repeat(2, 1, 1)
    views = Views(viewmats, torch.eye(3).repeat(2, 1, 1), 12, 10)
    start = SimpleNamespace(points=torch.rand(20, 3, generator=g), colors=torch.rand(20, 3, generator=g), extent=2.5)
    return Problem(views=views, srgb8=dark, clean=clean, start=start, seed=9)


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch) -> dict:
    """The arguments of the fit and of the start; the fit itself gives its start back, and moved cameras."""
    found: dict = {}

    def fit(gaussians, views, target, config, **keywords) -> FitResult:
        found.update(gaussians=gaussians, views=views, target=target, config=config, **keywords)
        return FitResult(
            gaussians=gaussians, viewmats=views.viewmats + 1, config=config, losses=[{"loss": 0.5}], seconds=0.25,
            peak_bytes=0,
        )  # fmt: skip

    original = gaussian_fit.start_gaussians
    monkeypatch.setattr(gaussian_fit, "fit", fit)
    monkeypatch.setattr(
        gaussian_fit, "start_gaussians", lambda *a, **k: found.update(start=(a, k)) or original(*a, **k)
    )
    return found


@pytest.mark.parametrize("kind", ["Gaussians", "field"])
def test_what_is_not_the_fit_is_counted_for_this_run_alone(kind: str) -> None:
    """Rationale: the seconds of a fit include those of stopped runs; the rest is done anew in every run."""
    result = SimpleNamespace(seconds=100.25, earlier=100.0, viewmats=None, losses=[], state=SimpleNamespace(losses=[]))
    started, config = time.perf_counter() - 1, SimpleNamespace(fit=FitConfig())
    scene = GaussianScene(Gaussians.from_points(torch.eye(3), torch.eye(3), sh_degree=0))
    found = (
        gaussian_fit.reconstructed(result, config, scene, "lit", started)
        if kind == "Gaussians"
        else fitting.reconstructed(scene, result, config, "lit", started)
    )
    assert found.seconds["fit"] == 100.25
    assert 0.75 <= found.seconds["other"] < 5


def images_of(method, inputs: Problem) -> torch.Tensor:
    """What each method aims at, worked out view by view."""
    pairs = [(dark, *enhance(dark, CONFIG.enhance)) for dark in inputs.srgb8]
    if method is enhance_then_fit:
        return torch.stack([image for _, image, _ in pairs])
    twins = zip(inputs.clean, pairs, strict=True)
    return torch.stack([enhance(clean, CONFIG.enhance, params)[0] for clean, (_, _, params) in twins])


@pytest.mark.parametrize("method", [enhance_then_fit, clean_fit], ids=["naive", "oracle"])
def test_the_fit_starts_from_and_aims_at_the_same_pictures(seen, method):
    inputs = problem()
    own = CONFIG if method is enhance_then_fit else OracleConfig(**vars(CONFIG))
    result = method.train(inputs, own)
    expected = images_of(method, inputs)
    assert torch.equal(torch.stack([seen["target"](view) for view in range(2)]), expected)
    assert torch.equal(result.targets, expected)
    assert torch.equal(result.enhanced, expected)
    (start, dark, images), keywords = seen["start"]
    assert start is inputs.start
    assert torch.equal(dark, inputs.srgb8)
    assert torch.equal(images, expected)
    assert keywords == {"sh_degree": 1, "init_scale": 0.3}
    assert seen["views"] is inputs.views


def test_seed_and_extent_are_the_problems_and_the_record_says_so(seen):
    result = enhance_then_fit.train(problem(), CONFIG)
    assert seen["config"] == dataclasses.replace(CONFIG.fit, seed=9, extent=2.5)
    assert result.config == dataclasses.replace(CONFIG, fit=seen["config"])
    assert result.scene.gaussians is seen["gaussians"]
    assert (result.space, result.losses) == ("enhanced", [{"loss": 0.5}])
    assert result.enhancement["config"] == dataclasses.asdict(CONFIG.enhance)


def test_a_network_learns_with_the_seed_of_the_problem(seen):
    config = dataclasses.replace(CONFIG, enhance=ZeroDceConfig(steps=1, batch=1, crop=8))
    seeds = (9, 9, 10)
    first, again, other = (
        enhance_then_fit.train(dataclasses.replace(problem(), seed=seed), config).targets for seed in seeds
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_progress_and_checkpoint_are_passed_on(seen, tmp_path):
    def progress(*entry: object) -> None: ...

    enhance_then_fit.train(problem(), CONFIG, progress=progress, checkpoint=tmp_path / "c")
    assert (seen["progress"], seen["checkpoint"]) == (progress, tmp_path / "c")


def test_refined_cameras_are_given_back_where_they_were_asked_for(seen):
    inputs = problem()
    assert enhance_then_fit.train(inputs, CONFIG).viewmats is None
    refining = dataclasses.replace(CONFIG, fit=dataclasses.replace(CONFIG.fit, refine_cameras=CameraRefinement()))
    assert torch.equal(enhance_then_fit.train(inputs, refining).viewmats, inputs.views.viewmats + 1)


def test_seconds_are_those_that_passed(seen):
    started = time.perf_counter()
    seconds = enhance_then_fit.train(problem(), CONFIG).seconds
    assert 0 < seconds["enhance"] < time.perf_counter() - started
    assert seconds["fit"] == 0.25


def test_only_bounds_see_the_noise_free_exposures():
    seeing = {name: method.family for name, method in methods.METHODS.items() if method.sees_clean}
    assert seeing == {"oracle": "bound", "nerf-oracle": "bound", "averaging": "bound"}
    assert {name: method.bound for name, method in methods.METHODS.items() if method.bound} == {
        "naive": "floor",
        "oracle": "ceiling",
    }
