"""The method `averaging` from a capture to its scores, and what it refuses."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from novags.cameras import parse_cameras
from novags.methods import METHODS, chosen
from novags.methods.averaging import trainer
from novags.methods.averaging.scene import LEAST
from novags.methods.inputs import LacksInput
from novags.methods.problem import Problem
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.stages.reconstructing import prepare
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from simscenes import read_exr

QUIET = Console(quiet=True)
TINY: dict[str, Any] = {"scene": "cornell", "n_views": 9, "width": 24, "height": 24, "spp": 4, "points": 100}


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("averaging")
    stages.render(folder / "set", replace(adapted(EXPERIMENTS["demo"], **TINY).render, variant="scalar"), QUIET)
    for electrons in (2.0, 200.0):
        config = adapted(EXPERIMENTS["demo"], **TINY, electrons=electrons).capture
        stages.capture(folder / "set", folder / f"{electrons:g}", config, QUIET)
    return folder


def scored(captures: Path, level: str, name: str, out: Path) -> dict[str, Any]:
    preset = adapted(EXPERIMENTS["demo"], **TINY, methods=(name,))
    record = stages.reconstruct(captures / level, out, preset.reconstruct(name), QUIET)
    (found,) = stages.score(out, QUIET)["methods"].values()
    return {**found, "record": record}


def test_light_and_noise_free_exposures_both_raise_the_score(captures: Path, tmp_path: Path) -> None:
    asked = (("2", "averaging"), ("200", "averaging"), ("2", "averaging-clean"))
    found = {(level, name): scored(captures, level, name, tmp_path / f"{name}{level}") for level, name in asked}
    psnr = {key: value["mean"]["enhanced"]["aligned_psnr"] for key, value in found.items()}
    assert psnr["2", "averaging"] + 3 < psnr["200", "averaging"]
    assert psnr["2", "averaging"] + 3 < psnr["2", "averaging-clean"]
    one = found["200", "averaging"]
    assert one["record"]["exposures"] == 7
    assert one["record"]["pixels"] == 9 * 24 * 24
    assert 0 <= one["record"]["holes"] < 0.1 * one["record"]["pixels"]
    assert one["geometry"]["abs_rel"] < 1e-4  # where it shows a surface, it is the true one
    assert one["geometry"]["coverage"] > 0.9
    channels, _ = read_exr(tmp_path / "averaging200" / "exr" / "0000.exr")
    assert {"R", "G", "B", "Z", "alpha"} <= channels.keys()
    with np.load(tmp_path / "averaging200" / "scene" / "exposures.npz") as saved:
        assert saved["exposures"].shape == (7, 24, 24, 3)


def test_held_out_exposures_are_no_part_of_it(captures: Path) -> None:
    """Rationale: truth gives it all cameras, and a held-out picture among the sources would be the answer itself."""
    config = adapted(EXPERIMENTS["demo"], **TINY, methods=("averaging",)).reconstruct("averaging")
    capture = open_capture(captures / "200")
    prepared = prepare(capture, capture.source(QUIET), config, QUIET)
    problem = prepared.problem
    assert problem.surface is not None
    assert problem.surface.training == tuple(capture.cameras.train_indices)
    scene = METHODS["averaging"].train(problem, config.config).scene
    for camera, viewmat in zip(scene.sources, problem.views.viewmats, strict=True):
        assert np.allclose(camera.viewmat, viewmat.numpy(), atol=1e-5)


def test_variances_are_those_at_the_true_mean_and_not_at_noisy_values(captures: Path) -> None:
    config = adapted(EXPERIMENTS["demo"], **TINY, methods=("averaging",)).reconstruct("averaging")
    capture = open_capture(captures / "2")
    problem = prepare(capture, capture.source(QUIET), config, QUIET).problem
    assert problem.noise is not None
    scene = METHODS["averaging"].train(problem, config.config).scene
    clean = np.stack([capture.clean_linear(i) for i in capture.cameras.train_indices])
    want = problem.noise.linear16(torch.from_numpy(clean.clip(0, 1)).double()).numpy()
    np.testing.assert_allclose(list(scene.variances), want, rtol=1e-3)


def test_a_pixel_without_noise_counts_as_a_share_of_the_noisiest_and_none_divides_by_zero() -> None:
    clean = torch.tensor([[0.0, 0.1, 0.2], [0.0, 0.5, 1.0]]).reshape(2, 1, 3, 1).expand(2, 2, 3, 3)
    for slope in (4.0, 0.0):
        noise: Any = lambda mean, slope=slope: slope * mean  # noqa: E731
        variances = np.stack(list(trainer._exposures(clean + 0.1, clean, [noise] * 2, "noisy")[1]))
        most = max(slope, LEAST)
        assert variances.min() == pytest.approx(LEAST * most, abs=0)
        assert variances.max() == pytest.approx(slope or LEAST * LEAST, abs=0)


@pytest.mark.parametrize("name", ["averaging", "averaging-clean"])
def test_other_cameras_are_refused_before_anything_runs(name: str) -> None:
    preset = {**TINY, "methods": (name,), "cameras": parse_cameras("known:rotation_deg=1")}
    with pytest.raises(ValueError, match=f"{name} follows the true surface .* known:rotation_deg=1.*: use known"):
        adapted(EXPERIMENTS["demo"], **preset)
    with pytest.raises(ValueError, match="cameras = sfm"):
        adapted(EXPERIMENTS["demo"], **{**preset, "cameras": parse_cameras("sfm")})


def test_a_capture_without_true_depth_is_refused(captures: Path, tmp_path: Path) -> None:
    capture = adapted(EXPERIMENTS["demo"], **TINY, max_size=23).capture
    stages.capture(captures / "set", tmp_path / "small", capture, QUIET)
    config = adapted(EXPERIMENTS["demo"], **TINY, methods=("averaging",)).reconstruct("averaging")
    with pytest.raises(LacksInput, match=r"averaging follows the true surface, .* it is not known"):
        stages.reconstruct(tmp_path / "small", tmp_path / "run", config, QUIET)


def test_only_its_row_gets_the_surface(problem: Callable[..., Problem]) -> None:
    assert [name for name, method in METHODS.items() if method.sees_surface] == ["averaging"]
    with pytest.raises(LacksInput, match="needs the true surface, the linear 16-bit pictures"):
        METHODS["averaging"].train(problem(), chosen("averaging").config(METHODS["averaging"].config(), {}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"exposures": "bright"}, "exposures must be one of noisy, noise-free, got 'bright'"),
        ({"kernel": "box"}, "kernel must be one of cubic, linear"),
        ({"tolerance": 0.0}, r"tolerance must lie in \(0, 1\), got 0.0"),
        ({"coarsest": 0.5}, "coarsest must be >= 1 pixel, got 0.5"),
    ],
)
def test_settings_out_of_range_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        METHODS["averaging"].config(**changes)
