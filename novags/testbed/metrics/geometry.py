"""Scores of a method's expected depth against the true depth of a scene, and of its surface against a laser scan.

Depths are z-depths [h,w] in scene units, in the true cameras' scale: multiply a method's depth by the depth scale of
the camera alignment first. Where nothing is hit, a depth is 0, infinite or nan. Every score exists for every method
that renders image, opacity and expected depth.

Surfaces are scored as in the RealX3D benchmark (arXiv 2512.23437): both clouds thinned to 5 cm, means of the distances
to the nearest point of the other cloud, and the F-score within 5 cm. Its clouds are registered by ICP before, because
networks find their own cameras; cameras that are given need no registration, and a shift of the surface counts.
"""

from collections.abc import Iterable
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter

TOLERANCE = 0.05  # relative: depths within it are right, opacity nearer than 1 - TOLERANCE of the surface is in front
MIN_ALPHA = 0.5  # with less opacity than this, a pixel shows more background than surface and has no depth
NEAR = 0.05  # m: within it a point is right
SPACING = 0.05  # m: points of both clouds in a cube of this side become their mean

Points = NDArray[np.float64]


class GeometryScores(TypedDict):
    """Scores of one view's depth; None where no pixel can be judged."""

    abs_rel: float | None
    within_5_percent: float | None
    coverage: float | None
    floaters: float | None


def geometry_scores(depth: NDArray, alpha: NDArray, truth: NDArray) -> GeometryScores:
    """Compare the depth of one view with the truth, over the pixels in which the truth shows a surface.

    - `coverage`: share of these pixels with a rendered depth (opacity of at least `MIN_ALPHA`).
    - `abs_rel`: mean of |depth - truth| / truth over the covered ones.
    - `within_5_percent`: share with a rendered depth within `TOLERANCE` of the truth; a pixel without depth is a miss,
      so that leaving out difficult pixels does not pay.
    - `floaters`: mean opacity in front of the true surface, at least: see `opacity_in_front`. Not for a depth that
      halves the weight of a ray, as fields have: with half of it in front, such a ray counts by up to all its opacity.

    Args:
        depth: Expected depth sum(w d) / sum(w) over the ray, with w the blending weights, float [h,w].
        alpha: Opacity sum(w), 0..1, float [h,w].
        truth: True depth, float [h,w].

    Raises:
        ValueError: If shapes differ, a depth is negative, or an opacity lies outside 0..1.
    """
    _check(depth, alpha, truth)
    surface = _is_depth(truth)
    covered = surface & _is_depth(depth) & (alpha >= MIN_ALPHA)
    error = np.abs(depth[covered].astype(np.float64) / truth[covered] - 1.0)
    judged = int(surface.sum())
    front = opacity_in_front(depth, alpha, truth)[surface]
    return {
        "abs_rel": float(error.mean()) if covered.any() else None,
        "within_5_percent": float((error <= TOLERANCE).sum() / judged) if judged else None,
        "coverage": float(covered.sum() / judged) if judged else None,
        "floaters": float(front.mean()) if judged else None,
    }


def opacity_in_front(depth: NDArray, alpha: NDArray, truth: NDArray) -> NDArray[np.float64]:
    """Least opacity in front of the true surface that explains opacity and expected depth, float64 [h,w].

    "In front" is nearer than t = (1 - TOLERANCE) * the nearest true depth within one pixel (3 x 3): a splat is wider
    than a pixel, and at a silhouette its depth lies between the surfaces without floating anywhere.

    A ray's weights w at depths d satisfy alpha * (1 - depth / t) = sum(w (1 - d / t)). Terms beyond t are negative,
    terms in front at most w, so the left side bounds the opacity in front from below, for any distribution along the
    ray. The bound is reached by opacity at the camera and the rest at t; a sheet of opacity a at half of t counts a /
    2, so floaters weigh more the nearer they are. 0 where the truth or the method has no depth.
    """
    known = _is_depth(truth) & _is_depth(depth)
    nearest = minimum_filter(np.where(_is_depth(truth), truth, np.inf), size=3, mode="nearest")
    front = np.zeros(np.shape(truth))
    ratio = depth[known].astype(np.float64) / ((1.0 - TOLERANCE) * nearest[known])
    front[known] = alpha[known] * np.maximum(1.0 - ratio, 0.0)
    return front


