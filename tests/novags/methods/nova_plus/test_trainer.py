"""The method as a whole, on a small wall seen dark."""

import dataclasses
import importlib
import math
from pathlib import Path
from typing import Any

import pytest
import torch

from novags.methods.denoised.config import AdaptConfig, DenoiseConfig
from novags.methods.enhancers.applying import enhanced_light
from novags.methods.gaussian_scene import GaussianScene
from novags.methods.inputs import LacksInput
from novags.methods.light import first_light
from novags.methods.noise import Noise, Variance
from novags.methods.nova_plus import trainer
from novags.methods.nova_plus.average import non_local_means
from novags.methods.nova_plus.bandwidth import choose_bandwidth
from novags.methods.nova_plus.config import FIT, PIXELS_PER_GAUSSIAN, NovaPlusConfig, parts
from novags.methods.nova_plus.data import exposures
from novags.methods.nova_plus.judge import Verdict
from novags.methods.nova_plus.targets import denoised_light, guided_light
from novags.methods.nova_plus.trainer import train
from novags.methods.problem import Problem
from novags.methods.reconstruction import Reconstruction
from novags.methods.tone import tone_curve
from novags.splats import McmcConfig
from novags.splats.files.ply import read_ply
from novags.splats.training.config import CameraRefinement

fitting = importlib.import_module("novags.splats.training.fit")  # the package has a function of that name
MCMC = McmcConfig(refine_start=4, refine_every=4)
CONFIG = NovaPlusConfig(
    fit=dataclasses.replace(FIT, iterations=48, sh_every=5, checkpoint_every=7, mcmc=MCMC),
    gaussians=160,
    held_share=0.1,
    denoise=DenoiseConfig(adapt=AdaptConfig(steps=2, batch=1, crop=16), turns=1),
)


def light_of(result: Reconstruction, problem: Problem) -> torch.Tensor:
    return result.render(problem.views)[0]


def test_it_ends_in_the_light_of_the_scene_with_less_noise_than_its_data(dark: Any) -> None:
    inputs, light = dark()
    config = dataclasses.replace(CONFIG, fit=dataclasses.replace(CONFIG.fit, iterations=480))
    result = train(inputs, config)
    found = light_of(result, inputs)
    assert result.space == "linear"
    assert result.enhancement is not None
    assert float(found.mean() / light.mean()) == pytest.approx(1, abs=0.02)
    inside = (slice(None), slice(4, -4), slice(4, -4))
    error = float((found - light)[inside].square().mean())
    assert error < 0.5 * float((inputs.linear16 - light)[inside].square().mean())


def test_every_stage_is_counted_and_told(dark: Any) -> None:
    inputs, _ = dark()
    seen: list[Any] = []
    result = train(inputs, CONFIG, progress=lambda *entry: seen.append(entry))
    assert parts(CONFIG) == {"likelihood": 40, "denoiser": 2, "structure": 40, "merged": 4}
    assert {entry[1] for entry in seen} == {86}
    done = [entry[0] for entry in seen]
    assert done == sorted(done)
    assert [entry[0] for entry in seen if "denoiser" in entry[2]] == [41, 42]
    assert done[-1] == 86
    assert [entry["iteration"] for entry in result.losses] == [10, 20, 30, 40, 52, 62, 72, 82, 86]
    assert set(result.found) >= {"tone", "gaussians", "held_out_pixels", "bandwidth", "structure", "merged"}
    assert result.targets is not None
    assert result.targets.shape == inputs.srgb8.shape
    assert len(result.scene.gaussians) == 2 * 160  # type: ignore[attr-defined]


def test_stage_1_alone_has_no_targets(dark: Any) -> None:
    inputs, _ = dark()
    config = dataclasses.replace(CONFIG, stages="likelihood", seeds=1)
    result = train(inputs, config)
    assert parts(config) == {"likelihood": 20}
    assert result.targets is None
    assert "structure" not in result.found
    assert len(result.scene.gaussians) == 160  # type: ignore[attr-defined]


def test_stage_1_of_several_seeds_is_merged_and_counted(dark: Any) -> None:
    inputs, _ = dark()
    seen: list[Any] = []
    config = dataclasses.replace(CONFIG, stages="likelihood")
    train(inputs, config, progress=lambda *entry: seen.append(entry))
    assert parts(config) == {"likelihood": 40, "merged": 4}
    assert seen[-1][:2] == (44, 44)


