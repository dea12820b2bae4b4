"""Captures whose darkness is that of somebody's own camera: which frames are taken, what is recorded and refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.importing.calibration.dark_frames import find_dark_frames
from novags.testbed.stages.configs.capturing import CaptureConfig
from sensor_model import PRESETS, Measured, write_dng, write_sensor
from sensor_model.characterisation import gain_fits
from sensor_model.files.camera_file import read_camera, write_maps
from sensor_model.params import Exposure

QUIET = Console(quiet=True)
SHAPE = (40, 48)
CAMERA = replace(PRESETS["a7s2-iso6400"], cfa="RGGB")
HOT = (12, 21)  # of a frame; pictures of 24 x 32 px see it at (4, 13): they begin at row 8 and column 8
ISOS = (100, 800, 1600, 3200, 6400)


def write_dark(folder: Path, n: int = 12, seed: int = 0, shape: tuple[int, int] = SHAPE, sigma: float = 8.0) -> Path:
    """A stack of [n, h, w] in one file, with a hot pixel and rows of their own."""
    rng = np.random.default_rng(seed)
    codes = 512 + sigma * rng.normal(size=(n, *shape)) + 3 * rng.normal(size=(n, shape[0], 1))
    codes[:, HOT[0] % shape[0], HOT[1] % shape[1]] += 900
    folder.mkdir(parents=True)
    np.save(folder / "dark.npy", np.rint(codes).astype(np.uint16))
    return folder


def taken(photographs: Path, out: Path, sensor: str = "a7s2-iso6400", **how) -> dict:
    return stages.capture(photographs, out, CaptureConfig(sensor=sensor, electrons=5.0, **how), QUIET, overwrite=True)


def series(folder: Path) -> str:
    cameras = {iso: PRESETS[f"a7s2-iso{iso}"] for iso in ISOS}
    fits = gain_fits(ISOS, [c.gain for c in cameras.values()], [c.sigma_d for c in cameras.values()])
    assert [fit.isos for fit in fits] == [(100, 1600), (3200, 6400)]
    write_sensor(folder / "mine.toml", cameras, fits=fits)
    return str(folder / "mine.toml")


def test_a_capture_has_the_darkness_of_the_frames_and_says_so(photographs: Path, tmp_path: Path) -> None:
    folder = write_dark(tmp_path / "dark")
    record = taken(photographs, tmp_path / "cap", dark_frames=folder)
    capture = open_capture(tmp_path / "cap")
    frames = np.load(folder / "dark.npy").astype(float)[:, 8:32, 8:40]
    for view in range(2):
        raw, mean = capture.raw(view).astype(float), capture.truth(view, "mean")
        assert raw[4, 13] > 512 + 700
        left = raw - mean
        assert left.std() == pytest.approx(np.sqrt(capture.truth(view, "variance").mean()), rel=0.15)
        assert capture.truth(view, "variance").mean() > frames.var(0).mean()
    sensor = capture.sensor
    assert sensor.sigma_d * sensor.gain == pytest.approx(8.0, rel=0.15)
    assert sensor.sigma_row * sensor.gain == pytest.approx(3.0, rel=0.4)
    usual = np.delete(frames.reshape(12, -1), 4 * 32 + 13, axis=1).var()
    assert float(capture.noise.raw.curve.offset[0]) == pytest.approx(usual, rel=0.05)  # what methods see
    plan = {effect["name"]: effect for effect in record["plan"]["effects"]}
    assert plan["banding"]["on"]
    assert plan["read_noise"]["reason"] == "in 12 dark frames, which take its place"
    assert record["dark_frames"] == record["stage"]["config"]["dark_frames"]
    assert str(tmp_path) not in (tmp_path / "cap" / "capture.json").read_text()


def test_the_content_of_the_frames_decides_what_is_done_again(photographs: Path, tmp_path: Path) -> None:
    first = taken(photographs, tmp_path / "cap", dark_frames=write_dark(tmp_path / "a"))["stage"]["key"]
    assert taken(photographs, tmp_path / "cap", dark_frames=write_dark(tmp_path / "b"))["stage"]["key"] == first
    other = write_dark(tmp_path / "c", seed=1)
    assert taken(photographs, tmp_path / "cap", dark_frames=other)["stage"]["key"] != first
    assert "dark_frames" not in taken(photographs, tmp_path / "cap")


def test_frames_of_the_nearest_iso_are_taken_and_never_across_the_switch_of_the_gain(tmp_path: Path) -> None:
    camera, folder = series(tmp_path), tmp_path / "dark"
    for iso in (100, 400, 3200, 12800):
        write_dark(folder / f"ISO_{iso}" / "dark" / "long", seed=iso)
    found = {iso: find_dark_frames(folder, read_camera(f"{camera}@{iso}")) for iso in (*ISOS, 300)}
    assert {iso: one.iso for iso, one in found.items()} == {
        100: 100,
        800: 400,
        1600: 400,
        3200: 3200,
        6400: 3200,
        300: 400,
    }
    assert found[100].gain is None
    assert found[1600].gain == pytest.approx(PRESETS["a7s2-iso400"].gain, rel=0.01)
    assert len({one.digest() for one in found.values()}) == 4  # ISO 400 at its own gain serves 800, 1600 and 300
    for iso in (100, 400):
        (folder / f"ISO_{iso}" / "dark" / "long" / "dark.npy").unlink()
        (folder / f"ISO_{iso}" / "dark" / "long").rmdir()
        (folder / f"ISO_{iso}" / "dark").rmdir()
        (folder / f"ISO_{iso}").rmdir()
    with pytest.raises(ValueError, match="of ISO 1600, or of one from 100 to 1600, .* got 3200, 12800"):
        find_dark_frames(folder, read_camera(f"{camera}@1600"))


def test_a_camera_at_an_iso_takes_pictures_under_its_name(photographs: Path, tmp_path: Path) -> None:
    record = taken(photographs, tmp_path / "cap", sensor=f"{series(tmp_path)}@3200")
    assert record["sensor_name"] == "mine-iso3200"
    assert open_capture(tmp_path / "cap").sensor == PRESETS["a7s2-iso3200"]


def test_maps_of_a_camera_are_its_pattern_and_part_of_the_key(photographs: Path, tmp_path: Path) -> None:
    camera = replace(PRESETS["a7s2-iso6400"], dsnu=1.0, prnu=0.01)
    offset = np.zeros(SHAPE, np.float32)
    offset[HOT] = 200.0
    write_maps(tmp_path / "mine.npz", Measured(offset=offset, response=np.ones(SHAPE, np.float32)))
    write_sensor(tmp_path / "mine.toml", camera, maps="mine.npz")
    first = taken(photographs, tmp_path / "cap", sensor=str(tmp_path / "mine.toml"), tolerance=None)
    capture = open_capture(tmp_path / "cap")
    for view in range(2):
        bright = capture.truth(view, "mean") - capture.truth(view, "clean")
        assert bright[4, 13] == pytest.approx(200 * camera.gain, rel=0.02)
        assert np.median(np.abs(bright)) < 0.1
    write_maps(tmp_path / "mine.npz", Measured(offset=2 * offset, response=np.ones(SHAPE, np.float32)))
    again = taken(photographs, tmp_path / "cap", sensor=str(tmp_path / "mine.toml"), tolerance=None)
    assert again["stage"]["key"] != first["stage"]["key"]


@pytest.mark.parametrize(("time", "said"), [(None, False), (1 / 30, False), (2.0, True)])
def test_maps_of_another_time_than_the_capture_are_told(
    time: float | None, said: bool, photographs: Path, tmp_path: Path, capsys
) -> None:
    maps = Measured(offset=np.zeros(SHAPE, "f4"), response=np.ones(SHAPE, "f4"), time=time)
    write_maps(tmp_path / "mine.npz", maps)
    write_sensor(tmp_path / "mine.toml", CAMERA, maps="mine.npz")
    config = CaptureConfig(sensor=str(tmp_path / "mine.toml"), electrons=5.0)
    stages.capture(photographs, tmp_path / "cap", config, Console())
    note = "mine.npz were exposed for 2 s, and the capture is for 0.0333333 s: dark current and hot pixels are those"
    assert (note in capsys.readouterr().err) == said


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:200]), "mine.npz is damaged .*measure the camera again"),
        (lambda path: np.savez(path, offset=np.zeros(SHAPE)), "mine.npz is damaged"),
        (lambda path: np.savez(path, offset=np.zeros((9, 9)), response=np.ones((9, 9))),
         r"mine.npz: maps must be of 24 rows and 32 columns or more, got \(9, 9\); .*--window"),
        (lambda path: np.savez(path, offset=np.full(SHAPE, np.nan), response=np.ones(SHAPE)), "maps must be finite"),
    ],
)  # fmt: skip
def test_damaged_maps_are_refused(damage, message: str, photographs: Path, tmp_path: Path) -> None:
    write_maps(tmp_path / "mine.npz", Measured(offset=np.zeros(SHAPE, "f4"), response=np.ones(SHAPE, "f4")))
    write_sensor(tmp_path / "mine.toml", replace(CAMERA, dsnu=1.0), maps="mine.npz")
    damage(tmp_path / "mine.npz")
    with pytest.raises(ValueError, match=message):
        taken(photographs, tmp_path / "cap", sensor=str(tmp_path / "mine.toml"))


def one_file(dark: Path, change) -> None:
    np.save(dark / "dark.npy", change(np.load(dark / "dark.npy")))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda dn: dn[:3], "dark: dark frames must be 4 or more, got 3; take ten or more"),
        (lambda dn: dn[:, :20], "dark.npy must hold 32 x 24 px or more, .* got 48 x 20: .*--max-size"),
        (lambda dn: dn << 5, "codes of dark frames must be at most 16383 by the camera's 14 bits"),
        (lambda dn: dn >> 2, "mean of dark frames over the black level must be from .*bit depth"),
        (lambda dn: np.maximum(dn, 512) - 512, "share of dark pixels at 0 DN must be at most 0.005, got 0"),
        (lambda dn: dn[[0, 1, 2, 3, 1]], "frames 2 and 5 are the same, and noise never is"),
        (lambda dn: dn.astype(np.float32), "integer codes of one channel"),
    ],
)
def test_frames_that_are_not_of_this_camera_are_refused(
    change, message: str, photographs: Path, tmp_path: Path
) -> None:
    one_file(write_dark(tmp_path / "dark"), change)
    with pytest.raises(ValueError, match=message):
        taken(photographs, tmp_path / "cap", dark_frames=tmp_path / "dark")
    assert not (tmp_path / "cap" / "capture.json").exists()


def test_raw_frames_are_compared_with_what_the_camera_states(photographs: Path, tmp_path: Path, capsys) -> None:
    codes = np.load(write_dark(tmp_path / "npy") / "dark.npy")
    for name, camera, time in (("right", CAMERA, 1.0), ("filters", replace(CAMERA, cfa="GRBG"), 0.1),
                               ("bits", replace(CAMERA, bits=12), 0.1)):  # fmt: skip
        (tmp_path / name).mkdir()
        for k, dn in enumerate(codes):
            write_dng(tmp_path / name / f"{k:02d}.dng", np.minimum(dn, camera.max_dn), camera, Exposure(time=time))
    with pytest.raises(ValueError, match="filters of the camera, RGGB, got GRBG"):
        taken(photographs, tmp_path / "cap", dark_frames=tmp_path / "filters")
    with pytest.raises(ValueError, match="codes of 14 bits, as the camera does, got 12: it is of another mode"):
        taken(photographs, tmp_path / "cap", dark_frames=tmp_path / "bits")
    config = CaptureConfig(sensor="a7s2-iso6400", electrons=5.0, dark_frames=tmp_path / "right")
    stages.capture(photographs, tmp_path / "cap", config, Console())
    assert "right was exposed for 1 s, and the capture is for 0.0333333 s" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: None, "no such folder of dark frames"),
        (lambda folder: folder.mkdir(), "got no frames"),
        (
            lambda folder: write_dark(folder / "iso100"),
            "must hold dark frames of ISO 6400, .* got 100",
        ),
    ],
)
def test_folders_without_frames_of_the_camera_are_refused(make, message: str, tmp_path: Path) -> None:
    make(tmp_path / "dark")
    with pytest.raises(ValueError, match=message):
        CaptureConfig(dark_frames=tmp_path / "dark")


def test_several_exposures_of_one_iso_are_asked_about(tmp_path: Path) -> None:
    for name in ("long", "short"):
        write_dark(tmp_path / "dark" / "iso100" / "dark" / name)
    with pytest.raises(ValueError, match=r"dark holds several exposures \(long, short\): name the folder of one"):
        CaptureConfig(sensor=f"{series(tmp_path)}@100", dark_frames=tmp_path / "dark")


def test_the_command_and_a_study_take_them(photographs: Path, tmp_path: Path, call) -> None:
    from novags.testbed.study.cells.axes import changes_of

    folder = write_dark(tmp_path / "dark")
    args = ["capture", str(photographs), "--sensor", "a7s2-iso6400", "--dark-frames", str(folder)]
    assert call(*args, "--out", str(tmp_path / "cap")) == 0
    assert json.loads((tmp_path / "cap" / "capture.json").read_text())["dark_frames"]
    assert changes_of("capture.dark_frames", "dark", tmp_path).capture == {"dark_frames": folder}


def test_a_run_takes_them_too(photographs: Path, tmp_path: Path, call, capsys) -> None:
    write_dark(tmp_path / "dark", n=3)
    args = ["run", "--scene", str(photographs), "--sensor", "a7s2-iso6400", "--dark-frames", str(tmp_path / "dark")]
    assert call(*args, "--methods", "naive", "--iterations", "2", "--out", str(tmp_path / "out")) != 0
    assert "dark frames must be 4 or more, got 3" in "".join(capsys.readouterr())


@pytest.mark.parametrize("how", [{"exposure_spread": 1.0}, {"bracket": 2.0}])
def test_frames_of_one_exposure_time_are_refused_where_times_differ_by_view(how: dict, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="dark_frames must be left out where exposure times differ by view"):
        CaptureConfig(sensor="a7s2-iso6400", dark_frames=write_dark(tmp_path / "dark"), **how)


def test_every_frame_of_a_burst_draws_a_dark_frame_of_its_own(photographs: Path, tmp_path: Path) -> None:
    folder = write_dark(tmp_path / "dark", n=40)
    for name, burst in (("one", 1), ("burst", 16)):
        taken(photographs, tmp_path / name, dark_frames=folder, burst=burst)
    one, burst = (open_capture(tmp_path / name) for name in ("one", "burst"))
    for capture, frames in ((one, 1), (burst, 16)):
        error = np.stack([capture.raw(i) - capture.truth(i, "mean") for i in range(len(capture.names))])
        expected = np.stack([capture.truth(i, "variance") for i in range(len(capture.names))])
        assert error.var() == pytest.approx(expected.mean(), rel=0.25), frames
    assert burst.truth(0, "variance").mean() < one.truth(0, "variance").mean() / 10
