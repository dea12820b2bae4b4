"""TIFF files of every kind that tifffile writes: what is read is what was stored, or the file is refused by name."""

import tracemalloc
from pathlib import Path
from struct import pack
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from sensor_model.isp import to_srgb8
from simscenes.sets.pictures.image_file import header, image_size, read_image, read_rgb
from simscenes.sets.pictures.tiff import BITS, TAGS, like_pages, tiff_tags
from tests.tiffs import write_tiff

STORED = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
LOSSLESS = [(None, 1), ("lzw", 1), ("lzw", 2), ("deflate", 1), ("deflate", 2), ("packbits", 1)]  # with the predictor
HEIGHT, WIDTH = 83, 70  # of no whole tiles or strips
LAYOUTS = {"strips": {"rowsperstrip": 16}, "tiles": {"tile": (32, 32)}}


def codes(bits: int, channels: int) -> np.ndarray:
    """Slopes with a little noise, which every compression finds something in: [h,w] or [h,w,c]."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    slopes = np.stack([3 * x, 2 * y, x + y, 255 - x], -1)[..., :channels].astype(float)
    found = slopes + np.random.default_rng(0).uniform(0, 0.9, slopes.shape)
    stored = (found * (2**bits / 300)).astype(f"u{bits // 8}")
    if channels == 4:
        stored[..., 3] = 2**bits - 1  # alpha
    return stored[..., 0] if channels == 1 else stored


def written(file: Path, pixels: np.ndarray, **options: Any) -> Path:
    kind = "minisblack" if pixels.ndim == 2 else "rgb"
    extra = {"extrasamples": ["unassalpha"]} if pixels.shape[2:] == (4,) else {}
    tifffile.imwrite(file, pixels, photometric=kind, **extra, **options)
    return file


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(("compression", "predictor"), LOSSLESS)
def test_codes_are_read_as_stored(
    compression: str | None, predictor: int, bits: int, channels: int, layout: str, tmp_path: Path
) -> None:
    stored = codes(bits, channels)
    file = written(tmp_path / "a.tif", stored, compression=compression, predictor=predictor, **LAYOUTS[layout])
    assert image_size(file) == (WIDTH, HEIGHT)
    rgb = stored[..., None].repeat(3, -1) if channels == 1 else stored[..., :3]
    found = read_image(file, STORED)[..., ::-1]
    assert found.dtype == stored.dtype
    assert np.array_equal(found, rgb)
    assert np.array_equal(read_rgb(file), to_srgb8(rgb / 65535) if bits == 16 else rgb)


GRAY = [  # and how many of three ways refuse it at a width of two tiles, and at one of two and a bit
    ("minisblack", 8, 0, 0), ("minisblack", 16, 0, 1), ("miniswhite", 8, 0, 0), ("miniswhite", 16, 2, 3),
    ("alpha", 8, 0, 3), ("alpha", 16, 3, 3),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "bits", "whole", "cut"), GRAY)
def test_gray_in_tiles_is_right_or_refused(kind: str, bits: int, whole: int, cut: int, tmp_path: Path) -> None:
    """Rationale: at 8 bits the tiles at the right edge came out black below their first row, without a word."""
    options: dict[str, Any] = {"photometric": kind}
    if kind == "alpha":
        options = {"photometric": "minisblack", "extrasamples": ["unassalpha"]}
    for width, refused in ((64, whole), (70, cut)):
        gray = codes(bits, 1)[:, :width]
        stored = np.dstack([gray, np.full_like(gray, 2**bits - 1)]) if kind == "alpha" else gray
        tifffile.imwrite(tmp_path / "a.tif", stored, tile=(32, 32), **options)
        shown = (2**bits - 1 - gray if kind == "miniswhite" else gray)[..., None] / (2**bits - 1)
        for way in (lambda file: read_image(file, cv2.IMREAD_COLOR), lambda file: read_image(file, STORED), read_rgb):
            try:
                found = way(tmp_path / "a.tif")
            except ValueError:
                refused -= 1
            else:
                wanted = to_srgb8(shown) / 255 if bits == 16 and way is read_rgb else shown
                assert np.abs(found / np.iinfo(found.dtype).max - wanted).max() <= (1 / 255 if bits == 16 else 1e-9)
        assert refused == 0


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("channels", [1, 3])
def test_jpeg_is_read_as_another_decoder_reads_it(channels: int, layout: str, tmp_path: Path) -> None:
    file = written(tmp_path / "a.tif", codes(8, channels), compression="jpeg", **LAYOUTS[layout])
    theirs = tifffile.imread(file).reshape(HEIGHT, WIDTH, channels)
    for found in (read_image(file, STORED)[..., ::-1], read_rgb(file)):
        assert np.abs(found.astype(int) - theirs).max() <= 3


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("compression", ["jpeg", "zstd", "lzma", "jpeg2000", "jpegxl"])
def test_what_no_decoder_here_knows_is_refused_by_name(compression: str, layout: str, tmp_path: Path) -> None:
    """16-bit JPEG among them: baseline JPEG has 8 bits."""
    file = written(tmp_path / "a.tif", codes(16, 3) // 16, compression=compression, **LAYOUTS[layout])
    asked = r"not a readable image \(.*\); replace or remove it(; or save it again with 8 or 16 bits|$)"
    with pytest.raises(ValueError, match=rf"a\.tif is ({asked}|a TIFF of 12, 12, 12 bits a sample)"):
        read_image(file, STORED)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("channels", "extra"), [(1, None), (2, 2), (3, None), (4, 1)])
def test_tags_are_those_that_tifffile_finds(
    channels: int, extra: int | None, order: str, big: bool, tmp_path: Path
) -> None:
    file = write_tiff(tmp_path / "a.tif", np.ones((3, 5, channels), np.uint16), extra=extra, order=order, big=big)
    with tifffile.TiffFile(file) as source:
        theirs = {tag.code: tag for tag in source.pages.first.tags if tag.code in TAGS}
    found = tiff_tags(file)
    assert {code: tag.at for code, tag in found.items()} == {code: tag.valueoffset for code, tag in theirs.items()}
    for code, tag in theirs.items():
        assert found[code].values == tuple(map(int, tag.value if isinstance(tag.value, tuple) else [tag.value]))


def pages(file: Path, *pictures: tuple[np.ndarray, int]) -> Path:
    """Pictures one after the other, with their kinds: 0 whole, 1 a smaller copy, 4 a mask."""
    with tifffile.TiffWriter(file) as target:
        for pixels, kind in pictures:
            form = "rgb" if pixels.ndim == 3 else "minisblack"
            target.write(pixels, photometric=form, subfiletype=kind, metadata=None)
    return file


def test_pages_are_alike_if_all_of_them_have_one_size_and_one_depth(tmp_path: Path) -> None:
    page = codes(16, 1)
    assert like_pages(pages(tmp_path / "a.tif", (page, 0), (page, 0), (page, 0))) == 3
    for other in (page[:-1], codes(8, 1), codes(16, 3)):
        for place in range(3):
            written = [(other if k == place else page, 0) for k in range(3)]
            assert like_pages(pages(tmp_path / "b.tif", *written)) == 0


@pytest.mark.parametrize("bits", [8, 16])
def test_pages_are_refused_and_smaller_copies_left_out(bits: int, tmp_path: Path) -> None:
    """Rationale: of a stack of frames the first one was read, and of a thumbnail and its picture the thumbnail."""
    whole, small = codes(bits, 3), codes(bits, 3)[::4, ::4]
    other = whole[::-1].copy()
    for several in ([(whole, 0), (other, 0)], [(whole, 0), (small, 1), (other, 0)]):
        file = pages(tmp_path / "a.tif", *several)
        for way in (image_size, read_rgb, lambda file: read_image(file, STORED)):
            with pytest.raises(
                ValueError, match=r"a\.tif is a TIFF of several pages, .*: save each as a file of its own"
            ):
                way(file)
    for one in ([(whole, 0), (small, 1)], [(whole, 0), (small, 0)], [(whole, 0), (whole[..., 0] > 99, 4)]):
        assert np.array_equal(read_image(pages(tmp_path / "a.tif", *one), STORED)[..., ::-1], whole)
    with pytest.raises(
        ValueError, match=r"a\.tif is a TIFF whose first picture is a smaller copy .*: save the picture"
    ):
        image_size(pages(tmp_path / "a.tif", (small, 1), (whole, 0)))


@pytest.mark.parametrize("big", [False, True])
def test_a_picture_below_the_first_one_is_refused_unless_it_is_smaller(big: bool, tmp_path: Path) -> None:
    """Rationale: some cameras keep a preview first, and the picture itself below it; layers of editors lie so, too."""
    whole, small = codes(8, 3), codes(8, 3)[::4, ::4].copy()
    for first, below, refused in ((small, whole, True), (whole, whole, True), (whole, small, False)):
        with tifffile.TiffWriter(tmp_path / "a.tif", bigtiff=big) as target:
            target.write(first, photometric="rgb", subifds=1, metadata=None)
            target.write(below, photometric="rgb", metadata=None)
        if refused:
            with pytest.raises(
                ValueError, match=r"a\.tif is a TIFF of several pages, .*: save each as a file of its own"
            ):
                image_size(tmp_path / "a.tif")
        else:
            assert np.array_equal(read_rgb(tmp_path / "a.tif"), whole)


def test_a_directory_that_names_itself_as_the_next_one_is_one_picture(tmp_path: Path) -> None:
    file = write_tiff(tmp_path / "a.tif", np.ones((3, 5, 3), np.uint8))
    content = bytearray(file.read_bytes())
    end = 8 + 2 + 12 * int.from_bytes(content[8:10], "little")
    content[end : end + 4] = pack("<I", 8)
    file.write_bytes(content)
    assert image_size(file) == (5, 3)


@pytest.mark.parametrize("at", [2**40, 2**62, 2**63, 2**64 - 1])
def test_places_beyond_the_file_cost_only_what_stands_there(at: int, tmp_path: Path) -> None:
    """Rationale: no file can be that large, and the system said so without a name."""
    file = write_tiff(tmp_path / "a.tif", np.ones((3, 5, 3), np.uint16), big=True)
    whole, content = tiff_tags(file), file.read_bytes()
    file.write_bytes(content[:8] + pack("<Q", at) + content[16:])
    assert tiff_tags(file) == {}
    with pytest.raises(ValueError, match=r"a\.tif is not a readable image"):
        image_size(file)
    entry = content.index(pack("<HHQ", BITS, 3, 3))  # whose three values fit no entry of ten: made five
    file.write_bytes(content[:entry] + pack("<HHQQ", BITS, 3, 5, at) + content[entry + 20 :])
    assert tiff_tags(file) == {tag: entry for tag, entry in whole.items() if tag != BITS}


def test_an_entry_that_is_repeated_takes_no_memory_of_its_own(tmp_path: Path) -> None:
    """Rationale: tifffile keeps the values of each: 4 GB of such a file of 1 MB."""
    repeated = pack("<HHII", 347, 7, 2**20, 8) * 4000
    gray = {256: 16, 257: 16, 258: 8, 259: 1, 262: 1, 273: 8, 277: 1, 278: 16, 279: 256}
    own = b"".join(pack("<HHII", tag, 4, 1, value) for tag, value in gray.items())
    file = tmp_path / "a.tif"
    file.write_bytes(b"II*\0" + pack("<I", 8 + 2**20) + bytes(2**20) + pack("<H", 4009) + own + repeated + bytes(4))
    tracemalloc.start()
    try:
        assert tiff_tags(file)[BITS].values == (8,)
        with header(file) as image:
            assert image.size == (16, 16)
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()
