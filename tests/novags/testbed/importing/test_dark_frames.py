"""Dark frames for a camera, without a capture: which ones are found, and that every one counts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin

from novags.testbed.console.terminal import Console
from novags.testbed.importing.calibration.dark_frames import DarkFolder, find_dark_frames
from novags.testbed.stages.configs.capturing import camera_file
from sensor_model import PRESETS
from sensor_model.characterisation import GainFit
from sensor_model.files.camera_file import CameraFile

QUIET = Console(quiet=True)
CAMERA = PRESETS["a7s2-iso6400"]


def write_frames(folder: Path, n: int = 3) -> Path:
    """Files of two frames each."""
    folder.mkdir(parents=True)
    for k in range(n):
        codes = np.random.default_rng(k).normal(CAMERA.black_level, 8.0, (2, 10, 12))
        np.save(folder / f"{k}.npy", np.rint(codes).astype(np.uint16))
    return folder


def write_tiff(folder: Path, iso: int) -> Path:
    """A frame whose file states its ISO."""
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags[34665] = {34855: iso}
    folder.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full((10, 12), 520, np.uint16)).save(folder / f"{iso}.tiff", tiffinfo=tags)
    return folder


def camera(iso: float, first: float = 100, last: float = 1600) -> CameraFile:
    return CameraFile(sensor=CAMERA, iso=iso, fit=GainFit(isos=(first, last), slope=0.01, start=0.5, residual=0.0))


@pytest.mark.parametrize("name", ["0.npy", "1.npy", "2.npy"])
def test_every_frame_and_the_gain_are_what_is_hashed_and_nothing_beside_them(name: str, tmp_path: Path) -> None:
    found = find_dark_frames(write_frames(tmp_path / "dark"), CameraFile(sensor=CAMERA))
    before = found.digest()
    (found.place / "notes.txt").write_text("mine")
    assert found.digest() == before
    at_gains = {replace(found, gain=gain).digest() for gain in (None, 0.5, 0.25)}
    assert len(at_gains) == 3
    np.save(found.place / name, np.load(found.place / name) + 1)
    assert found.digest() != before
    assert not at_gains & {replace(found, gain=gain).digest() for gain in (None, 0.5, 0.25)}


def test_the_frames_of_every_file_are_read(tmp_path: Path) -> None:
    found = find_dark_frames(write_frames(tmp_path / "dark"), CameraFile(sensor=CAMERA))
    read = found.read(CAMERA, (8, 8), 0.1, QUIET)
    there = [np.load(path) for path in found.files]
    np.testing.assert_array_equal(read.codes, np.concatenate(there)[:, :8, 2:10])


def test_the_nearest_iso_on_the_cameras_own_side_of_the_switch_is_taken_and_all_are_named(tmp_path: Path) -> None:
    for iso in (50, 100, 400, 1600, 3200):
        write_frames(tmp_path / f"iso{iso}", 1)
    found = {iso: find_dark_frames(tmp_path, camera(iso)) for iso in (100, 300, 1000, 1600)}
    assert {iso: one.iso for iso, one in found.items()} == {100: 100, 300: 400, 1000: 1600, 1600: 1600}
    assert [one.gain for one in found.values()] == [None, 4.5, 16.5, None]
    assert [one.place.name for one in found.values()] == ["iso100", "iso400", "iso1600", "iso1600"]
    assert find_dark_frames(tmp_path, camera(60, 50, 99)).iso == 50
    with pytest.raises(ValueError, match="must hold dark frames of ISO 6400, .* got 50, 100, 400, 1600, 3200"):
        find_dark_frames(tmp_path, camera(6400, 6400, 12800))
    with pytest.raises(ValueError, match=r"of several ISOs \(50, 100, 400, 1600, 3200\), and the camera is of none"):
        find_dark_frames(tmp_path, CameraFile(sensor=CAMERA))


def test_files_of_two_exposure_times_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from novags.testbed.importing.calibration import dark_frames as module

    files = tuple(sorted(write_frames(tmp_path / "dark").iterdir()))
    read = module.read_frame
    monkeypatch.setattr(module, "read_frame", lambda path: replace(read(path), time=2.0 if path == files[-1] else 1.0))
    with pytest.raises(ValueError, match="differ in exposure time: 1.0, 2.0"):
        DarkFolder(tmp_path / "dark", files, None, None).read(CAMERA, (8, 8), 1.0, QUIET)


def test_frames_that_state_another_iso_than_the_camera_or_their_folder_are_refused(tmp_path: Path) -> None:
    plain = write_tiff(tmp_path / "plain", 1600)
    preset = camera_file("a7s2-iso1600-3chip")
    for right in (preset, camera_file("imx900-hcg")):  # the latter is of no ISO
        assert find_dark_frames(plain, right).files == (plain / "1600.tiff",)
    with pytest.raises(
        ValueError, match=r"1600\.tiff states the ISO speed 1600, the camera 6400: dark and flat frames"
    ):
        find_dark_frames(plain, camera_file("a7s2-iso6400"))
    write_tiff(tmp_path / "all" / "iso1600", 1600)
    assert find_dark_frames(tmp_path / "all", preset).iso == 1600
    write_tiff(tmp_path / "all" / "iso1600", 100)
    with pytest.raises(
        ValueError, match=r"100\.tiff states the ISO speed 100, the name of the folder 1600: .* correct"
    ):
        find_dark_frames(tmp_path / "all", preset)
