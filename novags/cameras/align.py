"""Estimated cameras against the true ones: the similarity between their frames, and the errors that are left.

Naming law: X_true = scale * rotation @ X_estimated + translation. All tensors are float64 on the CPU.

A camera's error is sqrt(angle² + (distance / extent)²): its turn in radians and its centre's distance in units of the
true scene extent, which weigh alike. Rotations take part because centres alone leave the turn about a line of cameras
open, and the whole turn where there are two.
"""

import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import torch
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate, centers_of, extent_of
from novags.cameras.points import inside, project

HYPOTHESES = 2000  # pairs of cameras that are tried at most: with 30 % outliers half of all pairs are good
INLIER_SIGMAS = 3.0  # robust standard deviations within which a camera counts as an inlier
FLOOR = 1e-7  # error that is rounding: without it exact cameras among outliers would not count as inliers of each other


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
    """The similarity and what it leaves of the errors.

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
    """The similarity that brings most cameras close to the true ones, whatever the others do.

    The pair of cameras whose similarity has the least median error over all cameras (least median of squares, so up to
    half of the cameras may be wrong) chooses the inliers; rotation, scale and translation are then fitted to these.
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
    similarity, inliers = _robust(estimated, true, extent)
    angles, distances = _errors(similarity, estimated, true, extent)
    return Alignment(
        similarity=similarity,
        rotation_deg=torch.from_numpy(np.degrees(angles)),
        centre_error=torch.from_numpy(distances),
        inliers=torch.from_numpy(inliers),
    )


def depth_scale(
    estimate: CameraEstimate, similarity: Similarity, viewmats_true: Tensor, Ks: Tensor, depths: Tensor
) -> float:
    """Median, over points and views, of aligned over true depth: 1 where points lie on the surfaces they show.

    A point is compared in every registered view that has it in frame. Points that another surface hides there read as
    too deep; the median holds as long as they are fewer than half.

    Args:
        estimate: Its points.
        similarity: From its frame to the true one.
        viewmats_true: [R, 4, 4], the true cameras of the registered views.
        Ks: [R, 3, 3], the true intrinsics of these views.
        depths: [R, h, w], true z-depths, inf where there is no surface.

    Returns:
        NaN if no point falls on a surface.
    """
    points = similarity.apply(estimate.points).numpy()
    found = [np.empty(0)]
    for viewmat, K, depth in zip(viewmats_true.double().numpy(), Ks.double().numpy(), depths.numpy(), strict=True):
        pixels, z = project(points, viewmat, K)
        chosen = inside(pixels, *depth.shape)
        x, y = pixels[chosen].astype(int).T
        with np.errstate(divide="ignore"):
            ratio = z[chosen] / depth[y, x]
        found.append(ratio[np.isfinite(ratio) & (ratio > 0)])
    ratios = np.concatenate(found)
    return float(np.median(ratios)) if len(ratios) else math.nan


def _robust(estimated: Array, true: Array, extent: float) -> tuple[Similarity, np.ndarray]:
    """The fitted similarity and its inliers [R]."""
    count, best, least = len(true), None, math.inf
    distances = np.linalg.norm(centers_of(estimated)[:, None] - centers_of(estimated)[None], axis=-1)
    for i, j in _pairs(count):
        # A pair at one point has no scale. Others of tiny baseline have a bad one, which their median error shows.
        if distances[i, j] > 1e-9 * distances.max():
            candidate = _fit(estimated[[i, j]], true[[i, j]], extent)
            error = float(np.median(_error(candidate, estimated, true, extent)))
            if error < least:
                best, least = candidate, error
    if best is None or not best.scale > 0:
        raise ValueError("no two estimated cameras agree with the true ones on a scale: no alignment")
    for _ in range(5):  # it settles after two or three
        errors = _error(best, estimated, true, extent)
        # 1.4826 median = standard deviation of a normal; the factor for few cameras is Rousseeuw's (1987).
        spread = 1.4826 * (1 + 5 / max(count - 2, 1)) * float(np.median(errors))
        inliers = errors <= max(INLIER_SIGMAS * spread, FLOOR)
        best = _fit(estimated[inliers], true[inliers], extent)
    return best, inliers


def _pairs(count: int) -> list[tuple[int, int]]:
    pairs = list(combinations(range(count), 2))
    if len(pairs) <= HYPOTHESES:
        return pairs
    chosen = np.random.default_rng(0).choice(len(pairs), HYPOTHESES, replace=False)
    return [pairs[k] for k in sorted(chosen)]


def _fit(estimated: Array, true: Array, extent: float) -> Similarity:
    """Least squares of `_error` over the cameras.

    For a given scale s the rotation maximises trace(R^T (s A / extent² + B)), where A = sum of true times estimated
    centres about their means and B = sum of R_true^T R_estimated (|R - Q|² = 2 angle² for small angles); for a given
    rotation s = trace(R^T A) / sum of squared estimated centres (Umeyama 1991). The two take turns.
    """
    ce, ct = centers_of(estimated), centers_of(true)
    at_e, at_t = ce - ce.mean(0), ct - ct.mean(0)
    A, squares = at_t.T @ at_e, float((at_e**2).sum())
    B = np.einsum("kji,kjl->il", true[:, :3, :3], estimated[:, :3, :3])
    scale = math.sqrt(float((at_t**2).sum()) / squares)
    for _ in range(10):
        rotation = _nearest_rotation(scale * A / extent**2 + B)
        scale = float((rotation * A).sum()) / squares
        if scale <= 0:  # centres and rotations contradict each other; an inverted scene is not a fit
            scale = math.sqrt(float((at_t**2).sum()) / squares)
            break
    translation = ct.mean(0) - scale * rotation @ ce.mean(0)
    return Similarity(scale, torch.from_numpy(rotation), torch.from_numpy(translation))


def _nearest_rotation(matrix: Array) -> Array:
    """The rotation R that maximises trace(R^T matrix)."""
    U, _, Vt = np.linalg.svd(matrix)
    return U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt


def _errors(similarity: Similarity, estimated: Array, true: Array, extent: float) -> tuple[Array, Array]:
    """Angles [R] in radians and distances of the centres [R] in extents."""
    turned = estimated[:, :3, :3] @ similarity.rotation.numpy().T
    # |R - Q| = 2 sqrt(2) sin(angle / 2): exact for small angles, where the arc cosine of the trace is not.
    chord = np.linalg.norm(turned - true[:, :3, :3], axis=(1, 2)) / math.sqrt(8)
    centers = similarity.apply(torch.from_numpy(centers_of(estimated))).numpy()
    return 2 * np.arcsin(np.minimum(chord, 1)), np.linalg.norm(centers - centers_of(true), axis=1) / extent


def _error(similarity: Similarity, estimated: Array, true: Array, extent: float) -> Array:
    return np.hypot(*_errors(similarity, estimated, true, extent))
