"""Claims about how photographs were exposed and stored: alike or refused, compressed or not, in a tone of their own."""

import io
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.photographs.raw_files import read_digital_numbers
from novags.testbed.importing import raw_camera as module
from novags.testbed.importing.exposures import check_exposed_alike, exposure_doubts, stated_of
from novags.testbed.importing.raw_camera import raw_camera
from novags.testbed.importing.stored import Codes16, is_lossy
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.importing import ImportConfig
from sensor_model import PRESETS, Exposure, expose, mosaic, srgb_to_linear, write_dng
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.png import read_png, write_png
from tests.dngs import write_dng as write_tags
from tests.miniatures import write16

QUIET = Console(quiet=True)
CAMERA = PRESETS["a7s2-iso6400"]
NAMES = [f"{i:04d}" for i in range(3)]


def jpeg(file: Path, time: tuple[int, int] | None = None, iso: int | None = None) -> Path:
    exif = Image.Exif()
    part = exif.get_ifd(0x8769)
    for tag, value in ((0x829A, time), (0x8827, iso)):
        if value is not None:
            part[tag] = IFDRational(*value) if isinstance(value, tuple) else value
    Image.new("RGB", (32, 24), (40, 30, 20)).save(file, exif=exif)
    return file


def test_files_of_one_exposure_or_of_an_unknown_one_are_taken(tmp_path: Path) -> None:
    alike = [
        jpeg(tmp_path / "a.jpg", (1, 30), 800),
        jpeg(tmp_path / "b.jpg"),
        jpeg(tmp_path / "c.jpg", (333, 10000), 800),
    ]
    assert stated_of(alike[0]) == (pytest.approx(1 / 30), 800, None)
    assert stated_of(alike[1]) == (None, None, None)
    check_exposed_alike(alike)
    assert stated_of(jpeg(tmp_path / "odd.jpg", (0, 0))) == (None, None, None)


def test_other_times_and_speeds_are_refused_by_name(tmp_path: Path) -> None:
    first, unknown = jpeg(tmp_path / "a.jpg", (1, 30), 800), jpeg(tmp_path / "b.jpg")
    with pytest.raises(
        ValueError, match=r"c\.jpg states the exposure time 0\.1 s, a\.jpg 0\.0333333: all views must be"
    ):
        check_exposed_alike([first, unknown, jpeg(tmp_path / "c.jpg", (1, 10), 800)])
    with pytest.raises(ValueError, match=r"c\.jpg states the ISO speed 1600, a\.jpg 800: all views must be exposed"):
        check_exposed_alike([first, unknown, jpeg(tmp_path / "c.jpg", (1, 30), 1600)])
    for name, time in (("d", 0.01), ("e", 0.1)):
        write_dng(tmp_path / f"{name}.dng", np.full((64, 64), 700, np.uint16), CAMERA, Exposure(time=time))
    with pytest.raises(ValueError, match=r"e\.dng states the exposure time 0\.1 s, d\.dng 0\.01: .* or give --time"):
        check_exposed_alike([tmp_path / "d.dng", tmp_path / "e.dng"])


def test_pictures_of_another_iso_than_the_camera_are_refused(tmp_path: Path) -> None:
    write_cameras(tmp_path / "dark", NAMES, orbit_rig(3, 32, 24, 50.0, radius=3.0))
    cameras = tmp_path / "dark" / "transforms.json"
    cameras.write_text(cameras.read_text().replace(".png", ".jpg"))
    (tmp_path / "dark" / "images").mkdir()
    for name in NAMES:
        jpeg(tmp_path / "dark" / "images" / f"{name}.jpg", iso=100)
    wrong = r"0000\.jpg states the ISO speed 100, --sensor a7s2-iso6400 6400: .* or leave out --sensor"
    with pytest.raises(ValueError, match=wrong):
        brought(tmp_path / "dark", tmp_path / "cap", sensor="a7s2-iso6400")
    brought(tmp_path / "dark", tmp_path / "cap", sensor="a7s2-iso100")


def test_photographs_of_two_exposures_are_said_from_four_times_on(tmp_path: Path) -> None:
    first, unknown = jpeg(tmp_path / "a.jpg", (1, 30), 800), jpeg(tmp_path / "b.jpg")
    balanced = jpeg(tmp_path / "c.jpg", (1, 240), 6400)  # a shorter time at a higher speed is the same exposure
    assert exposure_doubts([first, unknown, balanced, jpeg(tmp_path / "d.jpg", (1, 30), 3200)]) == []
    (note,) = exposure_doubts([first, unknown, balanced, jpeg(tmp_path / "e.jpg", (1, 10), 2400)])
    assert "e.jpg got 9 times the exposure of " in note
    light = {"RGB": np.ones((8, 8, 3), np.float32)}
    for name, time in (("f", 0.5), ("g", 0.01)):
        OpenEXR.File({"type": OpenEXR.scanlineimage, "expTime": time}, light).write(str(tmp_path / f"{name}.exr"))
    (note,) = exposure_doubts([tmp_path / "f.exr", tmp_path / "g.exr"])
    assert "f.exr got 50 times the exposure of g.exr" in note


