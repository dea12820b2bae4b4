"""TIFF files of every kind that libraries do not write: orientation, kind of alpha, depth, order of bytes."""

import struct
from pathlib import Path

import numpy as np

SHORT, LONG = 3, 4


def write_tiff(
    path: Path,
    pixels: np.ndarray,
    *,
    orientation: int = 1,
    extra: int | None = None,
    order: str = "<",
    big: bool = False,
) -> Path:
    """Write pixels [h,w,c] in the order in which they are: gray, gray and alpha, RGB or RGB and alpha.

    Args:
        path: The file.
        pixels: Integers or floats of any depth.
        orientation: The tag of that name, 1 to 8.
        extra: What the last channel is: 0 unspecified, 1 alpha that colours are multiplied by, 2 alpha. None: a colour.
        order: Of bytes, "<" or ">".
        big: Whether it is a BigTIFF.
    """
    height, width, channels = pixels.shape
    data = pixels.astype(pixels.dtype.newbyteorder(order)).tobytes()
    kind = {"u": 1, "i": 2, "f": 3}[pixels.dtype.kind]
    tags = {256: [width], 257: [height], 258: [pixels.dtype.itemsize * 8] * channels, 259: [1],
            262: [2 if channels > 2 else 1], 274: [orientation], 277: [channels], 278: [height], 284: [1],
            339: [kind] * channels} | ({} if extra is None else {338: [extra]})  # fmt: skip
    long, short, head = ("Q", "Q", 16) if big else ("I", "H", 8)
    wide, entry = struct.calcsize(long), 4 + 2 * struct.calcsize(long)
    end = head + struct.calcsize(short) + (len(tags) + 2) * entry + wide
    rows, tail = {}, b""
    for tag, values in tags.items():
        packed = struct.pack(f"{order}{len(values)}H", *values)
        if len(packed) > wide:
            packed, tail = struct.pack(order + long, end + len(tail)), tail + packed
        rows[tag] = struct.pack(f"{order}HH{long}", tag, SHORT, len(values)) + packed.ljust(wide, b"\0")
    for tag, value in ((273, end + len(tail)), (279, len(data))):
        rows[tag] = struct.pack(f"{order}HH{long}", tag, LONG, 1) + struct.pack(order + "I", value).ljust(wide, b"\0")
    mark = b"II" if order == "<" else b"MM"
    start = struct.pack(order + ("HHHQ" if big else "HI"), *((43, 8, 0, 16) if big else (42, 8)))
    count = struct.pack(order + short, len(rows))
    path.write_bytes(mark + start + count + b"".join(rows[tag] for tag in sorted(rows)) + bytes(wide) + tail + data)
    return path
