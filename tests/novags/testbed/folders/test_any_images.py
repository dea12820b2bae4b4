"""Claims about what a capture can be made of, and that no set is too large for the memory."""

import io
import json
import tracemalloc
from pathlib import Path

import cv2
import numpy as np
import pytest

from novags.testbed import stages
from novags.testbed.console.terminal import Console
from novags.testbed.folders.capture import open_capture
from novags.testbed.folders.photographs.linear import (
    WHITE_QUANTILE,
    _exposure_scale,
    _size,
    find_linear,
    load_linear_set,
)  # fmt: skip
from novags.testbed.folders.photographs.raw_files import read_radiance
from novags.testbed.folders.set import PHOTOGRAPHS, READERS, for_photographs, open_source, scaled_rig
from novags.testbed.stages.capturing import QUANTILES, measure_light
from novags.testbed.stages.configs.capturing import CaptureConfig
from novags.testbed.stages.configs.importing import ImportConfig
from sensor_model import PRESETS, Exposure, expose, mosaic, photons_for_electrons, srgb_to_linear, write_dng
from sensor_model.files.dng import XYZ_TO_SRGB
from simscenes import orbit_rig
from simscenes.sets.multiview import write_cameras
from simscenes.sets.pictures.exr import write_exr
from simscenes.sets.pictures.png import read_png
from tests.dngs import NEUTRAL, mosaic_of
from tests.dngs import write_dng as write_tags

QUIET = Console(quiet=True)
CAMERA = PRESETS["imx900-hcg"]


def smooth(i: int, size: tuple[int, int]) -> np.ndarray:
    """A coloured radiance without fine detail, of mean green 1."""
    x, y = np.meshgrid(np.linspace(0, 1, size[0]), np.linspace(0, 1, size[1]))
    light = np.stack([0.4 + x, 0.6 + 0.8 * np.roll(y, i, 0), 1.2 - x * y], -1)
    return (light / light[..., 1].mean()).astype(np.float32)


def write_view(path: Path, i: int, size: tuple[int, int]) -> None:
    light = smooth(i, size)
    if path.suffix == ".exr":
        write_exr(path, dict(zip("RGB", np.moveaxis(40 * light, -1, 0), strict=True)))  # any unit
    elif path.suffix == ".dng":
        photons = mosaic(photons_for_electrons(light, electrons=700, mean_green=1.0, sensor=CAMERA), CAMERA.cfa)
        write_dng(path, expose(photons, CAMERA, Exposure(time=0.01), seed=0, view=i).dn, CAMERA, Exposure(time=0.01))
    else:
        cv2.imwrite(str(path), (80 * light[..., ::-1]).astype(np.uint8))


def photographs(folder: Path, suffix: str, n: int = 3, size: tuple[int, int] = (40, 30), **camera: float) -> Path:
    """A folder of posed images as nerfstudio lays them out."""
    write_cameras(folder, [f"{i:04d}" for i in range(n)], orbit_rig(n, *size, 50.0, radius=3.0))
    (folder / "images").mkdir()
    for i in range(n):
        write_view(folder / "images" / f"{i:04d}{suffix}", i, size)
    content = (folder / "transforms.json").read_text().replace(".png", suffix)
    (folder / "transforms.json").write_text(json.dumps({**json.loads(content), **camera}))
    return folder


