"""Files that nerfstudio and instant-ngp want beside the cameras: points as PLY, depth as PNG, where the scene lies.

nerfstudio: `ply_file_path` of a transforms.json (points in the world of its poses) and `depth_file_path` of every frame
(z-depth, 16-bit PNG, times `depth_unit_scale_factor` = 0.001 unless told otherwise; 0 is unknown).
instant-ngp: positions times `scale` plus `offset` are marched through the cube of side `aabb_scale` about (0.5, 0.5,
0.5), a power of two up to 128, of which the unit cube is modelled best.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.atomic import atomic
from simscenes.sets.pictures.png import write_codes

POINTS, DEPTHS = "points3D.ply", "depths"
DEPTH_UNIT = 1e-3  # world units a code of a depth PNG: nerfstudio's millimetres
CODES = 2**16  # of a 16-bit PNG
LOST = 0.01  # share of the depths that may be unknown without a word
FEW = 100  # codes, fewer than which a scene does not have without a word
CORE = (0.05, 0.95)  # quantiles of the points: a few strays must not shrink the content of the unit cube
FILL = 0.9  # of the unit cube, by cameras and the core
AABBS = tuple(2**i for i in range(8))
BACKGROUND_AABB = 16  # where it is not known how far the scene goes: the value of instant-ngp's own photographs


def write_points(path: Path, xyz: NDArray[np.floating], rgb: NDArray[np.uint8]) -> None:
    """Write points [P,3] and their colours [P,3] as a binary PLY: x y z double, red green blue uchar."""
    record = np.dtype([*((axis, "<f8") for axis in "xyz"), *((color, "u1") for color in ("red", "green", "blue"))])
    table = np.empty(len(xyz), record)
    for i, axis in enumerate("xyz"):
        table[axis] = xyz[:, i]
    for i, color in enumerate(("red", "green", "blue")):
        table[color] = rgb[:, i]
    kinds = [f"property double {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(xyz)}", *kinds, "end_header"]
    with atomic(path) as temporary:
        temporary.write_bytes(("\n".join(header) + "\n").encode("ascii") + table.tobytes())


def write_depth(path: Path, z: NDArray[np.float32]) -> None:
    """Write z-depth [h,w] (inf: no surface) in units of `DEPTH_UNIT`; 0 means no surface up to 65.535 units."""
    codes = np.round(np.where(np.isfinite(z), z, 0) / DEPTH_UNIT)
    write_codes(path, np.where(codes < CODES, codes, 0).astype(np.uint16))


@dataclass
class DepthLoss:
    """The loss of a set's z-depths in its depth PNGs, counted view by view."""

    count: int = 0
    far: int = 0
    nearest: float = math.inf
    farthest: float = 0.0

    def add(self, z: NDArray[np.float32]) -> None:
        """Count the z-depth [h,w] of a view."""
        seen = z[np.isfinite(z)]
        if seen.size:
            self.count, self.far = self.count + seen.size, self.far + int((seen >= CODES * DEPTH_UNIT).sum())
            self.nearest, self.farthest = min(self.nearest, float(seen.min())), max(self.farthest, float(seen.max()))

    def said(self) -> str:
        """The loss in words; "" if it is little."""
        files, whole = f"depths/*.png, in nerfstudio's units of {DEPTH_UNIT:g},", "the EXR files in gt/ hold all"
        end = CODES * DEPTH_UNIT
        if self.far > LOST * self.count:
            return (f"{files} hold depths up to {end:.5g}: {self.far / self.count:.0%} of the depths are beyond and "
                    f"unknown there; {whole}, and a scene scaled by {0.9 * end / self.farthest:.2g} would "
                    "fit")  # fmt: skip
        if self.count and self.farthest < FEW * DEPTH_UNIT:
            scale = FEW * DEPTH_UNIT / self.farthest
            return (f"{files} have few steps between the depths of {self.nearest:.3g} and {self.farthest:.3g} of this "
                    f"set; {whole}, and a scene scaled by {scale:.2g} would have {FEW}")  # fmt: skip
        return ""


def instant_ngp_box(centers: NDArray[np.floating], xyz: NDArray[np.floating]) -> dict[str, Any]:
    """`scale`, `offset` and `aabb_scale` such that all cameras [C,3] and points [P,3] lie inside the box.

    The unit cube holds the cameras and the core of the points. Without points the box reaches far beyond the cameras.
    """
    core = [centers] if len(xyz) == 0 else [centers, np.quantile(xyz, CORE, axis=0)]
    low, high = (bound(np.concatenate(core), axis=0) for bound in (np.min, np.max))
    middle, side = (low + high) / 2, float((high - low).max())
    if side == 0:  # one camera and nothing else
        side = 1.0
    reach = 2 * float(np.abs(np.concatenate([centers, xyz]) - middle).max()) / side * FILL
    aabb = BACKGROUND_AABB if len(xyz) == 0 else next((a for a in AABBS if a >= reach), AABBS[-1])
    scale = FILL / side * AABBS[-1] / max(reach, AABBS[-1])
    return {"aabb_scale": aabb, "scale": scale, "offset": (0.5 - scale * middle).tolist()}
