import dataclasses
import json
import sys
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from novags.methods.enhanced.config import ORIGINAL_FIT
from novags.methods.nova import trainer
from novags.methods.nova.config import ConsistencyConfig, NovaConfig
from novags.methods.nova.consistency import ConsistencyLoss
from novags.methods.nova.denoiser import Denoiser
from novags.methods.nova.denoiser_config import DenoiserConfig, ResUNetConfig
from novags.methods.nova.trainer import _Training, train
from novags.splats import FitConfig
from novags.splats.training.fit import Step
from novags.testbed.study.cells.presets import EXPERIMENTS

DENOISER = DenoiserConfig(
    network=ResUNetConfig(widths=(4,), bottleneck=6, normalization="none"),
    warmup_steps=4,
    denoise_every=3,
    batch=1,
    residual_blur=1.0,
)
CONFIG = NovaConfig(
    init_scale=0.7,
    denoiser=DENOISER,
    consistency=ConsistencyConfig(start=0.25, max_angle=60),
    fit=FitConfig(iterations=12, sh_degree=1, sh_every=4, checkpoint_every=5),
)


def changed(**changes) -> NovaConfig:
    return dataclasses.replace(CONFIG, **changes)


def sh(result) -> torch.Tensor:
    return result.scene.gaussians.sh


def test_the_paper_is_the_default():
    config = NovaConfig()
    assert (config.enhance.window, config.enhance.target) == (33, 0.5)
    assert config.consistency.weight == config.sh_weight == 1
    assert config.consistency.occlusion_tolerance == 0.1
    assert config.fit.iterations == 7000
    assert config.fit.dssim_weight == 0.2
    assert config.detach_target


def test_a_run_gives_images_losses_seconds_and_its_configuration(problem):
    inputs, seen = problem(seed=3), []
    result = train(inputs, CONFIG, progress=lambda *entry: seen.append(entry))
    assert result.enhanced.shape == result.targets.shape == inputs.srgb8.shape
    assert ((result.targets >= 0) & (result.targets <= 1)).all()
    assert abs(float(result.enhanced.mean()) - 0.5) < 0.05
    assert set(result.seconds) == {"enhance", "denoise", "fit"}
    assert result.found == {"consistency": {"views_with_partner": 5, "of": 5}}
    assert result.config.fit.seed == 3
    assert result.config.fit.extent == inputs.start.extent
    assert result.config.denoiser.warmup_steps == 4
    assert [entry[0] for entry in seen] == [1, 2, 3, 4, 14, 16]
    assert {entry[1] for entry in seen} == {16}
    assert result.losses[-1]["iteration"] == 12


def test_targets_are_the_denoised_images_and_lie_closer_to_the_clean_ones(problem):
    noisy, clean = problem(sigma=0.02), problem(sigma=0)
    denoiser = dataclasses.replace(DENOISER, warmup_steps=30, learning_rate=3e-3)
    result = train(noisy, changed(denoiser=denoiser))
    twin = train(clean, changed(denoiser=dataclasses.replace(DENOISER, warmup_steps=0))).enhanced
    assert (result.targets - twin).square().mean() < 0.7 * (result.enhanced - twin).square().mean()


@pytest.mark.parametrize(("every", "steps"), [(None, 4), (1, 16), (3, 8), (5, 7)])
def test_the_denoiser_goes_on_at_its_cadence(problem, monkeypatch, every, steps):
    taken = []
    original = Denoiser.train_step
    monkeypatch.setattr(Denoiser, "train_step", lambda self: taken.append(self.step) or original(self))
    train(problem(), changed(denoiser=dataclasses.replace(DENOISER, denoise_every=every)))
    assert taken == list(range(steps))


def test_pseudo_clean_images_are_computed_anew_only_when_stale(problem, monkeypatch):
    calls = []
    original = Denoiser.denoise
    monkeypatch.setattr(Denoiser, "denoise", lambda self, view: calls.append(view) or original(self, view))
    frozen = dataclasses.replace(DENOISER, denoise_every=None)
    train(problem(), changed(denoiser=frozen, consistency=None))
    assert len(calls) == 5  # once per view before the splats start; the result has these
    calls.clear()
    train(problem(), changed(consistency=None))
    eager = len(calls)
    calls.clear()
    train(problem(), changed(consistency=None, refresh_after=100))
    assert 10 == len(calls) < eager


def test_each_loss_changes_the_result(problem):
    whole = train(problem(), CONFIG)
    for off in ({"consistency": None}, {"sh_weight": None}):
        assert not torch.equal(sh(train(problem(), changed(**off))), sh(whole))
    only_start = dataclasses.replace(CONFIG.consistency, start=1.0)
    late = train(problem(), changed(consistency=only_start))
    torch.testing.assert_close(sh(late), sh(train(problem(), changed(consistency=None))))


