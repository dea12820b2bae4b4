"""Heads cut out of fields: ellipsoids that run into each other, eyes and mouths taken out, and the surface between.

A field [n,n,n] is positive outside, in metres from the surface near it. x is the sitter's left, -y is where he looks,
z is up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.scenes.parts import shapes as s

Field = NDArray[np.float64]
Point = Sequence[float]
SOFT = 0.02  # m over which one part runs into the next


class Stone:
    """A block of stone to cut from: all space within `low` and `high`, sampled every `step` metres."""

    def __init__(self, low: Point, high: Point, step: float) -> None:
        self.x, self.y, self.z = np.ix_(*(np.arange(a, b, step) for a, b in zip(low, high, strict=True)))
        self.low, self.step = np.asarray(low, dtype=np.float64), step
        self.field: Field = np.full((self.x.size, self.y.size, self.z.size), 1.0)

    def egg(self, center: Point, radii: Point, tilt: float = 0.0) -> Field:
        """Ellipsoid, leaning by `tilt` degrees about x."""
        cos, sin = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
        x, y, z = self.x - center[0], self.y - center[1], self.z - center[2]
        along, up = cos * y + sin * z, cos * z - sin * y
        scaled = np.sqrt((x / radii[0]) ** 2 + ((along / radii[1]) ** 2 + (up / radii[2]) ** 2))
        return np.asarray((scaled - 1) * min(radii))

    def melt(self, part: Field, soft: float = SOFT) -> None:
        """Let a part run into the present shape (a smooth minimum)."""
        mix = np.clip(0.5 + 0.5 * (self.field - part) / soft, 0, 1)
        self.field = self.field * (1 - mix) + part * mix - soft * mix * (1 - mix)

    def add(self, center: Point, radii: Point, soft: float = SOFT, *, tilt: float = 0.0, pair: bool = False) -> None:
        """Let an ellipsoid run into the present shape; of a pair the mirror image too, left and right."""
        for side in (-1, 1) if pair else (1,):
            self.melt(self.egg((side * center[0], *center[1:]), radii, tilt), soft)

    def cut(self, center: Point, radii: Point, soft: float = SOFT, *, tilt: float = 0.0, pair: bool = False) -> None:
        """Take an ellipsoid or a pair of them away."""
        self.field = -self.field
        self.add(center, radii, soft, tilt=tilt, pair=pair)
        self.field = -self.field

    def mesh(self, bsdf: Any, position: Point, yaw: float = 0.0, size: float = 1.0) -> Any:
        """The surface, with smooth normals; the texture is wrapped around z."""
        from skimage.measure import marching_cubes

        # Marching cubes needs a closed surface: the border of the block is outside.
        field = np.pad(self.field, 1, constant_values=self.step)
        points, faces, normals, _ = marching_cubes(field, 0.0)
        corners = points[faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        if np.einsum("ij,ij->", across, corners[:, 0]) < 0:  # six times the volume: faces that look inwards
            faces, across = faces[:, ::-1], -across
        if np.einsum("ij,ij->", across, normals[faces[:, 0]]) < 0:
            normals = -normals
        points = (points - 1) * self.step + self.low
        around = np.arctan2(points[:, 0], -points[:, 1]) / (2 * np.pi) + 0.5
        uv = np.stack([around, (points[:, 2] - points[:, 2].min()) / np.ptp(points[:, 2])], -1)
        matrix = np.array(s.place(position, yaw, size).matrix, dtype=np.float64)
        turned = normals @ (matrix[:3, :3] / size).T
        return s.mesh(points @ matrix[:3, :3].T + matrix[:3, 3], faces, uv, bsdf, turned)


def person(rng: np.random.Generator, step: float = 0.008) -> Stone:
    """A bust with shoulders, 0.52 m high; the proportions of the face vary."""
    wide, long, nose = (float(v) for v in rng.uniform((0.95, 0.95, 0.9), (1.06, 1.06, 1.25)))
    b = Stone((-0.25, -0.2, 0.0), (0.25, 0.2, 0.54), step)
    b.add((0, 0.01, 0.02), (0.21, 0.12, 0.13))  # shoulders
    b.add((0, 0.015, 0.17), (0.058, 0.06, 0.13), 0.05)  # neck
    b.add((0, 0.02, 0.41), (0.083 * wide, 0.105, 0.105))  # skull
    b.add((0, -0.025, 0.34), (0.066 * wide, 0.072, 0.1 * long), 0.03)  # face
    b.add((0, -0.072, 0.262), (0.026, 0.022, 0.018), 0.03)  # chin
    b.add((0.043, -0.062, 0.325), (0.024, 0.02, 0.022), 0.025, pair=True)  # cheeks
    b.cut((0.033, -0.108, 0.372), (0.02, 0.018, 0.012), 0.015, pair=True)  # sockets
    b.add((0.033, -0.08, 0.371), (0.013, 0.012, 0.012), 0.004, pair=True)  # eyes
    b.add((0.033, -0.091, 0.391), (0.024, 0.01, 0.006), 0.012, pair=True)  # brows
    b.add((0, -0.1, 0.35), (0.01, 0.014 * nose, 0.032), 0.012, tilt=18)  # nose
    b.add((0.01, -0.108 - 0.006 * nose, 0.326), (0.008, 0.01, 0.007), 0.008, pair=True)
    for z in (0.302, 0.29):  # lips, and the mouth between them
        b.add((0, -0.092, z), (0.023, 0.012, 0.007), 0.008)
    b.cut((0, -0.106, 0.296), (0.022, 0.008, 0.002), 0.004)
    b.add((0.088 * wide, 0.015, 0.36), (0.01, 0.022, 0.034), 0.008, tilt=-12, pair=True)  # ears
    hair = b.egg((0, 0.045, 0.43), (0.096 * wide, 0.105, 0.1))
    strands = 0.004 * np.sin(70 * b.x + 40 * b.z + 6 * rng.random())
    b.melt(hair + strands, 0.008)
    return b


def dog(rng: np.random.Generator, step: float = 0.008) -> Stone:
    """A dog's head and chest, 0.46 m high, with hanging ears."""
    snout = float(rng.uniform(0.9, 1.15))
    b = Stone((-0.2, -0.26, 0.0), (0.2, 0.2, 0.48), step)
    b.add((0, 0.04, 0.05), (0.15, 0.13, 0.16))
    b.add((0, 0.02, 0.2), (0.085, 0.09, 0.14), 0.05)
    b.add((0, 0.0, 0.345), (0.098, 0.1, 0.09))
    b.add((0, -0.1, 0.315), (0.052, 0.085 * snout, 0.042), 0.035, tilt=8)  # muzzle
    b.add((0, -0.1 - 0.08 * snout, 0.333), (0.022, 0.016, 0.016), 0.006)  # nose
    b.cut((0, -0.13, 0.285), (0.045, 0.08, 0.004), 0.006, tilt=8)  # mouth
    b.cut((0.045, -0.083, 0.375), (0.02, 0.014, 0.016), 0.012, pair=True)
    b.add((0.044, -0.074, 0.375), (0.014, 0.013, 0.013), 0.004, pair=True)
    b.add((0.102, 0.015, 0.325), (0.018, 0.045, 0.085), 0.012, tilt=10, pair=True)  # ears
    return b


