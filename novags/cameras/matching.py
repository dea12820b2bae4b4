"""Whether pictures show what their cameras say: points that two of them share lie on each other's epipolar lines.

Axes of another convention, poses of other pictures and pictures that were turned give valid cameras and a useless fit.
What is matched here needs no camera: SIFT, and the one geometry that most matches of a pair agree on.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from novags.cameras.estimate import Array
from novags.cameras.sweep import neighbours
from sensor_model.files.reading import some

SIDE = 320  # px, longest side of what is compared
FEATURES, RATIO = 500, 0.8  # the largest ones; distance of the best match over that of the second, by Lowe
ROBUST = 0.005  # of the diagonal: from the epipolar line of the geometry that most matches agree on
MATCHED = 30  # matches that agree with each other, of a pair that counts
LOOKED_AT, EACH = 16, 2  # views, and other views that each is compared with
PAIRS = 3  # fewer say nothing of all cameras
# Median distance from the line of the cameras, of the diagonal. Measured: right cameras up to .0012, wrong from .0045.
OFF, OFF_ONE = 0.0025, 0.01
FOCALS = (0.5, 0.6, 0.7, 0.8, 1.0, 1.25, 1.4, 1.7, 2.0)  # times the stated focal length
BETTER = 2.0  # of two distances: with right focal lengths no other one measured shorter distances


def picture_doubts(
    names: Sequence[str], viewmats: Array, Ks: Array, picture: Callable[[int], NDArray[np.uint8]]
) -> list[str]:
    """In words what speaks against the cameras of pictures; [] if nothing does, or too little can be matched.

    Args:
        names: Of the views.
        viewmats: World to camera [C,4,4].
        Ks: Intrinsics of the pictures [C,3,3].
        picture: The picture of a view, [h,w,3].
    """

    @cache
    def features(i: int) -> tuple[Array, Any, Array, float]:
        return _features(picture(i), Ks[i])

    stated = FOCALS.index(1.0)
    of_view = defaultdict[int, list[float]](list)
    pairs = []
    for i in np.unique(np.linspace(0, len(names) - 1, min(len(names), LOOKED_AT)).round().astype(int)).tolist():
        for j in neighbours(viewmats, i)[:EACH].tolist():
            off = _from_lines(features(i), features(j), viewmats[j] @ np.linalg.inv(viewmats[i]))
            if off is not None:
                pairs.append(off)
                of_view[i].append(off[stated])
                of_view[j].append(off[stated])
    if len(pairs) < PAIRS:
        return []
    usual = np.median(pairs, 0)
    best = int(usual.argmin())
    if usual[stated] > BETTER * usual[best] and usual[best] <= OFF:
        return [
            "pictures do not show what their cameras say: points that two of them share fit better with "
            f"{FOCALS[best]:g} times the focal length, {usual[best]:.2%} of the diagonal beside the cameras' lines, "
            f"{usual[stated]:.2%} as stated: it is probably of another size of the pictures, or of before a crop"
        ]
    if usual[stated] > OFF:
        return [
            "pictures do not show what their cameras say: points that two of them share lie "
            f"{usual[stated]:.2%} of the diagonal beside where the cameras see them, of at most {OFF:.2%}: axes are "
            "probably of another convention (transforms.json: camera to world, y up, z backwards), or pictures are "
            "turned, mirrored, cropped or of other names"
        ]
    odd = [names[i] for i, found in sorted(of_view.items()) if len(found) >= EACH and min(found) > OFF_ONE]
    return [] if not odd else [
        f"{len(odd)} of {len(of_view)} pictures that were looked at do not show what their cameras say: {some(odd)}; "
        "they are probably turned, or of another place"
    ]  # fmt: skip


def _features(picture: NDArray[np.uint8], K: Array) -> tuple[Array, Any, Array, float]:
    """Places [n,2] and descriptors of a picture, K and diagonal of what was looked at."""
    scale = min(1.0, SIDE / max(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA).mean(2)
    low, high = np.percentile(small, (1, 99))  # of a dark picture, too
    grey = np.clip((small - low) * 255 / max(high - low, 1), 0, 255).astype(np.uint8)
    keys, described = cv2.SIFT.create(FEATURES).detectAndCompute(grey, None)
    sides = np.array([grey.shape[1] / picture.shape[1], grey.shape[0] / picture.shape[0], 1])
    places = np.array([key.pt for key in keys], np.float64).reshape(-1, 2) + 0.5
    return places, described, K * sides[:, None], float(np.hypot(*grey.shape))


def _from_lines(one: Any, other: Any, relative: Array) -> Array | None:
    """Median distance of matches that agree with each other from the lines of the cameras, of the diagonal.

    Returns:
        For each of `FOCALS`; None: too few agree.
    """
    (here, described, K, diagonal), (there, others, K2, _) = one, other
    if min(len(here), len(there)) < MATCHED:
        return None
    found = cv2.BFMatcher().knnMatch(described, others, k=2)
    pairs = [(m.queryIdx, m.trainIdx) for m, second in found if m.distance < RATIO * second.distance]
    if len(pairs) < MATCHED:
        return None
    a, b = here[[i for i, _ in pairs]], there[[j for _, j in pairs]]
    _, agreed = cv2.findFundamentalMat(a, b, cv2.FM_RANSAC, ROBUST * diagonal, 0.99, 2000)
    kept = np.zeros(len(a), bool) if agreed is None else agreed.ravel().astype(bool)
    if kept.sum() < MATCHED:
        return None
    x, y, z = relative[:3, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ relative[:3, :3]
    a1, b1 = (np.column_stack([points[kept], np.ones(kept.sum())]) for points in (a, b))
    distances = []
    for focal in FOCALS:
        longer = np.diag([focal, focal, 1.0])
        F = np.linalg.inv(K2 @ longer).T @ essential @ np.linalg.inv(K @ longer)
        lines, back = a1 @ F.T, b1 @ F
        long = np.sqrt((lines[:, :2] ** 2).sum(1) + (back[:, :2] ** 2).sum(1))
        distances.append(np.median(np.abs((b1 * lines).sum(1)) / np.maximum(long, 1e-300)) / diagonal)
    return np.array(distances)
