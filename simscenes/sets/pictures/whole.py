"""Whether a JPEG or PNG file is there to its end, and whether it or an EXR file can hold the declared size.

Decoders fill missing parts of a JPEG with grey and say nothing, and reserve the memory that a damaged PNG or EXR file
asks for: two gigabytes for a file of 300 bytes.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

from sensor_model.files.door import read_bytes

JPEG, PNG, EXR = b"\xff\xd8", b"\x89PNG\r\n\x1a\n", b"\x76\x2f\x31\x01"
EOI = 0xD9
# In coded data, 0xFF is followed by 0 (a plain 0xFF), a restart marker or more 0xFF; anything else ends it.
NEXT = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
DEFLATE = 1032  # zlib cannot make data smaller than by this factor
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by the colour type of a PNG
# The largest factor by which the compressions of EXR, by their number, can shrink pixels; runs of lossy ones only
# roughly.
SHRINKS = {0: 1, 1: 64, 2: DEFLATE, 3: DEFLATE, 4: 4 * DEFLATE, 5: 2 * DEFLATE, 6: 16, 7: 16}
SHRINKS_MOST = 64 * DEFLATE  # all others
BYTES = {0: 4, 1: 2, 2: 4}  # by the type of an EXR channel


def whole_content(file: Path) -> bytes:
    """The bytes of a picture file.

    A JPEG or PNG file that is cut short is refused, and a PNG or EXR file that declares more than it can hold. Other
    files pass, and so do files that are damaged in ways that their decoders notice.

    Raises:
        ValueError: If it is.
        OSError: If it cannot be read.
    """
    content = read_bytes(file)
    if content.startswith(JPEG) and not _reaches_end(content):
        raise ValueError(f"{file} is cut short: a part of the picture is missing, copy it again")
    if content.startswith(PNG) and (problem := _png_problem(content)):
        raise ValueError(f"{file} {problem}: copy it again")
    if content.startswith(EXR) and (problem := _exr_problem(content)):
        raise ValueError(f"{file} {problem}: copy it again")
    return content


def _reaches_end(content: bytes) -> bool:
    """Walk a JPEG from marker to marker; thumbnails, which have ends of their own, lie inside of segments."""
    at = 2
    while found := NEXT.search(content, at):
        at = found.end()
        kind = content[at - 1]
        if kind == EOI:
            return True
        at += int.from_bytes(content[at : at + 2], "big")  # of the segment, with these two bytes
    return False


def _png_problem(content: bytes) -> str:
    """The fault of a PNG as a row of chunks; "" if nothing is."""
    at, kind, head, packed = len(PNG), b"", b"", 0
    while kind != b"IEND":
        length = int.from_bytes(content[at : at + 4], "big")
        kind = content[at + 4 : at + 8]
        if at + 12 + length > len(content):
            return "is cut short, or a chunk of it is damaged"
        if kind == b"IHDR" and not head:
            head = content[at + 8 : at + 8 + length]
        packed += length if kind == b"IDAT" else 0
        at += 12 + length
    if len(head) == 13:  # the decoder refuses any other length
        width, height = int.from_bytes(head[:4], "big"), int.from_bytes(head[4:8], "big")
        row = (width * head[8] * CHANNELS.get(head[9], 1) + 7) // 8
        if height * row > DEFLATE * packed:
            return f"declares {width} x {height} pixels, more than its {len(content)} bytes can hold"
    return ""


def _exr_problem(content: bytes) -> str:
    """The fault in the size of the first picture of an EXR file; "" if nothing is, or its header is damaged."""
    try:
        header = _exr_header(content)
        left, top, right, bottom = struct.unpack("<4i", header[b"dataWindow"])
        shrinks = SHRINKS.get(header[b"compression"][0], SHRINKS_MOST)
        each = _exr_pixel_bytes(header[b"channels"])
    except (ValueError, KeyError, IndexError, struct.error):
        return ""
    width, height = right - left + 1, bottom - top + 1
    if width > 0 and height > 0 and width * height * each > shrinks * len(content):
        return f"declares {width} x {height} pixels, more than its {len(content)} bytes can hold"
    return ""


def _exr_header(content: bytes) -> dict[bytes, bytes]:
    """The attributes of the first part: name, type, length and value each, an empty name after the last one."""
    found, at = {}, len(EXR) + 4
    while content[at]:
        name = content[at : content.index(b"\0", at)]
        at = content.index(b"\0", at + len(name) + 1) + 1
        (length,) = struct.unpack_from("<I", content, at)
        found[name] = content[at + 4 : at + 4 + length]
        at += 4 + length
    return found


def _exr_pixel_bytes(channels: bytes) -> float:
    """Bytes of a pixel: of each channel a name, its type, four bytes, and its distances in x and y."""
    total, at = 0.0, 0
    while channels[at]:
        at = channels.index(b"\0", at) + 1
        kind, _, x, y = struct.unpack_from("<iIii", channels, at)
        total += BYTES[kind] / max(x * y, 1)
        at += 16
    return total
