"""Sparse points of a scene and their tracks: which views see each point, and at which pixels.

A track is measured (features that structure from motion matched), exact (the depth of a rendered set says who sees the
point) or tested (`plausible`: it was not measured). Only the first two have a reprojection error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simscenes.rigs import Rig

UNKNOWN = -1.0  # COLMAP's own mark of a point whose reprojection error nobody computed (`Point3D.has_error`)

Float = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SparsePoints:
    """Points and their observations.

    Attributes:
        xyz: World positions, float64 [P,3].
        rgb: Colours, uint8 [P,3].
        view: Index of the view of each observation, intp [O], increasing.
        point: Index of its point, intp [O].
        pixel: Where it was seen, float64 [O,2], pixels with centres at +0.5.
        error: Mean reprojection error of each point, pixels, float64 [P]; `UNKNOWN` where nothing was measured.

    Raises:
        ValueError: If shapes disagree or an observation is of no point.
    """

    xyz: Float
    rgb: NDArray[np.uint8]
    view: NDArray[np.intp]
    point: NDArray[np.intp]
    pixel: Float
    error: Float

    def __post_init__(self) -> None:
        count, seen = len(self.xyz), len(self.view)
        shapes = [a.shape for a in (self.xyz, self.rgb, self.error, self.view, self.point, self.pixel)]
        if shapes != [(count, 3), (count, 3), (count,), (seen,), (seen,), (seen, 2)]:
            raise ValueError("xyz, rgb, error, view, point, pixel must be [P,3], [P,3], [P], [O], [O], [O,2], got "
                             + ", ".join(str(list(s)) for s in shapes))  # fmt: skip
        if seen and not (0 <= self.point.min() and self.point.max() < count and (np.diff(self.view) >= 0).all()):
            raise ValueError(f"observations must be of points 0..{count - 1}, in the order of the views")

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def lengths(self) -> NDArray[np.intp]:
        """Number of observations of each point, [P]."""
        return np.bincount(self.point, minlength=len(self))

    @staticmethod
    def untracked(xyz: Any, rgb: Any) -> SparsePoints:
        """Points of which nobody said who sees them."""
        none = np.zeros(0, np.intp)
        return SparsePoints(
            xyz=np.asarray(xyz, np.float64), rgb=np.asarray(rgb, np.uint8), view=none, point=none,
            pixel=np.zeros((0, 2)), error=np.full(len(xyz), UNKNOWN),
        )  # fmt: skip

    @staticmethod
    def seen(rig: Rig, xyz: Any, rgb: Any, visible: NDArray[np.bool_], *, exact: bool) -> SparsePoints:
        """Points with an observation at their projection into every view that sees them.

        Args:
            rig: The cameras.
            xyz: [P,3].
            rgb: [P,3].
            visible: [C,P]; projections outside the picture do not count as observations.
            exact: Whether the points are known to lie there (a rendered surface): their error is then the rounding of
                the projections; otherwise it is unknown.
        """
        points = SparsePoints.untracked(xyz, rgb)
        pixels, depths = rig.project(points.xyz)
        view, point = np.nonzero(visible & in_frame(rig, pixels, depths))
        found = replace(points, view=view, point=point, pixel=pixels[view, point])
        return replace(found, error=reprojection_errors(rig, found)) if exact else found

    def about(self, origin: tuple[float, float, float]) -> SparsePoints:
        """The same points in a world whose zero lies at `origin` of this one."""
        return replace(self, xyz=self.xyz - origin) if any(origin) else self

    def at_size(self, rig: Rig, scaled: Rig) -> SparsePoints:
        """The same points in pictures of another size (`scaled`: the cameras of those), errors in their pixels.

        Observations that fall outside are dropped: rounding of the size may move the border by half a pixel.
        """
        if (rig.width, rig.height) == (scaled.width, scaled.height):
            return self
        factors = np.array([scaled.width / rig.width, scaled.height / rig.height])
        return self.observed(scaled, self.view, self.point, self.pixel * factors)

    def observed(self, rig: Rig, view: NDArray[np.intp], point: NDArray[np.intp], pixel: Float) -> SparsePoints:
        """The same points with these observations in pictures of these cameras.

        Errors are measured again, in those pixels and over the observations that remain, for all points that had one.
        """
        inside = np.isfinite(pixel).all(-1) & ((pixel >= 0) & (pixel < (rig.width, rig.height))).all(-1)
        kept = np.flatnonzero(inside)
        order = kept[np.argsort(view[kept], kind="stable")]
        found = replace(self, view=view[order], point=point[order], pixel=pixel[order])
        return replace(found, error=np.where(self.error == UNKNOWN, UNKNOWN, reprojection_errors(rig, found)))


def in_frame(rig: Rig, pixels: Float, depths: Float) -> NDArray[np.bool_]:
    """Which projections (pixels [...,2] at z-depths [...]) lie in front of the camera and inside the picture."""
    return (depths > 0) & (pixels >= 0).all(-1) & (pixels < (rig.width, rig.height)).all(-1)


def reprojection_errors(rig: Rig, points: SparsePoints) -> Float:
    """Mean distance between observations and projections of each point [P], pixels; `UNKNOWN` without observations.

    As COLMAP defines it (`Reconstruction::UpdatePoint3DErrors`).
    """
    total = np.zeros(len(points))
    for i in range(len(rig)):
        mine = slice(*np.searchsorted(points.view, [i, i + 1]))
        point = points.point[mine]
        with np.errstate(all="ignore"):  # points of 1e300 and points in a camera's plane, see below
            camera = points.xyz[point] @ rig.viewmats[i, :3, :3].T + rig.viewmats[i, :3, 3]
            projected = (camera @ rig.Ks[i].T)[:, :2] / camera[:, 2:]
            np.add.at(total, point, np.linalg.norm(projected - points.pixel[mine], axis=1))
    lengths = points.lengths
    # A point in the plane of a camera that is said to see it projects nowhere: its error is unknown.
    return np.where((lengths > 0) & np.isfinite(total), total / np.maximum(lengths, 1), UNKNOWN)