@pytest.mark.parametrize(("suffix", "noise"), [(".exr", 1e-5), (".dng", 0.1)])
def test_linear_files_are_read_as_the_light_they_hold(suffix: str, noise: float, tmp_path: Path) -> None:
    source = open_source(photographs(tmp_path, suffix), QUIET)
    assert source.views.names == ("0000", "0001", "0002")
    assert (source.rig.width, source.rig.height) == (40, 30)
    np.testing.assert_allclose(source.rig.Ks, orbit_rig(3, 40, 30, 50.0, radius=3.0).Ks)
    np.testing.assert_allclose(source.rig.viewmats, orbit_rig(3, 40, 30, 50.0, radius=3.0).viewmats, atol=1e-9)
    for i in range(3):
        found, light = source.radiance(i)[2:-2, 2:-2], smooth(i, (40, 30))[2:-2, 2:-2]
        ratio = found / light
        assert ratio.std() / ratio.mean() < noise
        picture = srgb_to_linear(source.lit(i)[2:-2, 2:-2].astype(np.float64))
        inside = picture.max(-1) < 1
        factor = float(source.views.meta["exposure_scale"])
        np.testing.assert_allclose(picture[inside], factor * found[inside], atol=0.01)
    assert 0.3 < source.lit(0).mean() < 0.99


@pytest.mark.parametrize("suffix", [".exr", ".dng", ".png"])
def test_a_capture_of_any_images_is_whole(suffix: str, tmp_path: Path) -> None:
    views = photographs(tmp_path / "set", suffix)
    stages.capture(views, tmp_path / "cap", CaptureConfig(sensor="a7s2-iso6400", electrons=50.0), QUIET)
    capture = open_capture(tmp_path / "cap")
    for i in range(3):
        assert capture.srgb8(i).shape == capture.clean(i).shape == (30, 40, 3)
    scaled = CaptureConfig(sensor="ideal-3chip", electrons=500.0, max_size=20)
    stages.capture(views, tmp_path / "small", scaled, QUIET)
    small = open_capture(tmp_path / "small")
    assert small.clean(0).shape == (15, 20, 3)
    assert small.source(QUIET).lit(0).shape == (15, 20, 3)


@pytest.mark.parametrize("form", ["a.png", "a.tif", "k1.png"])
def test_16_bit_photographs_are_light_in_captures_as_in_imports(form: str, tmp_path: Path) -> None:
    """Rationale: they were cut to 8 bits and decoded from sRGB: a fifth of the light became a thirteenth."""
    suffix, bend = Path(form).suffix, {"k1": 1e-9} if form == "k1.png" else {}
    folder, stream = photographs(tmp_path / "set", suffix, **bend), io.StringIO()
    for i in range(3):
        codes = np.round(20000 * smooth(i, (40, 30))).astype(np.uint16)
        cv2.imwrite(str(folder / "images" / f"{i:04d}{suffix}"), codes[..., ::-1])
    console = Console(stream=stream)
    for i, source in enumerate([open_source(folder, console)] * 3):
        np.testing.assert_allclose(source.radiance(i), 20000 / 65535 * smooth(i, (40, 30)), atol=2e-5)
        shown = srgb_to_linear(source.lit(i).astype(np.float64))
        np.testing.assert_allclose(shown, np.minimum(20000 / 65535 * smooth(i, (40, 30)), 1), atol=5e-3)
    assert stream.getvalue().count("have 16 bits: their codes are taken as linear light") == 1
    stages.capture(folder, tmp_path / "cap", CaptureConfig(sensor="ideal", electrons=50.0), QUIET)
    assert json.loads((tmp_path / "cap" / "capture.json").read_text())["set"]["codes16"] == "linear"
    stages.import_photographs(folder, tmp_path / "imported", ImportConfig(), QUIET)
    light = open_capture(tmp_path / "imported").linear16(1)
    np.testing.assert_allclose(light, 20000 / 65535 * smooth(1, (40, 30)), atol=1e-4)


def test_distortion_of_linear_files_is_undone(tmp_path: Path) -> None:
    straight = load_linear_set(photographs(tmp_path / "a", ".exr"))
    bent = load_linear_set(photographs(tmp_path / "b", ".exr", k1=0.2))
    assert straight is not None
    assert bent is not None
    assert straight.lenses is None
    assert bent.rig.Ks[0, 0, 0] != straight.rig.Ks[0, 0, 0]
    assert bent.radiance(0).shape == (30, 40, 3)
    assert np.abs(bent.radiance(0) / straight.radiance(0) - 1).max() > 0.01


