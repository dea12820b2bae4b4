"""Pictures that are cut short are refused: decoders fill the rest with grey and say nothing, or reserve all memory."""

import io
import struct
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from simscenes.sets.pictures.image_file import image_size
from simscenes.sets.pictures.png import read_codes
from simscenes.sets.pictures.whole import whole_content

PICTURE = Image.fromarray(np.random.default_rng(0).integers(0, 255, (19, 33, 3), np.uint8))


def encoded(picture: Image.Image = PICTURE, **settings: Any) -> bytes:
    out = io.BytesIO()
    picture.save(out, "JPEG", **settings)
    return out.getvalue()


def with_thumbnail() -> bytes:
    """A picture with a smaller one in a segment of its own, as cameras write them."""
    inner = b"Exif\0\0" + encoded(PICTURE.resize((8, 5)))
    whole = encoded()
    return whole[:2] + b"\xff\xe1" + (len(inner) + 2).to_bytes(2, "big") + inner + whole[2:]


KINDS = {
    "plain": encoded(),
    "fine": encoded(quality=100),
    "progressive": encoded(progressive=True),
    "restarts": encoded(restart_marker_blocks=1),
    "grey": encoded(PICTURE.convert("L")),
    "thumbnail": with_thumbnail(),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_file_passes_and_every_cut_is_refused(kind: str, tmp_path: Path) -> None:
    content, file = KINDS[kind], tmp_path / "a.jpg"
    for more in (b"", b"\0" * 9, b"\xff\xd8 a preview that a camera puts behind"):
        file.write_bytes(content + more)
        whole_content(file)
    for length in (*range(2, len(content) - 2, 7), len(content) - 2, len(content) - 1):
        file.write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"a.jpg is cut short"):
            whole_content(file)


def png(width: int, height: int, depth: int, colour: int, packed: bytes) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    chunks = [(b"IHDR", head), (b"tEXt", b"a\0b"), (b"IDAT", packed[:5]), (b"IDAT", packed[5:]), (b"IEND", b"")]
    body = (struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(body)


@pytest.mark.parametrize(
    ("depth", "colour", "row"), [(8, 2, 6000), (16, 6, 16000), (1, 0, 250), (8, 3, 2000), (16, 0, 4000)]
)
def test_a_png_that_compresses_as_far_as_can_be_passes_and_one_line_more_is_refused(
    depth: int, colour: int, row: int, tmp_path: Path
) -> None:
    file, height = tmp_path / "a.png", 3000
    packed = zlib.compress(bytes(height * (row + 1)), 9)
    file.write_bytes(png(2000, height, depth, colour, packed))
    whole_content(file)
    most = 1032 * len(packed) // row  # rows of `row` bytes
    file.write_bytes(png(2000, most, depth, colour, packed))
    whole_content(file)
    file.write_bytes(png(2000, most + 2, depth, colour, packed))
    with pytest.raises(ValueError, match=rf"a.png declares 2000 x {most + 2} pixels, more than its \d+ bytes can hold"):
        whole_content(file)


def test_every_cut_of_a_png_is_refused_and_so_is_a_chunk_beyond_the_end(tmp_path: Path) -> None:
    out, file = io.BytesIO(), tmp_path / "a.png"
    PICTURE.save(out, "PNG")
    content = out.getvalue()
    file.write_bytes(content + b"more")
    assert np.array_equal(read_codes(file), np.asarray(PICTURE))
    for length in (*range(8, len(content), 17), len(content) - 1):
        file.write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"a.png is cut short"):
            whole_content(file)
    at = content.index(b"IDAT") - 4
    file.write_bytes(content[:at] + b"\x7f\xc0\0\0" + content[at + 4 :])  # 2 GiB in OpenCV's decoder
    with pytest.raises(ValueError, match=r"a chunk of it is damaged"):
        read_codes(file)


def test_other_files_are_others_business(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"GIF89a")
    whole_content(tmp_path / "a.jpg")


def exr(compression: Any, width: int = 2000, height: int = 500) -> bytes:
    """A picture that compresses best: all black."""
    out = Path(tempfile.mkdtemp()) / "a.exr"
    pixels = {"R": np.zeros((height, width), np.float16), "id": np.zeros((height, width), np.uint32)}
    with OpenEXR.File({"compression": compression, "type": OpenEXR.scanlineimage}, pixels) as file:
        file.write(str(out))
    return out.read_bytes()


COMPRESSIONS = [name for name in dir(OpenEXR) if name.endswith("_COMPRESSION") and not name.startswith("NUM")]


@pytest.mark.parametrize("name", COMPRESSIONS)
def test_an_exr_file_may_declare_what_its_compression_can_hold_and_not_a_thousand_times_more(
    name: str, tmp_path: Path
) -> None:
    content, file = exr(getattr(OpenEXR, name)), tmp_path / "a.exr"
    file.write_bytes(content)
    whole_content(file)
    window = struct.pack("<4i", 0, 0, 1999, 499)
    at = content.index(window)  # the data window, which comes before the display window
    file.write_bytes(content[:at] + struct.pack("<4i", -(10**9), -(10**9), 10**9, 10**9) + content[at + 16 :])
    with pytest.raises(ValueError, match=r"a.exr declares 2000000001 x 2000000001 pixels"):
        whole_content(file)


def test_a_damaged_exr_header_is_left_to_the_decoder(tmp_path: Path) -> None:
    content, file = exr(OpenEXR.ZIP_COMPRESSION), tmp_path / "a.exr"
    for length in range(4, content.index(b"scanlineimage"), 3):
        file.write_bytes(content[:length])
        whole_content(file)


def test_a_file_of_a_kind_that_no_photograph_has_is_not_tried(tmp_path: Path) -> None:
    """Rationale: as a brush of GIMP, this file asks PIL for a comment of 3 GiB. Found by `python -m tests.fuzz`."""
    size, version, width, height, channels = 28 + (3 << 30), 2, 8, 8, 1
    brush = struct.pack(">5I4sI", size, version, width, height, channels, b"GIMP", 10) + bytes(100)
    (tmp_path / "a.jpg").write_bytes(brush)
    with pytest.raises(ValueError, match=r"a\.jpg is not a readable image \(its kind is not known\)"):
        image_size(tmp_path / "a.jpg")
