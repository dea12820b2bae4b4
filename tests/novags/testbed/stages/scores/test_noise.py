"""Scores of the noise that is left: exposures taken again are the capture's own, and each number is of what it says."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch

from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import enhance
from novags.methods.memo import Memo
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.set import Source
from novags.testbed.metrics.noise import centred_noise
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.scores import noise as module
from novags.testbed.stages.scores.noise import bias_floor, exposed_again, noise_scores
from sensor_model import PRESETS, Measured, write_sensor
from sensor_model.files.camera_file import write_maps
from sensor_model.planner import Plan
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import write_png

QUIET = Console(quiet=True)
CONFIG = EnhanceConfig(window=9)
ENHANCEMENT = enhancement_record(CONFIG, "8bit")


def taken(folder: Path, **settings) -> tuple[Capture, Source]:
    """A capture of four posed photographs, and their set."""
    names = [f"{i:04d}" for i in range(4)]
    views = folder / "set"
    write_cameras(views, names, orbit_rig(4, 34, 30, 50.0, radius=3.0))
    (views / "images").mkdir()
    rng = np.random.default_rng(0)
    for name in names:
        smooth = cv2.resize(rng.integers(20, 250, (6, 7, 3), np.uint8), (34, 30), interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(views / "images" / f"{name}.png"), smooth)
    stages.capture(views, folder / "cap", CaptureConfig(**settings), QUIET)
    capture = open_capture(folder / "cap")
    return capture, capture.source(QUIET)


@pytest.fixture(scope="module")
def dark(tmp_path_factory: pytest.TempPathFactory) -> tuple[Capture, Source]:
    """By a three-chip camera at 20 electrons."""
    return taken(tmp_path_factory.mktemp("dark"), electrons=20, seed=3)


@pytest.mark.parametrize(
    "settings",
    [{"sensor": "a7s2-iso6400"}, {"electrons": 5, "jpeg_quality": 80}, {"tolerance": None, "demosaic": "bilinear"}],
    ids=["bayer", "jpeg", "all effects"],
)
def test_an_exposure_taken_again_with_its_own_seed_is_the_captures(tmp_path, settings):
    capture, lit = taken(tmp_path, seed=3, **settings)
    for i in (0, 2):
        assert np.array_equal(exposed_again(capture, lit, i, 3, "8bit"), capture.dark(i, "8bit"))
        np.testing.assert_allclose(exposed_again(capture, lit, i, 3, "16bit"), capture.dark(i, "16bit"), atol=1e-7)
        assert not np.array_equal(exposed_again(capture, lit, i, 4, "8bit"), capture.dark(i, "8bit"))


def test_effects_that_the_capture_left_out_are_left_out_again(dark, monkeypatch):
    capture, lit = dark
    seen, original = [], module.expose_view
    monkeypatch.setattr(module, "expose_view", lambda *a, **k: seen.append(k["plan"]) or original(*a, **k))
    exposed_again(capture, lit, 1, 3, "8bit")
    assert [effect.name for effect in seen[0].effects if not effect.on]
    assert seen == [Plan.from_dict(capture.record.simulated.plan)]


def test_the_bias_floor_is_of_new_exposures_each_with_its_own_enhancement(dark, monkeypatch):
    capture, lit = dark
    monkeypatch.setattr(module, "VIEWS", 1)
    (i, *_) = capture.cameras.train_indices
    errors = []
    for k in range(module.EXPOSURES):
        picture = torch.from_numpy(exposed_again(capture, lit, i, module.FURTHER + k, "8bit"))
        bright, params = enhance(picture, CONFIG)
        errors.append((bright - enhance(torch.from_numpy(capture.clean(i)), CONFIG, params)[0]).double().numpy())
    squared = np.mean(errors, 0) ** 2 - np.var(errors, 0, ddof=1) / len(errors)
    assert bias_floor(capture, lit, ENHANCEMENT) == pytest.approx(-10 * np.log10(squared.mean()), abs=1e-6)


def test_the_bias_floor_is_the_mean_over_views_spread_over_the_training_views(dark, monkeypatch):
    capture, lit = dark
    seen, biases, real = [], iter((0.01, 0.09)), module.exposed_again
    monkeypatch.setattr(module, "exposed_again", lambda *given: seen.append(given[2]) or real(*given))
    monkeypatch.setattr(module, "squared_bias", lambda *given: next(biases))
    monkeypatch.setattr(module, "EXPOSURES", 2)
    every = replace(capture, cameras=replace(capture.cameras, held_out=()))
    assert bias_floor(every, lit, ENHANCEMENT) == pytest.approx(-10 * np.log10(0.05))
    assert seen == [0, 0, 2, 2]


def a_run(folder: Path, capture: Capture, *, rendered: float, denoised: float | None, trained: bool = True):
    """Pictures of a run that leaves these shares of the noise in its renderings and in its targets; its truths."""
    truths, noisy = {}, {}
    for i in capture.cameras.train_indices:
        name = capture.names[i]
        bright, params = enhance(torch.from_numpy(capture.srgb8(i).copy()), CONFIG)
        noisy[name] = bright.numpy()
        clean = capture.clean(i, demosaiced=capture.demosaiced)
        truths[name] = enhance(torch.from_numpy(clean.copy()), CONFIG, params)[0].numpy()
        write_png(folder / "enhanced" / f"{name}.png", noisy[name])
        if denoised is not None:
            write_png(folder / "denoised" / f"{name}.png", truths[name] + denoised * (noisy[name] - truths[name]))
    run = SimpleNamespace(
        space="enhanced",
        path=folder, enhancement=ENHANCEMENT, shows_training_views=trained,
        rendering=lambda name: truths[name] + rendered * (noisy[name] - truths[name]),
    )  # fmt: skip
    return run, [centred_noise(noisy[name], truths[name]) for name in truths]


def test_the_runs_of_a_capture_share_its_bias_floor_unless_they_enhance_otherwise(dark, tmp_path, monkeypatch):
    capture, lit = dark
    monkeypatch.setattr(module, "_FLOORS", Memo())
    asked = []
    monkeypatch.setattr(module, "bias_floor", lambda *inputs: asked.append(inputs[2]) or 30.0 + len(asked))
    run, _ = a_run(tmp_path, capture, rendered=0.4, denoised=None)
    assert [noise_scores(run, capture, lit)["bias_floor"] for _ in range(2)] == [31.0, 31.0]
    run.enhancement = enhancement_record(EnhanceConfig(window=7), "8bit")
    assert noise_scores(run, capture, lit)["bias_floor"] == 32.0
    assert asked == [ENHANCEMENT, run.enhancement]


def test_a_camera_by_its_maps_is_not_taken_for_one_of_drawn_numbers(tmp_path, monkeypatch):
    """Its hot rows are in every picture, and an exposure that is taken again has none of them."""
    camera, offset = replace(PRESETS["a7s2-iso6400-3chip"], dsnu=1.0), np.zeros((30, 34), np.float32)
    offset[10:14] = 30.0
    write_maps(tmp_path / "mine.npz", Measured(offset=offset, response=np.ones((30, 34), np.float32)))
    write_sensor(tmp_path / "mine.toml", camera, maps="mine.npz")
    capture, lit = taken(tmp_path, sensor=str(tmp_path / "mine.toml"), electrons=20, seed=3)
    monkeypatch.setattr(module, "_FLOORS", Memo())
    run, _ = a_run(tmp_path / "run", capture, rendered=0.4, denoised=None)
    found = noise_scores(run, capture, lit)
    assert found["bias_floor"] is None
    assert found["known"] > 0


@pytest.mark.parametrize(("denoised", "targets"), [(None, 1.0), (0.25, 0.25)])
def test_the_shares_are_of_the_targets_and_of_the_renderings(dark, tmp_path, monkeypatch, denoised, targets):
    capture, lit = dark
    monkeypatch.setattr(module, "_FLOORS", Memo())
    monkeypatch.setattr(module, "bias_floor", lambda *inputs: 31.5 if inputs == (capture, lit, ENHANCEMENT) else 0.0)
    run, noise = a_run(tmp_path, capture, rendered=0.4, denoised=denoised)
    found = noise_scores(run, capture, lit)
    assert found["renders"] == pytest.approx(0.4, abs=1e-4)
    assert found["targets"] == pytest.approx(targets, abs=0.005)  # 8-bit pictures
    assert found["known"] == pytest.approx(float(np.sqrt(np.mean(np.square(noise)))))
    assert found["bias_floor"] == 31.5


def test_errors_of_demosaicing_are_no_noise(tmp_path, monkeypatch):
    capture, lit = taken(tmp_path / "bayer", sensor="a7s2-iso6400", electrons=200)
    monkeypatch.setattr(module, "_FLOORS", Memo())
    monkeypatch.setattr(module, "bias_floor", lambda *inputs: 0.0)
    run, noise = a_run(tmp_path / "run", capture, rendered=0.4, denoised=None)
    found = noise_scores(run, capture, lit)
    assert found["renders"] == pytest.approx(0.4, abs=1e-4)
    assert found["known"] == pytest.approx(float(np.sqrt(np.mean(np.square(noise)))))


def test_what_a_run_does_not_have_is_not_scored(dark, tmp_path, monkeypatch):
    capture, lit = dark
    monkeypatch.setattr(module, "_FLOORS", Memo())
    monkeypatch.setattr(module, "bias_floor", lambda *inputs: 0.0)
    run, _ = a_run(tmp_path, capture, rendered=0.4, denoised=None, trained=False)
    assert noise_scores(run, capture, lit)["renders"] is None
    run.enhancement = None
    assert noise_scores(run, capture, lit) is None


def test_each_capture_and_each_enhancement_has_a_bias_floor_of_its_own(dark, monkeypatch):
    """Whatever of the key is another: the capture, the settings, the weights that they name."""
    monkeypatch.setattr(module, "_FLOORS", Memo())
    monkeypatch.setattr(module, "bias_floor", lambda *given: len(made))
    monkeypatch.setattr(module, "stamps", lambda config: tuple(stamp))
    made, stamp, (capture, source) = [], ["w"], dark
    for other, settings, weights in ((capture, ENHANCEMENT, "w"), (replace(capture, content="x"), ENHANCEMENT, "w"),
                                     (capture, enhancement_record(CONFIG, "16bit"), "w"),
                                     (capture, ENHANCEMENT, "v")):  # fmt: skip
        stamp[:] = [weights]
        made.append(module._floor_of(other, source, settings))
    assert made == [0, 1, 2, 3]
    stamp[:] = ["w"]
    assert module._floor_of(capture, source, ENHANCEMENT) == 0


def test_another_seed_exposes_a_view_otherwise_and_the_same_alike(dark):
    capture, source = dark
    first, again, other = (exposed_again(capture, source, 1, seed, "8bit") for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_the_mean_is_of_all_values_that_are_known():
    assert module._mean([1.0, None, 4.0, None]) == 2.5
    assert module._mean([None, None]) is None
    assert module._mean([]) is None