def _is_depth(depth: NDArray) -> NDArray[np.bool_]:
    return np.isfinite(depth) & (depth > 0)


def _check(depth: NDArray, alpha: NDArray, truth: NDArray) -> None:
    if not depth.shape == alpha.shape == truth.shape or truth.ndim != 2:
        shapes = f"{depth.shape}, {alpha.shape} and {truth.shape}"
        raise ValueError(f"depth, alpha and true depth must all be [h, w] of one size, got {shapes}")
    for name, value in (("depth", depth), ("true depth", truth)):
        if (value < 0).any():
            raise ValueError(f"{name} must be >= 0 (0, inf or nan in front of empty space), got {np.nanmin(value):g}")
    # 1e-3: the float32 sum of many blending weights exceeds 1 by rounding.
    if not ((alpha >= 0) & (alpha <= 1 + 1e-3)).all():
        raise ValueError(f"alpha must lie in 0..1, got values from {np.min(alpha):g} to {np.max(alpha):g}")


class SurfaceScores(TypedDict):
    """Distances in metres and shares; None where one of the clouds is empty."""

    accuracy: float | None
    completeness: float | None
    f1: float | None


def thinned(points: Points, spacing: float = SPACING) -> Points:
    """The mean of the points [n,3] in each cube of side `spacing`, [m,3], in the order of the cubes."""
    if not len(points):
        return points
    _, cube, count = np.unique(np.floor(points / spacing).astype(np.int64), axis=0, return_inverse=True,
                               return_counts=True)  # fmt: skip
    cube = cube.reshape(-1)
    return np.stack([np.bincount(cube, points[:, k]) for k in range(3)], -1) / count[:, None]


def seen_points(depth: NDArray, alpha: NDArray, K: NDArray, viewmat: NDArray) -> Points:
    """The points [n,3] in the world that the z-depths of one view are of.

    Args:
        depth: z-depth [h,w] in the unit of the cameras; 0: none.
        alpha: Opacity [h,w].
        K: Intrinsics [3,3], pixel centres at +0.5.
        viewmat: World to camera [4,4].
    """
    there = np.isfinite(depth) & (depth > 0) & (alpha >= MIN_ALPHA)
    y, x = np.nonzero(there)
    z = depth[there].astype(np.float64)
    local = np.stack([(x + 0.5 - K[0, 2]) / K[0, 0] * z, (y + 0.5 - K[1, 2]) / K[1, 1] * z, z], -1)
    return np.asarray((local - viewmat[:3, 3]) @ viewmat[:3, :3], np.float64)


def surface_scores(views: Iterable[Points], scan: Points) -> SurfaceScores:
    """Compare the points of some views with the points of a scan, `thinned` both.

    - `accuracy`: mean distance of a point of the views to the scan.
    - `completeness`: mean distance of a point of the scan to the views.
    - `f1`: harmonic mean of the shares of both that are within `NEAR` of the other.

    Args:
        views: The points [n,3] of each view, m.
        scan: [m,3], m.
    """
    from scipy.spatial import cKDTree

    found, truth = thinned(np.concatenate([*views, np.zeros((0, 3))])), thinned(scan)
    if not (len(found) and len(truth)):
        return {"accuracy": None, "completeness": None, "f1": None}
    there, back = cKDTree(truth).query(found)[0], cKDTree(found).query(truth)[0]
    precision, recall = float((there <= NEAR).mean()), float((back <= NEAR).mean())
    both = precision + recall
    return {
        "accuracy": float(there.mean()),
        "completeness": float(back.mean()),
        "f1": 2 * precision * recall / both if both > 0 else 0.0,
    }
