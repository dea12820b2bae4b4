"""Claims about large images: those of real cameras are read, what only declares to be large is not decoded."""

import zlib
from pathlib import Path
from struct import pack

import cv2
import numpy as np
import PIL.Image
import pytest

from simscenes.sets.pictures.image_file import (
    COLOR,
    DEEP_COLOR,
    MAX_PIXELS,
    STORED,
    has_alpha,
    image_size,
    read_image,
    read_rgb,
)


def declared(path: Path, width: int, height: int) -> Path:
    """A grey PNG of that size with hardly any pixels in it."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return pack(">I", len(data)) + kind + data + pack(">I", zlib.crc32(kind + data))

    header = pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 100)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + data)
    return path


@pytest.mark.parametrize("size", [(16320, 12288), (20000, 20000)])
def test_images_beyond_the_limit_of_pil_have_a_size(size: tuple[int, int], tmp_path: Path) -> None:
    """Rationale: telephones take 200 million pixels; PIL warns at 179 and refuses 358."""
    before = PIL.Image.MAX_IMAGE_PIXELS
    assert image_size(declared(tmp_path / "a.png", *size)) == size
    assert before == PIL.Image.MAX_IMAGE_PIXELS


def test_what_declares_more_than_the_limit_is_refused_before_it_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cv2, "imread", lambda *_: pytest.fail("the pixels were decoded"))
    file = declared(tmp_path / "bomb.png", 2**20 - 1, 2**20 - 1)
    with pytest.raises(ValueError, match=rf"bomb\.png declares 1048575 x 1048575 pixels, at most {MAX_PIXELS}"):
        read_image(file, cv2.IMREAD_COLOR)


@pytest.mark.parametrize(
    "content", [b"", b"no image", b"\x89PNG\r\n\x1a\n" + b"\xff" * 40, b"GIF89a\1\0\1", b"II*\0\xff"]
)
def test_what_is_no_image_is_refused_by_name(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "x.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"x\.png is not a readable image"):
        read_image(tmp_path / "x.png", cv2.IMREAD_COLOR)


def test_flags_by_number_are_those_of_opencv() -> None:
    assert (STORED, COLOR) == (cv2.IMREAD_UNCHANGED, cv2.IMREAD_COLOR)
    assert DEEP_COLOR == cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH


def test_pixels_are_those_of_opencv(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    assert np.array_equal(read_image(tmp_path / "a.png", cv2.IMREAD_COLOR), pixels)


@pytest.mark.parametrize("name", ["RGBA.png", "LA.png", "LA.tif", "RGBA.tif", "L.png", "P.png", "1.png", "RGB.png"])
def test_whatever_is_transparent_is_before_white(name: str, tmp_path: Path) -> None:
    """The left half transparent, by a channel or by a code that stands for it; the right half as it is."""
    mode, file = name.partition(".")[0], tmp_path / name
    codes = np.array([[0, 0, 255 if mode == "1" else 90, 255]] * 2, np.uint8)
    gray = PIL.Image.fromarray(codes)
    if "A" in mode:
        image = gray.convert(mode)
        image.putalpha(PIL.Image.fromarray(np.where(codes == 0, 0, 255).astype(np.uint8)))
        image.save(file)
    else:
        image = gray.convert(mode)
        image.save(file, transparency=(0, 0, 0) if mode == "RGB" else image.getpixel((0, 0)))
    assert has_alpha(file)
    assert read_rgb(file).tolist() == [[[255] * 3, [255] * 3, [int(codes[0, 2])] * 3, [255] * 3]] * 2


def test_partly_transparent_gray_is_mixed_and_16_bit_gray_with_a_transparent_code_refused(tmp_path: Path) -> None:
    gray, alpha = (PIL.Image.new("L", (1, 1), value) for value in (100, 51))
    image = PIL.Image.merge("LA", (gray, alpha))
    image.save(tmp_path / "a.tif")
    assert read_rgb(tmp_path / "a.tif").tolist() == [[[round(100 * 0.2 + 255 * 0.8)] * 3]]
    deep = PIL.Image.fromarray(np.array([[0, 40000]], np.uint16))
    deep.save(tmp_path / "deep.png", transparency=0)
    with pytest.raises(ValueError, match=r"deep\.png must be 8-bit or have a channel of alpha"):
        read_rgb(tmp_path / "deep.png")
