"""The dilation of a fit is the one it renders with: in training, in what comes of it, on record."""

import dataclasses
import math

import pytest
import torch

from novags.methods.enhanced import enhance_then_fit
from novags.methods.enhanced.config import EnhancedFitConfig
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.nova import trainer
from novags.methods.nova.config import NovaConfig
from novags.splats import FitConfig, Gaussians, McmcConfig, Views, fit, photometric_loss, rasterize
from novags.splats.training.config import UNUSUAL

SMALL = {"eps2d": 0.02, "rasterize_mode": "classic"}
SHARP = {"eps2d": 0.02, "rasterize_mode": "antialiased"}
USUAL = {"eps2d": 0.3, "rasterize_mode": "classic"}


def config_of(splatting, **changes) -> FitConfig:
    antialiased = splatting["rasterize_mode"] == "antialiased"
    return FitConfig(
        iterations=1, eps2d=splatting["eps2d"], antialiased=antialiased, opacity_reg=0.0, scale_reg=0.0, mcmc=None,
        **changes,
    )  # fmt: skip


def scene() -> tuple[Gaussians, Views, torch.Tensor]:
    """Splats a fraction of a pixel wide, which the dilation matters to."""
    g = torch.Generator().manual_seed(3)
    gaussians = Gaussians.from_points(torch.rand(60, 3, generator=g), torch.rand(60, 3, generator=g), sh_degree=0)
    gaussians.log_scales -= 2.5
    viewmats = torch.eye(4).repeat(2, 1, 1)
    viewmats[:, 2, 3] = 3.0
    K = torch.tensor([[24.0, 0, 8], [0, 24.0, 8], [0, 0, 1]]).repeat(2, 1, 1)
    return gaussians, Views(viewmats, K, 24, 20), torch.rand(2, 20, 24, 3, generator=g)


def rendered(g: Gaussians, views: Views, splatting) -> torch.Tensor:
    values = g.means, g.quats, g.scales, g.opacities, g.sh, views.viewmats, views.Ks, views.width, views.height
    return rasterize(*values, sh_degree=0, **splatting)[0]


def test_colours_go_through_the_matrix_of_the_camera_once():
    gaussians, views, _ = scene()
    matrix = torch.tensor([[0.5, 0.25, 0.0], [0.0, 1.0, 0.5], [0.25, 0.0, 0.75]])
    plain, seen = (GaussianScene.of(gaussians, config_of(USUAL, extent=views.extent)) for _ in range(2))
    found = dataclasses.replace(seen, matrix=matrix).render(views)[0]
    torch.testing.assert_close(found, torch.einsum("ij,chwj->chwi", matrix, plain.render(views)[0]))


@pytest.mark.parametrize("splatting", [SMALL, SHARP, USUAL], ids=["small", "antialiased", "usual"])
@pytest.mark.parametrize("path", ["direct", "autograd", "torch"])
def test_the_loss_of_an_iteration_is_that_of_the_picture_so_rendered(splatting, path):
    gaussians, views, images = scene()
    options = {"extra_losses": [lambda step: None]} if path == "autograd" else {}
    config = config_of(splatting, backend="torch" if path == "torch" else "auto", sh_degree=0)
    (entry,) = fit(gaussians, views, lambda i: images[i], config, **options).losses
    losses = [
        float(photometric_loss(picture, image, 0.2))
        for picture, image in zip(rendered(gaussians, views, splatting), images, strict=True)
    ]
    other = float(photometric_loss(rendered(gaussians, views, {**splatting, "eps2d": 0.1})[0], images[0], 0.2))
    assert min(abs(entry["photometric"] - loss) for loss in losses) < 2e-6
    assert abs(entry["photometric"] - other) > 2e-5


@pytest.mark.parametrize("splatting", [SMALL, SHARP], ids=["small", "antialiased"])
def test_what_a_method_gives_back_is_shown_as_it_was_trained_and_says_how(problem, splatting):
    inputs = problem()
    enhanced = EnhancedFitConfig(fit=dataclasses.replace(config_of(splatting), iterations=3, mcmc=McmcConfig()))
    result = enhance_then_fit.train(inputs, enhanced)
    g = result.scene.gaussians
    views = inputs.views
    values = g.means, g.quats, g.scales, g.opacities, g.sh, views.viewmats, views.Ks, views.width, views.height
    expected = rasterize(*values, sh_degree=g.sh_degree, **splatting)[0]
    torch.testing.assert_close(result.render(views)[0], expected, rtol=0, atol=1e-6)
    assert not torch.allclose(rasterize(*values, sh_degree=g.sh_degree)[0], expected, rtol=0, atol=1e-3)
    antialiased = splatting["rasterize_mode"] == "antialiased"
    shown = {"eps2d": 0.02, "antialiased": antialiased, "near_plane": result.config.fit.near_plane}
    assert result.scene.facts() == {"gaussians": len(g), **shown}


