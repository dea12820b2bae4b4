"""Data files that some of Mitsuba's plugins read: made of formulas, as small as they may be."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.sets.pictures.exr import write_exr

CODES = {"uint8": 1, "uint16": 3, "float32": 10}  # of number types in Mitsuba's tensor files
NANOMETRES = np.array([400.0, 500.0, 550.0, 600.0, 700.0], np.float32)
REDDISH = np.array([0.2, 0.25, 0.3, 0.9, 1.0], np.float32)  # reflectance at these


def picture(path: Path) -> str:
    """A grey texture with a bright half."""
    write_exr(path, {c: np.tile(np.float32([0.2, 0.2, 0.8, 0.8]), (4, 1)) for c in "RGB"})
    return str(path)


def normals(path: Path) -> str:
    """Normals that lean to either side, as colours."""
    lean = np.tile(np.float32([0.3, 0.7]), (2, 1))
    write_exr(path, {"R": lean, "G": np.full_like(lean, 0.5), "B": np.full_like(lean, 0.95)})
    return str(path)


def tensors(path: Path, fields: dict[str, NDArray[Any]]) -> str:
    """Mitsuba's tensor file."""
    head, body = b"tensor_file\0" + struct.pack("<BBI", 1, 0, len(fields)), b""
    start = len(head) + sum(2 + len(name) + 2 + 1 + 8 + 8 * f.ndim for name, f in fields.items())
    for name, field in fields.items():
        place = struct.pack("<HBQ", field.ndim, CODES[str(field.dtype)], start + len(body))
        head += struct.pack("<H", len(name)) + name.encode() + place + struct.pack(f"<{field.ndim}Q", *field.shape)
        body += field.tobytes()
    path.write_bytes(head + body)
    return str(path)


def measured(path: Path) -> str:
    """An isotropic reddish material for `measured`: reflected light does not depend on the angle."""
    angles = np.linspace(0, np.pi / 2, 4, dtype=np.float32)
    ones = np.ones((1, 4, 4, 4), np.float32)
    spectra = np.broadcast_to(0.1 * REDDISH[None, None, :, None, None], (1, 4, 5, 4, 4)).astype(np.float32)
    fields = {
        "description": np.frombuffer(b"reddish", np.uint8), "theta_i": angles, "phi_i": np.zeros(1, np.float32),
        "ndf": np.ones((4, 4), np.float32), "sigma": np.ones((4, 4), np.float32), "vndf": ones, "luminance": ones,
        "spectra": spectra, "wavelengths": NANOMETRES, "jacobian": np.zeros(1, np.uint8),
    }  # fmt: skip
    return tensors(path, fields)


def measured_polarized(path: Path) -> str:
    """A reddish material for `measured_polarized` whose reflection polarises by half."""
    mueller = np.zeros((4, 4), np.float32)
    mueller[0, 0], mueller[0, 1], mueller[1, 0], mueller[1, 1] = 1.0, 0.5, 0.5, 1.0
    matrices = 0.3 * REDDISH[None, None, None, :, None, None] * mueller
    angles = [np.linspace(0, end, n, dtype=np.float32)[None] for end, n in ((np.pi / 2, 3), (np.pi / 2, 3), (np.pi, 5))]
    fields = {
        "theta_h": angles[0], "theta_d": angles[1], "phi_d": angles[2],
        "wvls": np.array([450, 500, 550, 600, 650], np.uint16),
        "M": np.broadcast_to(matrices, (5, 3, 3, 5, 4, 4)).astype(np.float32),
    }  # fmt: skip
    return tensors(path, fields)


def volume(path: Path, channels: int = 1) -> str:
    """A grid of 2 x 2 x 2 densities in Mitsuba's volume format, or of SGGX matrices with 6 channels."""
    grid = np.linspace(0.5, 1.0, 8, dtype=np.float32).reshape(2, 2, 2, 1)
    values = grid if channels == 1 else np.tile(np.float32([1, 0.5, 0.2, 0, 0, 0]), (2, 2, 2, 1))
    head = b"VOL" + struct.pack("<B5i6f", 3, 1, 2, 2, 2, channels, 0, 0, 0, 1, 1, 1)
    path.write_bytes(head + np.ascontiguousarray(values, np.float32).tobytes())
    return str(path)


def curve(path: Path) -> str:
    """A bent fibre of some width, for the curve shapes."""
    path.write_text("\n".join(f"{x:.3g} {0.1 * x * x:.3g} {0.6 + 0.1 * x:.3g} 0.15" for x in np.linspace(-0.6, 0.6, 6)))
    return str(path)


def mesh(path: Path, *, colored: bool = False) -> str:
    """A pyramid as PLY or OBJ, by the end of its name."""
    corners = [(-0.6, -0.6, 0.05), (0.6, -0.6, 0.05), (0.6, 0.6, 0.05), (-0.6, 0.6, 0.05), (0, 0, 1)]
    faces = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    if path.suffix == ".obj":
        lines = ["v {} {} {}".format(*c) for c in corners] + ["f {} {} {}".format(*(i + 1 for i in f)) for f in faces]
        path.write_text("\n".join(lines))
        return str(path)
    shades = "".join(f"property float {c}\n" for c in "rgb") if colored else ""
    head = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"{shades}element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    paint = " 0.3 0.3 0.3" if colored else ""
    rows = [" ".join(map(str, c)) + paint for c in corners] + ["3 {} {} {}".format(*f) for f in faces]
    path.write_text(head + "\n".join(rows) + "\n")
    return str(path)


def serialized(path: Path) -> str:
    """The pyramid's first face in Mitsuba's own compressed format."""
    import zlib

    corners = np.float32([[-0.6, 0, 0.05], [0.6, 0, 0.05], [0, 0.2, 1]])
    data = struct.pack("<I", 0x1000) + b"m\0" + struct.pack("<QQ", 3, 1) + corners.tobytes()
    packed = struct.pack("<HH", 0x041C, 4) + zlib.compress(data + np.uint32([0, 1, 2]).tobytes())
    path.write_bytes(packed + struct.pack("<QI", 0, 1))
    return str(path)
