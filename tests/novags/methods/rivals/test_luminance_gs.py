"""Luminance-GS as a whole: its losses by hand, and what it makes of a dark wall."""

import dataclasses
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.problem import Problem
from novags.methods.rivals.luminance_curve import BINS, ViewCurves
from novags.methods.rivals.luminance_gs import (
    LuminanceLoss,
    companion_of,
    contrast_loss,
    dark_colors,
    histogram_loss,
    train,
)
from novags.methods.rivals.rows.luminance_gs import LuminanceGsConfig
from novags.splats import LearningRates
from novags.splats.training.losses import ssim
from tests.novags.methods.rivals.short import SHORT

CONFIG = LuminanceGsConfig(fit=SHORT, init_scale=0.7, seen=16)


def test_contrasts_count_cell_by_cell_and_neighbour_by_neighbour() -> None:
    g = torch.Generator().manual_seed(4)
    dark, lit = torch.rand(2, 14, 9, 3, generator=g)
    cells = [
        np.array([[image[4 * y : 4 * y + 4, 4 * x : 4 * x + 4].mean() for x in range(2)] for y in range(3)])
        for image in (dark.numpy().astype(float), lit.numpy().astype(float))
    ]
    total = 0.0
    for y in range(3):
        for x in range(2):
            for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                inside = 0 <= y + dy < 3 and 0 <= x + dx < 2
                a, b = (c[y, x] - (c[y + dy, x + dx] if inside else 0.0) for c in cells)
                total += (2.5 * a - b) ** 2
    assert float(contrast_loss(dark, lit, 2.5)) == pytest.approx(total / 6, rel=1e-5)


def test_the_curve_is_drawn_to_three_things() -> None:
    g = torch.Generator().manual_seed(5)
    curve, shape, equal = (torch.rand(BINS, generator=g).double() for _ in range(3))
    c, s, e = (t.numpy() for t in (curve, shape, equal))
    want = 0.5 * np.mean((c - e) ** 2) + 0.1 * np.mean((c[1:] - c[:-1]) ** 2)
    want += 0.5 * (np.mean((s - c) ** 2) + 0.01 * np.mean((s - e) ** 2))
    assert float(histogram_loss(curve, shape, equal, 0.5)) == pytest.approx(want)


def test_the_dark_colour_is_the_lit_one_times_k_plus_b_in_the_constant_term() -> None:
    sh, features = torch.rand(5, 4, 3), torch.rand(5, 6)
    found = dark_colors(SimpleNamespace(gaussians=SimpleNamespace(sh=sh, features=features)))  # type: ignore[arg-type]
    for n in range(5):
        for k in range(4):
            for c in range(3):
                bias = features[n, 3 + c] if k == 0 else 0.0
                assert float(found[n, k, c]) == pytest.approx(float(features[n, c] * sh[n, k, c] + bias), rel=1e-5)


@pytest.mark.parametrize(("iteration", "weight"), [(29, 1.0), (30, 0.1)])
def test_the_loss_is_the_weighted_sum_of_its_parts(iteration: int, weight: float) -> None:
    g = torch.Generator().manual_seed(6)
    pictures = 0.2 * torch.rand(2, 16, 12, 3, generator=g)
    curves = ViewCurves(pictures, torch.eye(4).repeat(2, 1, 1), 8)
    render, low = torch.rand(16, 12, 3, generator=g), torch.rand(16, 12, 3, generator=g)
    config = dataclasses.replace(CONFIG, lit_weight=0.7, contrast_weight=1.3, histogram_weight=3.0, contrast=0.6)
    gaussians = SimpleNamespace(sh=torch.rand(4, 1, 3), features=torch.rand(4, 6))
    step: Any = SimpleNamespace(
        view=1, iteration=iteration, iterations=100, render=render, gaussians=gaussians, splat=lambda _: low
    )
    loss = LuminanceLoss(curves, config)
    found = float(loss(step, pictures[1]).detach())

    def pictured(a: torch.Tensor, b: torch.Tensor) -> float:
        return 0.8 * float((a - b).abs().mean()) + 0.2 * (1 - float(ssim(a, b)))

    with torch.no_grad():
        curve, shape = curves.curves(1)
        bright = curves.brightened(1, curve)
        want = pictured(low, pictures[1]) + 0.7 * pictured(render, bright)
        want += 1.3 * float(contrast_loss(pictures[1], render, 0.6 / float(pictures[1].mean())))
        want += 3 * float(histogram_loss(curve, shape, loss.equalising[1], weight))
    assert found == pytest.approx(want, rel=1e-5)


