"""Sparse points on the true surface, with the views that see each: what structure from motion would have found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.rigs import Rig, invert_rigid

N_POINTS = 4000


def surface_points(
    rig: Rig,
    depths: Sequence[NDArray[Any]],
    image: Callable[[int], NDArray[np.uint8]],
    *,
    seed: int,
    n_points: int = N_POINTS,
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.bool_]]:
    """Draw surface points from the views' depth maps and test in which views they can be seen.

    Args:
        rig: The cameras.
        depths: z-depth of every view, [h,w], inf where there is no surface.
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
    for i, z in enumerate(depths):
        surface = np.flatnonzero(np.isfinite(z).ravel())
        chosen = rng.permutation(surface)[:share]
        positions.append(unproject(rig, i, z, chosen))
        colors.append(image(i).reshape(-1, 3)[chosen])
    xyz, rgb = np.concatenate(positions), np.concatenate(colors)
    visible = _visibility(rig, depths, xyz)
    kept = np.flatnonzero(visible.sum(0) >= min(2, len(rig)))
    kept = np.sort(rng.permutation(kept)[:n_points])
    return xyz[kept], rgb[kept], visible[:, kept]


def unproject(rig: Rig, i: int, z: NDArray[Any], pixels: NDArray[np.intp]) -> NDArray[np.float64]:
    """World points [n,3] of some pixels (flat indices) of view `i`, from its z-depth [h,w]."""
    y, x = np.divmod(pixels, rig.width)
    K, depth = rig.Ks[i], z.ravel()[pixels].astype(np.float64)
    local = np.stack([(x + 0.5 - K[0, 2]) / K[0, 0] * depth, (y + 0.5 - K[1, 2]) / K[1, 1] * depth, depth], -1)
    c2w = invert_rigid(rig.viewmats[i])
    return local @ c2w[:3, :3].T + c2w[:3, 3]


def _visibility(rig: Rig, depths: Sequence[NDArray[Any]], xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """A point is seen where it lies in front of, or within 1 % of, the depth of the pixel it projects to."""
    pixels, z = rig.project(xyz)
    visible = np.zeros(z.shape, dtype=bool)
    for c, depth in enumerate(depths):
        inside = (z[c] > 0) & (pixels[c] >= 0).all(-1) & (pixels[c] < (rig.width, rig.height)).all(-1)
        x, y = np.floor(pixels[c, inside]).astype(int).T
        # 1 %: the point lies up to half a pixel from the centre whose depth is stored, on a possibly slanted surface.
        visible[c, inside] = z[c, inside] <= 1.01 * depth[y, x]
    return visible
