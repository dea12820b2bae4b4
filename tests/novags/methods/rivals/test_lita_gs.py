"""LITA-GS: its loss against a slow version, and walls whose light, structure and noise are known."""

import dataclasses
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem
from novags.methods.rivals.denoised_scene import DenoisedScene
from novags.methods.rivals.invariant import structure
from novags.methods.rivals.lita_gs import (
    LitaLoss,
    Networks,
    ToneMap,
    companion_of,
    first,
    flatness,
    parts_of,
    structures_of,
    train,
)
from novags.methods.rivals.rows.lita_gs import LitaGsConfig
from novags.splats import FitConfig, Gaussians, LearningRates, Views, rasterize
from novags.splats.training.fit import fit
from novags.splats.training.losses import ssim
from sensor_model import srgb_to_linear
from tests.novags.methods.rivals.short import SHORT

CONFIG = LitaGsConfig(fit=SHORT, init_scale=0.7, width=4)


def test_flatness_counts_slopes_as_far_as_there_is_no_edge_at_either_pixel() -> None:
    rng = np.random.default_rng(1)
    lit, seen = rng.random((6, 5, 3)), rng.random((6, 5))
    total = 0.0
    for y in range(6):
        for x in range(5):
            for dy, dx in ((0, 1), (1, 0)):
                if y + dy < 6 and x + dx < 5:
                    slope = np.abs(lit[y + dy, x + dx] - lit[y, x]).mean()
                    total += slope * (1 - max(seen[y, x], seen[y + dy, x + dx]))
    assert float(flatness(torch.tensor(lit), torch.tensor(seen))) == pytest.approx(total / 30)


def test_the_loss_is_the_weighted_sum_of_its_parts() -> None:
    g = torch.Generator().manual_seed(3)
    size = 34, 20  # two whole patches
    render, target = torch.rand(*size, 3, generator=g), torch.rand(*size, 3, generator=g)
    gaussians: Any = SimpleNamespace(features=torch.rand(5, 7, generator=g) - 0.5)
    spread = torch.rand(size[0] * size[1], 5, generator=g) / 5  # how much of which Gaussian a pixel shows
    structures = torch.rand(2, *size, generator=g)

    def splat(values: torch.Tensor) -> torch.Tensor:
        return (spread @ values).reshape(*size, -1)

    torch.manual_seed(4)
    networks = Networks(4).requires_grad_(False)
    for parameter in networks.parameters():
        parameter.copy_(0.1 * torch.randn(parameter.shape))
    config = dataclasses.replace(
        CONFIG, prior_weight=0.3, exposure=0.4, exposure_weight=0.7, light_weight=1.1, smooth_weight=1.3,
        noise_weight=1.7,
    )  # fmt: skip
    step: Any = SimpleNamespace(render=render, gaussians=gaussians, splat=splat, view=1)
    found = float(LitaLoss(networks, structures, config)(step, target))

    light = splat(gaussians.features[:, :3].exp())
    prior = splat(1 / (1 + (-gaussians.features[:, 3:4]).exp()))[..., 0]
    noise = networks.denoiser(splat(gaussians.features[:, 4:]))
    lit = (render - noise).clamp(0, 1)
    dark = networks.tone(light * lit)
    want = 0.8 * float((dark - target).abs().mean()) + 0.2 * (1 - float(ssim(dark, target)))
    want += 0.3 * float((prior - structures[1]).abs().mean())
    patches = [float(lit[16 * k : 16 * k + 16, :16].mean()) for k in range(2)]
    want += 0.7 * np.mean([(patch - 0.4) ** 2 for patch in patches])
    edge = np.abs(np.diff(render.numpy(), axis=1)).mean(-1), np.abs(np.diff(render.numpy(), axis=0)).mean(-1)
    slope = np.abs(np.diff(light.numpy(), axis=1)).mean(-1), np.abs(np.diff(light.numpy(), axis=0)).mean(-1)
    want += 1.1 * sum(float((s * np.exp(-10 * e)).sum()) for s, e in zip(slope, edge, strict=True)) / (34 * 20)
    want += 1.3 * float(flatness(lit, structures[1]))
    want += 1.7 * float(noise.abs().mean())
    assert found == pytest.approx(want, rel=1e-5)


