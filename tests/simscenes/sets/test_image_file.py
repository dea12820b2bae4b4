"""Claims about large images: those of real cameras are read, what only declares to be large is not decoded."""

import zlib
from pathlib import Path
from struct import pack

import cv2
import numpy as np
import PIL.Image
import pytest

from simscenes.sets.pictures.image_file import MAX_PIXELS, image_size, read_image


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


def test_pixels_are_those_of_opencv(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    assert np.array_equal(read_image(tmp_path / "a.png", cv2.IMREAD_COLOR), pixels)
