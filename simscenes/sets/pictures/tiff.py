"""TIFF files: the few tags that say what their pixels are, and content in which decoders find no reason to change them.

libtiff, and OpenCV and PIL with it, turn pixels by the mark of orientation and multiply colours by alpha on their own,
with any flags. The only sure way to pixels as stored is a file that does not ask for it.

Why not tifffile, whose tags are the same in the tests: it keeps the values of every entry, however often an entry is
repeated. A file of 1 MB takes 4 GB and 9 s so, here 16 MB and .06 s. A guard around it would be as long as the code
here: 40 lines. Why not imagecodecs: OpenCV decodes the same kinds rightly, except the kinds that `misread` names, and
has no 80 MB.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from sensor_model.files.door import PICTURE, opened, read_bytes

KIND, WIDTH, HEIGHT = 254, 256, 257
BITS, PHOTOMETRIC, ORIENTATION, PLANAR, TILE_WIDTH, EXTRA_SAMPLES, SAMPLE_FORMAT = 258, 262, 274, 284, 322, 338, 339
SUB_IFDS = 330
TAGS = (KIND, WIDTH, HEIGHT, BITS, PHOTOMETRIC, ORIENTATION, PLANAR, TILE_WIDTH, SUB_IFDS, EXTRA_SAMPLES, SAMPLE_FORMAT)
REDUCED, MASK = 1, 4  # bits of KIND: a smaller copy of another picture, the transparent part of one
MIN_IS_WHITE, MIN_IS_BLACK = 0, 1  # of PHOTOMETRIC: gray, by the meaning of its code 0
SEPARATE = 2  # of PLANAR: each channel is stored as a picture of its own
AS_STORED = 1  # the first row at the top, the first column at the left
PREMULTIPLIED = 1  # the first extra sample is alpha, and colours are multiplied by it
FLOAT = 3

ORDERS = {b"II": "<", b"MM": ">"}
# By the version (TIFF, BigTIFF): where the place of the first directory stands, and the types of places and counts, and
# of the number of entries of a directory.
LAYOUTS = {42: (4, "I", "H"), 43: (8, "Q", "Q")}
INTEGERS = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}  # types of values, by their number in the file
# Of a file, of a directory and of an entry; a damaged file may state any number.
MOST_DIRECTORIES, MOST_ENTRIES, MOST_VALUES, MOST_PAGES = 16, 2**16, 16, 4096


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
    with opened(file, most=PICTURE) as source, suppress(struct.error):
        return next(_directories(source), {})
    return {}


def unread(file: Path, *, pages: bool = False) -> str:
    """Why the pixels of a TIFF file are of a kind that no photograph is read from, and what to do; "" if they are not.

    Args:
        file: Any file.
        pages: Whether all its pages are read.

    Raises:
        OSError: If it cannot be read.
    """
    if not pages and (problem := _pages(file)):
        return problem
    tags = tiff_tags(file)
    bits, extra, kinds = (tags[tag].values if tag in tags else () for tag in (BITS, EXTRA_SAMPLES, SAMPLE_FORMAT))
    if FLOAT in kinds:
        return (f"is a TIFF of floating-point numbers ({max(bits, default=0)}-bit), which is not read: save it as "
                "16-bit TIFF or PNG, or as EXR where its light is linear")  # fmt: skip
    if bits == (16, 16) and extra:
        return "is a TIFF of 16-bit gray with alpha, which is not read: save it as RGBA, or without alpha"
    return ""


def misread(file: Path, deep: bool) -> str:
    """Why OpenCV gets codes of a TIFF file wrong, and what to do; "": it does not.

    Of 8 bits libtiff makes the pixels, and leaves gray ones black in tiles that reach over the right edge, where it has
    to leave out bytes of them. Of more OpenCV takes the bytes as if channels were interleaved and 0 black.

    Args:
        file: Any file.
        deep: Whether all bits are asked for, where there are more than 8.

    Raises:
        OSError: If it cannot be read.
    """
    tags = tiff_tags(file)
    bits, kind, planar = (tags[tag].values if tag in tags else () for tag in (BITS, PHOTOMETRIC, PLANAR))
    most = max(bits, default=0)
    width, tile = (tags[tag].values[0] if tag in tags else 0 for tag in (WIDTH, TILE_WIDTH))
    gray = MIN_IS_BLACK in kind or MIN_IS_WHITE in kind
    if gray and tile and width % tile and (len(bits) > 1 or (most > 8 and not deep)):
        return (f"is a TIFF of gray in tiles, whose width of {width} px is not a multiple of a tile's, {tile} "
                "px, which is not read at 8 bits: save it without tiles, or as PNG")  # fmt: skip
    if most <= 8 or not deep:
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


def like_pages(file: Path) -> int:
    """The number of pages of a TIFF file; 0 where they differ in size, depth or kind, and of other files.

    Raises:
        OSError: If it cannot be read.
    """
    kinds: list[dict[int, tuple[int, ...]]] = []
    with opened(file, most=PICTURE) as source, suppress(struct.error):
        for tags in _directories(source, MOST_PAGES):
            kinds.append({tag: entry.values for tag, entry in tags.items() if tag not in (KIND, SUB_IFDS)})
    return len(kinds) if kinds and all(kind == kinds[0] for kind in kinds) else 0


def _pages(file: Path) -> str:
    """Whether other pictures than smaller copies follow the first one, or it is such a copy itself; "" if not."""
    sizes: list[int] = []
    with opened(file, most=PICTURE) as source, suppress(struct.error):
        for tags in _directories(source, below=True):
            kind, *size = (tags[tag].values[0] if tag in tags else 0 for tag in (KIND, WIDTH, HEIGHT))
            if kind & REDUCED and not sizes:
                return ("is a TIFF whose first picture is a smaller copy of another one, and the only one that is "
                        "read: save the picture itself as a file of its own")  # fmt: skip
            sizes += [] if kind & (REDUCED | MASK) else [size[0] * size[1]]
    if sum(size >= sizes[0] for size in sizes) > 1:
        return "is a TIFF of several pages, of which only the first is read: save each as a file of its own"
    return ""


def _directories(
    source: BinaryIO, most: int = MOST_DIRECTORIES, *, below: bool = False
) -> Iterator[dict[int, Tag]]:  # fmt: skip
    """The tags of each picture of a file, one directory after the other, as far as they lie in the file; and of those
    that lie below others, such as smaller copies, where asked for.
    """
    start = source.read(16)
    order = ORDERS.get(start[:2])
    if order is None or (version := struct.unpack_from(order + "H", start, 2)[0]) not in LAYOUTS:
        return
    place, long, short = LAYOUTS[version]
    wide, size = struct.calcsize(long), os.fstat(source.fileno()).st_size
    (at,) = struct.unpack_from(order + long, start, place)
    seen, waiting = set[int](), [at]
    while waiting and len(seen) < most:
        at = waiting.pop(0)
        if not 0 < at < size or at in seen:
            continue
        seen.add(at)
        source.seek(at)
        (count,) = struct.unpack(order + short, source.read(struct.calcsize(short)))
        begin = source.tell()
        body = source.read(min(count, MOST_ENTRIES) * (4 + 2 * wide) + wide)
        tags = dict(_tags(source, body, begin, order, long, size))
        yield tags
        waiting += tags[SUB_IFDS].values if below and SUB_IFDS in tags else ()
        waiting += struct.unpack_from(order + long, body, count * (4 + 2 * wide))


def _tags(source: BinaryIO, body: bytes, begin: int, order: str, long: str, size: int) -> Iterator[tuple[int, Tag]]:
    """The entries of a directory, which begin at a place of a file of some size."""
    entry = struct.Struct(f"{order}HH{long}{long}")
    for at in range(0, len(body) - entry.size + 1, entry.size):
        tag, kind, number, where = entry.unpack_from(body, at)
        if tag not in TAGS or kind not in INTEGERS or not number:
            continue
        packed = struct.Struct(order + INTEGERS[kind] * min(number, MOST_VALUES))
        if number * struct.calcsize(INTEGERS[kind]) <= struct.calcsize(long):  # the values themselves, not their place
            where = begin + at + entry.size - struct.calcsize(long)
        if where + packed.size <= size:
            source.seek(where)
            yield tag, Tag(packed.unpack(source.read(packed.size)), where, order + INTEGERS[kind])
