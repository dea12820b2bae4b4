"""TIFF files: the few tags that say what their pixels are, and content in which decoders find no reason to change them.

libtiff, and OpenCV and PIL with it, turn pixels by the mark of orientation and multiply colours by alpha on their own,
with any flags. The only sure way to pixels as stored is a file that does not ask for it.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from sensor_model.files.door import PICTURE, opened, read_bytes

BITS, PHOTOMETRIC, ORIENTATION, PLANAR, EXTRA_SAMPLES, SAMPLE_FORMAT = 258, 262, 274, 284, 338, 339
TAGS = (BITS, PHOTOMETRIC, ORIENTATION, PLANAR, EXTRA_SAMPLES, SAMPLE_FORMAT)
MIN_IS_WHITE = 0  # of PHOTOMETRIC: gray whose code 0 is white
SEPARATE = 2  # of PLANAR: each channel is stored as a picture of its own
AS_STORED = 1  # the first row at the top, the first column at the left
PREMULTIPLIED = 1  # the first extra sample is alpha, and colours are multiplied by it
FLOAT = 3

ORDERS = {b"II": "<", b"MM": ">"}
# By the version (TIFF, BigTIFF): where the place of the first directory stands, and the types of places and counts, and
# of the number of entries of a directory.
LAYOUTS = {42: (4, "I", "H"), 43: (8, "Q", "Q")}
INTEGERS = {1: "B", 3: "H", 4: "I", 16: "Q"}  # types of values, by their number in the file
MOST_ENTRIES, MOST_VALUES = 2**16, 16  # of a directory and of an entry; a damaged file may state any number


@dataclass(frozen=True)
class Tag:
    """An entry: its first values, where they stand in the file, and how they are packed (see struct)."""

    values: tuple[int, ...]
    at: int
    form: str


def tiff_tags(file: Path) -> dict[int, Tag]:
    """The members of `TAGS` in the first picture of a TIFF file; none of a file that is damaged or of another kind.

    Raises:
        OSError: If it cannot be read.
    """
    with opened(file, most=PICTURE) as source, suppress(struct.error, OverflowError):
        return dict(_tags(source))
    return {}


def unread(file: Path) -> str:
    """Why the pixels of a TIFF file are of a kind that no photograph is read from, and what to do; "" if they are not.

    Raises:
        OSError: If it cannot be read.
    """
    tags = tiff_tags(file)
    bits, extra, kinds = (tags[tag].values if tag in tags else () for tag in (BITS, EXTRA_SAMPLES, SAMPLE_FORMAT))
    if FLOAT in kinds:
        return (f"is a TIFF of floating-point numbers ({max(bits, default=0)}-bit), which is not read: save it as "
                "16-bit TIFF or PNG, or as EXR where its light is linear")  # fmt: skip
    if bits == (16, 16) and extra:
        return "is a TIFF of 16-bit gray with alpha, which is not read: save it as RGBA, or without alpha"
    return ""


def misread(file: Path) -> str:
    """Why OpenCV gets codes of a TIFF file wrong where more than 8 bits are asked for, and what to do; "": it does not.

    Of 8 bits libtiff makes the pixels; of more OpenCV takes the bytes as if channels were interleaved and 0 black.

    Raises:
        OSError: If it cannot be read.
    """
    tags = tiff_tags(file)
    bits, kind, planar = (tags[tag].values if tag in tags else () for tag in (BITS, PHOTOMETRIC, PLANAR))
    if max(bits, default=0) <= 8:
        return ""
    if SEPARATE in planar and len(bits) > 1:
        return (f"is a {bits[0]}-bit TIFF whose channels are stored one after the other, which is not read at that "
                "depth: save it with interleaved channels (PlanarConfiguration 1), or as PNG")  # fmt: skip
    if MIN_IS_WHITE in kind:
        return (f"is a {bits[0]}-bit TIFF of gray in which 0 is white, which is not read at that depth: save it with "
                "0 as black, or as PNG")  # fmt: skip
    return ""


def retagged(file: Path, values: Mapping[int, int]) -> bytes | None:
    """The content of a TIFF file with other first values of some of its tags.

    Args:
        file: Any file.
        values: The value each tag must have, where the file has it.

    Returns:
        The content; None where nothing had to be changed.

    Raises:
        OSError: If it cannot be read.
    """
    found = tiff_tags(file)
    changed = {tag: found[tag] for tag in found.keys() & values.keys() if found[tag].values[0] != values[tag]}
    if not changed:
        return None
    content = bytearray(read_bytes(file))
    for tag, entry in changed.items():
        struct.pack_into(entry.form, content, entry.at, values[tag])
    return bytes(content)


def _tags(source: BinaryIO) -> Iterator[tuple[int, Tag]]:
    start = source.read(16)
    order = ORDERS.get(start[:2])
    if order is None or (version := struct.unpack_from(order + "H", start, 2)[0]) not in LAYOUTS:
        return
    place, long, short = LAYOUTS[version]
    entry = struct.Struct(f"{order}HH{long}{long}")
    (first,) = struct.unpack_from(order + long, start, place)
    source.seek(first)
    (count,) = struct.unpack(order + short, source.read(struct.calcsize(short)))
    begin = source.tell()
    body = source.read(min(count, MOST_ENTRIES) * entry.size)
    for at in range(0, len(body) - entry.size + 1, entry.size):
        tag, kind, number, where = entry.unpack_from(body, at)
        if tag not in TAGS or kind not in INTEGERS or not number:
            continue
        if number * struct.calcsize(INTEGERS[kind]) <= struct.calcsize(long):  # the values themselves, not their place
            where = begin + at + entry.size - struct.calcsize(long)
        source.seek(where)
        packed = struct.Struct(order + INTEGERS[kind] * min(number, MOST_VALUES))
        yield tag, Tag(packed.unpack(source.read(packed.size)), where, order + INTEGERS[kind])