def test_the_tone_map_changes_nothing_at_first_and_then_what_its_layers_say() -> None:
    colors = torch.rand(7, 3, generator=torch.Generator().manual_seed(2))
    tone = ToneMap().requires_grad_(False)
    assert torch.equal(tone(colors), colors)
    for parameter in tone.parameters():
        parameter.copy_(torch.randn(parameter.shape, generator=torch.Generator().manual_seed(6)))
    weights = {name: value.double().numpy() for name, value in tone.state_dict().items()}
    hidden = np.tanh(colors.numpy() @ weights["inner.weight"].T + weights["inner.bias"])
    want = colors.numpy() + hidden @ weights["outer.weight"].T + weights["outer.bias"]
    np.testing.assert_allclose(tone(colors).numpy(), want, rtol=1e-4, atol=1e-4)


def test_first_gaussians_are_lit_and_show_the_first_colours_in_their_light(problem: Callable[..., Problem]) -> None:
    inputs = problem()
    mean = float(inputs.srgb8.mean())
    colors = 2 * mean * torch.rand(len(inputs.start.points), 3, generator=torch.Generator().manual_seed(4))
    colors[0] = 1.0  # brighter than the one light: white in it
    inputs = dataclasses.replace(inputs, start=dataclasses.replace(inputs.start, colors=colors))  # type: ignore[type-var]
    start = first(inputs, inputs.srgb8, CONFIG)
    light, prior, noise = parts_of(start)
    torch.testing.assert_close(light, torch.full_like(light, mean / 0.49))
    seen = (0.28209479 * start.sh[:, 0] + 0.5) * light
    torch.testing.assert_close(seen, torch.minimum(colors, light), rtol=1e-4, atol=1e-5)
    assert bool((prior == 0.5).all())
    assert not bool(noise.any())


def test_black_pictures_have_a_first_light_too(problem: Callable[..., Problem]) -> None:
    inputs = problem()
    assert bool(first(inputs, torch.zeros_like(inputs.srgb8), CONFIG).features.isfinite().all())


def test_structures_are_those_of_light_not_of_codes(problem: Callable[..., Problem]) -> None:
    codes = problem().srgb8
    found = structures_of(codes)
    light = np.asarray(srgb_to_linear(codes.double().numpy()))
    for k, picture in enumerate(light):
        np.testing.assert_allclose(found[k].numpy(), structure(torch.tensor(picture)).numpy(), rtol=1e-3, atol=1e-4)


RATES = LearningRates(sh_dc=1e-2, features=2e-2)
WALL = LitaGsConfig(
    fit=FitConfig(iterations=400, sh_degree=0, mcmc=None, rates=RATES, opacity_reg=0, scale_reg=0), init_scale=0.7,
    width=4, denoiser_rate=1e-3,
)  # fmt: skip


@pytest.mark.parametrize("exposure", [0.35, 0.6])
def test_a_dark_wall_is_lit_to_the_exposure_in_the_colours_it_has(
    exposure: float, problem: Callable[..., Problem]
) -> None:
    inputs = problem(sigma=0.0)
    result = train(inputs, dataclasses.replace(WALL, exposure=exposure, exposure_weight=1.0))
    shown = result.render(inputs.views)[0]
    assert result.space == "lit"
    assert float(shown.mean()) == pytest.approx(exposure, abs=0.05)
    dark, lit = (t.flatten(0, 2).double() for t in (inputs.srgb8, shown))
    assert all(float(torch.corrcoef(torch.stack([dark[:, c], lit[:, c]]))[0, 1]) > 0.8 for c in range(3))


def fitted(inputs: Problem, config: LitaGsConfig) -> tuple[Gaussians, Networks]:
    """Gaussians with their features, and the networks, after a fit."""
    torch.manual_seed(0)
    networks = Networks(config.width)
    loss = LitaLoss(networks, structures_of(inputs.srgb8), config)
    start, dark = first(inputs, inputs.srgb8, config), inputs.srgb8
    result = fit(
        start, inputs.views, lambda i: dark[i], config.fit, photometric=loss, companion=companion_of(networks, config)
    )
    return result.gaussians.detach(), networks.requires_grad_(False)


def splatted(gaussians: Gaussians, values: torch.Tensor, views: Views) -> torch.Tensor:
    """Rendered values of Gaussians."""
    g = gaussians
    return rasterize(
        g.means, g.quats, g.scales, g.opacities, values, views.viewmats, views.Ks, views.width, views.height
    )[0]


