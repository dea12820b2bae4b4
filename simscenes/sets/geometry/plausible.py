"""Which views see a point for which no features were matched: tracks that are tested, since none were measured.

Where there is depth, it decides. In photographs a view counts if the point lies inside the picture, no other point
hides it (hidden point removal, Katz, Tal and Basri 2007) and the picture shows its colour there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simscenes.sets.geometry.correspondence import seen_in
from simscenes.sets.geometry.tracks import SparsePoints, in_frame
from simscenes.sets.multiview import MultiviewSet

# Measured against the depth of tabletop and cornell, 4000 points, 16 views: of the observations inside the picture 82 %
# and 91 % are true, of the passing ones 98 % and 100 %. The passing ones are 86 % and 90 % of all true ones.
FLIP = 100.0  # radius of the spherical flip in distances of the farthest point; 1000 is 92 % and 98 % right
COLOR_TOLERANCE = 0.15  # sRGB codes of 0..1; noise and gloss stay below, another surface mostly does not


def with_tested_tracks(views: MultiviewSet, points: SparsePoints) -> SparsePoints:
    """The points with an observation in every view that passes the test; their reprojection error stays unknown.

    Args:
        views: The set, its depths where it has them, else its pictures.
        points: In the frame of the set. Their own observations are not looked at.
    """
    pixels, depths = views.rig.project(points.xyz)
    visible = in_frame(views.rig, pixels, depths)
    shown = False
    for i in range(len(views)):
        if (geometry := views.geometry(i)) is not None:
            visible[i] &= seen_in(views.rig, pixels[i], depths[i], geometry["z"])
        else:
            visible[i] &= not_hidden(points.xyz, views.rig.positions[i])
            shown = True
    if shown:
        visible &= shows_its_color(views, points, pixels, visible)
    return SparsePoints.seen(views.rig, points.xyz, points.rgb, visible, exact=False)


def not_hidden(xyz: NDArray[np.float64], eye: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points [P,3] of a surface can be seen from `eye` [3]: the points on the hull of their spherical flip."""
    from scipy.spatial import ConvexHull, QhullError  # a list of presets imports this module, and computes nothing

    rays = xyz - eye
    distance = np.linalg.norm(rays, axis=1, keepdims=True)
    # A point in the eye itself has no direction; any will do, for it is in no picture.
    distance = np.maximum(distance, 1e-12 * max(distance.max(initial=0.0), 1e-300))
    flipped = rays * (2 * FLIP * distance.max(initial=0.0) / distance - 1)
    seen = np.ones(len(xyz) + 1, bool)
    try:
        hull = ConvexHull(np.concatenate([flipped, np.zeros((1, 3))]))
    except (QhullError, ValueError):  # fewer than four points, or all in one plane with the eye: nothing hides
        return seen[:-1]
    seen[:] = False
    seen[hull.vertices] = True
    return seen[:-1]


def shows_its_color(
    views: MultiviewSet, points: SparsePoints, pixels: NDArray[np.float64], candidates: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Where a point's neighbourhood in the picture has the colour that most of its candidate views show [C,P]."""
    import cv2

    shown = np.full((*candidates.shape, 3), np.nan)
    for i, chosen in enumerate(candidates):
        picture = cv2.blur(views.image(i).astype(np.float64) / 255, (3, 3))  # positions are good to a pixel or so
        x, y = np.floor(pixels[i, chosen]).astype(int).T
        shown[i, chosen] = picture[y, x]
    some = candidates.any(0)
    usual = np.full((len(points), 3), np.nan)
    usual[some] = np.nanmedian(shown[:, some], axis=0)
    with np.errstate(invalid="ignore"):
        return np.abs(shown - usual).max(-1) <= COLOR_TOLERANCE
