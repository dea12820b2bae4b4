"""TIFF files are read as stored, whatever marks in them ask decoders for."""

from pathlib import Path

import cv2
import numpy as np
import PIL
import PIL.Image
import pytest
import tifffile

from sensor_model.isp import to_srgb8
from simscenes.sets.pictures.image_file import alpha_of, has_alpha, header, image_size, read_image, read_rgb
from simscenes.sets.pictures.tiff import tiff_tags
from tests.tiffs import write_tiff

RNG = np.random.default_rng(0)
TURNS = range(1, 9)
# Channels, and what the last one is (1: alpha that colours are multiplied by, 2: alpha); with depth.
COLORS = [(1, None), (3, None), (4, 1), (4, 2)]
# Pillow learned grey with premultiplied alpha in 13; before, the file is refused in one line, as docs/install.md says.
OLD_PIL = pytest.mark.skipif(int(PIL.__version__.partition(".")[0]) < 13, reason="Pillow 13 was the first to read it")
GREY = [pytest.param(np.uint8, 2, 1, marks=OLD_PIL), (np.uint8, 2, 2)]
KINDS = [(np.uint8, *kind) for kind in COLORS] + GREY + [(np.uint16, *kind) for kind in COLORS]
ALPHA = [(np.uint8, *kind) for kind in COLORS if kind[1]] + GREY + [(np.uint16, *kind) for kind in COLORS if kind[1]]


@pytest.mark.parametrize("size", [(5, 3), (4, 4)])
@pytest.mark.parametrize(("dtype", "channels", "extra"), KINDS)
def test_a_mark_of_orientation_turns_no_pixels(
    dtype: type, channels: int, extra: int | None, size: tuple[int, int], tmp_path: Path
) -> None:
    """Rationale: poses refer to pixels as stored. Alpha is opaque here."""
    width, height = size
    largest = np.iinfo(dtype).max
    pixels = RNG.integers(0, largest, (height, width, channels), dtype, endpoint=True)
    if extra is not None:
        pixels[..., -1] = largest
    colors = pixels[..., :3] if channels > 2 else pixels[..., [0] * 3]
    for orientation in TURNS:
        file = write_tiff(tmp_path / "a.tif", pixels, orientation=orientation, extra=extra)
        assert image_size(file) == size
        assert np.array_equal(read_image(file, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)[..., ::-1], colors), orientation
        shown = to_srgb8(colors / largest) if dtype == np.uint16 else colors  # codes of 16 bits are light
        assert np.array_equal(read_rgb(file), shown), orientation


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
def test_the_mark_is_found_in_either_order_of_bytes_and_in_big_files(order: str, big: bool, tmp_path: Path) -> None:
    pixels = RNG.integers(0, 2**16, (3, 5, 3), np.uint16)
    file = write_tiff(tmp_path / "a.tif", pixels, orientation=6, order=order, big=big)
    assert tiff_tags(file)[274].values == (6,)
    assert tiff_tags(file)[258].values == (16, 16, 16)
    if (big, order) != (True, ">"):  # which PIL does not know
        assert np.array_equal(read_image(file, cv2.IMREAD_UNCHANGED)[..., ::-1], pixels)


def test_a_mark_of_orientation_in_xmp_turns_no_pixels_either(tmp_path: Path) -> None:
    """PIL, which reads gray with alpha, follows it."""
    mark = b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description tiff:Orientation="6"/></x:xmpmeta>'
    pixels = RNG.integers(0, 256, (3, 5, 2), np.uint8)
    PIL.Image.fromarray(pixels, "LA").save(tmp_path / "a.tif", tiffinfo={700: mark})
    with header(tmp_path / "a.tif") as image:
        assert np.array_equal(np.asarray(image), pixels)


@pytest.mark.parametrize("cut", range(0, 170, 3))
def test_damaged_files_have_the_tags_that_are_left(cut: int, tmp_path: Path) -> None:
    whole = write_tiff(tmp_path / "a.tif", np.zeros((3, 5, 3), np.uint8), orientation=6)
    tags = tiff_tags(whole)
    whole.write_bytes(whole.read_bytes()[:cut])
    assert tiff_tags(whole).items() <= tags.items()
    whole.write_bytes(b"II*\0\x08\0\0\0" + b"\xff" * cut)
    assert tiff_tags(whole) == {}


