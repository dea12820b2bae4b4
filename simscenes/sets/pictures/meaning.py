"""Statements of a picture file about its codes: their curve, their colours, the number of pictures.

8-bit codes are taken as sRGB-encoded and 16-bit ones as linear. A file that says otherwise is decoded as it says where
that can be done, and refused by name where it cannot. Colours of other primaries than sRGB's are said once.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from sensor_model.files.door import PICTURE, opened
from simscenes.sets.pictures.png_chunks import SRGB_PRIMARIES, chunks_of_png, curve_of_png, primaries_of_png, unfit_png
from simscenes.sets.pictures.profile import has_other_primaries, kind_of, middle_of
from simscenes.sets.pictures.tiff import BITS, tiff_tags
from simscenes.sets.pictures.tiff_meaning import unfit_tiff

SRGB = (0.3127, 0.3290, 0.64, 0.33, 0.30, 0.60, 0.15, 0.06)  # x, y of white, red, green and blue, as cHRM has them
ALIKE = 0.005  # of these
HEAD = 2**20  # bytes in which the sizes of a picture stand; before them may be a profile
WITH_WHITE = (b"P2", b"P3", b"P5", b"P6")
SIZES = b"\xff\x4f\xff\x51"  # of JPEG 2000: two markers, and 42 bytes from them the bits of a channel, less 1
BMP_MASKS = (3, 6)  # of its kinds of compression
Curve = Literal["linear", "srgb"]


def unfit(file: Path, image: Any, *, pages: int = 1) -> str:
    """Why a picture is not a photograph for all its suffix, and what to do; "" if it is.

    Args:
        file: The picture.
        image: The same, as PIL opens it.
        pages: How many pages of a TIFF file are read.

    Raises:
        OSError: If it cannot be read.
    """
    chunks = chunks_of_png(file)
    if problem := unfit_png(chunks) or unfit_tiff(image, pages) or _several(image):
        return problem
    if image.format == "BMP" and (problem := _unfit_bmp(file)):
        return problem
    if (most := _largest_code(file, image.format)) != 255:
        return (f"is a picture of codes up to {most} in {image.format}, which is not read: save it as PNG or TIFF of "
                "8 or 16 bits")  # fmt: skip
    if image.mode == "CMYK":
        return "is a picture in CMYK, the inks of a printer, which is not read: save it as RGB"
    kind, who = _stated(image, chunks)
    if who and not kind:
        return (f"states another curve between codes and light than sRGB ({who}), which is not read: save it as sRGB, "
                "or with linear codes in 16 bits")  # fmt: skip
    if kind == "linear" and not is_deep(file):
        return (f"states linear codes ({who}) and has 8 bits, which are taken as sRGB-encoded: save it as sRGB, or "
                "with linear codes in 16 bits")  # fmt: skip
    return ""


def _unfit_bmp(file: Path) -> str:
    """Decoders take no notice of masks that say where in a pixel its colours lie, and spread 5 bits to 248."""
    with opened(file, most=PICTURE) as stored:
        head = stored.read(34)
    if len(head) < 34 or int.from_bytes(head[14:18], "little") < 40:  # of OS/2, which knows no masks
        return ""
    bits, compression = int.from_bytes(head[28:30], "little"), int.from_bytes(head[30:34], "little")
    if bits != 16 and compression not in BMP_MASKS:
        return ""
    return f"is a BMP of {bits} bits a pixel with masks of its colours, which is not read: save it as PNG"


def _largest_code(file: Path, format: str) -> int:
    """What white is by the header of a PPM, PGM or JPEG 2000 file, of which decoders keep 8 bits; 255 of all others."""
    if format not in ("PPM", "JPEG2000"):
        return 255
    with opened(file, most=PICTURE) as stored:
        head = stored.read(HEAD)
    if format == "PPM":
        kind, *numbers = re.sub(rb"#[^\n]*\n", b"", head).split(maxsplit=4)[:4]
        return int(numbers[2]) if kind in WITH_WHITE else 255
    start = head.find(SIZES)
    return 2 ** (1 + (head[start + 42] & 127)) - 1 if 0 <= start < len(head) - 42 else 255


def curve_of(file: Path, image: Any) -> Curve | None:
    """The curve that a picture, as PIL opens it, states for its codes; None where it states none.

    Raises:
        OSError: If it cannot be read.
    """
    kind, _ = _stated(image, chunks_of_png(file))
    return None if kind not in ("linear", "srgb") else kind  # type: ignore[return-value]  # mypy does not narrow


def is_deep(file: Path) -> bool:
    """Whether a picture has more than 8 bits a channel, from its header alone.

    Raises:
        OSError: If it cannot be read.
    """
    if head := chunks_of_png(file).get(b"IHDR"):
        return len(head) > 8 and head[8] > 8
    bits = tiff_tags(file).get(BITS)
    return bits is not None and max(bits.values) > 8


def other_primaries(file: Path, image: Any) -> bool:
    """Whether the picture's colours are stated to be of other primaries than sRGB's, as telephones' P3.

    Raises:
        OSError: If it cannot be read.
    """
    if (number := primaries_of_png(chunks_of_png(file))) is not None:
        return number != SRGB_PRIMARIES
    profile, stated = image.info.get("icc_profile"), image.info.get("chromaticity")
    if isinstance(profile, bytes):
        return has_other_primaries(profile)
    return (
        stated is not None and len(stated) == 8 and any(abs(a - b) > ALIKE for a, b in zip(stated, SRGB, strict=True))
    )


def _stated(image: Any, chunks: dict[bytes, bytes]) -> tuple[str, str]:
    """The curve ("" another one than is known) and who says so ("" nobody)."""
    if (found := curve_of_png(chunks)) is not None:
        return found
    profile = image.info.get("icc_profile")
    middle = middle_of(profile) if isinstance(profile, bytes) else None
    return (
        ("", "") if middle is None else (kind_of(middle), f"a colour profile: the middle code is {middle:.3f} of light")
    )


def _several(image: Any) -> str:
    """Whether a file holds several pictures of full size; of TIFF and PNG `unread` and the chunks say it.

    A telephone's JPEG has smaller pictures behind its own: gain maps, depth, previews.
    """
    if image.format not in ("MPO", "WEBP") or (count := getattr(image, "n_frames", 1)) < 2:
        return ""
    if image.format == "MPO":
        size, others = image.size, []
        with suppress(EOFError, OSError, ValueError, SyntaxError):  # cut short behind the first picture, which is whole
            for number in range(1, count):
                image.seek(number)
                others.append(image.size)
        image.seek(0)
        if not any(w >= size[0] and h >= size[1] for w, h in others):
            return ""
    return f"holds {count} pictures, of which only the first is read: save each as a file of its own"
