"""A JPEG file that is cut short is refused: decoders fill the rest with grey and say nothing."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from simscenes.sets.jpeg import check_whole_jpeg

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
        check_whole_jpeg(file)
    for length in (*range(2, len(content) - 2, 7), len(content) - 2, len(content) - 1):
        file.write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"a.jpg is cut short"):
            check_whole_jpeg(file)


def test_files_that_are_no_jpegs_are_others_business(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(b"\x89PNG")
    check_whole_jpeg(tmp_path / "a.jpg")
