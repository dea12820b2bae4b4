"""Raw3DGS: its losses against slow float64 versions, and the noise that it extracts against the noise that there is."""

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
from scipy.stats import norm
from torch import Tensor

from novags.methods import METHODS, chosen
from novags.methods.denoised.config import AdaptConfig
from novags.methods.denoised.estimate import estimate
from novags.methods.denoised.measured import MeasuredPictures, measured
from novags.methods.denoised.network import Network, NetworkConfig
from novags.methods.denoised.packing import mask_of
from novags.methods.denoised.weights import load_weights
from novags.methods.enhanced.config import ORIGINAL_FIT
from novags.methods.enhancers.applying import enhanced_light
from novags.methods.inputs import LacksInput
from novags.methods.noise import Variance, camera_noise
from novags.methods.problem import Problem, RawPictures
from novags.methods.rivals.raw3dgs import ExtractorLoss, decorrelation, likelihood, pretrained, train
from novags.methods.rivals.rows.raw3dgs import METHOD, Raw3dgsConfig, parts
from novags.splats import CameraRefinement, FitConfig, Gaussians, LearningRates, Views, rasterize
from sensor_model import PRESETS, Exposure, NoiseCurve, expose, linear_to_srgb
from sensor_model.isp import white_balance
from sensor_model.mosaicking import channel_index, mosaic
from tests.novags.methods.rivals.le3d.photographed import WallPoints
from tests.novags.methods.rivals.short import SHORT

module = importlib.import_module("novags.methods.rivals.raw3dgs")
SIZE, VIEWS = 96, 4
EXPOSURE = Exposure(time=1 / 30)
# Rates that bring the Gaussians near their end in sixty steps
QUICK = FitConfig(iterations=60, sh_degree=0, mcmc=None, opacity_reg=0, scale_reg=0, rates=LearningRates(sh_dc=1e-2))
CONFIG = Raw3dgsConfig(fit=QUICK, init_scale=0.7, pretrain=AdaptConfig(steps=5, batch=1, crop=48))
SMALL = Raw3dgsConfig(
    fit=dataclasses.replace(SHORT, iterations=30), init_scale=0.7, pretrain=AdaptConfig(steps=4, batch=1, crop=16)
)


def slow_covariance_distance(planes: np.ndarray, patch: int) -> float:
    """(1 / d) |I - C|^2, datum by datum."""
    _, height, width = planes.shape
    side, patches = min(patch, height, width), []
    for top in range(0, height - side + 1, 2):
        for left in range(0, width - side + 1, 2):
            patches.append([float(v) for v in planes[:, top : top + side, left : left + side].reshape(-1)])
    d, total = len(patches[0]), 0.0
    for i in range(d):
        for j in range(d):
            covariance = math.fsum(p[i] * p[j] for p in patches) / len(patches)
            total += ((i == j) - covariance) ** 2
    return total / d


def slow_loss(
    render: np.ndarray, held: np.ndarray, clean: np.ndarray, electrons: np.ndarray, mask: np.ndarray, facts: Any
) -> float:
    """The loss by its definition. `held`: the render where it counts as constant."""
    error = density = 0.0
    whitened, count = np.zeros(mask.shape), int(mask.sum())
    for c, y, x in np.argwhere(mask > 0):
        r, fixed, scale = render[y, x, c], held[y, x, c], facts.scale[c]
        noise = electrons[c, y, x] - clean[c, y, x]
        error += ((min(r, facts.white[c]) - clean[c, y, x] * scale) / (fixed + facts.epsilon)) ** 2 / count
        deviation = math.sqrt(facts.offset + facts.slope * max(fixed, 0.0) / scale)  # of a datum, electrons
        density -= (norm.logpdf(noise, scale=deviation) - norm.logpdf(0.0, scale=deviation)) / count
        whitened[c, y, x] = noise / deviation
    planes = whitened if mask.all() else whitened.sum(0, keepdims=True)
    return error + facts.likely * density + facts.decorrelated * slow_covariance_distance(planes, facts.patch)


