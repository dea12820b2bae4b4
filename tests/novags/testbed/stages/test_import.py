"""Claims about imported photographs: what our own camera wrote comes back as if a stranger had taken it."""

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from PIL import Image

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import Capture, open_capture
from novags.testbed.folders.photographs.raw_files import read_digital_numbers
from novags.testbed.importing import stored
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.importing import ImportConfig
from sensor_model import PRESETS, Exposure, linear_to_srgb, srgb_to_linear, write_dng
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import read_codes, read_png, write_png
from tests.miniatures import realx3d, write16

QUIET = Console(quiet=True)
SIZE, VIEWS = (40, 30), 9
NAMES = [f"{i:04d}" for i in range(VIEWS)]
A7S2 = "a7s2-iso6400"


def lit_picture(i: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A smooth coloured pattern, uint8 [h,w,3]."""
    x, y = np.meshgrid(*(np.linspace(0, 1, side) for side in size))
    waves = [np.sin(5 * x + 3 * y + c + 0.3 * i) + np.cos((4 + c) * y - 2 * x) for c in range(3)]
    return (110 + 50 * np.stack(waves, -1)).clip(4, 250).astype(np.uint8)


def lit_set(folder: Path, size: tuple[int, int] = SIZE) -> Path:
    """Posed photographs in good light."""
    write_cameras(folder, NAMES, orbit_rig(VIEWS, *size, 50.0, radius=3.0))
    for i, name in enumerate(NAMES):
        write_png(folder / "images" / f"{name}.png", lit_picture(i, size))
    return folder


def captured(folder: Path, views: Path, sensor: str = A7S2, electrons: float = 60.0) -> Path:
    stages.capture(views, folder, CaptureConfig(sensor=sensor, electrons=electrons, demosaic="bilinear"), QUIET)
    return folder


def foreign(folder: Path, line: Path, *parts: str) -> Path:
    """What a stranger would have: the cameras of the lit pictures, dark files, and no record of ours."""
    folder.mkdir()
    shutil.copy(line / "lit" / "transforms.json", folder)
    for part in parts:
        shutil.copytree(line / "cap" / part, folder / part)
    return folder


def brought(folder: Path, out: Path, console: Console = QUIET, **config: Any) -> Capture:
    settings = ImportConfig(**{"demosaic": "bilinear", **config})
    stages.import_photographs(folder, out, settings, console, overwrite=True)
    return open_capture(out)


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """lit/, a set; cap/, a capture of it."""
    folder = tmp_path_factory.mktemp("line")
    captured(folder / "cap", lit_set(folder / "lit"))
    return folder


@pytest.fixture
def strangers(line: Path, tmp_path: Path) -> Path:
    """Dark 8-bit pictures and raw files beside their cameras."""
    return foreign(tmp_path / "dark", line, "images", "raw")


@pytest.mark.parametrize("sensor", [None, A7S2])
def test_our_own_raw_files_come_back_as_the_capture_they_were_of(
    sensor: str | None, line: Path, strangers: Path, tmp_path: Path
) -> None:
    """Expectation: to the bit; without the camera, white balance and matrix come from the file with six digits."""
    ours, theirs = open_capture(line / "cap"), brought(strangers, tmp_path / "cap", lit=line / "lit", sensor=sensor)
    assert theirs.names == ours.names
    for i in (0, 4):
        np.testing.assert_array_equal(theirs.srgb8(i), ours.srgb8(i))
        np.testing.assert_array_equal(theirs.raw(i), ours.raw(i))
        assert np.abs(theirs.linear16(i) - ours.linear16(i)).max() <= (0 if sensor else 1.01 / 61439)
        np.testing.assert_array_equal(theirs.source(QUIET).lit(i), ours.source(QUIET).lit(i))
    assert theirs.levels == ours.levels == ("RGGB", 512.0, 16383.0)
    assert theirs.channels_share == ours.channels_share == ("demosaicing",)
    assert theirs.noise == (ours.noise if sensor else None)
    np.testing.assert_array_equal(theirs.cameras.rig.viewmats, ours.cameras.rig.viewmats)


def test_8_bit_pictures_alone_have_no_16_bit_ones_and_no_raw_frames(line: Path, tmp_path: Path) -> None:
    capture = brought(foreign(tmp_path / "dark", line, "images"), tmp_path / "cap")
    np.testing.assert_array_equal(capture.srgb8(3), read_png(line / "cap" / "images" / "0003.png"))
    assert [capture.holds(part) for part in ("images16", "raw", "truth", "lit")] == [False] * 4
    assert {path.name for path in (tmp_path / "cap").iterdir() if path.is_dir()} == {"images", "sparse"}
    assert capture.channels_share == ("demosaicing",)  # nearly every camera does it, and this one is not known
    with pytest.raises(ValueError, match="there are no 16-bit linear pictures: novags import takes 16-bit or raw"):
        capture.linear16(0)


def test_levels_of_16_bit_codes_are_said_to_have_no_effect_where_there_are_none(line: Path, tmp_path: Path) -> None:
    """Rationale: who gives them takes the 8-bit pictures for others."""
    stream, dark = io.StringIO(), foreign(tmp_path / "dark", line, "images")
    brought(dark, tmp_path / "cap", Console(stream=stream), black=64.0, curve="srgb")
    assert "no picture here has 16 bits, so these options have no effect: --black 64, --curve srgb" in stream.getvalue()
    stream = io.StringIO()
    brought(dark, tmp_path / "cap", Console(stream=stream))
    assert "16-bit" not in stream.getvalue()


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize(
    ("black", "white", "curve"), [(4096, 65535, "linear"), (0, 4095, "linear"), (0, 65535, "srgb")]
)
def test_16_bit_pictures_are_read_by_their_levels_and_curve(
    suffix: str, black: int, white: int, curve: str, line: Path, tmp_path: Path
) -> None:
    light = np.random.default_rng(1).uniform(0, 0.2, (VIEWS, *SIZE[::-1], 3))
    coded = linear_to_srgb(light) if curve == "srgb" else light
    codes = np.round(black + (white - black) * coded).astype(np.uint16)
    write_cameras(tmp_path / "dark", NAMES, orbit_rig(VIEWS, *SIZE, 50.0, radius=3.0))
    (tmp_path / "dark" / "images").mkdir()
    transforms = tmp_path / "dark" / "transforms.json"
    transforms.write_text(transforms.read_text().replace(".png", suffix))
    for name, image in zip(NAMES, codes, strict=True):
        assert cv2.imwrite(str(tmp_path / "dark" / "images" / f"{name}{suffix}"), image[..., ::-1])
    stream = io.StringIO()
    config = {"black": black, "white": white, "curve": curve}
    capture = brought(tmp_path / "dark", tmp_path / "cap", Console(stream=stream), **config)
    step = 0.5 / (white - black) * (1 if curve == "linear" else 1.0) + 0.51 / 61439
    assert np.abs(capture.linear16(5) - light[5]).max() <= step
    expected = np.round(255 * linear_to_srgb(capture.linear16(5).astype(np.float64).clip(0, 1)))
    assert np.abs(255 * capture.srgb8(5) - expected).max() <= 1
    assert f"code {black} is black, {white} white, {curve} in between" in stream.getvalue()


@pytest.mark.parametrize(("place", "said"), [(None, "linear"), (-1, "linear or srgb"), (0, "srgb or linear")])
def test_all_curves_that_files_state_are_said_and_that_codes_stand_apart(
    place: int | None, said: str, line: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: each file is read by its own curve, and a folder of both kinds is likely a mistake."""
    dark = foreign(tmp_path / "dark", line, "images")
    for i, name in enumerate(NAMES):  # the first one of 12 bits, the others of 16
        write16(dark / "images" / f"{name}.png", (16 if i == 0 else 1) * (3 + lit_picture(i).astype(np.uint16)))
    others = [] if place is None else [f"{NAMES[place]}.png"]
    monkeypatch.setattr(stored, "stated_curve", lambda file: "srgb" if file.name in others else None)
    brought(dark, tmp_path / "cap", Console(stream=(stream := io.StringIO())))
    assert f"white, {said} in between{'' if place is None else ', as the files say'} (" in stream.getvalue()
    assert "codes of 0000.png are multiples of 16: they are probably of 12 bits" in stream.getvalue()


def test_pictures_of_an_unknown_camera_say_their_noise_themselves_by_the_training_views(tmp_path: Path) -> None:
    """Expectation: variance 1e-5 + 4e-4 mean in the training views; those held out have ten times the noise."""
    rng, size = np.random.default_rng(2), (48, 40)
    ramp = np.broadcast_to(np.linspace(0.02, 0.4, size[0])[None, :, None], (*size[::-1], 3))
    write_cameras(tmp_path / "dark", NAMES, orbit_rig(VIEWS, *size, 50.0, radius=3.0))
    (tmp_path / "dark" / "images").mkdir()
    for i, name in enumerate(NAMES):
        noisy = ramp + rng.normal(0, (10 if i % 8 == 0 else 1) * np.sqrt(1e-5 + 4e-4 * ramp))
        codes = np.round(4096 + (65535 - 4096) * noisy).clip(0, 65535).astype(np.uint16)
        cv2.imwrite(str(tmp_path / "dark" / "images" / f"{name}.png"), codes[..., ::-1])
    noise = brought(tmp_path / "dark", tmp_path / "cap", black=4096).noise
    assert noise.origin == "pictures"
    for mean in (0.05, 0.35):
        found = noise.linear16(torch.full((3,), mean, dtype=torch.float64))
        np.testing.assert_allclose(found, 1e-5 + 4e-4 * mean, rtol=0.25)


def test_scaled_pictures_are_averages_of_light_and_their_noise_is_not_known(
    line: Path, strangers: Path, tmp_path: Path
) -> None:
    stream = io.StringIO()
    capture = brought(strangers, tmp_path / "cap", Console(stream=stream), max_size=20, sensor=A7S2, lit=line / "lit")
    light = srgb_to_linear(lit_picture(2) / 255.0).reshape(15, 2, 20, 2, 3).mean((1, 3))
    assert np.abs(capture.source(QUIET).lit(2) - linear_to_srgb(light)).max() <= 0.51 / 255
    whole = brought(strangers, tmp_path / "whole").linear16(2).reshape(15, 2, 20, 2, 3).mean((1, 3))
    assert np.abs(capture.linear16(2) - whole).max() <= 1.01 / 61439
    assert capture.noise is None
    assert not capture.holds("raw")
    assert "scaled down: no raw frames and no known noise" in stream.getvalue()


def test_distortion_is_undone_in_dark_and_lit_pictures_alike(line: Path, tmp_path: Path) -> None:
    """Expectation: OpenCV's own undistortion, called here with pixel centres that count from 0."""
    dark = foreign(tmp_path / "dark", line, "images")
    content = json.loads((dark / "transforms.json").read_text())
    (dark / "transforms.json").write_text(json.dumps(content | {"k1": 0.2}))
    capture = brought(dark, tmp_path / "cap", lit=line / "lit" / "images")
    K = np.array([[content["fl_x"], 0, content["cx"] - 0.5], [0, content["fl_y"], content["cy"] - 0.5], [0, 0, 1]])
    new, _ = cv2.getOptimalNewCameraMatrix(K, np.array([0.2, 0, 0, 0, 0]), SIZE, 0)
    for found, picture in (
        (capture.source(QUIET).lit(1), lit_picture(1)), (capture.srgb8(1), read_codes(dark / "images" / "0001.png")),
    ):  # fmt: skip
        expected = cv2.undistort(picture, K, np.array([0.2, 0, 0, 0, 0]), newCameraMatrix=new)
        np.testing.assert_array_equal(np.round(255 * found), expected)
    assert np.abs(capture.cameras.rig.Ks[0, :2, 2] - 0.5 - new[:2, 2]).max() < 1e-9


def test_raw_files_beside_a_colmap_model_whose_pictures_are_gone(line: Path, tmp_path: Path) -> None:
    dark = tmp_path / "dark"
    dark.mkdir()
    for part in ("sparse", "raw"):
        shutil.copytree(line / "cap" / part, dark / part)
    capture, ours = brought(dark, tmp_path / "cap", sensor=A7S2), open_capture(line / "cap")
    np.testing.assert_array_equal(capture.linear16(6), ours.linear16(6))
    np.testing.assert_array_equal(capture.srgb8(6), ours.srgb8(6))
    assert np.abs(capture.cameras.rig.viewmats - ours.cameras.rig.viewmats).max() < 1e-9


@pytest.mark.parametrize(
    ("place", "named"), [(0, "0001.dng other ones than 0000"), (4, "0004.dng other ones than 0000")]
)
def test_a_raw_file_of_another_white_balance_is_named_beside_the_first_one(
    place: int, named: str, strangers: Path, tmp_path: Path
) -> None:
    file = strangers / "raw" / f"{NAMES[place]}.dng"
    other = replace(PRESETS[A7S2], rgb_response=(0.3, 1.0, 0.9))
    write_dng(file, read_digital_numbers(file), other, Exposure(time=1 / 30))
    brought(strangers, tmp_path / "cap", Console(stream=(stream := io.StringIO())))
    assert f"several white balances or colour matrices ({named}" in stream.getvalue()


def test_views_that_nobody_scanned_are_recorded_whichever_they_are(tmp_path: Path) -> None:
    folder = realx3d(tmp_path / "RealX3D")
    for lacking in ([], ["0001"], ["0001", "0009"]):
        for name in lacking:
            (tmp_path / "RealX3D" / "pointclouds" / "Popcorn" / "depth" / f"{name}.png").unlink(missing_ok=True)
        brought(folder, tmp_path / "cap")
        assert json.loads((tmp_path / "cap" / "capture.json").read_text()).get("unscanned", []) == lacking


def test_margins_of_raw_files_are_cut_and_the_filter_pattern_moves_with_them(
    line: Path, strangers: Path, tmp_path: Path
) -> None:
    content = json.loads((strangers / "transforms.json").read_text())
    (strangers / "transforms.json").write_text(json.dumps(content | {"w": 38, "h": 29}))
    for name in NAMES:
        path = strangers / "images" / f"{name}.png"
        write_png(path, read_codes(path)[:29, 1:39])
    capture, ours = brought(strangers, tmp_path / "cap", sensor=A7S2), open_capture(line / "cap")
    np.testing.assert_array_equal(capture.raw(1), ours.raw(1)[:29, 1:39])
    np.testing.assert_array_equal(capture.linear16(1), ours.linear16(1)[:29, 1:39])
    assert capture.levels[0] == "GRBG"


def test_a_long_exposure_becomes_the_noise_free_one_by_one_factor(line: Path, strangers: Path, tmp_path: Path) -> None:
    """Expectation: the least-squares factor, here over whole arrays; five times the light is 1/5, and leaves 1/sqrt(5)
    of the noise, 0.45, in what comes close to the clean exposure that the simulated capture knows."""
    long = captured(tmp_path / "long", line / "lit", electrons=300.0)
    capture, ours = brought(strangers, tmp_path / "cap", clean=long / "raw", sensor=A7S2), open_capture(line / "cap")
    gain = capture.imported.clean["gain"]
    x = np.stack([open_capture(long).linear16(i).astype(np.float64) for i in range(VIEWS)])
    y = np.stack([ours.linear16(i).astype(np.float64) for i in range(VIEWS)])
    assert gain == pytest.approx((x * y)[x < 0.99].sum() / (x * x)[x < 0.99].sum(), rel=2e-4)  # x, y in 16 bits
    assert gain == pytest.approx(60 / 300, rel=0.01)
    assert np.abs(capture.clean_linear(2) - gain * x[2]).max() < 1e-5
    away = (capture.clean_linear(2) - ours.clean_linear(2)).std()
    noise = (ours.linear16(2) - ours.clean_linear(2)).std()
    assert away < 0.6 * noise
    assert capture.holds("truth")


@pytest.mark.parametrize("renamed", [False, True])
def test_twins_are_paired_by_name_and_else_by_order(renamed: bool, line: Path, strangers: Path, tmp_path: Path) -> None:
    twins = tmp_path / "twins"
    twins.mkdir()
    for i, name in enumerate(NAMES):
        write_png(twins / (f"IMG_{7 * i:03d}.png" if renamed else f"{name}.png"), lit_picture(i))
    if not renamed:
        write_png(twins / "9999.png", lit_picture(0))
    stream = io.StringIO()
    capture = brought(strangers, tmp_path / "cap", Console(stream=stream), lit=twins)
    for i in (0, 5, 8):
        np.testing.assert_array_equal(np.round(255 * capture.source(QUIET).lit(i)), lit_picture(i))
    assert capture.imported.lit == {"folder": "twins", "paired": "order" if renamed else "names", "resampled": 0}
    said = "paired by order, 0000 with IMG_000.png" if renamed else "1 of 10 pictures of"
    assert said in stream.getvalue()


def small(folder: Path) -> None:
    write_png(folder / "0002.png", lit_picture(2, (20, 15)))


@pytest.mark.parametrize("option", ["lit", "clean"])
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "0003.png").unlink(), r"has no picture of 1 of 9 views \(0003\)"),
        (small, r"0002.png must be 40 x 30 px like the pictures .* got 20 x 15"),
        (lambda f: [p.rename(f / f"x{p.name}") for p in sorted(f.iterdir())[1:]], "has no picture of 8 of 9 views"),
        (lambda f: [p.rename(f / f"x{p.name}") if p.name != "0000.png" else p.unlink() for p in list(f.iterdir())],
         r"has 8 pictures \(x0001, .* the dark set 9 \(0000, .* with no name in common"),
        (lambda f: (f / "0004.png").write_bytes(b"no picture"), "0004.png is not a readable image"),
        (lambda f: [p.unlink() for p in f.iterdir()], "holds no pictures"),
        (shutil.rmtree, "no such folder"),
    ],
)  # fmt: skip
def test_twins_that_do_not_fit_are_refused_by_name(
    spoil, message: str, option: str, line: Path, tmp_path: Path
) -> None:
    dark, twins = foreign(tmp_path / "dark", line, "images"), tmp_path / "twins"
    shutil.copytree(line / "lit" / "images", twins)
    brought(dark, tmp_path / "cap")
    spoil(twins)
    before = {path: path.read_bytes() for path in (tmp_path / "cap").rglob("*") if path.is_file()}
    with pytest.raises(ValueError, match=message):
        brought(dark, tmp_path / "cap", **{option: twins})
    assert before == {path: path.read_bytes() for path in (tmp_path / "cap").rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("spoil", "config", "message"),
    [
        (lambda f: (f / "transforms.json").unlink(), {}, "holds 9 pictures and no cameras .* novags poses .* --out"),
        (lambda f: (shutil.rmtree(f), f.mkdir()), {}, r"dark holds no pictures \(.png"),
        (lambda f: (f / "raw" / "0002.dng").unlink(), {}, r"raw has no file of 1 of 9 views \(0002\)"),
        (lambda f: None, {"sensor": "imx686-iso6400"}, r"states the black level 512 DN, --sensor 64 DN"),
        (lambda f: None, {"sensor": "a7s2-iso6400-3chip"}, "has a colour filter array, --sensor three full channels"),
        (lambda f: (f / "raw" / "0001.dng").write_bytes(b"no raw" * 100), {},
         r"0001.dng is not a readable raw file \(Unsupported file format or not RAW file\)"),
        (lambda f: write_png(f / "images" / "0005.png", np.zeros((30, 40, 3), np.uint16)), {},
         "0005.png is 16bit, 0000.png 8bit"),
        (lambda f: None, {"black": 5.0, "white": 5.0}, "0 <= black < white <= 65535, got 5 and 5"),
    ],
)  # fmt: skip
def test_dark_folders_that_cannot_be_imported_are_refused_by_name(
    spoil, config: dict[str, Any], message: str, strangers: Path, tmp_path: Path
) -> None:
    spoil(strangers)
    with pytest.raises(ValueError, match=message):
        brought(strangers, tmp_path / "cap", **config)


