"""Where the points one view sees appear in another: optical flow of a static scene, from depth and cameras alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.rigs import Rig, unproject
from simscenes.sets.multiview import MultiviewSet

DEPTH_TOLERANCE = 0.01  # relative; surfaces bend between the pixel centres whose depth is stored


@dataclass(frozen=True)
class Flow:
    """Flow from one view to another.

    Attributes:
        displacement: How far each pixel centre's point moves, pixels (x, y), float32 [h,w,2]; nan without a surface.
        visible: Whether the other view sees that point: inside its image and not occluded, bool [h,w].
    """

    displacement: NDArray[np.float32]
    visible: NDArray[np.bool_]


def flow(views: MultiviewSet, i: int, j: int) -> Flow:
    """Exact flow from view `i` to view `j` of a rendered set.

    Raises:
        ValueError: If the set has no depth.
    """
    here, there = views.geometry(i), views.geometry(j)
    if here is None or there is None:
        raise ValueError(f"flow needs depth, which {views.path} does not have: it holds photographs")
    return flow_from_depth(views.rig, i, j, here["z"], there["z"])


def flow_from_depth(rig: Rig, i: int, j: int, z_i: NDArray[Any], z_j: NDArray[Any]) -> Flow:
    """As `flow`, from the z-depths [h,w] of both views."""
    h, w = z_i.shape
    surface = np.flatnonzero(np.isfinite(z_i).ravel())
    other = Rig(viewmats=rig.viewmats[j : j + 1], Ks=rig.Ks[j : j + 1], width=rig.width, height=rig.height)
    (pixels,), (depth,) = other.project(unproject(rig, i, z_i, surface))
    displacement = np.full((h * w, 2), np.nan, dtype=np.float32)
    y, x = np.divmod(surface, w)
    displacement[surface] = pixels - np.stack([x + 0.5, y + 0.5], -1)
    visible = np.zeros(h * w, dtype=bool)
    visible[surface] = seen_in(rig, pixels, depth, z_j)
    return Flow(displacement.reshape(h, w, 2), visible.reshape(h, w))


def seen_in(rig: Rig, pixels: NDArray[Any], depth: NDArray[Any], z: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether points that project to `pixels` [n,2] at `depth` [n] are in front of the surface of a z-depth [h,w]."""
    inside = (depth > 0) & (pixels >= 0).all(-1) & (pixels < (rig.width, rig.height)).all(-1)
    place = pixels[inside]
    x, y = np.floor(place).astype(int).T
    shown = np.maximum(z[y, x], _interpolated(z, place))
    seen = np.zeros(len(pixels), dtype=bool)
    seen[inside] = depth[inside] <= (1 + DEPTH_TOLERANCE) * shown
    return seen


def _interpolated(z: NDArray[Any], place: NDArray[Any]) -> NDArray[np.float64]:
    """Depth between pixel centres: 1/z is linear over the image of a plane, however slanted; 0 where that fails."""
    h, w = z.shape
    if h < 2 or w < 2:
        return np.zeros(len(place))
    corner = np.clip(np.floor(place - 0.5).astype(int), 0, (w - 2, h - 2))
    fx, fy = (place - 0.5 - corner).T  # outside 0..1 in the outer half of border pixels: the plane continues
    x, y = corner.T
    inverse = 1.0 / z.astype(np.float64)
    upper = (1 - fx) * inverse[y, x] + fx * inverse[y, x + 1]
    lower = (1 - fx) * inverse[y + 1, x] + fx * inverse[y + 1, x + 1]
    between = (1 - fy) * upper + fy * lower
    return np.where(between > 0, 1.0 / np.where(between > 0, between, 1.0), 0.0)
