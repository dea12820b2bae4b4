"""The decomposition of LL-Gaussian: its terms by hand, and a wall whose light is known."""

import dataclasses
import importlib
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem
from novags.methods.rivals.ll_gaussian import DecompositionLoss, chosen_gamma, first, lit, parts_of, shaded, train
from novags.methods.rivals.retinex import smoothness
from novags.methods.rivals.rows.ll_gaussian import LlGaussianConfig
from novags.splats import FitConfig, Gaussians, LearningRates
from novags.splats.sh import sh_basis
from novags.splats.training.losses import ssim
from tests.novags.methods.rivals.short import SHORT

CONFIG = LlGaussianConfig(fit=SHORT, init_scale=0.7)


def test_shaded_harmonics_show_the_colour_times_the_light_from_every_side() -> None:
    g = torch.Generator().manual_seed(1)
    sh, factor = (torch.rand(4, *shape, generator=g) for shape in ((4, 3), (1,)))
    directions = torch.nn.functional.normalize(torch.randn(6, 3, generator=g), dim=-1)
    basis = sh_basis(1, directions)  # [6, 4]
    plain, found = (torch.einsum("dk,nkc->dnc", basis, t) + 0.5 for t in (sh, shaded(sh, factor)))
    torch.testing.assert_close(found, factor * plain)


def test_slopes_of_the_light_count_where_the_reflectance_has_no_edge() -> None:
    g = torch.Generator().manual_seed(2)
    light, reflectance = torch.rand(6, 5, 1, generator=g), torch.rand(6, 5, 3, generator=g, requires_grad=True)
    s, r = light.numpy().astype(float), reflectance.detach().numpy().astype(float)
    total = 0.0
    for y in range(6):
        for x in range(5):
            for dy, dx in ((0, 1), (1, 0)):
                if y + dy < 6 and x + dx < 5:
                    edge = np.abs(r[y + dy, x + dx] - r[y, x]).mean()
                    total += abs(s[y + dy, x + dx, 0] - s[y, x, 0]) * math.exp(-10 * edge)
    found = smoothness(light, reflectance)
    assert float(found) == pytest.approx(total / 30, rel=1e-5)
    assert not found.requires_grad


def test_the_loss_is_the_weighted_sum_of_its_parts() -> None:
    g = torch.Generator().manual_seed(3)
    render, target = torch.rand(9, 8, 3, generator=g), torch.rand(9, 8, 3, generator=g)
    gaussians = SimpleNamespace(sh=torch.rand(5, 1, 3, generator=g), features=torch.rand(5, 4, generator=g) - 0.5)
    spread = torch.rand(72, 5, generator=g) / 5  # how much of which Gaussian a pixel shows

    def splat(values: torch.Tensor) -> torch.Tensor:
        return (spread @ values).reshape(9, 8, -1)

    config = dataclasses.replace(CONFIG, smooth_weight=0.3, bright_weight=0.7, sparse_weight=1.1)
    step: Any = SimpleNamespace(render=render, gaussians=gaussians, splat=splat)
    found = float(DecompositionLoss(config)(step, target))
    light, noise = splat(gaussians.features[:, :1].exp()), splat(gaussians.features[:, 1:])
    dark = render * light + noise
    want = 0.8 * float((dark - target).abs().mean()) + 0.2 * (1 - float(ssim(dark, target)))
    want += 0.3 * float(smoothness(light, render))
    want += 0.7 * float(np.abs(light[..., 0].numpy() - target.numpy().max(-1)).mean())
    want += 1.1 * float(splat(gaussians.features[:, 1:].abs()).mean())
    assert found == pytest.approx(want, rel=1e-5)


