"""DNG and TIFF files with any tags, as strangers' programs write them."""

import struct
from pathlib import Path

import numpy as np

from sensor_model.files.dng import XYZ_TO_SRGB

FORMS = {"B": (1, "B"), "A": (2, "s"), "H": (3, "H"), "I": (4, "I"), "R": (5, "II"), "S": (10, "ii"), "F": (11, "f"),
         "D": (12, "d")}  # fmt: skip
NEUTRAL = np.array([0.5, 1.0, 0.7])  # response to white
Tags = dict[int, tuple[str, list[float]]]


def write_tagged(path: Path, data: bytes, tags: Tags) -> Path:
    """One directory, whose pixels lie in one strip; a type's letter and the values of each tag."""
    packed = {}
    for number, (letter, values) in {**tags, 273: ("I", [0]), 279: ("I", [len(data)])}.items():
        kind, form = FORMS[letter]
        pairs = [(round(v * 10**6), 10**6) for v in values] if letter in "RS" else [(v,) for v in values]
        packed[number] = kind, len(values), b"".join(struct.pack("<" + form, *pair) for pair in pairs)
    end = 8 + 2 + 12 * len(packed) + 4
    rows, tail = [], b""
    start = end + sum(len(raw) + len(raw) % 2 for _, _, raw in packed.values() if len(raw) > 4)
    for number in sorted(packed):
        kind, count, raw = packed[number]
        if number == 273:
            raw = struct.pack("<I", start)
        elif len(raw) > 4:
            raw, tail = struct.pack("<I", end + len(tail)), tail + raw + bytes(len(raw) % 2)
        rows.append(struct.pack("<HHI", number, kind, count) + raw.ljust(4, b"\0"))
    path.parent.mkdir(parents=True, exist_ok=True)
    head = b"II*\0" + struct.pack("<IH", 8, len(rows))
    path.write_bytes(head + b"".join(rows) + bytes(4) + tail + data)
    return path


def write_dng(
    path: Path, codes: np.ndarray, extra: Tags | None = None, *, black: list[float], white: int = 16383
) -> Path:
    """A mosaic [h,w] behind RGGB."""
    h, w = codes.shape
    tags: Tags = {
        254: ("I", [0]), 256: ("I", [w]), 257: ("I", [h]), 258: ("H", [16]), 259: ("H", [1]), 262: ("H", [32803]),
        274: ("H", [1]), 277: ("H", [1]), 278: ("I", [h]), 284: ("H", [1]), 33421: ("H", [2, 2]),
        33422: ("B", [0, 1, 1, 2]), 33434: ("R", [0.02]), 50706: ("B", [1, 4, 0, 0]), 50710: ("B", [0, 1, 2]),
        50711: ("H", [1]), 50714: ("R", black), 50717: ("I", [white]), 50728: ("R", NEUTRAL.tolist()),
        50721: ("S", (NEUTRAL[:, None] * XYZ_TO_SRGB).ravel().tolist()), 50778: ("H", [21]),
    }  # fmt: skip
    return write_tagged(path, codes.astype("<u2").tobytes(), tags | (extra or {}))


def mosaic_of(light: np.ndarray, black: np.ndarray | float, white: float = 16383, block: int = 1) -> np.ndarray:
    """Codes [h,w] of light [h,w,3] behind RGGB filters of so many pixels, with a little noise."""
    h, w = light.shape[:2]
    row, column = np.indices((h, w)) // block % 2
    seen = np.take_along_axis(light * NEUTRAL, (row + column)[..., None], 2)[..., 0]
    return np.round(black + seen * (white - black) + np.random.default_rng(0).normal(0, 2, (h, w)))
