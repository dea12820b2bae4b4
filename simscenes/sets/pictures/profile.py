"""ICC profiles: how bright the middle code is, and whether the colours are those of sRGB.

Source: ICC.1:2022, sections 7 (header, table of tags), 10.6 (curveType) and 10.18 (parametricCurveType).
"""

from __future__ import annotations

import struct

import numpy as np

LINEAR = 0.49, 0.51  # light of the middle code where codes are proportional to light
# sRGB has .214, an exponent of 2.2 .218, video .26, L* .184. An exponent of 1.8 has .287, and is another picture.
SRGB = 0.17, 0.27
CURVES = (b"gTRC", b"kTRC")
# The columns of sRGB's matrix to XYZ at D50.
PRIMARIES = {b"rXYZ": (0.4361, 0.2225, 0.0139), b"gXYZ": (0.3851, 0.7169, 0.0971), b"bXYZ": (0.1431, 0.0606, 0.7141)}
ALIKE = 0.01  # a profile keeps numbers to 2e-5; this is a difference that nobody sees
# How many parameters each kind of parametric curve has.
PARAMETERS = (1, 3, 4, 5, 7)


def middle_of(profile: bytes) -> float | None:
    """Light of the code .5, 0 .. 1, by the curve of green or gray; None where the profile has no such curve."""
    for name in CURVES:
        if curve := _tag(profile, name):
            try:
                return _middle(curve)
            except (struct.error, IndexError, ValueError, OverflowError, ZeroDivisionError):
                return None
    return None


def has_other_primaries(profile: bytes) -> bool:
    """Whether the profile states primaries, and others than sRGB's."""
    for name, wanted in PRIMARIES.items():
        place = _tag(profile, name)
        if len(place) < 20:
            return False
        found = np.array(struct.unpack_from(">3i", place, 8)) / 65536
        if np.abs(found - wanted).max() > ALIKE:
            return True
    return False


def kind_of(middle: float) -> str:
    """The curve that has this light in its middle: "linear", "srgb", or "" for another one."""
    if LINEAR[0] <= middle <= LINEAR[1]:
        return "linear"
    return "srgb" if SRGB[0] <= middle <= SRGB[1] else ""


def _tag(profile: bytes, name: bytes) -> bytes:
    if len(profile) < 132:
        return b""
    (count,) = struct.unpack_from(">I", profile, 128)
    for at in range(132, min(132 + 12 * count, len(profile) - 11), 12):
        if profile[at : at + 4] == name:
            start, size = struct.unpack_from(">II", profile, at + 4)
            return profile[start : start + size]
    return b""


def _middle(curve: bytes) -> float | None:
    if curve[:4] == b"curv":
        (count,) = struct.unpack_from(">I", curve, 8)
        if count == 0:
            return 0.5
        if count == 1:
            return float(0.5 ** (struct.unpack_from(">H", curve, 12)[0] / 256))
        codes = np.frombuffer(curve, ">u2", count, 12) / 65535
        return float(np.interp(0.5, np.linspace(0, 1, count), codes))
    if curve[:4] != b"para":
        return None
    (kind,) = struct.unpack_from(">H", curve, 8)
    g, a, b, c, d, e, f = _parameters(kind, [v / 65536 for v in struct.unpack_from(f">{PARAMETERS[kind]}i", curve, 12)])
    return float((a * 0.5 + b) ** g + e if d <= 0.5 else c * 0.5 + f)


def _parameters(kind: int, stated: list[float]) -> list[float]:
    """All seven, of the kinds that state fewer of them."""
    if kind == 0:
        return [*stated, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    if kind in (1, 2):  # 0, or c, below the place where the power begins
        g, a, b, *c = stated
        level = c[0] if c else 0.0
        return [g, a, b, 0.0, -b / a, level, level]
    return stated if kind == 4 else [*stated, 0.0, 0.0]