@pytest.mark.parametrize("bent", range(3))
def test_one_lens_that_distorts_is_enough(tmp_path: Path, bent: int) -> None:
    folder = photographs(tmp_path, ".exr")
    content = json.loads((folder / "transforms.json").read_text())
    content["frames"][bent]["k1"] = 0.2
    (folder / "transforms.json").write_text(json.dumps(content))
    views = load_linear_set(folder)
    assert views is not None
    assert views.lenses is not None
    assert [lens.distortion[0] for lens in views.lenses] == [0.2 * (i == bent) for i in range(3)]


def test_margins_around_the_picture_in_a_raw_file_are_cut_off_and_not_scaled(tmp_path: Path) -> None:
    """Rationale: raw files show more of the sensor than the pictures that poses are found with."""
    whole = load_linear_set(photographs(tmp_path / "a", ".dng"))
    part = load_linear_set(photographs(tmp_path / "b", ".dng", w=38, h=29, cx=19.0, cy=14.5))
    assert whole is not None
    assert part is not None
    assert (part.rig.width, part.rig.height) == (38, 29)
    assert part.rig.Ks[0, 0, 0] == whole.rig.Ks[0, 0, 0]
    np.testing.assert_array_equal(part.radiance(1), whole.radiance(1)[0:29, 1:39])


# The picture of 80 x 30 px that an EXR file of 40 x 30 px holds the right half of.
RIGHT_HALF = {
    "dataWindow": (np.array([40, 0], np.int32), np.array([79, 29], np.int32)),
    "displayWindow": (np.array([0, 0], np.int32), np.array([79, 29], np.int32)),
}


def spoilt(value: float) -> dict[str, np.ndarray]:
    """An EXR image of light 1 with another value in one pixel."""
    channel = np.ones((30, 40), np.float32)
    channel[0, 0] = value
    return dict.fromkeys("RGB", channel)


def rename_in_list(folder: Path, old: str, new: str) -> None:
    listed = folder / "transforms.json"
    listed.write_text(listed.read_text().replace(old, new))


@pytest.mark.parametrize("suffix", [".exr", ".png"])
def test_listed_files_that_are_missing_are_skipped_with_a_note(suffix: str, tmp_path: Path) -> None:
    folder, stream = photographs(tmp_path, suffix), io.StringIO()
    (folder / "images" / f"0001{suffix}").unlink()
    source = open_source(folder, Console(stream=stream))
    assert source.views.names == ("0000", "0002")
    assert "1 of 3 views listed in" in stream.getvalue()
    assert f"have no image file and are skipped: images/0001{suffix}" in stream.getvalue()
    np.testing.assert_allclose(source.rig.viewmats, orbit_rig(3, 40, 30, 50.0, radius=3.0).viewmats[[0, 2]], atol=1e-9)


def test_linear_files_beside_the_pictures_that_a_file_lists_are_taken_for_every_view(tmp_path: Path) -> None:
    """The camera file names pictures that were developed; the last of three has no linear file."""
    folder = photographs(tmp_path, ".exr")
    (folder / "images" / "0002.exr").unlink()
    content = (folder / "transforms.json").read_text()
    (folder / "transforms.json").write_text(content.replace(".exr", ".png"))
    source = open_source(folder, QUIET)
    assert source.views.names == ("0000", "0001")
    assert [file.name for file in source.views.files] == ["0000.exr", "0001.exr"]


def test_noise_around_black_in_a_photograph_counts_as_zero_and_is_said(tmp_path: Path) -> None:
    folder, stream = photographs(tmp_path, ".exr"), io.StringIO()
    write_exr(folder / "images" / "0001.exr", spoilt(-1e-3))
    light = open_source(folder, Console(stream=stream)).radiance(1)
    assert (light[0, 0] == 0).all()
    assert (light[1:] == 1).all()
    assert "light slightly below 0" in stream.getvalue()


