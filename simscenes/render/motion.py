"""Cameras that move while they expose: poses within an exposure, and how far the picture moves meanwhile."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.rigs import Rig, invert_rigid, unproject

ENDLESS = 1e6  # steps of the camera, from where on a point is as good as infinitely far


def moved_pose(rig: Rig, i: int, t: float) -> NDArray[np.float64]:
    """World-to-camera pose of view `i` at time `t`, in steps to its neighbours: -1 is the one before, 1 the one after.

    Positions move on straight lines, orientations rotate evenly; past the ends of the rig the last step continues.
    """
    from scipy.spatial.transform import Rotation

    j = i + (1 if t >= 0 else -1)
    t = abs(t)
    if not 0 <= j < len(rig):
        j, t = 2 * i - j, -t
    if t == 0 or not 0 <= j < len(rig):
        return rig.viewmats[i]
    here, there = (invert_rigid(rig.viewmats[k]) for k in (i, j))
    turn = Rotation.from_matrix(there[:3, :3] @ here[:3, :3].T).as_rotvec()
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(t * turn).as_matrix() @ here[:3, :3]
    pose[:3, 3] = here[:3, 3] + t * (there[:3, 3] - here[:3, 3])
    return invert_rigid(pose)


def subframe_rig(rig: Rig, i: int, motion: float, count: int) -> Rig:
    """The poses of one exposure: `count` midpoints of equal parts of the time from -motion/2 to motion/2."""
    times = motion * ((np.arange(count) + 0.5) / count - 0.5)
    viewmats = np.stack([moved_pose(rig, i, float(t)) for t in times])
    return Rig(viewmats=viewmats, Ks=np.repeat(rig.Ks[i : i + 1], count, 0), width=rig.width, height=rig.height)


def image_motion(geometry: list[dict[str, Any]], rig: Rig, small: Rig, motion: float, sky: bool) -> float:
    """Distance that visible points travel over the small images during an exposure, 95th percentile, pixels.

    Args:
        geometry: Channels of the small views.
        rig: The whole rig, whose neighbours give the motion.
        small: The views of `geometry`, a subset of `rig` by pose.
        motion: As in `Optics`.
        sky: Whether pixels without a surface show something: it lies at infinity. Else they do not count.
    """
    travelled = []
    for c, channels in enumerate(geometry):
        i = int(np.abs(rig.viewmats - small.viewmats[c]).sum((1, 2)).argmin())
        ends = np.stack([moved_pose(rig, i, s * motion / 2) for s in (-1, 1)])
        pair = Rig(viewmats=ends, Ks=np.repeat(small.Ks[c : c + 1], 2, 0), width=small.width, height=small.height)
        z, pixels = channels["Z"].astype(np.float64), np.arange(channels["Z"].size)
        if sky:
            z[np.isinf(z)] = max(ENDLESS * np.ptp(pair.positions, axis=0).max(), 1.0)
        points = unproject(small, c, z, pixels[np.isfinite(z).ravel()])
        seen, _ = pair.project(points)
        travelled.append(np.linalg.norm(seen[1] - seen[0], axis=1))
    moved = np.concatenate(travelled)
    return float(np.quantile(moved, 0.95)) if moved.size else 0.0
