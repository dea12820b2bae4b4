"""Real photographs through the whole line, at a tiny size."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.report.page import write_report
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.study.cells.presets import Preset, adapted
from simscenes import orbit_rig
from simscenes.rigs import opencv_to_opengl
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.exr import write_exr


@pytest.fixture(scope="module")
def capture(fox: Path, tmp_path_factory: pytest.TempPathFactory, quiet: Console) -> Path:
    folder = tmp_path_factory.mktemp("fox") / "capture"
    stages.capture(fox, folder, CaptureConfig(sensor="a7s2-iso6400", electrons=20.0, max_size=40), quiet)
    return folder


def test_photographs_are_scaled_with_their_cameras(capture: Path) -> None:
    rig = open_capture(capture).cameras.rig
    assert (rig.width, rig.height) == (22, 40)
    # The principal point of the original lies near the middle, and so must that of the scaled one.
    assert np.abs(rig.Ks[0, :2, 2] / (22, 40) - 0.5).max() < 0.05


def test_the_lit_reference_is_the_photograph_itself(capture: Path, quiet: Console) -> None:
    opened = open_capture(capture)
    source = opened.source(quiet)
    photograph = source.views.image(5).astype(np.float64) / 255
    assert source.lit(5).shape == (40, 22, 3)
    # Averaging light, not codes, brightens edges a little.
    assert source.lit(5).mean() == pytest.approx(photograph.mean(), rel=0.1)


def test_photographs_are_reconstructed_scored_and_reported(
    capture: Path, tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    config = adapted(tiny, points=200, iterations=10).reconstruct("nova-fast")
    stages.reconstruct(capture, tmp_path / "run", config, quiet)
    metrics = stages.score(tmp_path / "run", quiet)
    assert len(metrics["methods"]["nova-fast"]["views"]) == 7
    assert "render" not in metrics["methods"]["nova-fast"]["seconds"]
    page = write_report(tmp_path / "run", quiet).read_text(encoding="utf-8")
    assert "The light was not simulated" in page
    assert "made linear by undoing the sRGB curve" in page


def test_the_report_does_not_undo_a_curve_that_linear_files_never_had(
    tiny: Preset, quiet: Console, tmp_path: Path
) -> None:
    names = [f"{i:04d}" for i in range(4)]
    write_cameras(tmp_path / "set", names, orbit_rig(4, 24, 24, 50.0, radius=3.0))
    transforms = tmp_path / "set" / "transforms.json"
    transforms.write_text(transforms.read_text().replace(".png", ".exr"))
    (tmp_path / "set" / "images").mkdir()
    light = np.random.default_rng(0).random((24, 24, 3), dtype=np.float32)
    for name in names:
        write_exr(tmp_path / "set" / "images" / f"{name}.exr", dict(zip("RGB", np.moveaxis(light, -1, 0), strict=True)))
    stages.capture(tmp_path / "set", tmp_path / "capture", CaptureConfig(), quiet)
    config = adapted(tiny, points=50, iterations=2).reconstruct("naive")
    stages.reconstruct(tmp_path / "capture", tmp_path / "run", config, quiet)
    stages.score(tmp_path / "run", quiet)
    page = write_report(tmp_path / "run", quiet).read_text(encoding="utf-8")
    assert "photographs, their linear light taken as radiance" in page
    assert "sRGB curve" not in page


def test_photographs_of_any_name_go_through_the_whole_line(tiny: Preset, quiet: Console, tmp_path: Path) -> None:
    files = ["a.png", "a-b.png", "photo.png", "photo (1).png", "one/x.png", "two/x.png", "new\nline.png", "日本[b].png"]
    frames, shades = [], np.random.default_rng(0)
    for name, pose in zip(
        files, opencv_to_opengl(orbit_rig(len(files), 32, 32, 50.0, radius=3.0).viewmats), strict=True
    ):
        (tmp_path / "set" / name).parent.mkdir(parents=True, exist_ok=True)
        done, data = cv2.imencode(".png", shades.integers(20, 200, (32, 32, 3), dtype=np.uint8))
        assert done
        (tmp_path / "set" / name).write_bytes(data.tobytes())
        frames.append({"file_path": name, "transform_matrix": pose.tolist()})
    (tmp_path / "set" / "transforms.json").write_text(json.dumps({"fl_x": 30.0, "frames": frames}))
    (tmp_path / "set" / "stray.png").write_bytes((tmp_path / "set" / "a.png").read_bytes())
    stages.capture(tmp_path / "set", tmp_path / "capture", CaptureConfig(), quiet)
    capture = open_capture(tmp_path / "capture")
    assert sorted(capture.record.files.values()) == sorted(files)
    config = adapted(tiny, points=50, iterations=2).reconstruct("naive")
    stages.reconstruct(tmp_path / "capture", tmp_path / "run", config, quiet)
    views = stages.score(tmp_path / "run", quiet)["methods"]["naive"]["views"]
    assert list(views) == ["a-b"] == [sorted(f"{name}.png" for name in capture.names)[0].removesuffix(".png")]
    page = write_report(tmp_path / "run", quiet).read_text(encoding="utf-8")
    assert "a-b · held out" in page
    assert page.count(" · training") == 2  # of four
    assert "8 of 9 photographs of set" in page
    assert "No camera was found for 1 of 9 photographs, which are left out: stray.png." in page
    listed = (tmp_path / "capture" / "train_list.txt").read_text(encoding="utf-8").splitlines()
    assert sorted(listed) == sorted(f"{name}.png" for name in capture.names if name != "a-b")
