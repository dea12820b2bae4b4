"""LE3D as a whole: both kinds of camera, its start, its rates, stopped runs."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods import METHODS
from novags.methods.inputs import LacksInput
from novags.methods.light import brightness, problem_light
from novags.methods.noise_estimate import noise_of
from novags.methods.problem import Problem
from novags.methods.rivals.le3d import trainer
from novags.methods.rivals.le3d.colours import ColourNetwork, ColourScene, seen_from, with_colours
from novags.methods.rivals.le3d.regularisers import BINS, EPSILON, FARTHEST, NEAREST
from novags.methods.rivals.le3d.trainer import Le3dLoss, first_gaussians, train
from novags.methods.rivals.rows.le3d import Le3dConfig
from novags.methods.saved import saved_gaussians
from novags.settings import changed
from novags.splats import CameraRefinement, McmcConfig
from novags.splats.training.companion import Companion
from tests.novags.methods.rivals.le3d.photographed import CAMERAS, POINTS, Camera, photographed

CONFIG = changed(
    Le3dConfig(init_scale=0.7),
    {"fit.iterations": 60, "fit.checkpoint_every": 25, "fit.mcmc": McmcConfig(refine_start=10, refine_every=20),
     "seen": 32}, what="x",
)  # fmt: skip


@pytest.mark.parametrize("camera", CAMERAS)
def test_it_ends_in_the_light_of_the_scene_with_less_noise_than_its_data(camera: Camera, tmp_path: Path) -> None:
    inputs, light = photographed(camera)
    result = train(inputs, changed(CONFIG, {"fit.iterations": 200}, what="x"))
    found = result.render(inputs.views)[0]
    inside = (slice(None), slice(6, -6), slice(6, -6))
    assert result.space == "linear"
    assert float(found[inside].mean() / light[inside].mean()) == pytest.approx(1, abs=0.1)
    assert inputs.linear16 is not None
    data = inputs.linear16.clamp_min(0)
    assert float((found - light)[inside].square().mean()) < 0.3 * float((data - light)[inside].square().mean())
    # the files and the record show the same again
    result.save(tmp_path)
    base = saved_gaussians(tmp_path / "point_cloud.ply", result.scene.facts())
    again = with_colours(base, tmp_path)
    assert isinstance(again, ColourScene)
    torch.testing.assert_close(again.render(inputs.views)[0], found, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("camera", CAMERAS)
def test_a_stopped_run_ends_as_if_it_had_not_been(camera: Camera, tmp_path: Path) -> None:
    inputs, path = photographed(camera)[0], tmp_path / "fit.safetensors"

    def stop(done: int, _: int, __: Any) -> None:
        if done == 40:
            raise KeyboardInterrupt

    whole = train(inputs, CONFIG)
    with pytest.raises(KeyboardInterrupt):
        train(inputs, CONFIG, progress=stop, checkpoint=path)
    resumed = train(inputs, CONFIG, checkpoint=path)
    assert torch.equal(whole.render(inputs.views)[0], resumed.render(inputs.views)[0])
    assert whole.found == resumed.found


def test_refined_cameras_are_given_back() -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    refining = changed(CONFIG, {"fit.iterations": 30, "fit.refine_cameras": CameraRefinement(start=5)}, what="x")
    result = train(inputs, refining)
    found = result.viewmats
    assert found is not None
    assert not torch.equal(found, inputs.views.viewmats)
    assert torch.allclose(found, inputs.views.viewmats, atol=0.2)
    # plain viewers show the colours seen from the middle of these cameras
    scene = result.scene
    assert isinstance(scene, ColourScene)
    again = [ColourScene.of(dataclasses.replace(scene.base, gaussians=dataclasses.replace(
        scene.base.gaussians, sh=scene.bias[:, None], features=scene.features)), scene.network,
        dataclasses.replace(inputs.views, viewmats=viewmats).centers.mean(0)).base.gaussians.sh
        for viewmats in (found, inputs.views.viewmats)]  # fmt: skip
    assert torch.equal(scene.base.gaussians.sh, again[0])
    assert not torch.equal(again[0], again[1])


def test_the_seed_chooses_the_first_network() -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    short = changed(CONFIG, {"fit.iterations": 1, "network_rate": 1e-9}, what="x")
    first = []
    for seed in (0, 0, 2):
        scene = train(dataclasses.replace(inputs, seed=seed), short).scene
        assert isinstance(scene, ColourScene)
        first.append(torch.cat([value.flatten() for value in scene.network.state_dict().values()]))
    assert torch.equal(first[0], first[1])
    torch.manual_seed(0)
    wanted = torch.cat([value.flatten() for value in ColourNetwork().state_dict().values()])
    torch.testing.assert_close(first[0], wanted, rtol=0, atol=1e-6)
    assert float((first[0] - first[2]).abs().max()) > 1e-2


def test_the_seed_chooses_the_first_features() -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    first, again, other = (start_of(dataclasses.replace(inputs, seed=seed), CONFIG)[0].features for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def start_of(inputs: Problem, config: Le3dConfig) -> tuple[Any, torch.Tensor]:
    """First Gaussians and their colours from the middle of the cameras, as light."""
    data = problem_light(inputs, noise_of(inputs), ())
    network, unit = ColourNetwork().requires_grad_(False), brightness(data.light)
    found = first_gaussians(inputs, data, unit, config, network)
    assert found.features is not None
    return found, unit * seen_from(
        inputs.views.centers.mean(0), found.means, found.features, found.sh[:, 0], network
    )  # fmt: skip


@pytest.mark.parametrize(("room", "count"), [(None, 0), (POINTS, 0), (POINTS + 200, 200), (10 * POINTS, 5 * POINTS)])
def test_the_cone_fills_the_room_that_first_points_leave(room: int | None, count: int) -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    config = changed(CONFIG, {"fit.cap_max": room}, what="x")
    found, _ = start_of(inputs, config)
    assert len(found) == POINTS + count
    torch.testing.assert_close(found.means[:POINTS], inputs.start.points)
    torch.testing.assert_close(found.opacities, torch.full((len(found),), 0.1))
    if count:
        assert not bool((found.means[POINTS:, 2] < inputs.start.points[:, 2].min() - 3).any())
        again, other = (start_of(dataclasses.replace(inputs, seed=seed), config)[0] for seed in (0, 1))
        assert torch.equal(found.means, again.means)
        assert not torch.equal(found.means[POINTS:], other.means[POINTS:])


def test_as_many_gaussians_as_were_asked_for_are_there_from_the_start() -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    asked = dataclasses.replace(inputs, n_gaussians=POINTS + 150)
    found = train(asked, changed(CONFIG, {"fit.iterations": 2}, what="x"))
    assert found.found["scattered"] == 150
    assert found.scene.facts()["gaussians"] == POINTS + 150
    assert train(inputs, changed(CONFIG, {"fit.iterations": 2}, what="x")).found["scattered"] == 0


@pytest.mark.parametrize("camera", CAMERAS)
def test_first_colours_are_means_of_the_data_at_the_projections(camera: Camera) -> None:
    inputs, light = photographed(camera)
    _, colors = start_of(inputs, CONFIG)
    totals, counts = np.zeros((POINTS, 3)), np.zeros(POINTS)
    for view in range(len(inputs.views)):
        viewmat, K = inputs.views.viewmats[view].double().numpy(), inputs.views.Ks[view].double().numpy()
        for i, point in enumerate(inputs.start.points.double().numpy()):
            x, y, z = K @ (viewmat[:3, :3] @ point + viewmat[:3, 3])
            column, row = math.floor(x / z), math.floor(y / z)
            if 0 <= column < 96 and 0 <= row < 96:
                totals[i] += light[view, row, column].numpy()
                counts[i] += 1
    seen = counts == len(inputs.views)
    assert seen.sum() > 200
    want = totals[seen] / counts[seen, None]
    # means of four data whose noise is 0.3 to 0.5 of them, and which lie a pixel apart where they are interpolated
    found = colors.numpy()[seen]
    assert found.mean() == pytest.approx(want.mean(), rel=0.05)
    assert np.corrcoef(found.ravel(), want.ravel())[0, 1] > 0.6


def test_without_weights_only_the_raw_loss_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    short = changed(CONFIG, {"fit.iterations": 3}, what="x")
    names = "opaque_weight", "spread_weight", "near_far_weight"
    losses = [train(inputs, short).losses[-1]["photometric"]]
    losses += [train(inputs, changed(short, {name: 0.0}, what="x")).losses[-1]["photometric"] for name in names]
    assert len(set(losses)) == 4  # each of them is part of the loss
    monkeypatch.setattr(Le3dLoss, "along_rays", lambda self, step: 0.0)
    monkeypatch.setattr(trainer, "opaque", lambda alpha: 0.0)
    plain = train(inputs, short).losses[-1]["photometric"]
    none = train(inputs, changed(short, dict.fromkeys(names, 0.0), what="x")).losses[-1]["photometric"]
    assert plain == none


def test_the_rate_of_the_network_falls_by_half_a_cosine(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []
    step = Companion.step

    def watched(self: Companion, *more: Any) -> None:
        step(self, *more)
        seen.append(self.optimizer.param_groups[0]["lr"])

    monkeypatch.setattr(Companion, "step", watched)
    inputs, _ = photographed("a7s2-iso6400-3chip")
    train(inputs, changed(CONFIG, {"fit.iterations": 4}, what="x"))
    assert seen == pytest.approx([1e-5 + 9e-5 * (1 + math.cos(math.pi * i / 4)) / 2 for i in range(4)])


def test_its_constants_are_those_published() -> None:
    config, naive = METHODS["le3d"].config(), METHODS["naive"].config()
    assert (BINS, EPSILON, NEAREST, FARTHEST) == (32, 1e-3, 0.2, 1000)
    assert (config.fit.rates.sh_dc, config.fit.rates.features, config.fit.rates.colours_final) == (2e-3, 1e-4, 1e-5)
    own = {"rates": naive.fit.rates, "sh_degree": 3}
    assert dataclasses.replace(config.fit, **own) == naive.fit
    names = "means", "means_final", "schedule", "quats", "log_scales", "logit_opacities"
    assert all(getattr(config.fit.rates, name) == getattr(naive.fit.rates, name) for name in names)


def test_what_it_cannot_use_is_said() -> None:
    inputs, _ = photographed("a7s2-iso6400-3chip")
    with pytest.raises(LacksInput, match="raw frames or 16-bit linear pictures"):
        train(dataclasses.replace(inputs, raw=None, linear16=None), CONFIG)
    for settings, message in (
        ({"epsilon": 0.0}, r"epsilon must be > 0 .* got 0"), ({"scatter": -1.0}, "weights, network_rate and scatter"),
        ({"init_opacity": 1.0}, r"init_opacity must lie in \(0, 1\), got 1"), ({"seen": 4}, "seen must be >= 8 px"),
        ({"ends": 0}, "ends >= 1"), ({"fit.rates.colours_final": -1.0}, "colours_final must be >= 0, got -1"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            changed(CONFIG, settings, what="x")