def test_nova_trains_renders_and_records_with_the_dilation_of_its_fit(problem, monkeypatch):
    """Its own losses look at the Step, which is the picture as `rasterize` makes it with this dilation."""
    original, inputs, off = trainer.fit, problem(), []

    def look(step):
        view = slice(step.view, step.view + 1)
        one = dataclasses.replace(step.views, viewmats=step.views.viewmats[view], Ks=step.views.Ks[view])
        off.append(float((step.render - rendered(step.gaussians, one, SHARP)[0]).detach().abs().max()))

    def watched(*args, extra_losses, **keywords):
        return original(*args, extra_losses=[*extra_losses, look], **keywords)

    monkeypatch.setattr(trainer, "fit", watched)
    fit_config = dataclasses.replace(config_of(SHARP, sh_degree=0), iterations=2)
    result = trainer.train(inputs, NovaConfig(denoiser=None, sh_weight=None, fit=fit_config))
    assert off == [pytest.approx(0, abs=1e-6)] * 2
    assert (result.scene.eps2d, result.scene.antialiased) == (0.02, True)


def test_a_checkpoint_belongs_to_its_dilation(tmp_path):
    gaussians, views, images = scene()
    fit(gaussians, views, lambda i: images[i], config_of(SMALL), checkpoint=tmp_path / "c")
    with pytest.raises(ValueError, match=r"antialiased: False there, True now"):
        fit(gaussians, views, lambda i: images[i], config_of(SHARP), checkpoint=tmp_path / "c")


@pytest.mark.parametrize("value", [-0.1, float("nan"), float("inf")])
def test_an_impossible_dilation_is_refused(value):
    with pytest.raises(ValueError, match="eps2d must be finite and >= 0"):
        FitConfig(eps2d=value)


def test_a_scene_without_a_fit_has_the_default_dilation():
    shown = {"eps2d": FitConfig().eps2d, "antialiased": False, "near_plane": 0.01}
    assert GaussianScene(scene()[0]).facts() == {"gaussians": 60, **shown}


@pytest.mark.parametrize("path", ["direct", "autograd"])
@pytest.mark.parametrize("unit", [2.0**12, 2.0**-12])
def test_a_scene_in_other_units_is_fitted_and_shown_alike(unit: float, path: str) -> None:
    """Of usual size, and so many times larger: splats must neither be pressed flat nor lie before the near plane."""
    options = {"extra_losses": [lambda step: None]} if path == "autograd" else {}
    start, views, images = scene()
    start.log_scales += 2.5
    moved = views.viewmats.clone()
    moved[1, 0, 3] = 2 * UNUSUAL / 1.1  # two cameras, at this extent of each other's mean
    losses, pictures = [], []
    for factor in (1.0, unit):
        viewmats = moved.clone()
        viewmats[:, :3, 3] *= factor
        seen = dataclasses.replace(views, viewmats=viewmats)
        assert seen.extent == pytest.approx(UNUSUAL * factor)
        gaussians = dataclasses.replace(start, means=start.means * factor)
        gaussians.log_scales = start.log_scales + math.log(factor)
        config = FitConfig(iterations=40, sh_degree=0, scale_reg=0.05, extent=seen.extent)
        result = fit(gaussians, seen, lambda i: images[i], config, **options)
        losses.append([entry["loss"] for entry in result.losses])
        pictures.append(GaussianScene.of(result.gaussians, config).render(seen)[0])
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
    assert float((pictures[0] - pictures[1]).abs().max()) < 0.01
    assert float(pictures[0].max()) > 0.3


@pytest.mark.parametrize("unit", [1e5, 1e-5])
def test_first_scales_follow_the_unit_of_the_points(unit: float) -> None:
    points, colors = torch.rand(200, 3, generator=torch.Generator().manual_seed(0)), torch.full((200, 3), 0.5)
    usual, other = (Gaussians.from_points(factor * points, colors, sh_degree=0).scales for factor in (1.0, unit))
    torch.testing.assert_close(other, unit * usual, rtol=1e-4, atol=0)