def test_depth_is_rendered_only_where_the_geometric_loss_is_due(problem, monkeypatch):
    seen = []
    original = _Training.noise_weights
    monkeypatch.setattr(
        _Training,
        "noise_weights",
        lambda self, step: seen.append(step.expected_depth is not None) or original(self, step),
    )
    train(problem(), changed(consistency=dataclasses.replace(CONFIG.consistency, every=4)))
    assert [i for i, with_depth in enumerate(seen) if with_depth] == [4, 8]


def test_the_denoiser_follows_the_splats_only_if_the_target_is_not_detached(problem):
    detached = train(problem(), changed(consistency=None))
    other_fit = train(problem(), changed(consistency=None, fit=dataclasses.replace(CONFIG.fit, dssim_weight=0.0)))
    assert torch.equal(detached.targets, other_fit.targets)
    joint = train(problem(), changed(consistency=None, detach_target=False))
    assert not torch.allclose(joint.targets, detached.targets)


class Stop(Exception):
    """The plug is pulled."""


@pytest.mark.parametrize("stop", [2, 4, 14])
def test_an_interrupted_run_resumes_to_the_same_bits(problem, tmp_path: Path, stop):
    whole = train(problem(), CONFIG)
    checkpoint = tmp_path / "checkpoint.safetensors"

    def pull(done: int, total: int, losses: dict[str, float]) -> None:
        if done == stop:
            raise Stop

    with pytest.raises(Stop):
        train(problem(), CONFIG, progress=pull, checkpoint=checkpoint)
    resumed = train(problem(), CONFIG, checkpoint=checkpoint)
    assert torch.equal(resumed.targets, whole.targets)
    assert torch.equal(sh(resumed), sh(whole))
    assert torch.equal(resumed.scene.gaussians.means, whole.scene.gaussians.means)
    again = train(problem(), CONFIG, checkpoint=checkpoint)
    assert torch.equal(again.targets, whole.targets)
    assert torch.equal(sh(again), sh(whole))


class Plug:
    """Pulled at the n-th of the moments before and after everything that a run saves or learns."""

    WATCHED = (
        (sys.modules["novags.splats.training.fit"], "save_checkpoint"),
        (trainer, "write_tensors"),
        (Denoiser, "train_step"),
        (ConsistencyLoss, "update"),
    )

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.moments: list[str] = []
        self.at: int | None = None
        for place, name in self.WATCHED:
            monkeypatch.setattr(place, name, self.watched(getattr(place, name), name))

    def watched(self, function, name: str):
        def call(*args, **keywords):
            self.pass_by(name)
            result = function(*args, **keywords)
            self.pass_by(name)
            return result

        return call

    def pass_by(self, name: str) -> None:
        self.moments.append(name)
        if len(self.moments) == self.at:
            raise Stop


@pytest.mark.parametrize(
    "changes", [{}, {"refresh_after": 3}, {"detach_target": False}], ids=["paper", "stale images", "joint"]
)
def test_wherever_a_run_is_interrupted_it_resumes_to_the_same_bits(problem, tmp_path: Path, monkeypatch, changes):
    """Rationale: fit and networks learn from each other, so they must go on from one and the same moment."""
    inputs, plug = problem(), Plug(monkeypatch)
    config = changed(
        denoiser=dataclasses.replace(DENOISER, warmup_steps=1, denoise_every=2),
        consistency=dataclasses.replace(CONFIG.consistency, start=0.0),
        fit=dataclasses.replace(CONFIG.fit, iterations=5, sh_every=1, checkpoint_every=3),
        **changes,
    )
    whole = train(inputs, config, checkpoint=tmp_path / "whole.safetensors")
    first = plug.moments.index("save_checkpoint")
    around = range(first, first + 8)
    assert {plug.moments[moment] for moment in around} == {name for _, name in Plug.WATCHED}
    for moment in around:
        checkpoint = tmp_path / f"{moment}.safetensors"
        plug.moments, plug.at = [], moment + 1
        with pytest.raises(Stop):
            train(inputs, config, checkpoint=checkpoint)
        plug.at = None
        resumed = train(inputs, config, checkpoint=checkpoint)
        assert torch.equal(resumed.targets, whole.targets), moment
        for name, tensor in whole.scene.gaussians.tensors().items():
            assert torch.equal(resumed.scene.gaussians.tensors()[name], tensor), (moment, name)


def stop_at(step: int):
    """A progress call that stops the run there."""

    def progress(done: int, total: int, losses: dict[str, float]) -> None:
        if done == step:
            raise Stop

    return progress