def case(cfa: Any) -> SimpleNamespace:
    """A loss in float64 with a small network that says something, a render, the data of a view, and its constants."""
    g = torch.Generator().manual_seed(4)
    height, width, unit = 13, 10, 0.3
    mask = mask_of((height, width), cfa).double()
    electrons = 9 * torch.rand(1, 3, height, width, generator=g, dtype=torch.float64) * mask
    zero, never = (0.0,) * 3, (math.inf,) * 3
    per_electron = torch.tensor([0.02, 0.01, 0.03], dtype=torch.float64)
    curve = NoiseCurve(
        black=zero, white=(9.0,) * 3, offset=tuple(1.7 * float(u) ** 2 for u in per_electron),
        slope=tuple(map(float, per_electron)), quadratic=zero, switch=never, step=zero,
    )  # fmt: skip
    torch.manual_seed(2)
    network = Network(NetworkConfig(widths=(4, 6), blocks=(1, 1))).double()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.normal_(0, 0.1)
    config = Raw3dgsConfig(noise_weight=1.5, covariance_weight=0.7, epsilon=0.02, patch=3)
    pictures = MeasuredPictures(electrons, mask, Variance(curve), per_electron, None)
    white = torch.tensor([0.15, 0.1, 0.2], dtype=torch.float64)
    loss = ExtractorLoss(network, pictures, config, unit=unit, white=white)
    facts = SimpleNamespace(
        scale=per_electron.numpy() / unit, white=white.numpy() / unit, epsilon=0.02 / unit, offset=1.7, slope=1.0,
        likely=1.5, decorrelated=0.7, patch=3,
    )  # fmt: skip
    render = 0.7 * torch.rand(height, width, 3, generator=g, dtype=torch.float64) - 0.02
    assert bool((render > torch.from_numpy(facts.white)).any())
    return SimpleNamespace(loss=loss, render=render, electrons=electrons[0], mask=mask[0], facts=facts)


def clean_of(given: SimpleNamespace) -> np.ndarray:
    """The data without the noise that the network finds."""
    p = given.loss.pictures
    with torch.no_grad():
        return estimate(given.loss.network, given.electrons[None], p.mask, p.read_variance)[0].numpy()


def slowly(given: SimpleNamespace, render: Tensor, clean: np.ndarray) -> float:
    held = given.render.numpy()
    return slow_loss(render.numpy(), held, clean, given.electrons.numpy(), given.mask.numpy(), given.facts)


@pytest.mark.parametrize("cfa", [None, "RGGB"])
def test_the_loss_is_that_of_its_definition(cfa: Any) -> None:
    given = case(cfa)
    step: Any = SimpleNamespace(render=given.render)
    found = float(given.loss(step, given.electrons).detach())
    assert found == pytest.approx(slowly(given, given.render, clean_of(given)), rel=1e-10)


@pytest.mark.parametrize("cfa", [None, "GBRG"])
def test_its_gradient_reaches_the_render_through_the_distance_alone_and_the_network_through_all_terms(cfa: Any) -> None:
    """Against differences of the slow version, in which the weight and the variance keep the render as it was."""
    given = case(cfa)
    render = given.render.clone().requires_grad_()
    step: Any = SimpleNamespace(render=render)
    given.loss(step, given.electrons).backward()
    g, h = torch.Generator().manual_seed(6), 1e-6
    assert render.grad is not None
    clean = clean_of(given)
    for _ in range(2):
        way = torch.randn(render.shape, generator=g, dtype=torch.float64)
        ahead, behind = (slowly(given, given.render + sign * h * way, clean) for sign in (1, -1))
        assert float((render.grad * way).sum()) == pytest.approx((ahead - behind) / (2 * h), rel=1e-5)
    ways = [torch.randn(p.shape, generator=g, dtype=torch.float64) for p in given.loss.trained_along()]
    slope = sum(float((p.grad * way).sum()) for p, way in zip(given.loss.trained_along(), ways, strict=True))
    values = []
    for move in (h, -2 * h):
        with torch.no_grad():
            for parameter, way in zip(given.loss.network.parameters(), ways, strict=True):
                parameter.add_(way, alpha=move)
        values.append(slowly(given, given.render, clean_of(given)))
    assert slope == pytest.approx((values[0] - values[1]) / (2 * h), rel=1e-5)