def cat(rng: np.random.Generator, step: float = 0.008) -> Stone:
    """A sitting cat, 0.5 m high, with upright ears."""
    round_ = float(rng.uniform(0.95, 1.1))
    b = Stone((-0.2, -0.22, 0.0), (0.22, 0.24, 0.52), step)
    b.add((0, 0.05, 0.12), (0.13, 0.15, 0.13))
    b.add((0, 0.0, 0.22), (0.09, 0.09, 0.15), 0.05)
    b.add((0.05, -0.07, 0.08), (0.035, 0.045, 0.11), 0.03, pair=True)  # fore legs
    b.add((0, -0.03, 0.375), (0.088 * round_, 0.078, 0.074), 0.03)
    b.add((0.055, -0.015, 0.445), (0.026, 0.014, 0.05), 0.012, tilt=8, pair=True)  # ears
    b.cut((0.055, -0.035, 0.445), (0.013, 0.012, 0.032), 0.008, tilt=8, pair=True)
    b.add((0.018, -0.098, 0.352), (0.022, 0.02, 0.018), 0.012, pair=True)  # whisker pads
    b.add((0, -0.115, 0.367), (0.01, 0.008, 0.007), 0.006)
    b.cut((0.036, -0.1, 0.39), (0.018, 0.014, 0.013), 0.008, pair=True)
    b.add((0.036, -0.09, 0.39), (0.014, 0.011, 0.011), 0.004, pair=True)
    curl = np.linspace(0, 1.6 * np.pi, 14)
    for a in curl:  # the tail, around the right side
        b.add((0.13 + 0.03 * np.cos(a) - 0.004 * a, 0.1 - 0.05 * a, 0.035), (0.024, 0.03, 0.024), 0.02)
    return b