def test_an_unchanged_import_is_kept_and_a_changed_picture_is_not(line: Path, strangers: Path, tmp_path: Path) -> None:
    def take() -> int:
        brought(strangers, tmp_path / "cap", lit=line / "lit")
        return (tmp_path / "cap" / "images" / "0000.png").stat().st_mtime_ns

    first = take()
    assert take() == first
    write_png(strangers / "images" / "0007.png", read_codes(strangers / "images" / "0006.png"))
    assert take() > first


def transparent(file: Path, mode: str, alpha: int = 255, last: int | None = None) -> None:
    """Store a picture again with an alpha channel, its last pixel's apart."""
    picture = Image.open(file).convert("RGB" if mode == "RGBA" else "L")
    layer = Image.new("L", picture.size, alpha)
    layer.putpixel((picture.width - 1, picture.height - 1), alpha if last is None else last)
    if mode == "one colour":
        picture.save(file, transparency=picture.getpixel((0, 0)))
    elif mode == "RGBA, 16-bit":
        codes = cv2.imread(str(file), cv2.IMREAD_COLOR).astype(np.uint16) * 257
        assert cv2.imwrite(str(file), np.dstack([codes, np.asarray(layer, np.uint16) * 257]))
    else:
        picture.putalpha(layer)
        picture.save(file)


