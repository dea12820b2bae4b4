"""Claims about what a reconstruction depends on, where its seed goes, and what is said before it begins."""

import io
import json
from dataclasses import make_dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from novags.methods.enhancers.networks.zero_dce import ZeroDce
from novags.methods.variant import Variant
from novags.methods.variant.several import MeanScene
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.run import Run, place_along
from novags.testbed.report.again import run_again
from novags.testbed.stages import reconstructing
from novags.testbed.stages.configs import reconstructing as module
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.viewer.splats import scene_of
from simscenes.sets.pictures.exr import read_exr

QUIET = Console(quiet=True)


def test_the_seed_reaches_the_camera_source_and_the_problem(capture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened, seeds, cameras_of = open_capture(capture), list[int](), reconstructing.cameras_of

    def noted(config: Any, capture: Any, source: Any, wanted: Any, points: int, seed: int, *more: Any) -> Any:
        seeds.append(seed)
        return cameras_of(config, capture, source, wanted, points, seed, *more)

    monkeypatch.setattr(reconstructing, "cameras_of", noted)
    config = replace(adapted(EXPERIMENTS["demo"], seed=7).reconstruct("naive"), points=50)
    prepared = reconstructing.prepare(opened, opened.source(QUIET), config, QUIET)
    assert prepared.problem.seed == 7
    assert seeds == [7]


def test_a_run_depends_on_its_captures_its_set_and_the_files_of_its_settings(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was hashed when it was opened is what is hashed again: the same parts, and here the same values."""
    asked: dict[str, Any] = {}

    def stage(*_: Any, **parts: Any) -> Any:
        asked.update(parts)
        raise ValueError("far enough")

    monkeypatch.setattr(reconstructing, "run_stage", stage)
    weights = tmp_path / "w.pth"
    torch.save(ZeroDce().state_dict(), weights)
    preset = adapted(EXPERIMENTS["demo"], methods=("zero-dce-gs",))
    config = replace(preset, settings={"enhance.weights": str(weights)}).reconstruct("zero-dce-gs")
    config = replace(config, more=capture)
    found = []
    for change in (b"", b"more"):
        weights.write_bytes(weights.read_bytes() + change)
        with pytest.raises(ValueError, match="far enough"):
            stages.reconstruct(capture, tmp_path / "run", config, QUIET)
        assert asked["inputs"]() == asked["opened"]
        found.append(asked["opened"])
    assert found[0].keys() == found[1].keys() > (same := {"capture", "set", "more"})
    assert {name for name in found[0] if found[0][name] != found[1][name]} == found[0].keys() - same


def test_the_seed_draws_the_views_that_nothing_is_trained_on(capture: Path) -> None:
    opened = open_capture(capture)
    count = len(opened.cameras.train_indices) - 2
    first, again, *others = (reconstructing.holding_out(opened, count, seed) for seed in (3, 3, *range(4, 9)))
    assert first.held == again.held
    assert set(first.held) <= set(opened.cameras.train_indices)
    assert len({other.held for other in (first, *others)}) > 1


def test_every_training_view_is_prepared_with_all_that_is_known_of_it(capture: Path) -> None:
    opened = open_capture(capture)
    config = replace(adapted(EXPERIMENTS["demo"]).reconstruct("oracle"), points=50)
    problem = reconstructing.prepare(opened, opened.source(QUIET), config, QUIET).problem
    train = opened.cameras.train_indices
    assert problem.names == tuple(opened.names[i] for i in train)
    assert problem.raw is not None
    held = ((problem.srgb8, opened.srgb8), (problem.linear16, opened.linear16), (problem.clean, opened.clean),
            (problem.raw.dn, opened.raw))  # fmt: skip
    for found, read in held:
        np.testing.assert_array_equal(found, np.stack([read(i) for i in train]).astype(np.float32))
    assert problem.exposures == tuple(opened.record.uneven.times(i) for i in train)
    assert (problem.raw.cfa, problem.raw.black, problem.raw.white) == opened.levels
    assert problem.raw.black < problem.raw.white
    lit = opened.source(QUIET)
    each = [float(np.mean(lit.lit(i) @ [0.299, 0.587, 0.114])) for i in train]
    assert reconstructing.lit_mean(lit, train) == pytest.approx(np.mean(each))
    assert len({round(value, 6) for value in each}) == len(each)


def test_a_run_has_a_camera_of_every_training_view_and_a_picture_of_every_view(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The method is one that trains nothing, and shows another scene after 5 iterations."""
    opened, drawn, along = open_capture(capture), list[tuple[int, Any]](), list[tuple[Path, int, Any]]()
    config = replace(adapted(EXPERIMENTS["demo"], seed=7).reconstruct("naive"), points=50)
    prepared = reconstructing.prepare(opened, opened.source(QUIET), config, QUIET)
    values = {"viewmats": None, "save": lambda folder: None, "space": "lit", "enhancement": None, "found": None,
              "config": config.config, "scene": SimpleNamespace(facts=dict), "seconds": {}, "enhanced": None,
              "along": {5: "earlier"}, "targets": None}  # fmt: skip
    result = make_dataclass("Result", values)(**values)
    method = SimpleNamespace(parts=None, train=lambda *_, **__: result, sees_clean=False, sees_surface=False)
    monkeypatch.setattr(reconstructing, "METHODS", {"naive": method})

    def shown(folder: Path, capture: Any, i: int, result: Any, view: Any) -> None:
        drawn.append((i, view)) if folder == tmp_path else along.append((folder, i, result.scene))

    monkeypatch.setattr(reconstructing, "write_rendering", shown)
    record = reconstructing.reconstruct_views(opened, prepared, tmp_path, config, QUIET)
    train = [opened.names[i] for i in opened.cameras.train_indices]
    listed = json.loads((tmp_path / "cameras.json").read_text())
    assert [camera["img_name"] for camera in listed] == train == record["cameras"]["registered"]
    assert len({str(camera["position"]) for camera in listed}) == len(train)
    assert [i for i, _ in drawn] == list(range(len(opened.names)))
    assert along == [(place_along(tmp_path, 5), i, "earlier") for i in opened.cameras.test_indices]
    assert len(along) > 1
    for i, view in drawn:
        np.testing.assert_allclose(view.viewmats[0], opened.cameras.rig.viewmats[i], atol=1e-5)
    assert (record["seed"], record["training_views"]) == (7, len(train))


@pytest.mark.parametrize("changed", ["a.pt", "b.pt"])
def test_each_file_that_settings_name_counts_and_its_neighbours_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    for name in ("a.pt", "b.pt"):
        (tmp_path / name).write_text(name)
    named = {"weights": (tmp_path / "a.pt", tmp_path / "b.pt")}
    config: Any = SimpleNamespace(config="settings", cameras="source")
    monkeypatch.setattr(module, "refuse_lost_files", lambda *_: None)
    monkeypatch.setattr(module, "files_among", lambda part: named if part == "settings" else {})
    before = module.files_of(config)
    (tmp_path / "beside.pt").write_text("no setting names it")
    assert module.files_of(config) == before
    (tmp_path / changed).write_text("other")
    after = module.files_of(config)
    assert after.keys() == before.keys() == {"weights: a.pt", "weights: b.pt"}
    assert {name for name in after if after[name] != before[name]} == {f"weights: {changed}"}


@pytest.mark.parametrize(("steps", "said"), [(8, True), (64, False)])
def test_a_part_that_is_too_short_to_work_is_said_before_it_begins(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, steps: int, said: bool
) -> None:
    def train(*_: Any, **__: Any) -> Any:
        raise ValueError("it began")

    stream, row = io.StringIO(), reconstructing.METHODS["nova"]
    monkeypatch.setattr(reconstructing, "METHODS", {"nova": replace(row, train=train)})
    preset = adapted(EXPERIMENTS["demo"], methods=("nova-fast",), points=60, iterations=900, denoiser_steps=steps)
    with pytest.raises(ValueError, match="it began"):
        stages.reconstruct(capture, tmp_path / "run", preset.reconstruct("nova-fast"), Console(stream=stream))
    told = f"reconstruct nova-fast: {steps} steps of denoiser are too few to work, of at least 64"
    assert (told in stream.getvalue()) == said
    assert "steps of fit are too few" not in stream.getvalue()


def test_a_run_of_several_fits_is_kept_shown_and_made_again(capture: Path, tmp_path: Path) -> None:
    """By the stage, as a user does: the identity has the number of fits, and the viewer reads the mean back."""
    preset = replace(adapted(EXPERIMENTS["demo"], methods=("naive", "naive*2")), points=60)
    preset = replace(preset, settings={**preset.settings, "fit.iterations": 30})
    said = io.StringIO()
    records = {}
    for name in preset.methods:
        config = preset.reconstruct(name)
        records[name] = stages.reconstruct(capture, tmp_path / name, config, Console(stream=said))
    one, two = (records[name] for name in preset.methods)
    assert one["stage"]["key"] != two["stage"]["key"]
    assert (two["name"], two["method"], len(two["fits"])) == ("naive-x2", "naive", 2)
    assert two["gaussians"] == sum(facts["gaussians"] for facts in two["fits"])
    assert not (tmp_path / "naive-x2" / "checkpoints").exists()
    run = Run(tmp_path / "naive-x2", two)
    scene = scene_of(run)
    assert isinstance(scene, MeanScene)
    assert len(scene.scenes) == 2
    cut = [place.name for place in (tmp_path / "naive-x2" / "scene").iterdir()]
    assert sorted(cut) == ["fit-1", "fit-2"]
    first = (tmp_path / "naive" / "point_cloud.ply").read_bytes()
    assert (tmp_path / "naive-x2" / "scene" / "fit-1" / "point_cloud.ply").read_bytes() == first
    mean, single = (read_exr(tmp_path / name / "exr" / "0000.exr")[0]["R"] for name in preset.methods[::-1])
    assert np.abs(mean - single).max() > 0
    again = run_again(run, tmp_path)
    assert again is not None
    assert "--method naive-x2 --iterations 30" in again
    (tmp_path / "naive-x2" / "scene" / "fit-2" / "point_cloud.ply").unlink()
    assert scene_of(run) is None  # the mean of the fits that are left would be another scene


def test_no_iterations_are_said_to_leave_the_first_gaussians(capture: Path, tmp_path: Path) -> None:
    told = io.StringIO()
    for count in (0, 1):
        variant = Variant(name=f"after{count}", method="naive", settings={"fit.iterations": str(count)})
        config = ReconstructConfig(variant=variant, points=50)
        record = stages.reconstruct(capture, tmp_path / variant.name, config, Console(stream=told))
        assert record["config"]["fit"]["iterations"] == count
    assert told.getvalue().count("0 iterations of the fit: the first Gaussians") == 1
    assert "reconstruct after0: 0 iterations" in told.getvalue()
