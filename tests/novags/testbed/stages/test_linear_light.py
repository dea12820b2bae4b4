"""Runs that end in linear light: how they are shown, scored, and opened again; imports of files that do not fit."""

import base64
import io
import re
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from novags.methods import METHODS, chosen
from novags.methods.enhancers import enhancement_record
from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import EnhanceParams, enhance
from novags.methods.problem import encode
from novags.methods.reconstruction import Reconstruction
from novags.settings import changed
from novags.splats import Views
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.exposures import exposures_of
from novags.testbed.folders.references import enhanced_truth, pictured, references
from novags.testbed.folders.run import CHECKPOINTS, Run, open_run
from novags.testbed.metrics.images import aligned_psnr, image_scores
from novags.testbed.report.page import write_report
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.reconstructing import ReconstructConfig
from novags.testbed.stages.reconstructing import prepare
from novags.testbed.study.knobs.reconstruction import held_out_error
from novags.testbed.viewer.splats import scene_of
from sensor_model import srgb_to_linear
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import read_png, write_png
from tests.novags.testbed.stages.test_import import NAMES, brought, foreign, line  # noqa: F401

QUIET = Console(quiet=True)
ENHANCE = EnhanceConfig(window=9)
SIDE = 32


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """Nine posed photographs of smooth colours at 30 electrons."""
    folder = tmp_path_factory.mktemp("linear")
    names = [f"{i:04d}" for i in range(9)]
    write_cameras(folder / "set", names, orbit_rig(9, SIDE, SIDE, 50.0, radius=3.0))
    (folder / "set" / "images").mkdir()
    rng = np.random.default_rng(0)
    for name in names:
        smooth = cv2.resize(rng.integers(20, 250, (5, 5, 3), np.uint8), (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(folder / "set" / "images" / f"{name}.png"), smooth)
    stages.capture(folder / "set", folder / "cap", CaptureConfig(electrons=30, seed=3), QUIET)
    return open_capture(folder / "cap")


@pytest.fixture(scope="module")
def run(capture: Capture) -> Run:
    """A short run of a method that ends in linear light and states an enhancement."""
    variant = chosen("nova-plus")
    config = changed(variant.config(_default(), {}), {"fit.iterations": 24, "seeds": 1, "enhance.window": 9}, what="x")
    out = capture.path.parent / "run"
    stages.reconstruct(capture.path, out, ReconstructConfig(variant=variant, config=config, points=120), QUIET)
    return open_run(out)


def _default() -> Any:
    return METHODS["nova-plus"].config()


def linear(enhancement: Any) -> Any:
    return SimpleNamespace(space="linear", enhancement=enhancement)


def test_linear_light_goes_through_the_stated_enhancement_with_the_mean_parameters_of_the_training_views(
    capture: Capture,
) -> None:
    light = capture.linear16(0).clip(0)
    found = pictured(linear(enhancement_record(ENHANCE, "8bit")), capture, light)
    params = [enhance(torch.from_numpy(capture.srgb8(i).copy()), ENHANCE)[1] for i in capture.cameras.train_indices]
    middle = EnhanceParams(
        gamma=sum(p.gamma for p in params) / len(params),  # type: ignore[arg-type]
        epsilon=sum(p.epsilon for p in params) / len(params),  # type: ignore[arg-type]
        radius=params[0].radius,
    )
    want, _ = enhance(torch.from_numpy(encode(light)), ENHANCE, middle)
    np.testing.assert_allclose(found, want.numpy(), atol=1e-6)
    gammas = [float(p.gamma) for p in params]
    assert max(gammas) - min(gammas) > 1e-3  # or any of them would have done


def test_linear_light_without_an_enhancement_is_encoded_and_other_pictures_are_left_alone(capture: Capture) -> None:
    light = capture.linear16(0)
    np.testing.assert_array_equal(pictured(linear(None), capture, light), encode(light))
    made: Any = SimpleNamespace(space="enhanced", enhancement=enhancement_record(ENHANCE, "8bit"))
    assert pictured(made, capture, light) is light


def test_a_run_in_linear_light_is_scored_against_each_of_its_references(capture: Capture, run: Run) -> None:
    metrics = stages.score(run.path, QUIET)["methods"]["nova-plus"]
    source = capture.source(QUIET)
    for i in capture.cameras.test_indices:
        name = capture.names[i]
        assert list(metrics["views"][name]) == ["enhanced", "linear", "lit"]
        truth = references(run, capture, source, i)["enhanced"]
        want = image_scores(pictured(run, capture, run.rendering(name)), truth)
        assert metrics["views"][name]["enhanced"]["aligned_psnr"] == pytest.approx(want["aligned_psnr"])
        assert metrics["views"][name]["linear"]["linear_psnr"] > 10
        lit = source.lit(i)
        brought = encode(_gain_to_lit(capture, run, source) * run.rendering(name))
        assert metrics["views"][name]["lit"]["psnr"] == pytest.approx(image_scores(brought, lit)["psnr"], abs=1e-3)
    assert metrics["training_2d"]["enhanced"] is not None


def _gain_to_lit(capture: Capture, run: Run, source: Any) -> float:
    """The factor on all views that brings them nearest to the lit pictures in linear light, where these do not clip."""
    cross = energy = 0.0
    for i in capture.cameras.test_indices:
        light, code = run.rendering(capture.names[i]).astype(np.float64), source.lit(i)
        target = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
        cross += float((light * target)[code < 1].sum())
        energy += float((light**2)[code < 1].sum())
    return cross / energy


def test_curves_of_accuracy_take_linear_light_through_the_enhancement_too(capture: Capture) -> None:
    variant = chosen("nova-plus")
    wanted = ReconstructConfig(variant=variant, config=_default(), points=120)
    prepared = prepare(capture, capture.source(QUIET), wanted, QUIET)
    rng = np.random.default_rng(1)
    views = capture.cameras.test_indices
    lights = [capture.clean_linear(i) * rng.uniform(0.8, 1.2, (SIDE, SIDE, 1)).astype(np.float32) for i in views]
    left = iter(lights)
    scene: Any = SimpleNamespace(render=lambda view: (torch.from_numpy(next(left))[None], None, None))
    record = enhancement_record(ENHANCE, "8bit")
    made = Reconstruction(scene=scene, space="linear", config=None, enhancement=record)
    found = held_out_error(made, prepared, capture, capture)
    truths = [enhanced_truth(capture, i, record) for i in views]
    shown = [pictured(linear(record), capture, light) for light in lights]
    scores = [aligned_psnr(image, truth) for image, truth in zip(shown, truths, strict=True)]
    assert found == pytest.approx(100 * 10 ** (-np.mean(scores) / 20), rel=1e-6)  # type: ignore[arg-type]


def test_pictures_on_disk_are_as_they_are_shown_and_floats_are_light(capture: Capture, run: Run) -> None:
    name = capture.names[capture.cameras.test_indices[0]]
    light = run.rendering(name)
    shown = read_png(run.path / "renders" / f"{name}.png")
    np.testing.assert_allclose(shown, np.clip(pictured(run, capture, light), 0, 1), atol=0.5 / 255 + 1e-6)
    exposure = np.mean([capture.clean_linear(i).mean() for i in capture.cameras.train_indices])
    assert light.mean() == pytest.approx(exposure, rel=0.2)


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("nova-plus", "tone"),
        ("raw-gs", "matrix"),
        ("gaussian-dk", "response"),
        ("lita-gs", "denoiser"),
        ("le3d", "network"),
    ],
)
def test_a_saved_scene_gives_the_same_light_again(capture: Capture, run: Run, name: str, kept: str) -> None:
    if name != "nova-plus":
        variant, out = chosen(name), capture.path.parent / name
        config = changed(variant.config(METHODS[name].config(), {}), {"fit.iterations": 12}, what="x")
        stages.reconstruct(capture.path, out, ReconstructConfig(variant=variant, config=config, points=120), QUIET)
        run = open_run(out)
    scene = scene_of(run)
    assert scene is not None
    assert getattr(scene, kept) is not None
    i = capture.cameras.test_indices[0]
    rig = capture.cameras.rig
    view = Views(
        torch.from_numpy(np.asarray(rig.viewmats, np.float32))[i : i + 1],
        torch.from_numpy(np.asarray(rig.Ks, np.float32))[i : i + 1], SIDE, SIDE,
    )  # fmt: skip
    again = scene.render(view)[0][0].numpy()
    np.testing.assert_allclose(again, run.rendering(capture.names[i]), rtol=1e-3, atol=1e-6)


