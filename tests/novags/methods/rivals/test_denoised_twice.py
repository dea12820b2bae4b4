"""`denoise-gs-twice`: how its renders go back to electrons, which cameras see them, and its settings."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from novags.methods import METHODS
from novags.methods.denoised.config import AdaptConfig, DenoiseConfig
from novags.methods.denoised.measured import MeasuredPictures, measured
from novags.methods.enhancers.applying import enhanced_light
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.problem import Problem
from novags.methods.rivals import denoised_twice
from novags.methods.rivals.denoised_twice import electrons_of, train
from novags.methods.rivals.rows.denoised_twice import DenoisedTwiceConfig, parts
from novags.splats import CameraRefinement, FitConfig
from novags.testbed.folders.run import CHECKPOINTS

CONFIG = DenoisedTwiceConfig(
    denoise=DenoiseConfig(adapt=AdaptConfig(steps=1, batch=1, crop=16), turns=1),
    fit=FitConfig(iterations=12, sh_degree=0, refine_cameras=CameraRefinement(start=2)),
)
Dark = Callable[..., tuple[Problem, Tensor]]


def truth(pictures: MeasuredPictures, light: Tensor) -> Tensor:
    """Mean electrons [C, 3, H, W] of the light [C, H, W, 3] of a wall."""
    return (light / pictures.unit).movedim(-1, 1)


@pytest.mark.parametrize("mixed", [False, True])
def test_a_render_that_shows_the_enhanced_picture_is_the_electrons_of_the_picture(dark: Dark, mixed: bool) -> None:
    inputs, light = dark()
    pictures = measured(inputs)
    electrons = truth(pictures, light)
    assert float(pictures.electrons.mean() / electrons.mean()) == pytest.approx(1, abs=0.02)  # the unit is right
    if mixed:  # a camera whose colours are not the colours of the screen
        matrix = torch.tensor([[1.05, -0.02, -0.03], [-0.04, 1.06, -0.02], [0.0, -0.05, 1.05]])
        pictures = dataclasses.replace(pictures, matrix=matrix)
    linear = pictures.linear(electrons)
    enhanced = torch.stack(list(enhanced_light(inputs, linear, CONFIG.enhance, "8bit")))
    again = electrons_of(enhanced, linear, enhanced, pictures)
    known = ~again.isnan()
    assert float(known.float().mean()) > 0.8  # of the wall; behind it is black
    torch.testing.assert_close(again[known], electrons[known], rtol=1e-4, atol=1e-3)
    # A twentieth brighter in code is 1.05 ** 2.4 of the light, on the curve's upper part.
    brighter = pictures.linear(electrons_of(1.05 * enhanced, linear, enhanced, pictures))
    bright = (linear > 0.01) & ~brighter.isnan()
    ratio = (brighter / linear)[bright]
    assert ((ratio > 1.04) & (ratio < 1.05**2.4 + 1e-3)).all()


def test_where_the_enhancement_has_no_factor_a_render_teaches_nothing(dark: Dark) -> None:
    inputs, light = dark()
    pictures, linear = measured(inputs), 0.1 + light
    enhanced = torch.full_like(linear, 0.5)
    linear[0, 0, 0], enhanced[1, 2, 3] = -0.1, 1.0  # black; clipped
    found = electrons_of(enhanced, linear, enhanced, pictures)
    assert found.isnan().any(1).nonzero().tolist() == [[0, 0, 0], [1, 2, 3]]


def test_renders_that_teach_are_seen_by_the_cameras_that_the_first_fit_has_refined(
    dark: Dark, monkeypatch: pytest.MonkeyPatch
) -> None:
    (inputs, _), fits, rendered = dark(), list[Any](), list[Tensor]()
    fit, render = denoised_twice.fit_denoised, GaussianScene.render

    def fitted(*given: Any) -> Any:
        fits.append(fit(*given))
        return fits[-1]

    def seen(scene: GaussianScene, views: Any) -> Any:
        rendered.append(views.viewmats)
        return render(scene, views)

    monkeypatch.setattr(denoised_twice, "fit_denoised", fitted)
    monkeypatch.setattr(GaussianScene, "render", seen)
    train(inputs, CONFIG)
    first, _ = fits
    assert not torch.equal(first.viewmats, inputs.views.viewmats)
    assert torch.equal(torch.cat(rendered), first.viewmats)


def test_all_that_an_unfinished_run_keeps_is_removed_with_the_checkpoints_of_a_run(dark: Dark, tmp_path: Path) -> None:
    """Rationale: files of the first round stayed, and the run of another capture in that folder stopped at them."""
    train(dark()[0], CONFIG, checkpoint=tmp_path / CHECKPOINTS[0])
    kept = {path.relative_to(tmp_path).parts[0] for path in tmp_path.rglob("*.safetensors")}
    assert kept == {"checkpoint.safetensors", "checkpoint.denoiser.safetensors", "checkpoints"}
    assert kept <= {*CHECKPOINTS}


def test_both_rounds_have_parts_of_their_own() -> None:
    assert parts(CONFIG) == {"denoiser": 1, "first fit": 12, "denoiser again": 1, "fit": 12}


def test_settings_that_would_leave_the_renders_out_are_refused() -> None:
    with pytest.raises(ValueError, match="denoise.adapt must not be none"):
        DenoisedTwiceConfig(denoise=DenoiseConfig(adapt=None))
    with pytest.raises(ValueError, match=r"render_weight must be > 0, got 0"):
        DenoisedTwiceConfig(render_weight=0)
    assert METHODS["denoise-gs-twice"].family == METHODS["denoise-gs"].family