def test_first_gaussians_show_the_first_colours(problem: Callable[..., Problem]) -> None:
    inputs = problem()
    colors = torch.rand(len(inputs.start.points), 3, generator=torch.Generator().manual_seed(4))
    inputs = dataclasses.replace(inputs, start=dataclasses.replace(inputs.start, colors=colors))  # type: ignore[type-var]
    colors[0] = 0.0  # a black point has the least light, a quarter of a code
    start = first(inputs, inputs.srgb8, CONFIG)
    light, noise = parts_of(start)
    torch.testing.assert_close(light[:, 0], colors.amax(-1).clamp_min(1e-3))
    assert not bool(noise.any())
    seen = (0.28209479 * start.sh[:, 0] + 0.5) * light
    torch.testing.assert_close(seen, colors, rtol=1e-4, atol=1e-5)


def test_gamma_brings_the_lit_views_to_their_mean(problem: Callable[..., Problem]) -> None:
    inputs = problem()
    start = first(inputs, inputs.srgb8, CONFIG)
    scene = GaussianScene(start)
    gamma = chosen_gamma(scene, inputs.views, 0.4)
    shown = dataclasses.replace(scene, gaussians=lit(start, gamma)).render(inputs.views)[0].clamp(0, 1)
    assert float(shown.mean()) == pytest.approx(0.4, abs=1e-3)
    assert 0.01 < gamma < 1


def test_on_a_wall_in_known_light_the_light_is_found_and_the_paint_is_lit_evenly(
    problem: Callable[..., Problem],
) -> None:
    """Paint of which some channel is always full, light that falls off to the right: which of both made it darker?"""
    inputs = problem(sigma=0.0)
    g = torch.Generator().manual_seed(8)
    points = inputs.start.points
    hues = torch.rand(len(points), 3, generator=g)
    paint = 0.2 + 0.8 * hues / hues.amax(-1, keepdim=True)
    light = 0.05 * (-0.7 * points[:, :1]).exp()
    wall = Gaussians.from_points(points, light * paint, sh_degree=0, init_opacity=0.95)
    pictures = GaussianScene(wall).render(inputs.views)[0]
    inputs = dataclasses.replace(inputs, srgb8=pictures, clean=None)
    rates = LearningRates(sh_dc=1e-2, features=2e-2)
    fit = FitConfig(iterations=400, sh_degree=0, mcmc=None, rates=rates, opacity_reg=0, scale_reg=0)
    result = train(inputs, dataclasses.replace(CONFIG, fit=fit, bright_weight=1.0, sparse_weight=1.0))
    assert result.space == "lit"
    evenly = GaussianScene(Gaussians.from_points(points, paint, sh_degree=0, init_opacity=0.95)).render(inputs.views)[0]
    bright = result.render(inputs.views)[0]

    def fall(images: torch.Tensor) -> float:
        """Natural logarithm of the left side over the right one."""
        return math.log(float(images[:, 5:-5, 5:10].mean() / images[:, 5:-5, -10:-5].mean()))

    assert float(bright.mean()) > 5 * float(pictures.mean())
    of_light = fall(pictures) - fall(evenly)
    assert of_light > 0.3
    # what is left of the fall of the light is its power of gamma; the paint is as it was
    assert fall(bright) - fall(evenly) == pytest.approx(result.found["gamma"] * of_light, abs=0.15 * of_light)


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="weights must be >= 0"):
        LlGaussianConfig(sparse_weight=-1)
    with pytest.raises(ValueError, match=r"target must lie in \(0, 1\), got 0"):
        LlGaussianConfig(target=0)


def test_gamma_is_chosen_where_the_cameras_were_refined_to(
    problem: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    module, seen = importlib.import_module("novags.methods.rivals.ll_gaussian"), list[torch.Tensor]()
    given, fitted = problem(), module.fit

    def refined(*parts: Any, **more: Any) -> Any:
        result = fitted(*parts, **more)
        return dataclasses.replace(result, viewmats=result.viewmats + 0.01)

    def noted(scene: GaussianScene, views: Any, target: float) -> float:
        seen.append(views.viewmats)
        return 0.5

    monkeypatch.setattr(module, "fit", refined)
    monkeypatch.setattr(module, "chosen_gamma", noted)
    train(given, LlGaussianConfig(fit=FitConfig(iterations=1)))
    torch.testing.assert_close(seen, [given.views.viewmats + 0.01])