def test_exposures_that_a_camera_changed_step_by_step_are_not_doubted(tmp_path: Path) -> None:
    speeds = (100, 250, 600, 1500, 3200)  # 32 times from first to last, at most 2.5 from one to the next
    walk = [jpeg(tmp_path / f"{speed}.jpg", (1, 60), speed) for speed in speeds]
    assert exposure_doubts(walk) == []
    (note,) = exposure_doubts([walk[0], walk[1], walk[4]])
    assert "3200.jpg got 12.8 times the exposure of 250.jpg" in note


@pytest.fixture
def dark(tmp_path: Path) -> Path:
    """Pictures and raw files of one exposure; long/ has clean ones of ten times the light."""
    rng = np.random.default_rng(0)
    light = cv2.resize(rng.uniform(200, 900, (4, 4, 3)), (64, 64))
    write_cameras(tmp_path / "lit", NAMES, orbit_rig(3, 64, 64, 50.0, radius=3.0))
    for name in NAMES:
        write_png(tmp_path / "lit" / "images" / f"{name}.png", np.clip(light / 4, 0, 255).astype(np.uint8))
    for place, electrons in (("dark", 300.0), ("long", 2000.0)):
        config = CaptureConfig(sensor="a7s2-iso6400", electrons=electrons, demosaic="bilinear")
        stages.capture(tmp_path / "lit", tmp_path / place, config, QUIET)
    stranger = tmp_path / "stranger"
    stranger.mkdir()
    shutil.copy(tmp_path / "lit" / "transforms.json", stranger)
    for part in ("images", "raw"):
        shutil.copytree(tmp_path / "dark" / part, stranger / part)
    return stranger


def brought(dark: Path, out: Path, **config: object) -> str:
    stream = io.StringIO()
    settings = ImportConfig(demosaic="bilinear", **config)  # type: ignore[arg-type]
    stages.import_photographs(dark, out, settings, Console(stream=stream), overwrite=True)
    return stream.getvalue()


def test_an_import_refuses_mixed_exposures_unless_the_user_says_the_time(dark: Path, tmp_path: Path) -> None:
    codes = np.random.default_rng(0).integers(600, 900, (64, 64)).astype(np.uint16)
    write_dng(dark / "raw" / "0001.dng", codes, CAMERA, Exposure(time=0.5))
    with pytest.raises(ValueError, match=r"0001\.dng states the exposure time 0\.5 s"):
        brought(dark, tmp_path / "cap")
    brought(dark, tmp_path / "cap", time=0.1)


def test_clean_exposures_of_several_times_are_refused_whatever_the_time_of_the_dark_ones(
    dark: Path, tmp_path: Path
) -> None:
    """Expectation: one factor cannot bring them to the light of the dark pictures, so they are no truth."""
    long = shutil.copytree(tmp_path / "long" / "raw", tmp_path / "elsewhere")  # files of a capture may not be exchanged
    write_dng(long / "0002.dng", read_digital_numbers(long / "0002.dng"), CAMERA, Exposure(time=7.0))
    for time in (None, 0.1):
        with pytest.raises(
            ValueError, match=r"0002\.dng states the exposure time 7 s, .*: all clean exposures must be"
        ):
            brought(dark, tmp_path / "cap", clean=long, time=time)


def test_clean_exposures_beside_raw_files_are_raw_and_a_tone_of_the_pictures_own_is_said(
    dark: Path, tmp_path: Path
) -> None:
    """Expectation: one factor cannot serve the camera's picture and the light of its raw file."""
    assert "tone of their own" not in brought(dark, tmp_path / "cap", clean=tmp_path / "long" / "raw")
    with pytest.raises(ValueError, match=r"--clean must hold files like the dark ones \(raw\), got 8bit"):
        brought(dark, tmp_path / "cap", clean=tmp_path / "long" / "images")
    for name in NAMES:
        codes = read_png(dark / "images" / f"{name}.png")
        write_png(dark / "images" / f"{name}.png", (255 * (codes / 255.0) ** 0.7).round().astype(np.uint8))
    assert "tone of their own" in brought(dark, tmp_path / "cap", clean=tmp_path / "long" / "raw")
    assert "tone of their own" not in brought(dark, tmp_path / "cap")  # nothing is compared with the light then


def test_the_black_level_is_that_of_the_file(tmp_path: Path) -> None:
    """Expectation: 20 electrons are 20 electrons, with a camera whose black is 100 codes above its model's."""
    real = replace(CAMERA, black_level=CAMERA.black_level + 100)
    photons = mosaic(np.full((64, 64, 3), 20 / CAMERA.eta), "RGGB")
    frame = expose(photons, real, Exposure(time=1 / 30), seed=0, view=0)
    write_dng(tmp_path / "a.dng", frame.dn, real, Exposure(time=1 / 30))
    camera = raw_camera(tmp_path / "a.dng", CAMERA, "bilinear")
    assert camera.sensor.black_level == real.black_level
    found = camera.develop(camera.codes(tmp_path / "a.dng"))[..., 1].mean()
    assert found == pytest.approx(20 * CAMERA.gain / (real.white_dn - real.black_level), rel=0.05)  # 3 standard errors


