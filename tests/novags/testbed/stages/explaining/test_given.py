"""Claims about truths in place of one ingredient of a problem: that one changes, and the others do not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from novags.cameras import parse_cameras
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.stages import reconstructing
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.stages.explaining.given import GIVEN
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from tests.fuzz.readers.records import make_set

QUIET = Console(quiet=True)


def prepared(capture: Path, config: ReconstructConfig) -> reconstructing.PreparedProblem:
    opened = open_capture(capture)
    return reconstructing.prepare(opened, opened.source(QUIET), config, QUIET)


def test_without_noise_every_kind_of_picture_is_the_clean_exposure_and_points_and_cameras_stay(capture: Path) -> None:
    config = replace(adapted(EXPERIMENTS["demo"]).reconstruct("naive"), points=50, device="cpu")
    noisy = prepared(capture, config).problem
    clean = prepared(capture, replace(config, given="noise")).problem
    opened = open_capture(capture)
    train = opened.cameras.train_indices
    np.testing.assert_array_equal(clean.srgb8, np.stack([opened.clean(i) for i in train]))
    assert clean.raw is not None
    assert clean.linear16 is not None
    np.testing.assert_array_equal(clean.linear16, np.stack([opened.clean_linear(i) for i in train]))
    np.testing.assert_array_equal(clean.raw.dn, np.stack([opened.truth(i, "clean") for i in train]))
    assert not torch.equal(noisy.srgb8, clean.srgb8)
    assert torch.equal(noisy.start.points, clean.start.points)
    assert torch.equal(noisy.views.viewmats, clean.views.viewmats)
    assert clean.shared is not noisy.shared  # pictures enhanced for the one are not the other's


def test_true_first_points_are_those_of_the_true_cameras_in_the_frame_of_the_runs_own(tmp_path: Path) -> None:
    make_set(tmp_path / "set", views=6)
    stages.capture(tmp_path / "set", tmp_path / "capture", CaptureConfig(electrons=200.0), QUIET)
    preset = adapted(EXPERIMENTS["demo"], cameras=parse_cameras("known:depth_error=0.5"))
    wrong = replace(preset.reconstruct("naive"), points=50, device="cpu", seed=7)
    exact = replace(wrong, cameras=parse_cameras("known"))
    start = prepared(tmp_path / "capture", replace(wrong, given="points")).problem.start
    true, own = (prepared(tmp_path / "capture", config).problem.start for config in (exact, wrong))
    torch.testing.assert_close(start.points, true.points)
    assert not torch.allclose(start.points, own.points)


def test_a_truth_is_part_of_what_a_run_is_asked_for_and_none_leaves_no_trace() -> None:
    config = adapted(EXPERIMENTS["demo"]).reconstruct("naive")
    assert "given" not in config.resolved()
    asked = [replace(config, given=name).resolved()["given"] for name in GIVEN]
    assert asked == list(GIVEN)
