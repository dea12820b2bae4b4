"""Whether a JPEG or PNG file is there to its end, and can hold what it declares.

OpenCV fills what is missing of a JPEG with grey and says nothing, and reserves what a damaged PNG asks for: a chunk of
two gigabytes in a file of 300 bytes.
"""

from __future__ import annotations

import re
from pathlib import Path

JPEG, PNG = b"\xff\xd8", b"\x89PNG\r\n\x1a\n"
EOI = 0xD9
# In coded data, 0xFF is followed by 0 (a plain 0xFF), a restart marker or more 0xFF; anything else ends it.
NEXT = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
DEFLATE = 1032  # zlib cannot make data smaller than by this factor
CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by the colour type of a PNG


def check_whole(file: Path) -> None:
    """Refuse a JPEG or PNG file that is cut short or declares more than it can hold; other files pass.

    Raises:
        ValueError: If it is.
        OSError: If it cannot be read.
    """
    content = file.read_bytes()
    if content.startswith(JPEG) and not _reaches_end(content):
        raise ValueError(f"{file} is cut short: a part of the picture is missing, copy it again")
    if content.startswith(PNG) and (problem := _png_problem(content)):
        raise ValueError(f"{file} {problem}: copy it again")


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
    """What is wrong with a PNG as a row of chunks; "" if nothing is."""
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
