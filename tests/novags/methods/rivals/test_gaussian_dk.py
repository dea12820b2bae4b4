"""Gaussian-DK: response, exposure and loss by hand; and a scene seen through a response of its own."""

import dataclasses
import importlib
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.problem import Problem
from novags.methods.rivals.gaussian_dk import (
    FAINT,
    Response,
    ResponseLoss,
    lit_exposure,
    logarithm,
    radiance_of,
    table_of,
    train,
)
from novags.methods.rivals.rows.gaussian_dk import GaussianDkConfig
from novags.methods.tone import ResponseTable
from novags.splats import FitConfig, LearningRates
from novags.splats.training.losses import ssim
from tests.novags.methods.rivals.short import SHORT

CONFIG = GaussianDkConfig(fit=SHORT, init_scale=0.7)


def taught() -> Response:
    """A response with weights that count."""
    torch.manual_seed(3)
    response = Response()
    with torch.no_grad():
        for parameter in response.parameters():
            parameter.normal_(0, 0.3)
    return response


def slowly(response: Response, x: float) -> float:
    w = {name: p.detach().double().numpy() for name, p in response.named_parameters()}
    hidden = [math.tanh(a[0] * x + b) for a, b in zip(w["inner.weight"], w["inner.bias"], strict=True)]
    bend = sum(a * h for a, h in zip(w["outer.weight"][0], hidden, strict=True)) + w["outer.bias"][0]
    return 1 / (1 + math.exp(-(x + bend)))


def test_a_response_is_a_logistic_curve_that_a_network_bends() -> None:
    logs = torch.linspace(-8, 4, 13)
    np.testing.assert_allclose(Response()(logs).detach(), 1 / (1 + np.exp(-logs.numpy())), rtol=1e-5)
    response = taught()
    found = response(logs.reshape(13, 1)).detach()
    assert found.shape == (13, 1)
    np.testing.assert_allclose(found[:, 0], [slowly(response, float(x)) for x in logs], rtol=1e-4)


def test_the_loss_compares_the_picture_of_the_render_and_anchors_the_response() -> None:
    g, response = torch.Generator().manual_seed(1), taught()
    render, target = torch.rand(9, 8, 3, generator=g) - 0.1, torch.rand(9, 8, 3, generator=g)
    step: Any = SimpleNamespace(render=render)
    found = float(ResponseLoss(response, 0.3)(step, target).detach())
    shown = torch.tensor(
        [slowly(response, math.log(max(float(v), 0) + FAINT)) for v in render.reshape(-1)], dtype=torch.float32
    ).reshape(render.shape)
    want = 0.7 * float((shown - target).abs().mean()) + 0.3 * (1 - float(ssim(shown, target)))
    assert found == pytest.approx(want + 0.5 * abs(slowly(response, 0.0) - 0.5), rel=1e-4)


def test_first_radiance_is_what_shows_the_first_codes() -> None:
    codes = torch.tensor([0.001, 0.05, 0.5, 0.9])
    shown = Response()(logarithm(radiance_of(codes))).detach()
    torch.testing.assert_close(shown, codes, rtol=1e-4, atol=1e-6)
    assert float(radiance_of(torch.tensor(0.0))) == 0
    assert float(radiance_of(torch.tensor(1.0))) == pytest.approx(999, rel=1e-3)


@pytest.mark.parametrize("target", [0.3, 0.5])
def test_the_lit_exposure_brings_the_mean_to_its_target(target: float) -> None:
    radiance = 0.05 * torch.rand(3, 6, 6, 3, generator=torch.Generator().manual_seed(2))
    found = lit_exposure(Response(), radiance, target)
    mean = np.mean([1 / (1 + 1 / ((float(v) + FAINT) * found)) for v in radiance.reshape(-1)])
    assert mean == pytest.approx(target, abs=1e-4)
    assert found > 1


