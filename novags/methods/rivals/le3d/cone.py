"""The cone scatter of LE3D: random points between the cameras and far beyond the first points.

Structure from motion finds few points in the dark, and none far away. With the mean viewing direction n, the largest
field of view Θ and the largest distance r of a camera from the mean place c of the cameras, the cone has

    apex  c - 0.9 r / tan(Θ / 2) n,    axis n,    depths from the nearest first point to FAR times the farthest one

The apex lies so far behind that every camera is in the cone. 0.9 is of its code; the text has r itself.
"""

import numpy as np

from novags.cameras.estimate import Array

APEX, FAR = 0.9, 10.0
# Of the mean of unit vectors: cameras that look in all directions alike have no mean one, but for rounding.
LEAST_MEAN = 1e-6


def cone_scatter(
    points: Array, viewmats: Array, Ks: Array, size: tuple[int, int], count: int, rng: np.random.Generator
) -> Array:
    """Points in the cone, evenly over its volume.

    Args:
        points: First points [P, 3], P > 0, world units.
        viewmats: [C, 4, 4], float64.
        Ks: [C, 3, 3], float64.
        size: Width and height of a picture, px.
        count: How many.
        rng: Of the draws.

    Returns:
        [count, 3]; none where the cameras have no mean viewing direction.
    """
    centers, n = -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3]), viewmats[:, 2, :3].mean(0)
    if np.linalg.norm(n) < LEAST_MEAN:
        return np.empty((0, 3))
    n = n / np.linalg.norm(n)
    slope = (np.array(size) / (2 * Ks[:, (0, 1), (0, 1)])).max()  # tan(Θ / 2)
    middle = centers.mean(0)
    apex = middle - APEX * np.linalg.norm(centers - middle, axis=1).max() / slope * n
    distances = np.linalg.norm(points - apex, axis=1)
    near, far = distances.min(), FAR * distances.max()
    deep, wide, turn = rng.random((3, count))
    depth = near + np.cbrt(deep) * (far - near)
    radius, angle = np.sqrt(wide) * depth * slope, 2 * np.pi * turn
    across, up = _across(n)
    return apex + depth[:, None] * n + radius[:, None] * (
        np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * up
    )  # fmt: skip


def _across(n: Array) -> tuple[Array, Array]:
    """Two unit vectors that are perpendicular to the unit vector n and to each other."""
    across = np.cross(n, np.eye(3)[np.abs(n).argmin()])
    across /= np.linalg.norm(across)
    return across, np.cross(n, across)