def test_images_too_small_to_be_scored_are_refused_before_the_work(tmp_path: Path) -> None:
    folder = photographs(tmp_path, ".png", size=(64, 36))
    assert open_source(folder, QUIET, 20).rig.height == 11
    with pytest.raises(ValueError, match=r"at least 11 px .* got 16 x 9: choose a max_size larger than 16"):
        open_source(folder, QUIET, 16)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: [p.unlink() for p in (f / "images").iterdir()], "none of the 3 images listed in"),
        (lambda f: write_exr(f / "images" / "0001.exr", spoilt(-0.5)), "got -0.5 at .* correct 0001.exr, or remove it"),
        (lambda f: write_exr(f / "images" / "0001.exr", spoilt(np.nan)), "got nan at .* correct 0001.exr"),
        (lambda f: (f / "images" / "0001.exr").write_bytes(b"no picture"), "not a readable EXR"),
        (lambda f: write_exr(f / "images" / "0001.exr", spoilt(0.5), RIGHT_HALF), "holds a part of its picture"),
        (lambda f: write_view(f / "images" / "0000.exr", 0, (20, 30)), "must share one size"),
        (lambda f: write_view(f / "images" / "0001.exr", 0, (20, 30)), "must share one size"),
        (lambda f: write_exr(f / "images" / "0001.exr", {"Y": np.ones((30, 40), np.float32)}), "channels R, G, B"),
        (lambda f: rename_in_list(f, "0.exr", "0.png"), "either linear files"),
        (lambda f: rename_in_list(f, "1.exr", "1.png"), "either linear files"),
    ],
)
def test_a_broken_set_of_linear_files_says_which_file(spoil, message: str, tmp_path: Path) -> None:
    spoil(photographs(tmp_path, ".exr"))
    with pytest.raises(ValueError, match=message):
        open_source(tmp_path, QUIET).radiance(1)


@pytest.mark.parametrize("side", [128, 160, 256])
def test_quantiles_of_the_signal_are_those_of_all_pixels_and_colours(side: int, tmp_path: Path) -> None:
    """Rationale: a regular choice of pixels must see every colour and, in a picture of stripes, every column.

    Expectation: among n chosen pixels, a share p of the picture is found up to 5 sqrt(p (1 - p) / n) at random. Here n
    is 1365; colours and columns take whole shares of a third and a half.
    """
    folder = photographs(tmp_path, ".exr", n=2, size=(side, side))
    light = np.ones((side, side, 3), np.float32) * np.array([1.0, 10.0, 100.0], np.float32)
    light[:, ::2] *= 2
    for i in range(2):
        write_exr(folder / "images" / f"{i:04d}.exr", dict(zip("RGB", np.moveaxis(light, -1, 0), strict=True)))
    sensor = PRESETS["ideal-3chip"]
    _, found = measure_light(open_source(folder, QUIET), sensor, lambda *_: None)
    everything = light * np.asarray(sensor.rgb_response, np.float32)
    for quantile, value in zip(QUANTILES, found, strict=True):
        below, up_to = np.mean(everything < value * (1 - 1e-6)), np.mean(everything <= value * (1 + 1e-6))
        slack = 5 * np.sqrt(quantile * (1 - quantile) / 1365)
        assert below - slack <= quantile <= up_to + slack


