"""Whether a JPEG file is there to its end: decoders fill what is missing with grey and say nothing."""

from __future__ import annotations

import re
from pathlib import Path

SOI, EOI = b"\xff\xd8", 0xD9
# In coded data, 0xFF is followed by 0 (a plain 0xFF), a restart marker or more 0xFF; anything else ends it.
NEXT = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")


def check_whole_jpeg(file: Path) -> None:
    """Refuse a JPEG file that is cut short; files that do not start like a JPEG pass.

    Raises:
        ValueError: If its end is missing.
        OSError: If it cannot be read.
    """
    content = file.read_bytes()
    if content.startswith(SOI) and not _reaches_end(content):
        raise ValueError(f"{file} is cut short: a part of the picture is missing, copy it again")


def _reaches_end(content: bytes) -> bool:
    """Walk from marker to marker; thumbnails, which have ends of their own, lie inside of segments."""
    at = 2
    while found := NEXT.search(content, at):
        at = found.end()
        kind = content[at - 1]
        if kind == EOI:
            return True
        at += int.from_bytes(content[at : at + 2], "big")  # of the segment, with these two bytes
    return False
