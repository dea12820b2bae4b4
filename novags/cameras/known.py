"""Cameras taken from the set itself, exact or with a stated error, and points to start from.

The errors stand for an estimator's: rotation and translation per camera, depth as one factor per view (what a
feed-forward network gets wrong is coherent within a view). Points follow the perturbed cameras.
"""

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from torch import Tensor

from novags.splats.views import Views
from simscenes.sets.multiview import MultiviewSet

COLOR_NEIGHBOURS = 8  # points whose colours are averaged: a single dark pixel is mostly noise


@dataclass(frozen=True)
class InitialScene:
    """Where a reconstruction starts.

    Attributes:
        viewmats: [C, 4, 4] float64, world to camera.
        Ks: [C, 3, 3] float64.
        points: [P, 3] float32, world units.
        colors: [P, 3] float32, 0..1, as the dark images show them.
        extent: 1.1 times the largest distance of a camera from the mean camera, world units.
    """

    viewmats: Tensor
    Ks: Tensor
    points: Tensor
    colors: Tensor
    extent: float


def known(
    multiview: MultiviewSet,
    indices: list[int],
    colors_from: Tensor,
    *,
    n_points: int,
    rotation_deg: float = 0.0,
    translation: float = 0.0,
    depth_error: float = 0.0,
    seed: int = 0,
) -> InitialScene:
    """Cameras of the given views, and points from depth, from the sparse model, or at random, whichever there is.

    Args:
        multiview: The set.
        indices: Views to use, the training views.
        colors_from: [C, h, w, 3] dark images of those views, 0..1. Never the lit ones.
        n_points: How many points at most.
        rotation_deg: Root-mean-square angle by which cameras are turned, about random axes.
        translation: Root-mean-square distance by which camera centres are moved, in scene extents.
        depth_error: Standard deviation of the log of each view's depth factor.
        seed: Of the errors and of the choice of points.

    Raises:
        ValueError: For no views, images of another number or size, or negative errors.
    """
    rig = multiview.rig
    want = (len(indices), rig.height, rig.width, 3)
    if not indices or tuple(colors_from.shape) != want:
        raise ValueError(f"colors_from must be {want} for {len(indices)} views, got {tuple(colors_from.shape)}")
    if n_points < 2 or min(rotation_deg, translation, depth_error) < 0:
        raise ValueError(
            "n_points must be >= 2 and errors >= 0, got "
            f"n_points={n_points}, rotation_deg={rotation_deg}, translation={translation}, depth_error={depth_error}"
        )
    rng = np.random.default_rng(seed)
    exact = np.asarray(rig.viewmats, np.float64)[indices]
    Ks = np.asarray(rig.Ks, np.float64)[indices]
    extent = _views(exact, Ks, rig.width, rig.height).extent
    viewmats = perturb(exact, rotation_deg, translation * extent, rng)
    images = colors_from.detach().cpu().numpy().astype(np.float32)
    depths = _depths(multiview, indices)
    if depths is not None:
        factors = np.exp(depth_error * rng.standard_normal(len(indices)))
        points, colors = _lift(depths * factors[:, None, None], images, viewmats, Ks, n_points, rng)
    else:
        sparse = multiview.points()
        points = _random_points(viewmats, n_points, rng) if sparse is None else _subset(sparse[0], n_points, rng)
        colors = _seen_colors(points, images, viewmats, Ks)
    return InitialScene(
        viewmats=torch.from_numpy(viewmats),
        Ks=torch.from_numpy(Ks),
        points=torch.from_numpy(points.astype(np.float32)),
        colors=torch.from_numpy(_averaged(points, colors).astype(np.float32)),
        extent=extent,
    )