@pytest.mark.parametrize("suffix", [".png", ".exr", ".dng"])
def test_peak_memory_does_not_grow_with_the_number_of_views(suffix: str, tmp_path: Path) -> None:
    """Rationale: sets of thousands of photographs must pass. Expectation: what six more views add is under a tenth of
    what they would take, 0.36 MB each as float32."""
    config = CaptureConfig(sensor="a7s2-iso6400", electrons=50.0, demosaic="bilinear")

    def peaks(n: int) -> np.ndarray:
        views = photographs(tmp_path / f"set{n}", suffix, n, (200, 150))
        tracemalloc.start()
        measure_light(open_source(views, QUIET), CAMERA, lambda *_: None)
        light = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        stages.capture(views, tmp_path / f"cap{n}", config, QUIET)
        whole = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return np.array([light, whole])

    # What is imported and compiled on first use
    stages.capture(photographs(tmp_path / "set", suffix, 2), tmp_path / "cap", config, QUIET)
    assert (peaks(9) - peaks(3)).max() < 0.1 * 6 * 200 * 150 * 3 * 4


@pytest.mark.parametrize("read", ["radiance", "lit"])
def test_transparent_pixels_of_a_photograph_are_before_white_and_that_is_said_where_they_are_read(
    read: str, tmp_path: Path
) -> None:
    folder, stream = photographs(tmp_path, ".png"), io.StringIO()
    plain = [getattr(open_source(folder, QUIET), read)(i) for i in (0, 1)]
    file = folder / "images" / "0001.png"
    alpha = np.full((30, 40, 1), 255, np.uint8)
    alpha[:10] = 0
    assert cv2.imwrite(str(file), np.concatenate([cv2.imread(str(file)), alpha], -1))
    source = open_source(folder, Console(stream=stream))
    np.testing.assert_array_equal(getattr(source, read)(0), plain[0])
    assert "alpha" not in stream.getvalue()
    found = getattr(source, read)(1)
    assert (found[:10] == 1).all()
    np.testing.assert_array_equal(found[10:], plain[1][10:])
    assert "have an alpha channel: the background of their pixels counts as white" in stream.getvalue()


def test_views_that_are_called_unlike_their_files_are_said_to_be_named_in_a_capture(tmp_path: Path) -> None:
    """Pictures can be scored against a set alone, without a capture.json that lists their names."""
    folder, stream = photographs(tmp_path, ".png"), io.StringIO()
    (folder / "images" / "a").mkdir()
    (folder / "images" / "0000.png").rename(folder / "images" / "a" / "0001.png")
    transforms = folder / "transforms.json"
    transforms.write_text(transforms.read_text().replace("images/0000.png", "images/a/0001.png"))
    open_source(folder, Console(stream=stream))
    assert "cannot have one name" in stream.getvalue()
    assert "the capture.json of a capture of it names the file of each" in " ".join(stream.getvalue().split())


def test_cameras_of_smaller_pictures_see_the_same_at_scaled_pixels() -> None:
    rig = orbit_rig(2, 40, 30, 50.0, radius=3.0)
    small = scaled_rig(rig, 20)
    assert (small.width, small.height) == (20, 15)
    points = np.random.default_rng(0).normal(0, 0.3, (7, 3))
    np.testing.assert_allclose(small.project(points)[0], rig.project(points)[0] / 2, atol=1e-9)
    assert scaled_rig(rig, 40) is rig


@pytest.mark.parametrize("name", ["images/0000.png", "images/0002.png", "transforms.json"])
def test_every_file_of_a_set_that_is_read_counts_and_no_other(name: str, tmp_path: Path) -> None:
    source = open_source(photographs(tmp_path, ".png"), QUIET)
    before = source.digest()
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "images" / "thumbs.db").write_text("somebody's")
    assert source.digest() == before
    with (tmp_path / name).open("ab") as file:
        file.write(b" ")
    assert source.digest() != before


def test_light_slightly_below_zero_is_so_by_the_bright_light_of_its_picture(tmp_path: Path) -> None:
    """One hundredth of the bright light is noise, more is an error, whatever the unit of the light is."""
    folder = photographs(tmp_path, ".exr")
    for unit in (1e-3, 1.0, 1e3):
        for share, fine in ((-0.009, True), (-0.02, False)):
            channel = np.full((30, 40), 0.1 * unit, np.float32)
            channel[:10] = unit  # a third is bright
            channel[20, 20] = share * unit
            write_exr(folder / "images" / "0001.exr", dict.fromkeys("RGB", channel))
            source = open_source(folder, QUIET)
            if fine:
                assert source.radiance(1).min() == 0
                assert source.radiance(1).max() == np.float32(unit)
            else:
                with pytest.raises(ValueError, match="radiance must be finite and >= 0"):
                    source.radiance(1)


