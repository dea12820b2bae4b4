"""Gaussians as the small files that web viewers open: .splat (antimatter15) and .spz (Niantic).

.splat: 32 bytes a Gaussian, the weightiest first: position and scale float32, colour and opacity 8-bit, rotation wxyz
8-bit. No harmonics beyond the base colour.

.spz, versions 2 and 3: gzip of a header and, for all Gaussians one after the other, positions (24-bit fixed point),
opacities, colours, scales (log, 1/16), rotations (2: x y z, 8-bit; 3: the smallest three, 10-bit) and harmonics (5 bits
at degree 1, 4 bits above). Axes are the scene's, as in the PLY: Niantic's converter leaves them by default, and viewers
show what the file says. The format itself would call them right, up, back.
"""

import gzip
import struct
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from sensor_model.files.atomic import atomic

from ..gaussians import Gaussians
from ..sh import sh_to_rgb
from .ply import unit_quats

SPZ_MAGIC, SPZ_VERSIONS = 0x5053474E, (2, 3)
SPZ_COLOR = 0.15  # of the base coefficient, so that values a bit outside 0..1 survive
SPZ_BITS = 20  # most fractional bits of a position
SH_BUCKETS = (8, 16)  # steps of 1/128 at degree 1, and above

Bytes = NDArray[np.uint8]


def write_splat(path: str | Path, gaussians: Gaussians) -> None:
    """Write a .splat file, atomically; colours outside 0..1 are clipped, as everywhere in this format."""
    g = gaussians.detach()
    weight = g.log_scales.sum(1).exp() * g.opacities
    order = torch.argsort(-weight, stable=True).cpu().numpy()
    colors = torch.cat([sh_to_rgb(g.sh[:, 0]), g.opacities[:, None]], 1)
    table = np.empty(len(g), np.dtype([("place", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)]))
    table["place"], table["scale"] = _array(g.means)[order], _array(g.scales)[order]
    table["rgba"] = _byte(_array(colors)[order] * 255)
    table["turn"] = _byte(_array(unit_quats(g))[order] * 128 + 128)
    with atomic(path) as temporary:
        temporary.write_bytes(table.tobytes())


def write_spz(path: str | Path, gaussians: Gaussians, *, version: int = 3, antialiased: bool = False) -> None:
    """Write an .spz file, atomically.

    Args:
        path: File to write.
        gaussians: Log scales outside -10..5.9375, which its bytes hold, are clipped.
        version: 2, for old readers, or 3, whose rotations are finer.
        antialiased: Whether they were trained with rasterize_mode="antialiased".

    Raises:
        ValueError: For another version, or positions of 2^23 and more, which the format cannot hold.
    """
    if version not in SPZ_VERSIONS:
        raise ValueError(f"version of an .spz file must be one of {SPZ_VERSIONS}, got {version}")
    g = gaussians.detach()
    means = _array(g.means).astype(np.float64)
    largest = float(np.abs(means).max(initial=0.0))
    if not largest < 2**23 - 1:
        raise ValueError(f"positions must be below 2^23 for .spz, got {largest:.3g}: use .ply or rescale the scene")
    bits = min(SPZ_BITS, int(np.floor(np.log2((2**23 - 1) / max(largest, 1.0)))))
    turns = _array(unit_quats(g))[:, (1, 2, 3, 0)].astype(np.float64)
    degree = g.sh_degree
    header = struct.pack("<IIIBBBB", SPZ_MAGIC, version, len(g), degree, bits, int(antialiased), 0)
    fixed = np.round(means * 2**bits).astype("<i4")
    parts = [
        fixed.view(np.uint8).reshape(len(g), 3, 4)[:, :, :3],
        _byte(_array(g.opacities) * 255),
        _byte(_array(g.sh[:, 0]) * (SPZ_COLOR * 255) + 127.5),
        _byte((_array(g.log_scales) + 10) * 16),
        _first_three(turns) if version == 2 else _smallest_three(turns),
        _harmonics(g),
    ]
    with atomic(path) as temporary:
        content = header + b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
        temporary.write_bytes(gzip.compress(content, mtime=0))


def _array(tensor: torch.Tensor) -> NDArray[np.float32]:
    return tensor.cpu().float().numpy()


def _byte(values: NDArray[np.floating]) -> Bytes:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _first_three(xyzw: NDArray[np.float64]) -> Bytes:
    """[N, 3] bytes of x, y, z with w >= 0."""
    return _byte(np.where(xyzw[:, 3:] < 0, -1, 1) * xyzw[:, :3] * 127.5 + 127.5)


def _smallest_three(xyzw: NDArray[np.float64]) -> NDArray[np.uint32]:
    """[N] words: two bits for the place of the largest, then sign and 9 bits of the others in order."""
    largest = np.abs(xyzw).argmax(1)
    negative = np.take_along_axis(xyzw, largest[:, None], 1)[:, 0] < 0
    word = largest.astype(np.uint32)
    for place in range(4):
        value = xyzw[:, place]
        sign = ((value < 0) ^ negative).astype(np.uint32)
        size = np.minimum(np.floor(511 * np.abs(value) * np.sqrt(2) + 0.5), 511).astype(np.uint32)
        word = np.where(place == largest, word, (word << 10) | (sign << 9) | size)
    return word.astype("<u4")


def _harmonics(g: Gaussians) -> Bytes:
    """[N, K - 1, 3] bytes: multiples of a bucket, so that they compress; 128 is 0."""
    steps = np.round(_array(g.sh[:, 1:]) * 128).astype(np.int64) + 128
    buckets = np.where(np.arange(steps.shape[1]) < 3, *SH_BUCKETS)[:, None]
    return np.clip((steps + buckets // 2) // buckets * buckets, 0, 255).astype(np.uint8)
