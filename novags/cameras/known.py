"""Cameras taken from the set itself, exact or with a stated error, and points to start from.

The errors stand for an estimator's: rotation and translation per camera, depth as one factor per view (a feed-forward
network's errors are coherent within a view). Points from depth and from the pictures follow the perturbed cameras;
points of a sparse model do not move and stay exact.
"""

import numpy as np
from scipy.spatial.transform import Rotation
from torch import Tensor

from novags.cameras.estimate import Array, CameraEstimate, as_estimate, centers_of, extent_of
from novags.cameras.first import from_depths, from_model, from_pictures
from novags.cameras.points import averaged
from novags.cameras.sources.known import KnownConfig
from simscenes.sets.multiview import MultiviewSet


def known(
    multiview: MultiviewSet,
    indices: list[int],
    colors_from: Tensor,
    *,
    n_points: int,
    config: KnownConfig | None = None,
    seed: int = 0,
) -> CameraEstimate:
    """Cameras of the given views, and points from depth, else from the sparse model, else from the pictures alone.

    Args:
        multiview: The set.
        indices: Views to use, the training views.
        colors_from: [C, h, w, 3] dark images of those views, 0..1. Never the lit ones.
        n_points: Number of points.
        config: The errors; None: exact.
        seed: Of the errors and of the choice of points.

    Returns:
        Every view has a camera, in the frame of the set; `extent` belongs to the exact cameras.

    Raises:
        ValueError: For no views, images of the wrong number or size, fewer than 2 points, or a depth_error where the
            set has no depth.
    """
    config = config or KnownConfig()
    rig = multiview.rig
    want = (len(indices), rig.height, rig.width, 3)
    if not indices or tuple(colors_from.shape) != want:
        raise ValueError(f"colors_from must be {want} for {len(indices)} views, got {tuple(colors_from.shape)}")
    if n_points < 2:
        raise ValueError(f"n_points must be >= 2, got {n_points}")
    rng = np.random.default_rng(seed)
    exact = np.asarray(rig.viewmats, np.float64)[indices]
    Ks = np.asarray(rig.Ks, np.float64)[indices]
    extent = extent_of(exact)
    moved = perturb(exact, config.rotation_deg, config.translation * extent, rng)
    images = colors_from.detach().cpu().numpy().astype(np.float32)
    depths = _depths(multiview, indices)
    if config.depth_error and depths is None:
        raise ValueError(f"depth_error of known cameras needs a set with depth, at its full size, got "
                         f"{config.depth_error:g} and no depth: leave it out")  # fmt: skip
    if depths is not None:
        factors = np.exp(config.depth_error * rng.standard_normal(len(indices)))
        first = from_depths(depths * factors[:, None, None], images, moved, Ks, n_points, rng)
    elif (sparse := multiview.points()) is not None:
        first = from_model(sparse.xyz, images, moved, Ks, n_points, rng)
    else:
        first = from_pictures(images, moved, Ks, n_points, rng)
    # Moving by zero would round the last bit: without errors the cameras are exactly the set's own, and a seed gives
    # the same points as ever.
    viewmats = moved if config.rotation_deg or config.translation else exact
    colors = averaged(first.xyz, first.colors)
    registered, size = tuple(range(len(indices))), (rig.width, rig.height)
    return as_estimate(registered, viewmats, Ks, first.xyz, colors, extent, size=size, made_of=first.made_of)


def perturb(viewmats: Array, rotation_deg: float, translation: float, rng: np.random.Generator) -> Array:
    """Rotate and move cameras [C, 4, 4] by random amounts of the given root mean square (degrees, world units)."""
    count = len(viewmats)
    turns = Rotation.from_rotvec(np.radians(rotation_deg) / np.sqrt(3) * rng.standard_normal((count, 3))).as_matrix()
    moves = translation / np.sqrt(3) * rng.standard_normal((count, 3))
    result = viewmats.copy()
    result[:, :3, :3] = turns @ viewmats[:, :3, :3]
    result[:, :3, 3] = -np.einsum("cij,cj->ci", result[:, :3, :3], centers_of(viewmats) + moves)
    return result


def _depths(multiview: MultiviewSet, indices: list[int]) -> Array | None:
    """z-depths [C, h, w] of the views, inf in front of empty space; None if the set has no depths."""
    found = (multiview.geometry(i) for i in indices)  # of which one is there at a time: each has a dozen maps
    depths = [geometry["z"] for geometry in found if geometry is not None]
    if len(depths) < len(indices) or not any(np.isfinite(z).any() for z in depths):
        return None
    return np.stack(depths)
