"""Where the points one view sees appear in another: optical flow of a static scene, from depth and cameras alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.multiview import MultiviewSet
from simscenes.rigs import Rig, unproject

DEPTH_TOLERANCE = 0.01  # relative; a point lies up to half a pixel from the centre whose depth is stored


@dataclass(frozen=True)
class Flow:
    """Flow from one view to another.

    Attributes:
        displacement: How far each pixel centre's point moves, pixels (x, y), float32 [h,w,2]; nan without a surface.
        visible: Whether the other view sees that point: inside its image and hidden by nothing, bool [h,w].
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
    pixels, depth = rig.project(unproject(rig, i, z_i, surface))
    displacement = np.full((h * w, 2), np.nan, dtype=np.float32)
    y, x = np.divmod(surface, w)
    displacement[surface] = pixels[j] - np.stack([x + 0.5, y + 0.5], -1)
    visible = np.zeros(h * w, dtype=bool)
    visible[surface] = seen_in(rig, pixels[j], depth[j], z_j)
    return Flow(displacement.reshape(h, w, 2), visible.reshape(h, w))


def seen_in(rig: Rig, pixels: NDArray[Any], depth: NDArray[Any], z: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether points that project to `pixels` [n,2] at `depth` [n] are in front of what a z-depth [h,w] shows."""
    inside = (depth > 0) & (pixels >= 0).all(-1) & (pixels < (rig.width, rig.height)).all(-1)
    x, y = np.floor(pixels[inside]).astype(int).T
    seen = np.zeros(len(pixels), dtype=bool)
    seen[inside] = depth[inside] <= (1 + DEPTH_TOLERANCE) * z[y, x]
    return seen
