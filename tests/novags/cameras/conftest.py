"""A room corner with a texture, seen by cameras whose truth is known."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from simscenes.rigs import Rig, orbit_rig

PLANES = ((2, 0.0), (1, 0.7), (0, 0.7))  # axis and place: the floor z = 0, the walls y = 0.7 and x = 0.7


@dataclass(frozen=True)
class Corner:
    rig: Rig
    pictures: np.ndarray  # uint8 [C, h, w, 3]
    depths: np.ndarray  # z-depth [C, h, w]

    @staticmethod
    def distance(points: np.ndarray) -> np.ndarray:
        """From points [P, 3] to the nearest of the planes, [P]."""
        return np.min([np.abs(points[:, axis] - place) for axis, place in PLANES], axis=0)

    @staticmethod
    def depth(viewmat: np.ndarray, K: np.ndarray, width: int, height: int) -> np.ndarray:
        """z-depth [h, w] of any camera."""
        return hit(viewmat, K, width, height)[0]

    @staticmethod
    def see(viewmat: np.ndarray, K: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """Picture uint8 [h, w, 3] and z-depth [h, w] of any camera."""
        depth, points, plane = hit(viewmat, K, width, height)
        shade = np.zeros(depth.shape)
        for k, (axis, _) in enumerate(PLANES):
            a, b = (points[..., i] for i in range(3) if i != axis)
            for octave in range(4):
                table = np.random.default_rng([k, octave]).uniform(-1, 1, (64, 64))
                at = [8 * 2**octave * (c + 1.7) for c in (a, b)]
                found = map_coordinates(table, at, order=3, mode="grid-wrap")
                shade += np.where(plane == k, found / 1.3**octave, 0)
        picture = np.clip(128 + 55 * shade, 0, 255).round().astype(np.uint8)
        return np.repeat(picture[..., None], 3, -1), depth


def hit(viewmat: np.ndarray, K: np.ndarray, width: int, height: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """z-depth [h, w], world point [h, w, 3] and plane [h, w] behind the centre of each pixel."""
    y, x = np.mgrid[0:height, 0:width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T @ viewmat[:3, :3]
    centre = -viewmat[:3, :3].T @ viewmat[:3, 3]
    with np.errstate(divide="ignore"):
        along = np.stack([(place - centre[axis]) / rays[..., axis] for axis, place in PLANES])
    along[along <= 0] = np.inf
    depth = along.min(0)
    return depth, centre + rays * depth[..., None], along.argmin(0)


@pytest.fixture(scope="session")
def corner() -> Callable[..., Corner]:
    def make(count: int, width: int, height: int) -> Corner:
        rig = orbit_rig(
            count, width, height, 50.0, target=(0.2, 0.2, 0.2), radius=1.6, elevation_deg=30.0, start_deg=-160.0,
            sweep_deg=50.0,
        )  # fmt: skip
        seen = [Corner.see(v, K, width, height) for v, K in zip(rig.viewmats, rig.Ks, strict=True)]
        return Corner(rig, np.stack([picture for picture, _ in seen]), np.stack([depth for _, depth in seen]))

    return make
