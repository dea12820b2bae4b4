"""Claims about the truth of cameras with a colour filter array: all three channels of each pixel, not interpolated."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch

from novags.methods.enhancers.choice import EnhanceConfig
from novags.methods.enhancers.guided import enhance
from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.references import references
from novags.testbed.folders.run import open_run
from novags.testbed.folders.runs import runs_in
from novags.testbed.report.page import write_report
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.study.cells.presets import EXPERIMENTS, adapted
from novags.testbed.study.place import run
from sensor_model import develop_linear, read_sensor, srgb_to_linear
from sensor_model.mosaicking import channel_index
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.exr import read_exr, write_exr
from simscenes.sets.pictures.png import read_png, write_png

QUIET = Console(quiet=True)
SIZE = (32, 24)
# Every part of the noise-free response: droop, dark charge, saturation, filters of unequal sensitivity
CAMERA = """gain = 2.0
eta = 0.5
mu_e_sat = 400.0
black_level = 64.0
bits = 10
sigma_d = 2.0
nonlinearity = 0.1
dark_current = 90.0
rgb_response = [0.7, 1.0, 0.5]
prnu = 0.02
dsnu = 3.0
cfa = "GRBG"
"""
ELECTRONS, TIME = 150.0, 1 / 30


@pytest.fixture(scope="module")
def mosaics(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set of nine photographs of fine texture, and captures of it by a camera with a filter array and by its twin."""
    folder, rng = tmp_path_factory.mktemp("mosaics"), np.random.default_rng(0)
    names = [f"{i:04d}" for i in range(9)]
    write_cameras(folder / "set", names, orbit_rig(9, *SIZE, 50.0, radius=3.0))
    for name in names:
        write_png(folder / "set" / "images" / f"{name}.png", rng.integers(20, 250, (*SIZE[::-1], 3)).astype(np.uint8))
    for name, text in (("bayer", CAMERA), ("chips", CAMERA.replace("GRBG", "none"))):
        (folder / f"{name}.toml").write_text(text)
        config = CaptureConfig(sensor=str(folder / f"{name}.toml"), electrons=ELECTRONS, time=TIME, tolerance=None)
        stages.capture(folder / "set", folder / name, config, QUIET)
    return folder


def test_the_noise_free_exposure_of_a_mosaic_is_the_response_at_all_three_channels(mosaics: Path) -> None:
    """Expectation: pixel by pixel from the formulas of the camera's file, and one channel of it in the raw frame."""
    capture = open_capture(mosaics / "bayer")
    lights = [srgb_to_linear(read_png(mosaics / "set" / "images" / f"{name}.png")) for name in capture.names]
    mean_green = np.mean([light[..., 1].mean(dtype=np.float64) for light in lights])
    electrons = ELECTRONS * lights[3].astype(np.float64) / mean_green * [0.7, 1.0, 0.5] + 90.0 * TIME
    held = np.minimum(electrons, 400.0)
    white = 64.0 + 2.0 * 400.0 * (1 - 0.1)
    dn = np.minimum(64.0 + 2.0 * (held - 0.1 / 400.0 * held**2), white)
    linear = (dn - 64.0) / (white - 64.0) * (1.0 / np.array([0.7, 1.0, 0.5]))
    assert (electrons > 400.0).any()  # some saturate
    np.testing.assert_allclose(capture.clean_linear(3), linear, rtol=2e-6, atol=1e-7)
    index = channel_index(dn.shape[:2], "GRBG")
    np.testing.assert_allclose(
        capture.truth(3, "clean"), np.take_along_axis(dn, index[..., None], 2)[..., 0], rtol=1e-6
    )


def test_it_is_what_three_chips_of_the_same_camera_would_have_given(mosaics: Path) -> None:
    mosaic, chips = open_capture(mosaics / "bayer"), open_capture(mosaics / "chips")
    assert chips.sensor.cfa is None
    np.testing.assert_array_equal(mosaic.clean(5), chips.clean(5))
    np.testing.assert_array_equal(chips.clean(5, demosaiced=True), chips.clean(5))
    channels, _ = read_exr(mosaics / "chips" / "truth" / "0005.exr")
    assert {name for name in channels if name.startswith("clean")} == {"clean.R", "clean.G", "clean.B"}


def test_the_exr_package_opens_the_truth_of_every_camera_as_it_opens_files_without_being_asked(mosaics: Path) -> None:
    for camera, planes in (("bayer", {"mean", "variance", "clean", "saturated", "clean_rgb"}), ("chips", {"clean"})):
        path = mosaics / camera / "truth" / "0005.exr"
        with OpenEXR.File(str(path)) as file:
            pixels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
        channels, _ = read_exr(path)
        assert planes <= pixels.keys()
        for name, found in pixels.items():
            named = [name] if found.ndim == 2 else [f"{name}.{colour}" for colour in "RGB"]
            np.testing.assert_array_equal(np.atleast_3d(found), np.stack([channels[each] for each in named], -1))