def test_what_is_no_picture_for_all_its_mark_is_refused_by_name(tmp_path: Path) -> None:
    file = write_tiff(tmp_path / "a.tif", np.zeros((3, 5, 5), np.uint8), orientation=6)
    with pytest.raises(ValueError, match=r"a\.tif is not a readable image \(its kind is not known\); replace"):
        image_size(file)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("dtype", "channels", "extra"), ALPHA)
def test_whatever_alpha_a_file_has_its_colours_are_before_white(
    dtype: type, channels: int, extra: int, order: str, tmp_path: Path
) -> None:
    """Rationale: 8-bit colours came multiplied by alpha from OpenCV, and were multiplied again."""
    scale = np.iinfo(dtype).max / 255
    colors = np.array([200, 100, 50])[: channels - 1]
    stored = colors * 128 / 255 if extra == 1 else colors
    pixels = np.tile(np.round(np.append(stored, 128) * scale).astype(dtype), (2, 3, 1))
    file = write_tiff(tmp_path / "a.tif", pixels, extra=extra, order=order)
    white = np.array([227, 177, 152] if channels == 4 else [227] * 3)
    if dtype == np.uint16:  # mixed as light
        white = to_srgb8(white / 255)
    assert read_rgb(file).tolist() == [[white.tolist()] * 3] * 2
    assert alpha_of(file).tolist() == [[128] * 3] * 2


def test_colours_beyond_their_alpha_are_white_at_most(tmp_path: Path) -> None:
    file = write_tiff(tmp_path / "a.tif", np.full((2, 3, 4), (200, 100, 50, 100), np.uint8), extra=1)
    assert read_rgb(file)[0, 0].tolist() == [255, 255, 205]


@pytest.mark.parametrize(
    ("pixels", "problem"),
    [
        (np.ones((3, 5, 1), np.float32), r"is a TIFF of floating-point numbers \(32-bit\), which is not read: save it "
         r"as 16-bit TIFF or PNG, or as EXR where its light is linear$"),
        (np.ones((3, 5, 3), np.float32), r"is a TIFF of floating-point numbers \(32-bit\)"),
        (np.ones((3, 5, 3), np.float16), r"is a TIFF of floating-point numbers \(16-bit\)"),
        (np.ones((3, 5, 2), np.uint16), "is a TIFF of 16-bit gray with alpha, which is not read: save it as RGBA, or"),
    ],
)  # fmt: skip
def test_kinds_that_are_not_read_are_refused_by_what_they_are(
    pixels: np.ndarray, problem: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = write_tiff(tmp_path / "a.tif", pixels, extra=2 if pixels.shape[2] == 2 else None)
    for way in (image_size, has_alpha, read_rgb, lambda file: read_image(file, cv2.IMREAD_UNCHANGED)):
        with pytest.raises(ValueError, match=rf"a\.tif {problem}"):
            way(file)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", ["planes", "planes and alpha", "0 is white"])
def test_deep_files_whose_codes_opencv_confuses_are_refused(kind: str, tmp_path: Path) -> None:
    """Rationale: planes came out interleaved, and 0 as black, without a word."""
    file, codes = tmp_path / "a.tif", RNG.integers(0, 256, (4 if "alpha" in kind else 3, 6, 5), np.uint16) * 257
    if kind == "0 is white":
        tifffile.imwrite(file, 65535 - codes[0], photometric="miniswhite")
        problem = "is a 16-bit TIFF of gray in which 0 is white, which is not read at that"
    else:
        more = {"extrasamples": ["unassalpha"]} if "alpha" in kind else {}
        tifffile.imwrite(file, codes, photometric="rgb", planarconfig="separate", **more)
        problem = "is a 16-bit TIFF whose channels are stored one after the other, which is not read at that depth"
    for flags in (cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH, cv2.IMREAD_UNCHANGED):
        with pytest.raises(ValueError, match=rf"a\.tif {problem}"):
            read_image(file, flags)
    with pytest.raises(ValueError, match=rf"a\.tif {problem}"):
        read_rgb(file)


def test_opencv_writes_no_lines_of_its_own_of_a_damaged_picture(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """And writes them again afterwards, where others call it."""
    file = write_tiff(tmp_path / "a.tif", np.ones((30, 50, 3), np.uint16))
    file.write_bytes(file.read_bytes()[:-3000])
    before = cv2.utils.logging.getLogLevel()
    with pytest.raises(
        ValueError, match=r"a\.tif is not a readable image \(it cannot be decoded\); replace or remove it"
    ):
        read_image(file, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    assert capfd.readouterr() == ("", "")
    assert cv2.utils.logging.getLogLevel() == before
