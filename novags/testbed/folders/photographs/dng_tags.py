"""The tags of a DNG file: which pictures lie in it, and what each says of its codes.

Source: TIFF 6.0, section 2; Adobe DNG 1.7.1, chapter 3. Nothing here knows what a tag means: see `dng_meaning`.
"""

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from sensor_model.files.door import PICTURE, opened

ORDERS = {b"II": "<", b"MM": ">"}
# By the version (TIFF, BigTIFF): types of places, and of the number of entries.
LAYOUTS = {42: ("I", "H"), 43: ("Q", "Q")}
# numpy's types by the number of a type in the file; rationals are pairs.
TYPES = {1: "u1", 2: "u1", 3: "u2", 4: "u4", 5: "u4", 6: "i1", 7: "u1", 8: "i2", 9: "i4", 10: "i4", 11: "f4", 12: "f8",
         13: "u4", 16: "u8", 17: "i8", 18: "u8"}  # fmt: skip
RATIONALS = 5, 10
SUB_IFDS = 330
MOST_PICTURES, MOST_ENTRIES, MOST_BYTES = 64, 4096, 2**18  # a damaged file may state any number


@dataclass(frozen=True)
class Tags:
    """One directory: the values of each tag, rationals as quotients; the first ones of very long tags."""

    values: dict[int, np.ndarray]

    def numbers(self, tag: int) -> list[float]:
        """The values of a tag; none where it is not there."""
        return [float(v) for v in self.values.get(tag, ())]

    def wholes(self, tag: int) -> list[int]:
        """The values of a tag as whole numbers; none where one is not finite."""
        found = self.numbers(tag)
        return [int(v) for v in found] if np.isfinite(found).all() else []

    def first(self, tag: int, default: int) -> int:
        """The first value of a tag as a whole number."""
        found = self.values.get(tag)
        return default if found is None or not len(found) or not np.isfinite(found[0]) else int(found[0])


def directories(path: Path) -> list[Tags]:
    """Every picture of a TIFF file, the first one first, and those below others; none of files of other kinds.

    Raises:
        OSError: If it cannot be read.
    """
    with opened(path, most=PICTURE) as source:
        start = source.read(16)
        order = ORDERS.get(start[:2])
        if order is None or len(start) < 16:
            return []
        (version,) = struct.unpack_from(order + "H", start, 2)
        if version not in LAYOUTS:
            return []
        long, short = LAYOUTS[version]
        (at,) = struct.unpack_from(order + long, start, 4 if version == 42 else 8)
        return list(_walk(source, at, order, long, short))


def _walk(source: BinaryIO, at: int, order: str, long: str, short: str) -> Iterator[Tags]:
    size, waiting, seen = os.fstat(source.fileno()).st_size, [at], set[int]()
    while waiting and len(seen) < MOST_PICTURES:
        at = waiting.pop(0)
        if not 0 < at < size or at in seen:
            continue
        seen.add(at)
        source.seek(at)
        head = source.read(struct.calcsize(order + short))
        if len(head) < struct.calcsize(order + short):
            continue
        count = min(struct.unpack(order + short, head)[0], MOST_ENTRIES)
        entry, wide = 4 + 2 * struct.calcsize(order + long), struct.calcsize(order + long)
        body = source.read(count * entry + wide)
        tags = Tags(dict(_entries(source, body, count, order, long)))
        waiting += [int(place) for place in tags.values.get(SUB_IFDS, ())]
        if len(body) == count * entry + wide:
            waiting.append(struct.unpack_from(order + long, body, count * entry)[0])
        yield tags


def _entries(source: BinaryIO, body: bytes, count: int, order: str, long: str) -> Iterator[tuple[int, np.ndarray]]:
    entry = struct.Struct(f"{order}HH{long}{long}")
    wide = struct.calcsize(order + long)
    for k in range(min(count, len(body) // entry.size)):
        tag, kind, number, where = entry.unpack_from(body, k * entry.size)
        if kind not in TYPES:
            continue
        form = np.dtype(order + TYPES[kind])
        each = form.itemsize * (2 if kind in RATIONALS else 1)
        if number * each <= wide:
            content = body[(k + 1) * entry.size - wide : (k + 1) * entry.size][: number * each]
        else:
            source.seek(where)
            content = source.read(min(number * each, MOST_BYTES // each * each))
        values = np.frombuffer(content[: len(content) // each * each], form)
        if kind in RATIONALS:
            with np.errstate(divide="ignore", invalid="ignore"):
                values = values[::2] / values[1::2].astype(np.float64)
        yield tag, values
