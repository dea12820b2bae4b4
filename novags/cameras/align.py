"""Estimated cameras against the true ones: the similarity between their frames, and the remaining errors.

Naming law: X_true = scale * rotation @ X_estimated + translation. All tensors are float64 on the CPU.

A camera's error is sqrt(angle² + (distance / extent)²): the angle of its rotation error in radians and the distance
of its centre in units of the true scene extent, weighted alike. Rotations are included because centres alone leave the
rotation about a line of cameras undetermined, as with any two cameras.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import torch
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate, centers_of, extent_of
from novags.cameras.points import inside, project

HYPOTHESES = 2000  # pairs of cameras to try at most: with 30 % outliers half of all pairs are good
INLIER_SIGMAS = 3.0  # robust standard deviations within which a camera counts as an inlier
FLOOR = 1e-7  # rounding error: without it exact cameras among outliers would not count as inliers of each other


@dataclass(frozen=True)
class Similarity:
    """X_true = scale * rotation @ X_estimated + translation.

    Attributes:
        scale: > 0.
        rotation: [3, 3] float64.
        translation: [3] float64.
    """

    scale: float
    rotation: Tensor
    translation: Tensor

    def apply(self, points: Tensor) -> Tensor:
        """Points [..., 3] of the estimated frame in the true one."""
        return self.scale * points.double() @ self.rotation.mT + self.translation

    def inverse(self) -> "Similarity":
        """From the true frame to the estimated one."""
        back = self.rotation.mT
        return Similarity(1 / self.scale, back, -(back @ self.translation) / self.scale)

    def __matmul__(self, first: "Similarity") -> "Similarity":
        """`first`, then this one."""
        return Similarity(
            self.scale * first.scale, self.rotation @ first.rotation, self.apply(first.translation[None])[0]
        )


IDENTITY = Similarity(1.0, torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """The similarity and the errors that remain after it.

    Attributes:
        similarity: From the estimated to the true frame.
        rotation_deg: [R], angle between each aligned camera and the true one.
        centre_error: [R], distance between their centres in true scene extents.
        inliers: [R] bool, the cameras that the similarity was fitted to.
    """

    similarity: Similarity
    rotation_deg: Tensor = field(repr=False)
    centre_error: Tensor = field(repr=False)
    inliers: Tensor = field(repr=False)


def to_estimated(similarity: Similarity, viewmats_true: Tensor) -> Tensor:
    """True cameras [..., 4, 4] in the estimated frame: rigid, and seeing the same picture of the scaled scene."""
    result = viewmats_true.double().clone()
    turned = result[..., :3, :3] @ similarity.rotation
    result[..., :3, 3] = (result[..., :3, :3] @ similarity.translation + result[..., :3, 3]) / similarity.scale
    result[..., :3, :3] = turned
    return result


def to_true(similarity: Similarity, viewmats_estimated: Tensor) -> Tensor:
    """Estimated cameras [..., 4, 4] in the true frame, rigid."""
    return to_estimated(similarity.inverse(), viewmats_estimated)


def align(viewmats_estimated: Tensor, viewmats_true: Tensor) -> Alignment:
    """The similarity that brings most cameras close to the true ones, regardless of the others.

    The pair of cameras whose similarity has the least median error over all cameras (least median of squares, so up to
    half of the cameras may be wrong) determines the inliers; rotation, scale and translation are then fitted to these.
    Deterministic. Equal cameras give the exact identity.

    Args:
        viewmats_estimated: [R, 4, 4], rigid.
        viewmats_true: [R, 4, 4], rigid, the same views.

    Raises:
        ValueError: For other shapes, values that are not finite, fewer than 2 cameras, or cameras that all stand at one
            point, which leave the scale open.
    """
    shape = viewmats_estimated.shape
    if shape != viewmats_true.shape or shape[1:] != (4, 4) or len(shape) != 3 or len(viewmats_true) < 2:
        raise ValueError(
            "aligning needs the same 2 or more cameras, [R, 4, 4] each, estimated and true; got "
            f"{list(shape)} and {list(viewmats_true.shape)}"
        )
    if not (torch.isfinite(viewmats_estimated).all() and torch.isfinite(viewmats_true).all()):
        raise ValueError("aligning needs finite cameras: leave out views that the camera source failed on")
    if torch.equal(viewmats_estimated, viewmats_true):
        zeros = torch.zeros(len(viewmats_true), dtype=torch.float64)
        return Alignment(similarity=IDENTITY, rotation_deg=zeros, centre_error=zeros, inliers=zeros == 0)
    estimated, true = (v.detach().cpu().double().numpy() for v in (viewmats_estimated, viewmats_true))
    for name, viewmats in (("estimated", estimated), ("true", true)):
        centers = centers_of(viewmats)
        # Below rounding of the coordinates, distances between centres are noise, and so would be the scale.
        if np.ptp(centers, axis=0).max() <= 1e-9 * max(1.0, np.abs(centers).max()):
            raise ValueError(f"the {name} cameras all stand at one point, which leaves the scale open: no alignment")
    extent = extent_of(true)
    fit, inliers = _robust(estimated, true, extent)
    angles, distances = fit.errors(estimated, true, extent)
    return Alignment(
        similarity=Similarity(
            float(fit.scales[0]), torch.from_numpy(fit.rotations[0]), torch.from_numpy(fit.translations[0])
        ),
        rotation_deg=torch.from_numpy(np.degrees(angles[0])),
        centre_error=torch.from_numpy(distances[0]),
        inliers=torch.from_numpy(inliers),
    )


def depth_scale(
    estimate: CameraEstimate, similarity: Similarity, viewmats_true: Tensor, Ks: Tensor, depths: Tensor
) -> float:
    """Median, over points and views, of aligned over true depth: 1 where points lie on the surfaces they show.

    A point is compared in every registered view that has it in frame. Points that another surface hides there read as
    too deep; the median holds while they are fewer than half.

    Args:
        estimate: Its points.
        similarity: From its frame to the true one.
        viewmats_true: [R, 4, 4], the true cameras of the registered views.
        Ks: [R, 3, 3], the true intrinsics of these views.
        depths: [R, h, w], true z-depths, inf in front of empty space.

    Returns:
        NaN if no point falls on a surface.
    """
    ratios = depth_ratios(estimate, similarity, viewmats_true, Ks, depths)
    return float(np.median(ratios)) if len(ratios) else math.nan


def depth_ratios(
    estimate: CameraEstimate, similarity: Similarity, viewmats_true: Tensor, Ks: Tensor, depths: Tensor
) -> Array:
    """Aligned over true depth of every point in every view that has it in frame, [n]; arguments as `depth_scale`."""
    points = similarity.apply(estimate.points).numpy()
    found = [np.empty(0)]
    for viewmat, K, depth in zip(viewmats_true.double().numpy(), Ks.double().numpy(), depths.numpy(), strict=True):
        pixels, z = project(points, viewmat, K)
        chosen = inside(pixels, *depth.shape)
        x, y = pixels[chosen].astype(int).T
        with np.errstate(divide="ignore"):
            ratio = z[chosen] / depth[y, x]
        found.append(ratio[np.isfinite(ratio) & (ratio > 0)])
    return np.concatenate(found)


def angles_between(one: Array, other: Array) -> Array:
    """Angles of the rotations between rotations [..., 3, 3], radians."""
    # |R - Q| = 2 sqrt(2) sin(angle / 2): exact for small angles, where the arc cosine of the trace is not.
    chord = np.linalg.norm(one - other, axis=(-2, -1)) / math.sqrt(8)
    return np.asarray(2 * np.arcsin(np.minimum(chord, 1)))


def pair_errors(viewmats_estimated: Array, viewmats_true: Array, registered: Sequence[int]) -> tuple[Array, Array]:
    """Errors of the relative poses of all pairs of views, degrees: of the rotation [P], of the direction of the
    translation [P'].

    Both are infinite for a pair of which a view has no camera. A direction and its opposite differ by 180 degrees: the
    benchmarks of networks that take them for one let a mirrored answer pass. Pairs whose true cameras stand at one
    place have no direction and are left out of P'.

    Args:
        viewmats_estimated: [R, 4, 4], in any frame, at any scale.
        viewmats_true: [C, 4, 4], of all views that were asked for.
        registered: The place of each estimated camera among these.
    """
    place = {view: k for k, view in enumerate(registered)}
    extent = extent_of(viewmats_true)
    turns, directions = list[float](), list[float]()
    for i, j in combinations(range(len(viewmats_true)), 2):
        true = viewmats_true[j] @ np.linalg.inv(viewmats_true[i])
        # Between closer cameras rounding makes the direction.
        moves = float(np.linalg.norm(true[:3, 3])) > 1e-9 * extent
        if i not in place or j not in place:
            turns.append(math.inf)
            directions += [math.inf] * moves
            continue
        found = viewmats_estimated[place[j]] @ np.linalg.inv(viewmats_estimated[place[i]])
        turns.append(math.degrees(angles_between(found[:3, :3], true[:3, :3])))
        if moves:
            a, b = found[:3, 3], true[:3, 3]
            angle = math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b)) if a.any() else math.pi
            directions.append(math.degrees(angle))
    return np.array(turns), np.array(directions)


def auc(errors: Array, threshold: float) -> float:
    """Area under the share of errors below t, over t from 0 to `threshold`, 1 at best; nan of none.

    The exact area of the steps; benchmarks that sum over bins, or draw lines between errors, differ a little.
    """
    return float(np.clip(1 - errors / threshold, 0, 1).mean()) if len(errors) else math.nan


def left_apart(moved: Array, fixed: Array) -> float:
    """Root mean square distance of points [n, 3] to others after the similarity of least squares (Umeyama 1991)."""
    a, b = moved - moved.mean(0), fixed - fixed.mean(0)
    U, s, Vt = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])  # a reflection is not a rotation
    squares = float((a**2).sum())
    scale = float((s * signs).sum()) / squares if squares > 0 else 0.0  # all at one point: every scale is as good
    return float(np.sqrt(((b - scale * a @ ((U * signs) @ Vt).T) ** 2).sum(1).mean()))


def trajectory_error(viewmats_estimated: Array, viewmats_true: Array) -> float:
    """`left_apart` of the centres of cameras [R, 4, 4], in extents of the true ones; rotations have no say."""
    return left_apart(centers_of(viewmats_estimated), centers_of(viewmats_true)) / extent_of(viewmats_true)


@dataclass(frozen=True)
class _Fits:
    """Many similarities at once: scales [H], rotations [H, 3, 3], translations [H, 3]."""

    scales: Array
    rotations: Array
    translations: Array

    def errors(self, estimated: Array, true: Array, extent: float) -> tuple[Array, Array]:
        """Angles [H, R] in radians and distances of the centres [H, R] in extents, for cameras [R, 4, 4]."""
        turned = estimated[None, :, :3, :3] @ self.rotations.transpose(0, 2, 1)[:, None]
        angles = angles_between(turned, true[:, :3, :3])
        centers = self.scales[:, None, None] * (centers_of(estimated) @ self.rotations.transpose(0, 2, 1))
        distances = np.linalg.norm(centers + self.translations[:, None] - centers_of(true), axis=-1)
        return angles, distances / extent


def _robust(estimated: Array, true: Array, extent: float) -> tuple[_Fits, np.ndarray]:
    """The fitted similarity, alone in its `_Fits`, and its inliers [R]."""
    count = len(true)
    pairs = _pairs(count)
    baselines = np.linalg.norm(np.diff(centers_of(estimated)[pairs], axis=1)[:, 0], axis=-1)
    # A pair at one point has no scale. Others with a tiny baseline have a bad one, which their median error shows.
    pairs = pairs[baselines > 1e-9 * baselines.max()]
    candidates = _fit(estimated[pairs], true[pairs], extent)
    medians = np.median(np.hypot(*candidates.errors(estimated, true, extent)), axis=1)
    chosen = pairs[int(np.argmin(medians))]
    best = _fit(estimated[chosen][None], true[chosen][None], extent)
    for _ in range(5):  # it converges after two or three
        errors = np.hypot(*best.errors(estimated, true, extent))[0]
        # 1.4826 median = standard deviation of a normal; the factor for few cameras is Rousseeuw's (1987).
        spread = 1.4826 * (1 + 5 / max(count - 2, 1)) * float(np.median(errors))
        inliers = errors <= max(INLIER_SIGMAS * spread, FLOOR)
        best = _fit(estimated[inliers][None], true[inliers][None], extent)
    return best, inliers


def _pairs(count: int) -> np.ndarray:
    """Pairs of cameras [H, 2]: all, or a fixed choice of `HYPOTHESES`."""
    pairs = np.array(list(combinations(range(count), 2)))
    if len(pairs) <= HYPOTHESES:
        return pairs
    return pairs[np.sort(np.random.default_rng(0).choice(len(pairs), HYPOTHESES, replace=False))]


def _fit(estimated: Array, true: Array, extent: float) -> _Fits:
    """Least squares of the error over the cameras of each group, [H, G, 4, 4].

    For a given scale s the rotation maximises trace(R^T (2 s A / extent² + B)), where A = sum of true times estimated
    centres about their means and B = sum of R_true^T R_estimated (|R - Q|² = 2 angle² for small angles); for a given
    rotation s = trace(R^T A) / sum of squared estimated centres (Umeyama 1991). The two alternate.
    """
    groups, size = estimated.shape[:2]
    ce, ct = (centers_of(v.reshape(-1, 4, 4)).reshape(groups, size, 3) for v in (estimated, true))
    mean_e, mean_t = ce.mean(1), ct.mean(1)
    ce, ct = ce - mean_e[:, None], ct - mean_t[:, None]
    A, squares = ct.transpose(0, 2, 1) @ ce, (ce**2).sum((1, 2))
    B = np.einsum("hkji,hkjl->hil", true[..., :3, :3], estimated[..., :3, :3])
    # From the spreads alone: if centres and rotations contradict each other, the other formula may turn negative.
    scales = first = np.sqrt((ct**2).sum((1, 2)) / squares)
    for _ in range(10):
        rotations = _nearest_rotations(2 * scales[:, None, None] * A / extent**2 + B)
        scales = (rotations * A).sum((1, 2)) / squares
        scales = np.where(scales > 0, scales, first)
    translations = mean_t - scales[:, None] * np.einsum("hij,hj->hi", rotations, mean_e)
    return _Fits(scales, rotations, translations)


def _nearest_rotations(matrices: Array) -> Array:
    """The rotations R that maximise trace(R^T M), for matrices M [H, 3, 3]."""
    U, _, Vt = np.linalg.svd(matrices)
    signs = np.ones((len(matrices), 3))
    signs[:, 2] = np.sign(np.linalg.det(U @ Vt))
    return (U * signs[:, None]) @ Vt