def perturb(viewmats: np.ndarray, rotation_deg: float, translation: float, rng: np.random.Generator) -> np.ndarray:
    """Turn and move cameras [C, 4, 4] by random amounts of the given root mean square (degrees, world units)."""
    count = len(viewmats)
    turns = Rotation.from_rotvec(np.radians(rotation_deg) / np.sqrt(3) * rng.standard_normal((count, 3))).as_matrix()
    moves = translation / np.sqrt(3) * rng.standard_normal((count, 3))
    centers = -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3]) + moves
    result = viewmats.copy()
    result[:, :3, :3] = turns @ viewmats[:, :3, :3]
    result[:, :3, 3] = -np.einsum("cij,cj->ci", result[:, :3, :3], centers)
    return result


def _views(viewmats: np.ndarray, Ks: np.ndarray, width: int, height: int) -> Views:
    return Views(torch.tensor(viewmats, dtype=torch.float32), torch.tensor(Ks, dtype=torch.float32), width, height)


def _depths(multiview: MultiviewSet, indices: list[int]) -> np.ndarray | None:
    """z-depths [C, h, w] of the views, inf where there is no surface; None if the set knows none."""
    found = [multiview.geometry(i) for i in indices]
    depths = [geometry["z"] for geometry in found if geometry is not None]
    if len(depths) < len(indices) or not any(np.isfinite(z).any() for z in depths):
        return None
    return np.stack(depths)


def _subset(points: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    return points if len(points) <= count else points[rng.choice(len(points), count, replace=False)]


def _lift(
    depths: np.ndarray, images: np.ndarray, viewmats: np.ndarray, Ks: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """World points and colours of randomly chosen pixels that show a surface."""
    pixels = _subset(np.argwhere(np.isfinite(depths) & (depths > 0)), count, rng)
    view, y, x = pixels.T
    homogeneous = np.stack([x + 0.5, y + 0.5, np.ones(len(x))], -1)
    rays = np.einsum("pij,pj->pi", np.linalg.inv(Ks)[view], homogeneous)
    camera = rays * depths[view, y, x][:, None]
    world = np.einsum("pji,pj->pi", viewmats[view, :3, :3], camera - viewmats[view, :3, 3])
    return world, images[view, y, x]


def _random_points(viewmats: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Uniform points in a cube around where the cameras look, half as wide as they stand away from it."""
    centers = -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3])
    axes = viewmats[:, 2, :3]
    # The point nearest to all optical axes; the ridge decides for parallel axes, which meet nowhere.
    planes = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    ridge = 1e-3 * len(axes) * np.eye(3)
    focus = np.linalg.solve(planes.sum(0) + ridge, np.einsum("cij,cj->i", planes, centers) + ridge @ centers.mean(0))
    reach = np.median(np.linalg.norm(centers - focus, axis=1))
    # A single camera looks at nothing in particular: its own surroundings of unit size are as good as any.
    return focus + (reach if reach > 1e-6 else 1.0) / 2 * rng.uniform(-1, 1, (count, 3))


def _seen_colors(points: np.ndarray, images: np.ndarray, viewmats: np.ndarray, Ks: np.ndarray) -> np.ndarray:
    """Mean colour at the projections of each point into the views that have it in frame; the overall mean elsewhere."""
    height, width = images.shape[1:3]
    total, seen = np.zeros((len(points), 3)), np.zeros(len(points))
    for image, viewmat, K in zip(images, viewmats, Ks, strict=True):
        camera = points @ viewmat[:3, :3].T + viewmat[:3, 3]
        front = np.flatnonzero(camera[:, 2] > 1e-6)  # behind the camera, projections are mirror images
        u, v = ((camera[front] @ K.T)[:, :2] / camera[front, 2:]).T
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        chosen = front[inside]
        total[chosen] += image[v[inside].astype(int), u[inside].astype(int)]
        seen[chosen] += 1
    return np.where(seen[:, None] > 0, total / np.maximum(seen, 1)[:, None], images.mean((0, 1, 2)))


def _averaged(points: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Colours averaged over the nearest points."""
    count = min(COLOR_NEIGHBOURS, len(points))
    _, nearest = cKDTree(points).query(points, k=count)
    return colors[nearest.reshape(len(points), count)].mean(1)