@pytest.mark.parametrize(("shape", "patch"), [((1, 11, 8), 4), ((3, 9, 10), 2), ((1, 3, 7), 4), ((3, 6, 6), 1)])
def test_the_distance_from_white_noise_is_that_of_its_definition(shape: tuple[int, ...], patch: int) -> None:
    planes = torch.randn(shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    found = float(decorrelation(planes, patch))
    assert found == pytest.approx(slow_covariance_distance(planes.numpy(), patch), rel=1e-12)


def test_patches_of_a_mosaic_begin_under_the_same_filter() -> None:
    """Noise that is louder in green: a covariance by the place in the mosaic sees a variance for each filter."""
    index = torch.from_numpy(channel_index((64, 64), "RGGB"))
    noise = torch.randn(1, 64, 64, generator=torch.Generator().manual_seed(3), dtype=torch.float64)
    loud = torch.where(index == 1, 1.3, 1.0).double()
    found = float(decorrelation(noise * loud, 2)) - float(decorrelation(noise, 2))
    # two of four data of a patch have a variance of 1.69; the standard error of a variance over 961 patches is 0.045
    assert found == pytest.approx(2 * 0.69**2 / 4, abs=5 * 0.69 * 0.045)


@pytest.mark.parametrize(("likely", "white"), [(5.0, 20.0), (3.0, 20.0), (5.0, 2.0), (5.0, 0.0)])
def test_both_terms_together_are_least_at_the_variance_that_the_docstring_says(likely: float, white: float) -> None:
    """At 1 - a / (4 b); without the covariance noise vanishes, and with a tenth of it most does, as published figures
    of both (22.41 and 22.52 dB, beside 23.53) let expect."""
    noise = torch.randn(3, 512, 512, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    noise /= noise.square().mean().sqrt()
    variances = np.linspace(0, 1.2, 241)
    # |I - v C|^2 / d is a square in v: three values of it are all
    zero, one, two = (float(decorrelation(math.sqrt(v) * noise, 4)) for v in (0, 1, 2))
    square = (two - 2 * one + zero) / 2
    covariances = zero + (one - zero - square) * variances + square * variances**2
    likelihoods = float(likelihood(noise, torch.ones_like(noise))) * variances
    best = variances[np.argmin(likely * likelihoods + white * covariances)]
    assert best == pytest.approx(max(0.0, 1 - likely / (4 * white)) if white else 0.0, abs=0.01)


@pytest.mark.parametrize("cfa", [None, "RGGB"])
def test_black_renders_and_no_read_noise_give_finite_losses_and_slopes(cfa: Any) -> None:
    given = case(cfa)
    curve = dataclasses.replace(given.loss.pictures.noise.curve, offset=(0.0,) * 3)
    old = given.loss.pictures
    pictures = MeasuredPictures(old.electrons.float(), old.mask.float(), Variance(curve), old.unit.float(), None)
    loss = ExtractorLoss(load_weights(), pictures, Raw3dgsConfig(), unit=0.3, white=torch.ones(3))
    for electrons in (torch.zeros_like(pictures.electrons[0]), 1e5 * pictures.electrons[0]):
        render = torch.zeros(13, 10, 3, requires_grad=True)
        step: Any = SimpleNamespace(render=render)
        value = loss(step, electrons)
        slopes = torch.autograd.grad(value, [render, *loss.trained_along()])
        assert all(bool(torch.isfinite(t).all()) for t in (value, *slopes))


def exposed(cfa: Any, green: float = 20.0) -> tuple[Problem, Tensor]:
    """A coloured wall, photographed by a known camera, and its noise-free light in electrons [C, 3, H, W].

    The first points are those of the wall, in their colours, so that a short fit ends near it.
    """
    g = torch.Generator().manual_seed(7)
    count = 500
    points = torch.cat([2.6 * torch.rand(count, 2, generator=g) - 1.3, 0.1 * torch.rand(count, 1, generator=g)], 1)
    colors = torch.rand(count, 3, generator=g) * 0.8 + 0.1
    wall = Gaussians.from_points(points, colors, sh_degree=0, init_scale=0.9)
    viewmats = torch.eye(4).repeat(VIEWS, 1, 1)
    viewmats[:, 0, 3], viewmats[:, 2, 3] = torch.linspace(-0.2, 0.2, VIEWS), 3.0
    K = torch.tensor([[150.0, 0, SIZE / 2], [0, 150.0, SIZE / 2], [0, 0, 1]])
    views = Views(viewmats, K.repeat(VIEWS, 1, 1), SIZE, SIZE)
    lit, _, _ = rasterize(
        wall.means, wall.quats, wall.scales, torch.full((count,), 0.99), wall.sh, views.viewmats, views.Ks, SIZE, SIZE,
        sh_degree=0,
    )  # fmt: skip
    sensor = dataclasses.replace(PRESETS["a7s2-iso6400-3chip"], cfa=cfa, dsnu=0.0, prnu=0.0)
    factor = green / float(lit[..., 1].mean())
    mean = factor * lit.double().numpy() / white_balance(sensor)  # electrons; balanced, they are the wall's colours
    seen = mean if cfa is None else np.stack([mosaic(view, cfa) for view in mean])
    frames = [expose(view / sensor.eta, sensor, EXPOSURE, seed=4, view=i) for i, view in enumerate(seen)]
    noise = camera_noise(sensor, EXPOSURE, demosaic="menon", color_matrix=None)
    red, green_, blue = white_balance(sensor).tolist()
    raw = RawPictures(
        dn=torch.from_numpy(np.stack([f.dn for f in frames]).astype(np.float32)), cfa=cfa, black=sensor.black_level,
        white=sensor.white_dn, balance=(red, green_, blue),
    )  # fmt: skip
    light = factor * sensor.gain / (sensor.white_dn - sensor.black_level)
    codes = torch.from_numpy(linear_to_srgb(light * colors.double().numpy())).float()
    problem = Problem(
        views=views, start=WallPoints(points, codes, 1.0), seed=3, srgb8=(light * lit).clamp(0, 1), raw=raw, noise=noise
    )
    return problem, torch.from_numpy(mean).movedim(-1, 1).float()


def noise_of(loss: ExtractorLoss, true: Tensor) -> tuple[Tensor, Tensor]:
    """The noise that the network of a loss extracts, and the noise that there is, in units of its deviation [n]."""
    p = loss.pictures
    with torch.no_grad():
        clean = torch.cat([estimate(loss.network, x[None], p.mask, p.read_variance) for x in p.electrons])
    there, deviation = p.mask.expand_as(true) > 0, p.variance(true).sqrt()
    return ((p.electrons - clean) / deviation)[there], ((p.electrons - true) / deviation)[there]


@pytest.fixture
def losses(monkeypatch: pytest.MonkeyPatch) -> list[ExtractorLoss]:
    """Filled with the loss of each training."""
    made, create = list[ExtractorLoss](), ExtractorLoss.__init__

    def noted(self: ExtractorLoss, *parts: Any, **more: Any) -> None:
        create(self, *parts, **more)
        made.append(self)

    monkeypatch.setattr(ExtractorLoss, "__init__", noted)
    return made


@pytest.mark.parametrize("cfa", [None, "RGGB"])
def test_the_extracted_noise_has_the_variance_of_the_camera_and_data_without_it_are_nearer_to_the_light(
    cfa: Any, losses: list[ExtractorLoss]
) -> None:
    """By the losses its variance is 1 - 3 / 80 of the camera's; a third of the noise left would be a bad extractor."""
    problem, true = exposed(cfa)
    result = train(problem, CONFIG)
    found, there = noise_of(losses[0], true)
    assert float(there.square().mean()) == pytest.approx(1, abs=5 * math.sqrt(2 / len(there)))
    assert float(found.square().mean()) == pytest.approx(1 - 3 / 80, abs=0.06)
    assert result.found["noise_variance"] == pytest.approx(float(found.square().mean()), abs=0.03)  # by the render
    assert float((there - found).square().mean()) < 0.25
    assert float(torch.corrcoef(torch.stack([found, there]))[0, 1]) > 0.9
    assert result.space == "linear"
    light = result.render(problem.views)[0] / losses[0].pictures.unit
    error = (light.movedim(-1, 1) - true) / losses[0].pictures.variance(true).sqrt()
    assert float(error[losses[0].pictures.mask.expand_as(true) > 0].square().mean()) < 0.15


def test_without_the_covariance_the_extracted_noise_vanishes(losses: list[ExtractorLoss]) -> None:
    """Rationale: the likelihood of noise is largest without any. At ten times the rate, to keep the test short."""
    problem, true = exposed(None)
    settings = chosen("raw3dgs-no-cov").settings
    assert dict(settings) == {"covariance_weight": 0.0}
    quick = dataclasses.replace(CONFIG, extractor_rate=1e-3, noise_weight=5.0)
    shares = []
    for more in ({}, settings):
        train(problem, dataclasses.replace(quick, **more))
        shares.append(float(noise_of(losses[-1], true)[0].square().mean()))
    assert shares[0] == pytest.approx(1 - 5 / 80, abs=0.1)
    assert shares[1] < 0.4


def test_targets_are_the_data_without_the_noise_seen_by_the_refined_cameras_and_enhanced(
    dark: Any, losses: list[ExtractorLoss], monkeypatch: pytest.MonkeyPatch
) -> None:
    (inputs, light), seen, left_of = dark(), list[Tensor](), module._left
    monkeypatch.setattr(module, "_left", lambda *given: seen.append(given[2].viewmats) or left_of(*given))
    fit = dataclasses.replace(SMALL.fit, refine_cameras=CameraRefinement(start=2))
    result = train(inputs, dataclasses.replace(SMALL, fit=fit))
    assert torch.equal(seen[0], result.viewmats)
    assert not torch.equal(seen[0], inputs.views.viewmats)
    clean = torch.cat([losses[0].split(x, light[0])[0][None] for x in losses[0].pictures.electrons]).detach()
    left = losses[0].pictures.linear(clean)
    assert result.targets is not None
    assert result.enhanced is not None
    shown = torch.stack(list(enhanced_light(inputs, left, SMALL.enhance, SMALL.pictures)))
    torch.testing.assert_close(result.targets, shown)
    assert float((left - light).square().mean()) < 0.5 * float((inputs.linear16 - light).square().mean())


def test_an_interruption_in_the_pretraining_changes_nothing(dark: Any, tmp_path: Path) -> None:
    """One in the fit, whose checkpoint has the network too, is tested for every rival."""
    (inputs, _), seen = dark(), list[Any]()
    whole = train(inputs, SMALL, progress=lambda *entry: seen.append(entry))
    assert parts(SMALL) == {"pretraining": 4, "fit": 30}
    assert [done for done, _, entry in seen if "denoiser" in entry] == [1, 2, 3, 4]
    assert [done for done, _, entry in seen if "loss" in entry] == [14, 24, 34]
    assert {total for _, total, _ in seen} == {34}

    def stop(done: int, *_: Any) -> None:
        if done == 3:
            raise KeyboardInterrupt

    path = tmp_path / "fit.safetensors"
    with pytest.raises(KeyboardInterrupt):
        train(inputs, SMALL, progress=stop, checkpoint=path)
    again = train(inputs, SMALL, checkpoint=path)
    assert torch.equal(again.render(inputs.views)[0], whole.render(inputs.views)[0])
    assert again.found == whole.found


def test_the_network_learns_at_the_published_rates(dark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """1e-4, and 1e-5 after 25,000 of 30,000 steps; pretrained it is where the fit begins."""
    (inputs, _), rates, begun = dark(), dict[int, float](), list[Any]()

    def fit(*_: Any, companion: Any, before_step: Callable[[int], None], **more: Any) -> None:
        for iteration in (0, 24_999, 25_000, 29_999):
            before_step(iteration)
            companion.step(iteration, 30_000)
            rates[iteration] = companion.optimizer.param_groups[0]["lr"]
        begun.append(more["photometric"].network)
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "fit", fit)
    with pytest.raises(KeyboardInterrupt):
        train(inputs, dataclasses.replace(SMALL, fit=dataclasses.replace(ORIGINAL_FIT, iterations=30_000)))
    assert rates == pytest.approx({0: 1e-4, 24_999: 1e-4, 25_000: 1e-5, 29_999: 1e-5})
    shipped = load_weights().state_dict()
    assert not torch.equal(shipped["leave.weight"], begun[0].state_dict()["leave.weight"])
    with pytest.raises(KeyboardInterrupt):
        train(inputs, dataclasses.replace(SMALL, pretrain=None))
    assert all(torch.equal(shipped[name], value) for name, value in begun[1].state_dict().items())


def test_the_seed_chooses_what_the_pretraining_draws(dark: Any) -> None:
    (inputs, _), found = dark(), list[Tensor]()
    for each in (dataclasses.replace(inputs, seed=seed) for seed in (0, 0, 1)):
        network = pretrained(each, SMALL, measured(each), None, None)
        found.append(torch.cat([value.flatten() for value in network.parameters()]))
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])