def test_the_interpolated_mosaic_has_a_name_of_its_own(mosaics: Path) -> None:
    capture = open_capture(mosaics / "bayer")
    sensor = read_sensor(mosaics / "bayer.toml")
    expected = develop_linear(capture.truth(2, "clean"), sensor, demosaic="menon")
    np.testing.assert_array_equal(capture.clean_linear(2, demosaiced=True), expected)
    assert np.abs(capture.clean_linear(2) - expected).max() > 0.1  # random pixels are the worst case of interpolation


def test_a_capture_of_an_earlier_version_says_to_capture_again_and_is_captured_again(
    mosaics: Path, tmp_path: Path
) -> None:
    shutil.copytree(mosaics / "set", tmp_path / "set")
    old = Path(shutil.copytree(mosaics / "bayer", tmp_path / "bayer"))
    for path in (old / "truth").glob("*.exr"):
        channels, header = read_exr(path)
        write_exr(path, {name: values for name, values in channels.items() if not name.startswith("clean_rgb.")})
    record = json.loads((old / "capture.json").read_text())
    del record["stage"]["files"]  # which that version wrote of its own files
    (old / "capture.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r"truth/0000\.exr lacks the channels clean_rgb\.R, .*: capture again"):
        open_capture(old).clean(0)
    record = json.loads((old / "capture.json").read_text())
    del record["stage"]["config"]["truth"]
    (old / "capture.json").write_text(
        json.dumps(record | {"stage": record["stage"] | {"key": "of an earlier version"}})
    )
    config = CaptureConfig(sensor=str(mosaics / "bayer.toml"), electrons=ELECTRONS, time=TIME, tolerance=None)
    with pytest.raises(ValueError, match="truth"):  # says what differs
        stages.capture(tmp_path / "set", old, config, QUIET)
    stages.capture(tmp_path / "set", old, config, QUIET, overwrite=True)
    np.testing.assert_array_equal(open_capture(old).clean(0), open_capture(mosaics / "bayer").clean(0))


@pytest.fixture(scope="module")
def experiment(mosaics: Path) -> Path:
    preset = adapted(
        EXPERIMENTS["demo"], scene=str(mosaics / "set"), sensor=str(mosaics / "bayer.toml"), electrons=ELECTRONS,
        points=100, iterations=2, methods=("naive", "oracle", "oracle-demosaiced"),
    )  # fmt: skip
    run(preset, mosaics / "experiment", QUIET, report=write_report)
    return mosaics / "experiment"


def test_both_references_are_scored_and_reported_by_name(experiment: Path) -> None:
    scores = {name: run.scores() or {} for name, run in runs_in([experiment]).items()}
    assert len(scores) == 3
    for found in scores.values():
        assert list(found["mean"]) == ["enhanced", "enhanced_demosaiced", "lit"]
        assert found["mean"]["enhanced"]["aligned_psnr"] != found["mean"]["enhanced_demosaiced"]["aligned_psnr"]
    page = (experiment / "report.html").read_text()
    assert page.count("Scores against enhanced_demosaiced") == 1
    assert "Truth: demosaiced" in page
    naive = open_run(experiment / "naive")
    capture, lit = naive.inputs(QUIET)
    found = references(naive, capture, lit, 0)
    dark, three = (torch.from_numpy(image.copy()) for image in (capture.srgb8(0), capture.clean(0)))
    config = EnhanceConfig(**naive.enhancement["config"])
    _, params = enhance(dark, config)
    np.testing.assert_array_equal(found["enhanced"], enhance(three, config, params)[0])
    linear = references(replace(naive, record=naive.record | {"space": "linear", "enhancement": None}), capture, lit, 0)
    assert list(linear) == ["linear", "linear_demosaiced", "lit"]
    np.testing.assert_array_equal(linear["linear"], capture.clean_linear(0))
    np.testing.assert_array_equal(linear["linear_demosaiced"], capture.clean_linear(0, demosaiced=True))


def test_each_oracle_learns_from_the_exposures_of_its_name(experiment: Path) -> None:
    for name in ("oracle", "oracle-demosaiced"):
        made = open_run(experiment / name)
        capture, _ = made.inputs(QUIET)
        config = EnhanceConfig(**made.enhancement["config"])
        _, params = enhance(torch.from_numpy(capture.srgb8(1).copy()), config)
        clean = torch.from_numpy(capture.clean(1, demosaiced=name != "oracle"))
        expected = enhance(clean, config, params)[0]  # not from the capture's memo, which the run has filled
        np.testing.assert_allclose(read_png(experiment / name / "enhanced" / "0001.png"), expected, atol=0.51 / 255)