def test_a_long_warm_up_is_saved_as_it_goes(problem, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(trainer, "SAVE_INTERVAL", 0.0)

    with pytest.raises(Stop):
        train(problem(), CONFIG, progress=stop_at(3), checkpoint=tmp_path / "run.safetensors")
    seen = []
    train(problem(), CONFIG, progress=lambda *entry: seen.append(entry[0]), checkpoint=tmp_path / "run.safetensors")
    assert seen[0] == 4


def test_seconds_count_interrupted_attempts_too(problem, tmp_path: Path):
    checkpoint = tmp_path / "run.safetensors"
    with pytest.raises(Stop):
        train(problem(), CONFIG, progress=stop_at(14), checkpoint=checkpoint)
    spent = float(load_file(tmp_path / "run.denoiser.safetensors")["seconds"])
    resumed = train(problem(), CONFIG, checkpoint=checkpoint)
    assert 0 < spent == resumed.seconds["denoise"]
    with safe_open(checkpoint, framework="pt") as file:
        saved = json.loads(file.metadata()["state"])["seconds"]
    again = train(problem(), CONFIG, checkpoint=checkpoint)
    assert again.seconds["denoise"] == spent
    assert again.seconds["fit"] >= saved > 0


def test_a_run_of_other_images_or_settings_is_not_continued(problem, tmp_path: Path):
    checkpoint = tmp_path / "run.safetensors"
    with pytest.raises(Stop):
        train(problem(), CONFIG, progress=stop_at(14), checkpoint=checkpoint)
    brighter = dataclasses.replace(problem(), srgb8=problem().srgb8 * 1.01)
    for inputs, config in ((brighter, CONFIG), (problem(), dataclasses.replace(CONFIG, sh_weight=0.5))):
        with pytest.raises(ValueError, match="other images or settings"):
            train(inputs, config, checkpoint=checkpoint)
    train(problem(), CONFIG, checkpoint=checkpoint)


def test_a_fit_without_its_networks_is_not_continued(problem, tmp_path: Path):
    checkpoint = tmp_path / "run.safetensors"
    train(problem(), CONFIG, checkpoint=checkpoint)
    (tmp_path / "run.denoiser.safetensors").unlink()
    with pytest.raises(ValueError, match=r"run\.safetensors lacks the networks"):
        train(problem(), CONFIG, checkpoint=checkpoint)


def test_the_papers_preset_resumes_to_the_same_bits(problem, tmp_path: Path):
    """Rationale: its settings, but for size and length, are what takes days and gets interrupted."""
    paper = EXPERIMENTS["paper"].reconstruct("nova").config
    fit = dataclasses.replace(ORIGINAL_FIT, iterations=7000, cap_max=1_000_000, checkpoint_every=250)
    assert paper == NovaConfig(fit=fit)
    tiny = dataclasses.replace(paper.denoiser, network=ResUNetConfig(widths=(4,), bottleneck=6), warmup_steps=2)
    short = dataclasses.replace(paper.fit, iterations=12, checkpoint_every=5)
    config = dataclasses.replace(paper, denoiser=tiny, fit=short)
    whole = train(problem(), config)

    def pull(done: int, total: int, losses: dict[str, float]) -> None:
        if done == 2 + 12:
            raise Stop

    with pytest.raises(Stop):
        train(problem(), config, progress=pull, checkpoint=tmp_path / "run.safetensors")
    seen = []
    resumed = train(
        problem(), config, progress=lambda *entry: seen.append(entry[0]), checkpoint=tmp_path / "run.safetensors"
    )
    assert seen == [2 + 12]  # fit logs every tenth iteration and the last: it went on from the tenth
    assert torch.equal(resumed.targets, whole.targets)
    assert torch.equal(resumed.scene.gaussians.means, whole.scene.gaussians.means)
    assert torch.equal(sh(resumed), sh(whole))


def test_a_damaged_checkpoint_is_named(problem, tmp_path: Path):
    (tmp_path / "run.denoiser.safetensors").write_bytes(b"half a file")
    with pytest.raises(ValueError, match=r"run\.denoiser\.safetensors is damaged"):
        train(problem(), CONFIG, checkpoint=tmp_path / "run.safetensors")


def test_the_confidence_network_learns_while_the_splats_do(problem, monkeypatch):
    kept: list[ConsistencyLoss] = []
    original = ConsistencyLoss.__init__
    monkeypatch.setattr(
        ConsistencyLoss, "__init__", lambda self, *args, **kw: (kept.append(self), original(self, *args, **kw))[1]
    )
    before = []
    call = ConsistencyLoss.__call__

    def watched(self: ConsistencyLoss, step: Step) -> torch.Tensor | None:
        before.append([p.detach().clone() for p in self.network.parameters()])
        return call(self, step)

    monkeypatch.setattr(ConsistencyLoss, "__call__", watched)
    train(problem(), CONFIG)
    assert all(not torch.equal(a, b) for a, b in zip(before[0], kept[0].network.parameters(), strict=True))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sh_weight": -1.0}, "sh_weight must be > 0, or None .* got -1.0"),
        ({"refresh_after": 0}, "refresh_after must be >= 1, got 0"),
    ],
)
def test_impossible_configurations_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        NovaConfig(**wrong)
