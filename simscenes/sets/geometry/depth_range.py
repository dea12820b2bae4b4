"""How near and how far the views of a set look: from depth, where a set has it, else from its sparse points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simscenes.rigs import Rig
from simscenes.sets.geometry.tracks import SparsePoints
from simscenes.sets.multiview import MultiviewSet

PIXELS = 4096  # of a view are kept to count values outside a range
STRAYS = (0.001, 0.999)  # quantiles that bound a view for LLFF

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Depths:
    """z-depth and distance from the camera of each view's surfaces, evenly chosen [n_i] each, and all views' extremes.

    Attributes:
        z: Of each view.
        distance: Likewise, of the same pixels or points.
        nearest: Smallest z.
        farthest: Largest distance.
        center: Of the scene [3]: the middle of the box of its points without strays.
    """

    z: list[Float]
    distance: list[Float]
    nearest: float
    farthest: float
    center: Float

    @staticmethod
    def of(views: MultiviewSet, truth: MultiviewSet | None = None) -> Depths:
        """The depths of a set, or of a capture and the rendered set that it was made from.

        Raises:
            ValueError: As `of_points`.
        """
        return Depths.of_points(views, views.points(), truth)

    @staticmethod
    def of_points(views: MultiviewSet, points: SparsePoints | None, truth: MultiviewSet | None = None) -> Depths:
        """Likewise with the points given, as before a capture is there: `views` are the views of the set, at its size.

        Raises:
            ValueError: If the set has neither depth nor points, or a view sees nothing.
        """
        source = truth or views
        found = []
        for i in range(len(views)):
            geometry = source.geometry(i)
            if geometry is not None:
                seen = np.isfinite(geometry["z"])
                z, distance = (geometry[name][seen].astype(np.float64) for name in ("z", "distance"))
            elif points is not None:
                z, distance = _of_points(views.rig, points, i)
            else:
                raise ValueError(f"near and far of the views of {views.path} are not known: it has neither depth nor "
                                 "sparse points (sparse/0). Take a set that was rendered, or one with points: novags "
                                 "poses makes one of photographs")  # fmt: skip
            if len(z) == 0:
                raise ValueError(f"view {views.names[i]} of {views.path} sees no surface and no point: near and far "
                                 "of it are not known. Leave that view out, or use the set's own transforms.json"
                                 )  # fmt: skip
            found.append((z, distance))
        box = None if points is None or not len(points) else np.quantile(points.xyz, (0.02, 0.98), axis=0)
        step = [max(1, len(z) // PIXELS) for z, _ in found]
        return Depths(
            z=[z[::s] for (z, _), s in zip(found, step, strict=True)],
            distance=[d[::s] for (_, d), s in zip(found, step, strict=True)],
            nearest=min(float(z.min()) for z, _ in found), farthest=max(float(d.max()) for _, d in found),
            center=np.zeros(3) if box is None else box.mean(0),
        )  # fmt: skip

    def bounds(self, i: int) -> tuple[float, float]:
        """Smallest and largest z of view `i` without strays."""
        near, far = np.quantile(self.z[i], STRAYS)
        return float(near), float(far)

    def fit(self, near: float, far: float) -> tuple[float, Float, float]:
        """The scale that brings z and distances between `near` and `far`, the centre, and the share left outside."""
        if self.farthest / self.nearest <= far / near:
            return float(np.sqrt(near * far / (self.nearest * self.farthest))), self.center, 0.0
        scales = np.geomspace(near / self._all[0].max(), far / self._all[1].min(), 400)
        shares = [np.mean((self._all[0] * s < near) | (self._all[1] * s > far)) for s in scales]
        best = np.flatnonzero(shares == np.min(shares))
        middle = best[len(best) // 2]
        return float(scales[middle]), self.center, max(float(shares[middle]), 1e-9)  # a stray may not be in the sample

    @cached_property
    def _all(self) -> tuple[Float, Float]:
        return np.concatenate(self.z), np.concatenate(self.distance)


def _of_points(rig: Rig, points: SparsePoints, i: int) -> tuple[Float, Float]:
    """z-depth and distance of the points that view `i` has seen or, where that is unknown, that lie in its picture."""
    one = Rig(viewmats=rig.viewmats[i : i + 1], Ks=rig.Ks[i : i + 1], width=rig.width, height=rig.height)
    pixels, depths = (values[0] for values in one.project(points.xyz))
    inside = (depths > 0) & (pixels >= 0).all(-1) & (pixels <= (rig.width, rig.height)).all(-1)
    if len(points.view):
        seen = np.zeros(len(points), np.bool_)
        seen[points.point[points.view == i]] = True
        inside &= seen
    return depths[inside], np.linalg.norm(points.xyz[inside] - rig.positions[i], axis=-1)