def test_the_lit_exposure_looks_at_levels_and_not_at_every_value(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: the network takes 250 bytes a value, and 112 views of 800 x 800 took 55 GB after the whole fit."""
    seen, forward = [], Response.forward
    monkeypatch.setattr(Response, "forward", lambda self, x: seen.append(x.numel()) or forward(self, x))
    radiance = 0.05 * torch.rand(2, 300, 300, 3, generator=torch.Generator().manual_seed(2))
    found = lit_exposure(Response(), radiance, 0.5)
    assert max(seen) < radiance.numel() / 5
    shown = radiance.double() + FAINT
    assert float((1 / (1 + 1 / (shown * found))).mean()) == pytest.approx(0.5, abs=1e-5)


def test_the_table_shows_what_the_response_shows_under_an_exposure() -> None:
    response = taught()
    table = table_of(response, 12.0)
    radiance = torch.cat([torch.tensor([0.0, -1.0, 1e9]), torch.logspace(-5, 4, 40)])
    found = table.codes(radiance)
    for value, code in zip(radiance.tolist(), found.tolist(), strict=True):
        logs = min(math.log(max(value, 0.0) + FAINT), table.high)
        assert code == pytest.approx(slowly(response, logs + math.log(12)), abs=2e-4)


def test_between_the_entries_of_a_table_it_is_straight_and_beyond_them_flat() -> None:
    table = ResponseTable(faint=1e-3, low=-2.0, high=2.0, values=(0.1, 0.2, 0.7))
    logs = torch.tensor([-3.0, -2.0, -1.5, -0.5, 0.5, 2.0, 5.0])
    want = torch.tensor([0.1, 0.1, 0.125, 0.175, 0.325, 0.7, 0.7])
    torch.testing.assert_close(table.codes(logs.exp() - 1e-3), want, rtol=0, atol=1e-5)
    for wrong in ({"faint": 0.0}, {"low": 2.0}, {"values": (0.1,)}):
        with pytest.raises(ValueError, match="a response needs faint > 0, low < high and two values at least"):
            dataclasses.replace(table, **wrong)  # type: ignore[arg-type]


def test_radiance_and_response_together_make_the_dark_pictures_and_a_lit_one(
    problem: Callable[..., Problem], tmp_path: Path
) -> None:
    inputs = problem(sigma=0.0)
    rates = LearningRates(sh_dc=2e-2)
    quick = dataclasses.replace(CONFIG, fit=dataclasses.replace(CONFIG.fit, iterations=400, rates=rates), target=0.4)
    result = train(inputs, quick)
    assert result.space == "lit"
    inside = (slice(None), slice(4, -4), slice(4, -4))
    lit = result.render(inputs.views)[0]
    assert float(lit.mean()) == pytest.approx(0.4, abs=0.01)
    scene: Any = result.scene
    # the same Gaussians under the exposure of the pictures: the table, moved by the logarithm of what was added
    shift = math.log(result.found["exposure"])
    table = dataclasses.replace(scene.response, low=scene.response.low + shift, high=scene.response.high + shift)
    seen = dataclasses.replace(scene, response=table).render(inputs.views)[0]
    dark = inputs.srgb8
    assert float((seen - dark)[inside].abs().mean()) < 0.1 * float(dark[inside].mean())
    assert result.found["exposure"] > 5
    assert scene.facts()["response"]["values"] == scene.response.values


def test_the_response_learns_what_gaussians_that_stand_still_cannot(problem: Callable[..., Problem]) -> None:
    """Their colours show a third of the pictures' code; only the response can make good for it."""
    inputs = problem(sigma=0.0)
    inputs = dataclasses.replace(inputs, srgb8=torch.full_like(inputs.srgb8, 3 * float(inputs.start.colors.mean())))
    still = LearningRates(means=0, means_final=0, quats=0, log_scales=0, logit_opacities=0, sh_dc=0, sh_rest=0)
    fit = FitConfig(iterations=300, sh_degree=0, dssim_weight=0, mcmc=None, rates=still)
    result = train(inputs, dataclasses.replace(CONFIG, fit=fit, response_rate=1e-2))
    scene: Any = result.scene
    shift = math.log(result.found["exposure"])
    table = dataclasses.replace(scene.response, low=scene.response.low + shift, high=scene.response.high + shift)
    seen = dataclasses.replace(scene, response=table).render(inputs.views)[0][:, 6:-6, 6:-6]
    assert float(seen.median() / inputs.srgb8.mean()) == pytest.approx(1, abs=0.1)


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(ValueError, match=r"target must lie in \(0, 1\), got 1"):
        GaussianDkConfig(target=1)
    with pytest.raises(ValueError, match="response_rate must be >= 0, got -1"):
        GaussianDkConfig(response_rate=-1)


def test_the_lit_exposure_is_looked_for_where_the_cameras_were_refined_to(
    problem: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    module, seen = importlib.import_module("novags.methods.rivals.gaussian_dk"), list[torch.Tensor]()
    given, fitted, render = problem(), module.fit, module.GaussianScene.render
    shift = torch.zeros(4, 4)
    shift[0, 3] = 0.01

    def refined(*parts: Any, **more: Any) -> Any:
        result = fitted(*parts, **more)
        return dataclasses.replace(result, viewmats=result.viewmats + shift)

    def noted(scene: Any, views: Any) -> Any:
        seen.append(views.viewmats)
        return render(scene, views)

    monkeypatch.setattr(module, "fit", refined)
    monkeypatch.setattr(module.GaussianScene, "render", noted)
    module.train(given, GaussianDkConfig(fit=FitConfig(iterations=1)))
    torch.testing.assert_close(torch.cat(seen), given.views.viewmats + shift)


def test_the_response_begins_as_the_seed_of_the_problem_says(
    problem: Callable[..., Problem], monkeypatch: pytest.MonkeyPatch
) -> None:
    module, seen = importlib.import_module("novags.methods.rivals.gaussian_dk"), list[torch.Tensor]()

    def begun(*_: Any, companion: Any, **__: Any) -> Any:
        seen.append(torch.cat([parameter.detach().flatten() for parameter in companion.network.parameters()]))
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "fit", begun)
    given = problem()
    for seed in (3, 3, 4):
        with pytest.raises(KeyboardInterrupt):
            module.train(dataclasses.replace(given, seed=seed), GaussianDkConfig(fit=FitConfig(iterations=1)))
    assert torch.equal(seen[0], seen[1])
    assert not torch.equal(seen[0], seen[2])