def test_black_levels_that_differ_between_the_colours_become_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rationale: methods are given one black level. Expectation: codes over their own black level stay as they are."""
    plain, file = np.random.default_rng(0).integers(700, 900, (64, 64)).astype(np.uint16), tmp_path / "a.dng"
    write_dng(file, plain, CAMERA, Exposure(time=0.1))
    honest = module.read_format
    monkeypatch.setattr(module, "read_format", lambda f: replace(honest(f), black=(511.0, 512.0, 514.0, 511.0)))
    camera = raw_camera(file, None, "bilinear")
    assert camera.sensor.black_level == 512.0
    np.testing.assert_array_equal(camera.codes(file), plain.astype(int) + np.tile([[1, 0], [-2, 1]], (32, 32)))


def test_levels_less_than_a_code_apart_are_a_cameras_too(tmp_path: Path) -> None:
    file = write_tags(tmp_path / "a.dng", np.full((64, 96), 1023), black=[1022.5], white=1023)
    camera = raw_camera(file, None, "bilinear")
    assert (camera.sensor.black_level, camera.format.white) == (1022.5, 1023)
    assert (camera.codes(file) == 1023).all()


def test_compression_with_loss_is_seen_in_every_format_that_has_it(tmp_path: Path) -> None:
    picture = Image.fromarray(np.random.default_rng(0).integers(0, 255, (32, 32, 3)).astype(np.uint8))
    lossy = {"a.jpg": {}, "a.webp": {"quality": 80}, "a.tif": {"compression": "jpeg"}}
    whole = {"b.png": {}, "b.webp": {"lossless": True}, "b.tif": {}, "c.tif": {"compression": "tiff_lzw"}}
    for name, how in (lossy | whole).items():
        picture.save(tmp_path / name, **how)
        assert is_lossy(tmp_path / name) == (name in lossy), name
    picture.save(tmp_path / "film.webp", save_all=True, append_images=[picture.rotate(90)], quality=80)
    assert is_lossy(tmp_path / "film.webp")
    cv2.imwrite(str(tmp_path / "deep.tif"), np.full((8, 8, 3), 700, np.uint16))
    assert not is_lossy(tmp_path / "deep.tif")


@pytest.mark.parametrize("curve", ["linear", "srgb"])
def test_codes_are_light_between_their_own_black_and_white(curve: str) -> None:
    codes = Codes16(black=1000.0, white=9000.0, curve=curve)  # type: ignore[arg-type]
    light = codes.linear(np.array([200, 1000, 3000, 5000, 9000, 10600], np.uint16))
    expected = np.array([-0.1, 0.0, 0.25, 0.5, 1.0, 1.2])
    np.testing.assert_allclose(light, expected if curve == "linear" else srgb_to_linear(expected), atol=1e-6)
    eight = codes.linear(np.array([0, 128, 255], np.uint8))
    np.testing.assert_allclose(eight, srgb_to_linear(np.array([0, 128, 255]) / 255), atol=1e-6)


@pytest.mark.parametrize("code", [100, 60000])
def test_twins_are_of_full_range_as_soon_as_one_of_them_is_off_the_levels_of_the_dark_ones(
    code: int, tmp_path: Path
) -> None:
    dark, files = Codes16(black=1000.0, white=9000.0, curve="srgb"), [tmp_path / f"{name}.png" for name in "abc"]
    codes = np.random.default_rng(0).integers(1000, 9000, (8, 8, 3)).astype(np.uint16)
    for other in (None, *files):
        for file in files:
            write16(file, np.full_like(codes, code) if file == other else codes)
        wanted = dark if other is None else Codes16(black=0.0, white=65535.0, curve="srgb")
        assert dark.for_twins(files) == wanted


def test_raw_files_of_the_first_one_are_one_cameras_and_others_are_refused_by_what_differs(tmp_path: Path) -> None:
    codes = np.random.default_rng(0).integers(700, 900, (64, 64)).astype(np.uint16)
    other = replace(CAMERA, mu_e_sat=CAMERA.mu_e_sat / 4, bits=12)
    for name, sensor, dn in (("a", CAMERA, codes), ("b", other, codes), ("c", CAMERA, codes[:48])):
        write_dng(tmp_path / f"{name}.dng", np.ascontiguousarray(dn), sensor, Exposure(time=0.1))
    camera = raw_camera(tmp_path / "a.dng", None, "bilinear")
    assert camera.format.black[0] < camera.format.white
    assert camera.sensor.mu_e_sat == camera.format.white - camera.format.black[0]
    assert camera.sensor.bits == int(camera.format.white).bit_length() > 8
    np.testing.assert_array_equal(camera.codes(tmp_path / "a.dng"), codes)
    for name, what in (("b", "white level"), ("c", "size")):
        with pytest.raises(ValueError, match=f"{name}.dng has the {what}"):
            camera.codes(tmp_path / f"{name}.dng")
