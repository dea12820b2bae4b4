"""The surface in front of a camera: the tangent plane of every pixel.

In camera coordinates a plane m . P = 1 has 1/z = m . d at the image point (x, y), with d = K^-1 (x, y, 1).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GRAZING = 0.02  # cosine; planes seen more from the side are taken as facing the camera: 1/z would be a division by zero


@dataclass(frozen=True)
class SurfaceCamera:
    """A camera and the surface that it sees.

    What it works out of the surface takes much memory, and goes with it: of a camera that is kept, use a copy.

    Attributes:
        viewmat: World to camera [4, 4].
        K: Intrinsics [3, 3].
        size: Height and width.
        tolerance: Relative difference of depth up to which two pixels show the same surface.
        surface: Gives `planes`.
    """

    viewmat: Array
    K: Array
    size: tuple[int, int]
    tolerance: float
    surface: Callable[[], Array]

    @staticmethod
    def of(
        viewmat: Array, K: Array, depth: NDArray[Any], normals: NDArray[Any], tolerance: float = 0.01
    ) -> "SurfaceCamera":
        """From z-depth [h, w], inf without surface, and world normals [h, w, 3]."""
        height, width = depth.shape
        return SurfaceCamera(viewmat, K, (height, width), tolerance, partial(tangents, viewmat, K, depth, normals))

    @cached_property
    def planes(self) -> Array:
        """Inverse depth of every pixel's tangent plane, [h, w, 3]: 1/z = planes . K^-1 (x, y, 1), zero for the
        background.
        """
        return self.surface()

    @cached_property
    def inverse_depth(self) -> NDArray[np.float32]:
        """1/z at the pixel centres [h, w], 0 for the background; it says which pixels show a surface, not where."""
        return np.asarray((self.planes * rays_of(self.K, *self.size)).sum(-1), np.float32)

    def at(self, rows: NDArray[np.intp], points: Array) -> Array:
        """1/z of the planes of some pixels (flat indices [n]) at image points [n, 2]."""
        rays = np.concatenate([points, np.ones((len(points), 1))], 1) @ np.linalg.inv(self.K).T
        return np.asarray((self.planes.reshape(-1, 3)[rows] * rays).sum(-1))

    @cached_property
    def whole(self) -> Mask:
        """Pixels whose eight neighbours show the same surface [h, w]: no edge passes through these."""
        height, width = self.size
        inverse, found = self.inverse_depth, np.ones((height, width), bool)
        rays, steps = rays_of(self.K, height, width), [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x]
        for dy, dx in steps:
            here = (slice(max(0, -dy), height - max(0, dy)), slice(max(0, -dx), width - max(0, dx)))
            there = (slice(max(0, dy), height - max(0, -dy)), slice(max(0, dx), width - max(0, -dx)))
            expected = (self.planes[here] * rays[there]).sum(-1)
            found[here] &= same_depth(expected, inverse[there], self.tolerance)
        return found


def tangents(viewmat: Array, K: Array, depth: NDArray[Any], normals: NDArray[Any]) -> Array:
    """The tangent planes [h, w, 3] of z-depths [h, w], inf without surface, with world normals [h, w, 3]."""
    rays = rays_of(K, *depth.shape)
    turned = normals.astype(np.float64) @ viewmat[:3, :3].T
    surface = np.isfinite(depth) & (depth > 0)
    slope = (turned * rays).sum(-1)  # n . d
    level = np.abs(slope) < GRAZING * np.linalg.norm(rays, axis=-1)
    turned = np.where(level[..., None], [0.0, 0.0, 1.0], turned)
    slope = np.where(level, 1.0, slope)
    near = np.where(surface, depth, np.inf).astype(np.float64)
    return np.asarray(turned / (slope * near)[..., None])


def seen_together(known: list[SurfaceCamera], viewmat: Array, K: Array, height: int, width: int) -> SurfaceCamera:
    """The surface in front of a camera from the pixels of all known ones: the nearest that falls onto each pixel."""
    inverse, planes = np.zeros(height * width), np.zeros((height * width, 3))
    for camera in map(replace, known):
        mine, near = _brought(camera, viewmat, K, height, width)
        nearer = near > inverse
        inverse, planes = np.where(nearer, near, inverse), np.where(nearer[:, None], mine, planes)
    rays = rays_of(K, height, width)
    shaped = planes.reshape(height, width, 3)
    # A plane seen from the side may pass the centre of its pixel far away, or not at all.
    facing = np.stack([0 * inverse, 0 * inverse, inverse], -1).reshape(height, width, 3)
    fits = same_depth((shaped * rays).sum(-1), inverse.reshape(height, width), 5 * known[0].tolerance)
    found = np.where(fits[..., None], shaped, facing)
    return SurfaceCamera(viewmat, K, (height, width), known[0].tolerance, lambda: found)


def _brought(camera: SurfaceCamera, viewmat: Array, K: Array, height: int, width: int) -> tuple[Array, Array]:
    """A camera's pixels in another one: the plane [height * width, 3] of the nearest that falls onto each pixel, and
    its inverse depth, 0 where none does.
    """
    surface = camera.inverse_depth > 0
    motion = viewmat @ np.linalg.inv(camera.viewmat)
    points = rays_of(camera.K, *camera.size)[surface] / camera.inverse_depth[surface][:, None]
    points = points @ motion[:3, :3].T + motion[:3, 3]
    # The plane (m, -1) of homogeneous coordinates transforms with the inverse of the points' matrix.
    turned = np.concatenate([camera.planes[surface], -np.ones((len(points), 1))], 1) @ np.linalg.inv(motion)
    ahead = points[:, 2] > 0
    points, turned = points[ahead], turned[ahead]
    place = np.floor((points @ K.T)[:, :2] / points[:, 2:])
    inside = (place >= 0).all(-1) & (place < (width, height)).all(-1) & (turned[:, 3] < 0)
    points, turned, place = points[inside], turned[inside], place[inside]
    index = (place @ (1, width)).astype(int)
    order = np.argsort(-points[:, 2])  # of several points in a pixel the nearest is written last
    planes, inverse = np.zeros((height * width, 3)), np.zeros(height * width)
    planes[index[order]] = (turned[:, :3] / -turned[:, 3:])[order]
    inverse[index[order]] = 1 / points[order, 2]
    return planes, inverse


def rays_of(K: Array, height: int, width: int) -> Array:
    """K^-1 (x, y, 1) of all pixel centres [h, w, 3]."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.asarray(np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(K).T)


def same_depth(expected: NDArray[Any], found: NDArray[Any], tolerance: float) -> Mask:
    """Whether inverse depths agree to a relative tolerance; two backgrounds do."""
    return np.asarray(np.abs(expected - found) <= tolerance * np.maximum(np.abs(found), np.abs(expected)))
