"""Sparse points on the true surface, with the views that see each: the points that structure from motion would have
found.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.rigs import Rig, unproject
from simscenes.sets.geometry.correspondence import seen_in

N_POINTS = 4000


def surface_points(
    rig: Rig,
    depth: Callable[[int], NDArray[Any]],
    image: Callable[[int], NDArray[np.uint8]],
    *,
    seed: int,
    n_points: int = N_POINTS,
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.bool_]]:
    """Draw surface points from the views' depth maps and test in which views they can be seen.

    Args:
        rig: The cameras.
        depth: View index -> z-depth [h,w], inf where a ray hits nothing. Called twice for each view, so that only one
            map is in memory at a time.
        image: View index -> sRGB image uint8 [h,w,3], for the colours.
        seed: Seed of the draw.
        n_points: Points wanted; fewer come back if few are seen twice.

    Returns:
        Positions [P,3], colours [P,3] and visibility [C,P]; every point is seen by two views or more (by one if the rig
        has only one).
    """
    rng = np.random.default_rng([seed, 3])
    share = int(np.ceil(1.3 * n_points / len(rig)))
    positions, colors = [], []
    for i in range(len(rig)):
        chosen, xyz = _drawn(rig, i, depth(i), share, rng)
        positions.append(xyz)
        colors.append(image(i).reshape(-1, 3)[chosen])
    xyz, rgb = np.concatenate(positions), np.concatenate(colors)
    pixels, distance = rig.project(xyz)
    visible = np.stack([seen_in(rig, pixels[i], distance[i], depth(i)) for i in range(len(rig))])
    kept = np.flatnonzero(visible.sum(0) >= min(2, len(rig)))
    kept = np.sort(rng.permutation(kept)[:n_points])
    return xyz[kept], rgb[kept], visible[:, kept]


def _drawn(
    rig: Rig, i: int, z: NDArray[Any], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Up to `count` pixels of view `i` that show a surface, and where that is in the world [n,3]."""
    chosen = rng.permutation(np.flatnonzero(np.isfinite(z).ravel()))[:count]
    return chosen, unproject(rig, i, z, chosen)