def test_the_rendered_structure_becomes_that_of_the_pictures(problem: Callable[..., Problem]) -> None:
    inputs = problem(sigma=0.0)
    seen = structures_of(inputs.srgb8)

    def distance(weight: float) -> float:
        gaussians, _ = fitted(inputs, dataclasses.replace(WALL, prior_weight=weight))
        return float((splatted(gaussians, parts_of(gaussians)[1], inputs.views)[..., 0] - seen).abs().mean())

    assert distance(1.0) < 0.6 * distance(0.0)


def test_on_a_wall_in_known_light_the_light_is_found(problem: Callable[..., Problem]) -> None:
    """White paint in light that falls off smoothly: most of the fall is found as light, and no part of it is lost."""
    inputs = problem(sigma=0.0)
    points = inputs.start.points
    light = 0.05 * (-0.7 * points[:, :1]).exp()
    wall = Gaussians.from_points(points, light.expand(-1, 3), sh_degree=0, init_opacity=0.95)
    pictures = GaussianScene(wall).render(inputs.views)[0]
    gaussians, networks = fitted(
        dataclasses.replace(inputs, srgb8=pictures, clean=None), dataclasses.replace(WALL, exposure_weight=1.0)
    )

    def fall(images: torch.Tensor) -> float:
        """Natural logarithm of the left side over the right one."""
        return math.log(float(images[:, 5:-5, 5:10].mean() / images[:, 5:-5, -10:-5].mean()))

    shown = DenoisedScene(GaussianScene(gaussians), parts_of(gaussians)[2], networks.denoiser).render(inputs.views)[0]
    light_found = fall(splatted(gaussians, parts_of(gaussians)[0], inputs.views))
    assert fall(pictures) > 0.6
    assert light_found > 0.5 * fall(pictures)
    assert light_found + fall(shown) == pytest.approx(fall(pictures), abs=0.05)


def test_noise_that_a_smooth_picture_cannot_have_goes_into_the_noise(problem: Callable[..., Problem]) -> None:
    inputs = problem(sigma=0.03)

    def rough(weight: float) -> tuple[float, float]:
        gaussians, networks = fitted(inputs, dataclasses.replace(WALL, smooth_weight=weight))
        noise = parts_of(gaussians)[2]
        base = GaussianScene(dataclasses.replace(gaussians, features=None))
        shown = DenoisedScene(base, noise, networks.denoiser).render(inputs.views)[0]
        held = base.render(inputs.views)[0].clamp(0, 1)
        return tuple(float(t.diff(dim=2).abs().mean()) for t in (shown, held))  # type: ignore[return-value]

    shown, held = rough(0.3)
    assert shown < 0.5 * held
    shown, held = rough(0.0)
    assert shown > held


def test_each_network_has_a_rate_of_its_own() -> None:
    networks = Networks(4)
    groups = companion_of(
        networks, dataclasses.replace(CONFIG, denoiser_rate=0.25, tone_rate=0.5)
    ).optimizer.param_groups
    rates = {id(parameter): group["lr"] for group in groups for parameter in group["params"]}
    assert {rates[id(p)] for p in networks.denoiser.parameters()} == {0.25}
    assert {rates[id(p)] for p in networks.tone.parameters()} == {0.5}


def test_the_scene_has_the_noise_and_the_networks_of_the_fit(problem: Callable[..., Problem]) -> None:
    inputs = problem(seed=5)
    scene = train(inputs, dataclasses.replace(CONFIG, denoiser_rate=0.0)).scene
    assert isinstance(scene, DenoisedScene)
    torch.manual_seed(5)
    fresh = Networks(CONFIG.width).denoiser.state_dict()
    assert all(torch.equal(value, fresh[name]) for name, value in scene.denoiser.state_dict().items())
    # the noise moves at its rate of 2.5e-3 per iteration, of which there are 60
    assert 1e-3 < float(scene.noise.abs().mean()) < 60 * 2.5e-3
    learned = train(inputs, CONFIG).scene
    assert isinstance(learned, DenoisedScene)
    assert bool(learned.denoiser.get_submodule("stages.2").outer.weight.any())  # type: ignore[union-attr,operator]


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="weights and rates must be >= 0"):
        LitaGsConfig(noise_weight=-1)
    with pytest.raises(ValueError, match=r"exposure must lie in \(0, 1\), got 1"):
        LitaGsConfig(exposure=1)
    with pytest.raises(ValueError, match="width must be >= 1, got 0"):
        LitaGsConfig(width=0)