def test_what_the_held_out_data_dislike_is_dropped(dark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, _ = dark()
    first = train(inputs, dataclasses.replace(CONFIG, stages="likelihood", seeds=1))
    verdicts = iter([Verdict(1.0, 0.1), Verdict(1.0, 0.1)])
    monkeypatch.setattr(trainer, "compare", lambda *_: next(verdicts))
    result = train(inputs, CONFIG)
    assert result.targets is None
    for name, tensor in result.scene.gaussians.tensors().items():  # type: ignore[attr-defined]
        assert torch.equal(tensor, first.scene.gaussians.tensors()[name]), name  # type: ignore[attr-defined]


def test_the_merged_set_is_what_is_judged_and_its_first_seed_the_measure(
    dark: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs, _ = dark()
    config = dataclasses.replace(CONFIG, stages="likelihood")
    judged: list[tuple[torch.Tensor, torch.Tensor]] = []

    def spy(tones: Any, other: torch.Tensor, *_: Any) -> Verdict:
        judged.append((torch.stack(list(tones)), other))
        return Verdict(0.0, 1.0)

    monkeypatch.setattr(trainer, "compare", spy)
    scenes: list[Any] = [train(inputs, dataclasses.replace(config, seeds=seeds)).scene for seeds in (2, 1)]
    (found,) = judged
    for scene, tones in zip(scenes, found, strict=True):
        assert torch.equal(dataclasses.replace(scene, tone=None).render(inputs.views)[0], tones)
    assert not torch.equal(*found)


def test_a_run_stopped_anywhere_ends_as_if_it_had_not_been(
    dark: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs, _ = dark()
    whole = train(inputs, CONFIG)
    original = fitting._mcmc_step
    for stop in (11, 27, 65, 83):
        left = [stop]

        def step(*args: Any, left: list[int] = left) -> Any:
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt
            return original(*args)

        folder = tmp_path / str(stop)
        folder.mkdir()
        monkeypatch.setattr(fitting, "_mcmc_step", step)
        with pytest.raises(KeyboardInterrupt):
            train(inputs, CONFIG, checkpoint=folder / "checkpoint.safetensors")
        monkeypatch.setattr(fitting, "_mcmc_step", original)
        assert any((folder / trainer.CHECKPOINTS).glob("*.safetensors"))
        again = train(inputs, CONFIG, checkpoint=folder / "checkpoint.safetensors")
        for name, tensor in again.scene.gaussians.tensors().items():  # type: ignore[attr-defined]
            assert torch.equal(tensor, whole.scene.gaussians.tensors()[name]), (stop, name)  # type: ignore[attr-defined]


def test_another_seed_gives_other_gaussians_and_other_judges(dark: Any) -> None:
    config = dataclasses.replace(CONFIG, stages="likelihood", seeds=1)
    inputs, _ = dark()
    other = dataclasses.replace(inputs, seed=1)
    a, b = (train(each, config).scene.gaussians for each in (inputs, other))  # type: ignore[attr-defined]
    assert not torch.equal(a.means, b.means)


def test_the_file_of_gaussians_holds_tones_and_the_record_how_to_read_them(dark: Any, tmp_path: Path) -> None:
    inputs, _ = dark()
    result = train(inputs, dataclasses.replace(CONFIG, stages="likelihood", seeds=1))
    result.save(tmp_path)
    facts = result.scene.facts()
    assert facts["tone"] == result.found["tone"]
    assert "matrix" not in facts
    read = read_ply(tmp_path / "point_cloud.ply")
    again = dataclasses.replace(result.scene, gaussians=read)  # type: ignore[type-var]
    torch.testing.assert_close(again.render(inputs.views)[0], light_of(result, inputs), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("points", [100, 400])  # fewer and more than that
def test_the_number_of_gaussians_follows_the_pixels_however_many_points_there_are(dark: Any, points: int) -> None:
    inputs, _ = dark()
    some = torch.arange(points) % len(inputs.start.points)
    start = dataclasses.replace(inputs.start, points=inputs.start.points[some], colors=inputs.start.colors[some])
    config = dataclasses.replace(CONFIG, gaussians=None, stages="likelihood", seeds=1)
    result = train(dataclasses.replace(inputs, start=start), config)
    expected = 5 * 24 * 24 // PIXELS_PER_GAUSSIAN
    assert result.found["gaussians"] == expected
    count = len(result.scene.gaussians)  # type: ignore[attr-defined]
    assert points < count < expected if points < expected else count == expected  # the one grows, the other is thinned


@pytest.mark.parametrize(("cap", "each"), [(100, 50), (101, 50), (1000, 160)])
def test_all_seeds_together_keep_to_the_cap(dark: Any, cap: int, each: int) -> None:
    inputs, _ = dark()
    fit = dataclasses.replace(CONFIG.fit, cap_max=cap)
    result = train(inputs, dataclasses.replace(CONFIG, fit=fit, stages="likelihood"))
    assert result.found["gaussians"] == each
    assert len(result.scene.gaussians) == 2 * each  # type: ignore[attr-defined]


def test_noise_can_be_taken_from_the_pictures_and_must_come_from_somewhere(dark: Any) -> None:
    inputs, _ = dark()
    config = dataclasses.replace(CONFIG, stages="likelihood", seeds=1)
    unknown = train(dataclasses.replace(inputs, noise=None), config)
    asked = train(inputs, dataclasses.replace(config, noise="pictures"))
    assert torch.equal(light_of(unknown, inputs), light_of(asked, inputs))
    assert not torch.equal(light_of(asked, inputs), light_of(train(inputs, config), inputs))
    with pytest.raises(LacksInput, match="needs raw frames or 16-bit linear pictures"):
        train(dataclasses.replace(inputs, noise=None, linear16=None), config)


@pytest.mark.parametrize(
    ("setting", "value", "said"),
    [
        ("seeds", 0, "seeds must be >= 1, got 0"),
        ("held_share", 1.0, "held_share must lie in"),
        ("averaged_share", 1.5, "averaged_share, denoised_share and least_share must lie in"),
        ("denoised_share", -0.5, "got 0.5, -0.5 and 1.0"),
        ("bandwidth", 0.0, "bandwidth must be > 0 or None, got 0"),
        ("gaussians", 0, "gaussians must be >= 1 or None, got 0"),
    ],
)
def test_settings_that_mean_nothing_are_refused(setting: str, value: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        NovaPlusConfig(**{setting: value})


def test_stages_follow_one_another_with_rates_and_seeds_of_their_own(
    dark: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs, _ = dark(seed=7)
    calls: list[Any] = []

    def spy(start: Any, views: Any, target: Any, config: Any, **options: Any) -> Any:
        result = fitting.fit(start, views, target, config, **options)
        calls.append((start, torch.stack([target(i) for i in range(len(views))]), config, options, result.gaussians))
        return result

    monkeypatch.setattr(trainer, "fit", spy)
    result = train(inputs, CONFIG)
    configs = [config for _, _, config, _, _ in calls]
    assert [c.iterations for c in configs] == [20, 20, 20, 20, 4]
    assert [c.seed for c in configs] == [7, 1007, 7, 1007, 7]
    for config, factor in zip(configs, (1, 1, 1, 1, 0.1), strict=True):
        for name in ("quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest"):
            assert getattr(config.rates, name) == pytest.approx(factor * getattr(FIT.rates, name))
        assert config.rates.means == pytest.approx(factor * FIT.rates.means)
        assert config.rates.means_final == FIT.rates.means_final
    assert [c.mcmc is None for c in configs] == [False, False, False, False, True]
    assert [c.sh_every for c in configs] == [5, 5, 5, 5, 1]  # a merged set has its harmonics already
    assert [c.opacity_reg_at(c.iterations // 2) for c in configs] == [0.005, 0.005, 0.005, 0.005, 0]
    assert [options["photometric"] is None for _, _, _, options, _ in calls] == [False, False, True, True, True]
    # both stages start from the first points; the targets of the second are guided by the mean light of both seeds
    first = calls[0][0].tensors()
    assert torch.equal(first["means"], inputs.start.points)
    for start, *_ in calls[1:4]:
        for name, tensor in start.tensors().items():
            assert torch.equal(tensor, first[name]), name
    data = exposures(inputs, inputs.noise, CONFIG.held_share)
    curve = tone_curve(data.greens)
    torch.testing.assert_close(calls[0][1], data.fitted, equal_nan=True)
    tones = torch.as_tensor(curve.tone(first_light(inputs.start, data))).clamp(0, 1)
    torch.testing.assert_close(0.5 + calls[0][0].sh[:, 0] * math.sqrt(1 / (4 * math.pi)), tones.to(data.light))
    renders = [curve.light(GaussianScene(g, 0.1).render(inputs.views)[0]) for g in (calls[0][4], calls[1][4])]
    guide = curve.tone((renders[0] + renders[1]) / 2)
    h, _ = choose_bandwidth(guide, data, curve)
    guide = torch.stack(list(non_local_means(guide, trainer.GUIDE_BANDWIDTH * h)))
    assert CONFIG.denoise is not None
    clean = torch.stack(list(denoised_light(data, curve.light(guide), CONFIG.denoise, seed=7)))
    want = curve.tone(2 / 3 * guided_light(guide, data, curve, h, 0.5, 1.0) + 1 / 3 * clean)
    torch.testing.assert_close(calls[2][1], want, rtol=1e-4, atol=1e-5)
    shown = enhanced_light(inputs, curve.light(calls[2][1]), CONFIG.enhance, CONFIG.pictures)
    torch.testing.assert_close(result.targets, torch.stack(list(shown)))


def test_the_first_fit_corrects_the_cameras_for_all_others(dark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, _ = dark()
    used: list[Any] = []
    rendered: list[torch.Tensor] = []
    render = GaussianScene.render

    def spy(start: Any, views: Any, target: Any, config: Any, **options: Any) -> Any:
        result = fitting.fit(start, views, target, config, **options)
        used.append((views.viewmats, config.refine_cameras, result.viewmats))
        return result

    def seen(scene: GaussianScene, views: Any) -> Any:
        rendered.append(views.viewmats)
        return render(scene, views)

    monkeypatch.setattr(trainer, "fit", spy)
    monkeypatch.setattr(GaussianScene, "render", seen)
    refinement = CameraRefinement(start=2)
    result = train(inputs, dataclasses.replace(CONFIG, fit=dataclasses.replace(CONFIG.fit, refine_cameras=refinement)))
    corrected = used[0][2]
    assert torch.equal(used[0][0], inputs.views.viewmats)
    assert not torch.equal(corrected, inputs.views.viewmats)
    assert [refine for _, refine, _ in used] == [refinement, None, None, None, None]
    assert all(torch.equal(viewmats, corrected) for viewmats, _, _ in used[1:])
    assert rendered
    assert all(bool((corrected == viewmats).all(2).all(1).any()) for viewmats in rendered)
    assert result.viewmats is not None
    assert torch.equal(result.viewmats, corrected)
    assert train(inputs, CONFIG).viewmats is None


@pytest.mark.parametrize("last", [4e-6, 4e-5, 4e-4])
def test_the_means_of_a_merged_set_move_less_than_in_the_stages_and_ever_more_slowly(last: float) -> None:
    before = dataclasses.replace(FIT.rates, means_final=last)
    slower = trainer._scaled(before, 0.1)
    found = [rates.means_at(i, 20, 1.0) for rates in (before, slower) for i in range(21)]
    assert all(b <= a * (1 + 1e-9) for a, b in zip(found[:20], found[1:21], strict=True))
    assert all(b <= a * (1 + 1e-9) for a, b in zip(found[21:41], found[22:], strict=True))
    assert found[21] == pytest.approx(max(0.1 * 4e-4, last))
    assert found[41] == pytest.approx(last)


def test_a_third_of_the_data_has_three_times_the_regulariser(dark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, _ = dark()
    data = exposures(inputs, inputs.noise, CONFIG.held_share)
    kept = torch.arange(3) == torch.arange(24)[:, None, None] % 3  # stripes of one channel each
    some = torch.where(kept.expand_as(data.light), data.light, math.nan)
    weights: list[float] = []

    def spy(start: Any, views: Any, target: Any, config: Any, **options: Any) -> Any:
        weights.append(config.opacity_reg)
        return fitting.fit(start, views, target, config, **options)

    monkeypatch.setattr(trainer, "fit", spy)
    for light in (data.light, some):
        seen = dataclasses.replace(data, light=light)
        monkeypatch.setattr(trainer, "exposures", lambda *_, seen=seen: seen)
        train(inputs, dataclasses.replace(CONFIG, denoise=None, seeds=1))
    # the targets of stage 2 are whole
    once = FIT.opacity_reg
    assert weights == pytest.approx([once, once, 3 * once, once])


@pytest.mark.parametrize("why", ["not wanted", "noise is shared", "no noise"])
def test_without_independent_noise_the_targets_are_the_guided_averages(dark: Any, why: str) -> None:
    inputs, _ = dark()
    config = CONFIG if why != "not wanted" else dataclasses.replace(CONFIG, denoise=None)
    if why == "noise is shared":
        inputs = dataclasses.replace(inputs, channels_share=("JPEG",))
    if why == "no noise":
        silent = dataclasses.replace(inputs.noise.linear16.curve, offset=(0.0,) * 3, slope=(0.0,) * 3)
        inputs = dataclasses.replace(inputs, noise=Noise(Variance(silent), None, "camera"))
    data = exposures(inputs, inputs.noise, CONFIG.held_share)
    work = trainer._Work(inputs, config, data, tone_curve(data.greens), None, None)
    guide = torch.full_like(data.light, 0.5)
    found = work.targets(guide, 0.05)
    want = work.curve.tone(guided_light(guide, data, work.curve, 0.05, 0.5, 1.0))
    torch.testing.assert_close(found, want, rtol=1e-6, atol=1e-7)
    assert work.found["denoised"] is False
    assert work.done == parts(config)["denoiser"]


def test_judges_weigh_errors_as_the_enhanced_pictures_show_them(dark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, light = dark()
    given: list[torch.Tensor] = []

    def spy(tones: Any, other: torch.Tensor, data: Any, curve: Any, weights: torch.Tensor) -> Verdict:
        given.append(weights)
        return Verdict(0.0, 1.0)

    monkeypatch.setattr(trainer, "compare", spy)
    train(inputs, CONFIG)
    assert len(given) == 2  # of stage 2, and of the merged seeds
    for weights in given:
        assert float(weights.mean()) == pytest.approx(1, rel=1e-4)
        assert weights.shape == light.shape
        # the enhancement lifts dark parts most: there errors show
        bright = light > light.median()
        assert float(weights[~bright].mean()) > 1.5 * float(weights[bright].mean())


def test_weights_are_those_of_the_smoothed_renders_that_are_judged(dark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one seed as it is: what is shown of a noisy render would respond to its noise."""
    inputs, _ = dark()
    given: list[tuple[torch.Tensor, torch.Tensor]] = []

    def spy(tones: Any, other: torch.Tensor, data: Any, curve: Any, weights: torch.Tensor) -> Verdict:
        given.append((other, weights))
        return Verdict(0.0, 1.0)

    monkeypatch.setattr(trainer, "compare", spy)
    train(inputs, dataclasses.replace(CONFIG, denoise=None))
    data = exposures(inputs, inputs.noise, CONFIG.held_share)
    work = trainer._Work(inputs, CONFIG, data, tone_curve(data.greens), None, None)
    (guide, structure), (first, joined) = given
    torch.testing.assert_close(structure, work.weights(non_local_means(guide, 0.02)))
    torch.testing.assert_close(joined, work.weights(first))
    assert not torch.allclose(structure, work.weights(guide), rtol=0.01)


def test_the_light_of_a_camera_is_shown_in_srgb(dark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    inputs, light = dark()
    matrix = torch.tensor([[0.7, 0.2, 0.1], [0.0, 0.9, 0.1], [0.05, 0.15, 0.8]])
    data = dataclasses.replace(exposures(inputs, inputs.noise, CONFIG.held_share), matrix=matrix)
    work = trainer._Work(inputs, CONFIG, data, tone_curve(data.greens), None, None)
    monkeypatch.setattr(trainer, "enhanced_light", lambda problem, light, *_: torch.stack(list(light)))
    red = torch.zeros_like(light)
    red[..., 0] = 0.1
    shown = work.shown(work.curve.tone(red)).float()
    torch.testing.assert_close(shown, (0.1 * matrix[:, 0]).expand_as(shown), rtol=1e-4, atol=1e-6)