def test_the_report_shows_the_light_at_the_exposures_of_both_truths(capture: Capture, run: Run) -> None:
    stages.score(run.path, QUIET)
    page = write_report(run.path, QUIET).read_text(encoding="utf-8")
    first = page.split('<div class="grid"')[1]
    tiles = dict(re.findall(r'<figure data-key="([^"]+)"><img (?:data-strip|src="([^"]+)")', first))
    labels = re.findall('data-label="(.*?)"', first)
    assert len(set(labels)) == len(labels) == len(tiles)  # or no list could tell which is which
    name, source = capture.names[capture.cameras.test_indices[0]], capture.source(QUIET)
    light = run.rendering(name)
    gains = exposures_of(run, capture, source)
    for kind, gain in (("dark", gains.dark), ("lit", gains.lit)):
        assert gain is not None
        codes = cv2.imdecode(np.frombuffer(base64.b64decode(tiles[f"{kind}-nova-plus"].partition(",")[2]), np.uint8), 1)
        assert codes is not None
        assert np.abs(codes[..., ::-1] - 255 * encode(gain * light).clip(0, 1)).max() <= 0.51
    assert gains.lit is not None
    assert gains.dark is not None
    assert gains.lit > 3 * gains.dark  # the well-lit picture is brighter
    assert "nova-plus: linear light, brought to the exposure of the well-lit pictures" in page


