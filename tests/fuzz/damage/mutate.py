"""Damage: a valid file in, a broken one out; the same for the same random numbers.

`damaged` picks what suits the file: structure first (a JSON value replaced, a PNG chunk with a sum that fits), since
plain bit flips seldom get past the first check, then bytes.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from random import Random

from tests.fuzz.damage import structure

Mutator = Callable[[bytes, Random], bytes]

ABSURD_INTS = (0, 1, -1, 2, 127, 128, 255, 256, 32767, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**33, 2**40,
               2**62, 2**63 - 1, -(2**31), -(2**63))  # fmt: skip
ABSURD_FLOATS = (0.0, -0.0, 1e-45, 1e-38, 1e38, -1e38, float("inf"), float("-inf"), float("nan"), 0.5, -1.0)
NUMBERS = ("0", "-1", "1", "2", "1e-320", "1e308", "-1e308", "1e999", "nan", "inf", "-inf", "1" + "0" * 30,
           "9" * 400, "4294967296", "2147483648", "-2147483649", "9223372036854775808", "0x10", "1_000", "1.5", "1e5",
           "65536", "", "x", "½", "1 2")  # fmt: skip
NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
TEXT = (".json", ".jsonl", ".gltf", ".toml", ".xml", ".txt", ".obj", ".argv")


def damaged(name: str, content: bytes, rng: Random) -> bytes:
    """One to four kinds of damage, one after the other; `name` is that of the file."""
    for _ in range(rng.choice((1, 1, 1, 2, 2, 4))):
        own = structure.FOR.get(suffix(name))
        options: tuple[Mutator, ...] = BYTES
        if suffix(name) in TEXT:
            options = TEXTUAL if rng.random() < 0.8 else BYTES
        if own is not None and rng.random() < 0.7:
            options = (own,)
        changed = rng.choice(options)(content, rng)
        content = changed if changed != content else rng.choice(BYTES)(content, rng)  # no longer of that structure
    return content


def suffix(name: str) -> str:
    """With its dot, lower case; of `transforms.json` it is `.json`."""
    return "." + name.rpartition(".")[2].lower()


def _span(content: bytes, rng: Random) -> tuple[int, int]:
    """A piece, mostly short; heads of files are hit more often than their bodies."""
    start = rng.randrange(len(content) + 1) if rng.random() < 0.5 else rng.randrange(min(len(content), 256) + 1)
    return start, min(len(content), start + int(2 ** rng.uniform(0, 10)))


def flip(content: bytes, rng: Random) -> bytes:
    out = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 8)) if out else 0):
        place = rng.randrange(len(out)) if rng.random() < 0.5 else rng.randrange(min(len(out), 256))
        out[place] = out[place] ^ (1 << rng.randrange(8)) if rng.random() < 0.7 else rng.choice((0, 1, 127, 128, 255))
    return bytes(out)


def integer(content: bytes, rng: Random) -> bytes:
    form = rng.choice(("<H", ">H", "<I", ">I", "<Q", ">Q"))
    value = rng.choice(ABSURD_INTS) & (256 ** struct.calcsize(form) - 1)
    return _overwrite(content, struct.pack(form, value), rng)


def floating(content: bytes, rng: Random) -> bytes:
    return _overwrite(content, struct.pack(rng.choice(("<f", ">f", "<d", ">d")), rng.choice(ABSURD_FLOATS)), rng)


def _overwrite(content: bytes, patch: bytes, rng: Random) -> bytes:
    start, _ = _span(content, rng)
    return content[:start] + patch + content[start + len(patch) :]


def cut(content: bytes, rng: Random) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def drop(content: bytes, rng: Random) -> bytes:
    start, stop = _span(content, rng)
    return content[:start] + content[stop:]


def repeat(content: bytes, rng: Random) -> bytes:
    start, stop = _span(content, rng)
    return content[:stop] + content[start:stop] * rng.choice((1, 1, 2, 50)) + content[stop:]


def blank(content: bytes, rng: Random) -> bytes:
    start, stop = _span(content, rng)
    return content[:start] + rng.choice((b"\0", b"\xff", b" ")) * (stop - start) + content[stop:]


def move(content: bytes, rng: Random) -> bytes:
    start, stop = _span(content, rng)
    rest = content[:start] + content[stop:]
    place = rng.randrange(len(rest) + 1)
    return rest[:place] + content[start:stop] + rest[place:]


def noise(content: bytes, rng: Random) -> bytes:
    start, _ = _span(content, rng)
    return content[:start] + rng.randbytes(rng.randrange(1, 64)) + content[start:]


def number(content: bytes, rng: Random) -> bytes:
    found = list(NUMBER.finditer(content))
    if not found:
        return content
    match = rng.choice(found)
    return content[: match.start()] + rng.choice(NUMBERS).encode() + content[match.end() :]


def token(content: bytes, rng: Random) -> bytes:
    """Swap two words."""
    words = re.split(rb"([\s,:=\"'<>\[\]{}/]+)", content)
    i, j = (rng.randrange(0, len(words), 2) for _ in range(2))
    words[i], words[j] = words[j], words[i]
    return b"".join(words)


def line(content: bytes, rng: Random) -> bytes:
    """Leave a line out, write one twice, or swap two."""
    lines = content.splitlines(keepends=True)
    if not lines:
        return content
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    what = rng.randrange(3)
    if what == 0:
        del lines[i]
    elif what == 1:
        lines.insert(j, lines[i])
    else:
        lines[i], lines[j] = lines[j], lines[i]
    return b"".join(lines)


BYTES: tuple[Mutator, ...] = (flip, flip, integer, floating, cut, drop, repeat, blank, move, noise)
TEXTUAL: tuple[Mutator, ...] = (number, number, number, token, line, drop, cut)