def test_each_part_of_the_curves_has_the_rate_of_the_publication() -> None:
    curves = ViewCurves(torch.rand(2, 16, 12, 3), torch.eye(4).repeat(2, 1, 1), 8)
    companion = companion_of(curves, LuminanceGsConfig())
    assert [(group["lr"], group["weight_decay"]) for group in companion.optimizer.param_groups] == [
        (1e-3, 1e-4), (1e-5, 1e-5), (2e-4, 1e-4),
    ]  # fmt: skip
    attentions = [*curves.bend.parameters(), *curves.shape.parameters()]
    wanted = [curves.curve], attentions, [curves.first, curves.second]
    for group, parts in zip(companion.optimizer.param_groups, wanted, strict=True):
        assert {id(part) for part in group["params"]} == {id(part) for part in parts}
    assert companion.cool_to == 0.01


def test_a_dark_wall_is_shown_as_dark_as_it_was_seen_and_as_bright_as_its_curves_make_it(
    problem: Callable[..., Problem],
) -> None:
    """What it claims: one set of Gaussians, two exposures of it. And the curve goes to where its loss pulls it."""
    inputs = problem(sigma=0.0)
    rates = LearningRates(sh_dc=2e-2, features=2e-2)
    quick = dataclasses.replace(
        CONFIG, fit=dataclasses.replace(CONFIG.fit, iterations=300, rates=rates), curve_rate=2e-2, contrast_weight=0.0,
        histogram_weight=100.0,
    )  # fmt: skip
    result = train(inputs, quick)
    assert result.space == "lit"
    assert result.targets is not None
    inside = (slice(None), slice(4, -4), slice(4, -4))
    lit, dark = result.render(inputs.views)[0][inside], inputs.srgb8[inside]
    assert float(lit.mean()) == pytest.approx(float(result.targets[inside].mean()), rel=0.05)
    assert float(lit.mean()) > 3 * float(dark.mean())
    scene: Any = result.scene
    sh = dark_colors(SimpleNamespace(gaussians=scene.gaussians))  # type: ignore[arg-type]
    low = dataclasses.replace(scene, gaussians=dataclasses.replace(scene.gaussians, sh=sh)).render(inputs.views)[0]
    assert float((low[inside] - dark).abs().mean()) < 0.1 * float(dark.mean())
    # in the end a nearly straight curve draws it five times as hard as an equalising one, of mean 1/2
    straight, equal = float(inputs.srgb8.mean()), 0.5
    assert (equal + 5 * straight) / 6 < float(result.targets.mean()) < (equal + straight) / 2


def test_black_pictures_ask_for_no_contrast(problem: Callable[..., Problem]) -> None:
    inputs = problem()
    result = train(dataclasses.replace(inputs, srgb8=torch.zeros_like(inputs.srgb8)), CONFIG)
    assert float(result.render(inputs.views)[0].max()) < 0.3


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="weights and rates must be >= 0"):
        LuminanceGsConfig(lit_weight=-1)
    with pytest.raises(ValueError, match="seen must be >= 8 px, got 4"):
        LuminanceGsConfig(seen=4)


def test_the_curves_start_elsewhere_with_another_seed(problem: Callable[..., Problem]) -> None:
    inputs, short = problem(), dataclasses.replace(CONFIG.fit, iterations=1)
    config = dataclasses.replace(CONFIG, fit=short, curve_rate=0.0, attention_rate=0.0, axes_rate=0.0)
    first, again, other = (train(dataclasses.replace(inputs, seed=seed), config).targets for seed in (0, 0, 1))
    assert isinstance(first, torch.Tensor)
    assert isinstance(again, torch.Tensor)
    assert isinstance(other, torch.Tensor)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