def test_few_views_have_the_smaller_published_weight_of_the_likelihood() -> None:
    config = Raw3dgsConfig()
    assert [config.noise_weight_of(views) for views in (4, 20, 21, 100)] == [3, 3, 5, 5]
    assert dataclasses.replace(config, noise_weight=0.5).noise_weight_of(4) == 0.5


def test_it_sees_no_truth_and_estimates_noise_that_is_not_known(dark: Any) -> None:
    assert (METHOD.sees_clean, METHOD.sees_surface) == (False, False)
    assert METHODS["raw3dgs"] is METHOD
    inputs, light = dark()
    others = dataclasses.replace(inputs, noise=None), dataclasses.replace(inputs, clean=0 * light)
    known, unknown, told = (train(each, SMALL) for each in (inputs, *others))
    assert [each.found["noise"] for each in (known, unknown)] == ["camera", "pictures"]
    assert torch.equal(known.render(inputs.views)[0], told.render(inputs.views)[0])


def test_what_it_cannot_use_is_said(dark: Any) -> None:
    inputs, _ = dark()
    for change, said in (
        ({"linear16": None}, "raw frames or 16-bit linear pictures"),
        ({"pixels_share": ("resampling",)}, "data whose noise is independent"),
        ({"exposures": (1.0, 1.0, 2.0, 1.0, 1.0)}, "a noise extractor knows one noise for the data of all views"),
    ):
        with pytest.raises(LacksInput, match=said):
            train(dataclasses.replace(inputs, **change), SMALL)
    for settings, said in (
        ({"epsilon": 0.0}, r"epsilon must be > 0 .* got 0"),
        ({"noise_weight": -1.0}, "must be >= 0, got -1.0, 20.0 and 0.0001"),
        ({"covariance_weight": -2.0}, "must be >= 0, got None, -2.0 and 0.0001"),
        ({"extractor_rate": -3.0}, "must be >= 0, got None, 20.0 and -3.0"),
        ({"patch": 0}, "patch must be >= 1 px, got 0"),
    ):
        with pytest.raises(ValueError, match=said):
            Raw3dgsConfig(**settings)