def test_photographs_need_the_modules_of_all_their_tables() -> None:
    found = for_photographs()
    for table in (PHOTOGRAPHS, READERS):
        assert {table.module_of(name) for name in table} - {None} <= set(found)


def test_the_size_of_a_picture_is_that_of_its_window_and_its_exposure_makes_a_bright_part_white(tmp_path: Path) -> None:
    light = np.linspace(1.0, 100.0, 30 * 40, dtype=np.float32).reshape(30, 40)
    file = tmp_path / "a.exr"
    write_exr(file, dict.fromkeys("RGB", light))
    assert _size(file) == (40, 30)
    assert 1 / _exposure_scale((file,)) == pytest.approx(np.quantile(light, WHITE_QUANTILE), rel=1e-3)


@pytest.mark.parametrize("place", ["images", "raw", "."])
@pytest.mark.parametrize("suffix", [".exr", ".EXR", ".dng", ".NEF"])
def test_a_linear_file_is_found_in_every_place_with_every_suffix(place: str, suffix: str, tmp_path: Path) -> None:
    file = tmp_path / place / f"sub/a{suffix}"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()
    assert find_linear(tmp_path, "images/sub/a.png") == file
    assert find_linear(tmp_path, "images/sub/b.png") is None


BALANCES = [([0.5, 1.0, 0.7], 0.0), ([0.7, 1.0, 0.5], 0.0), ([0.5, 1.0, 0.7], 0.3)]  # neutral; green leaking into red


def test_raw_files_of_automatic_white_balance_are_developed_with_the_colours_of_the_first(tmp_path: Path) -> None:
    """The same codes, other balances: one surface has one colour in all views, of a set and of well-lit twins."""
    folder = photographs(tmp_path / "set", ".dng", size=(64, 48))
    codes = mosaic_of(smooth(0, (64, 48)) * 0.2, 512)
    to_camera = NEUTRAL[:, None] * XYZ_TO_SRGB
    for i, (neutral, leak) in enumerate(BALANCES):
        matrix = (np.array([[1, leak, 0], [0, 1, 0], [0, 0, 1]]) @ to_camera).ravel().tolist()
        extra = {50728: ("R", neutral), 50721: ("S", matrix)}
        write_tags(folder / "images" / f"{i:04d}.dng", codes, extra, black=[512.0])
    console = Console(stream=(stream := io.StringIO()))
    source = open_source(folder, console)
    own = read_radiance(folder / "images" / "0000.dng")
    for i in range(3):
        alone = read_radiance(folder / "images" / f"{i:04d}.dng")
        assert (np.abs(alone - own).max() > 0.03) == (i > 0)
        np.testing.assert_allclose(source.radiance(i), own, atol=1e-3)  # AHD looks at the own matrix for edges
    assert "0001.dng other ones than 0000.dng" in stream.getvalue()
    stages.import_photographs(folder, tmp_path / "cap", ImportConfig(lit=folder / "images"), console)
    lit = [read_png(tmp_path / "cap" / "lit" / f"{i:04d}.png") for i in range(3)]
    np.testing.assert_allclose(lit, [lit[0]] * 3, atol=1.5 / 255)
    assert stream.getvalue().count("those of 0000.dng count for all") == 1


def test_nothing_is_said_of_raw_files_of_one_white_balance(tmp_path: Path) -> None:
    stream = io.StringIO()
    open_source(photographs(tmp_path, ".dng"), Console(stream=stream))
    assert "white balance" not in stream.getvalue()