@pytest.mark.parametrize("mode", ["RGBA", "LA", "one colour", "RGBA, 16-bit"])
def test_a_transparent_pixel_is_refused_since_no_light_is_known_there(mode: str, line: Path, tmp_path: Path) -> None:
    dark = foreign(tmp_path / "dark", line, "images")
    for file in (dark / "images").iterdir():
        transparent(file, mode, last=254 if file.stem == "0007" else None)
    first = r"0000.png must be opaque, got \d+" if mode == "one colour" else "0007.png must be opaque, got 1"
    with pytest.raises(ValueError, match=f"{first} of 1200 pixels with alpha below 255: .* save it without alpha"):
        brought(dark, tmp_path / "cap")
    assert not (tmp_path / "cap" / "images").exists()


def test_a_transparent_lit_picture_is_refused_too(line: Path, tmp_path: Path) -> None:
    dark, lit = foreign(tmp_path / "dark", line, "images"), tmp_path / "twins"
    shutil.copytree(line / "lit" / "images", lit)
    transparent(lit / "0002.png", "RGBA", alpha=10)
    with pytest.raises(ValueError, match=r"twins/0002.png must be opaque, got 1200 of 1200 pixels"):
        brought(dark, tmp_path / "cap", lit=lit)


def test_an_opaque_alpha_channel_changes_no_pixel_and_nothing_is_said_of_white(line: Path, tmp_path: Path) -> None:
    plain = brought(foreign(tmp_path / "plain", line, "images"), tmp_path / "one")
    dark, told = foreign(tmp_path / "plain2", line, "images"), io.StringIO()
    for file in (dark / "images").iterdir():
        transparent(file, "RGBA")
    found = brought(dark, tmp_path / "two", Console(stream=told))
    for i in range(VIEWS):
        np.testing.assert_array_equal(found.srgb8(i), plain.srgb8(i))
    assert "white" not in told.getvalue()