def test_nothing_that_only_unfinished_work_needs_is_left(run: Run) -> None:
    assert not any((run.path / name).exists() for name in CHECKPOINTS)
    assert run.record["found"]["held_out_pixels"] > 0
    assert Path(run.path / "point_cloud.ply").is_file()


@pytest.mark.parametrize("name", ["0001", "0005"])
def test_a_raw_file_that_cannot_be_read_costs_no_finished_import(name: str, line: Path, tmp_path: Path) -> None:  # noqa: F811
    strangers = foreign(tmp_path / "dark", line, "images", "raw")
    brought(strangers, tmp_path / "cap", time=0.02)
    before = {path: path.read_bytes() for path in (tmp_path / "cap").rglob("*") if path.is_file()}
    shutil.copy(strangers / "raw" / "0007.dng", strangers / "raw" / "0000.dng")  # which would be written anew
    whole = (strangers / "raw" / f"{name}.dng").read_bytes()
    (strangers / "raw" / f"{name}.dng").write_bytes(whole[: len(whole) // 2])  # its header can be read, its pixels not
    with pytest.raises(ValueError, match=rf"{name}\.dng"):
        brought(strangers, tmp_path / "cap", time=0.02)
    assert before == {path: path.read_bytes() for path in (tmp_path / "cap").rglob("*") if path.is_file()}


def test_raw_files_are_refused_from_the_first_on_where_cameras_are_of_shrunk_pictures(
    line: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    dark = foreign(tmp_path / "dark", line, "raw")
    write_cameras(dark, NAMES, orbit_rig(9, 20, 15, 50.0, radius=3.0))
    for name in NAMES:
        write_png(dark / "images" / f"{name}.png", np.full((15, 20, 3), 9, np.uint8))
    with pytest.raises(ValueError, match=r"0000\.dng must be 20 x 15 px .* got 40 x 30: .* probably shrunk by 2; give"):
        brought(dark, tmp_path / "cap")


@pytest.mark.parametrize("place", [0, 8])
def test_one_jpeg_among_the_photographs_makes_channels_share_noise(
    place: int,
    line: Path,  # noqa: F811
    tmp_path: Path,
) -> None:
    dark = foreign(tmp_path / "dark", line, "images")
    picture, listed = dark / "images" / f"{NAMES[place]}.png", dark / "transforms.json"
    assert cv2.imwrite(str(picture.with_suffix(".jpg")), cv2.imread(str(picture)))
    picture.unlink()
    listed.write_text(listed.read_text().replace(picture.name, picture.with_suffix(".jpg").name))
    assert brought(dark, tmp_path / "cap").channels_share == ("demosaicing", "JPEG")


def test_held_out_pictures_are_brighter_by_the_median_of_a_few_of_each(tmp_path: Path) -> None:
    """Rationale: one lamp switched on, or one failed exposure, does not make a data set of lit pictures."""
    codes = np.array([10, 40, 30, 250, 20, 120, 40, 180, 60], np.uint8)
    write_cameras(tmp_path / "dark", NAMES, orbit_rig(9, SIDE, SIDE, 50.0, radius=3.0), held_out=(1, 3, 5, 7))
    for name, code in zip(NAMES, codes, strict=True):
        write_png(tmp_path / "dark" / "images" / f"{name}.png", np.full((SIDE, SIDE, 3), code))
    brought(tmp_path / "dark", tmp_path / "cap", Console(stream=(said := io.StringIO())))
    light = srgb_to_linear(codes / 255)
    times = np.median(light[[1, 3, 5, 7]]) / np.median(light[[0, 4, 8]])
    assert f"dark are {times:.0f} times as bright as the others" in " ".join(said.getvalue().split())
