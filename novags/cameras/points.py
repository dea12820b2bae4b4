"""Initial points: from pixels with a depth, and coloured as the dark images show them. All numpy, float64."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from novags.cameras.estimate import Array

COLOR_NEIGHBOURS = 8  # points whose colours are averaged: a single dark pixel is mostly noise
DEPTH_NEIGHBOURS = 4  # observed points whose inverse depths a filled-up pixel averages


def subset(values: NDArray[Any], count: int, rng: np.random.Generator) -> NDArray[Any]:
    """At most `count` rows, chosen at random."""
    return values if len(values) <= count else values[rng.choice(len(values), count, replace=False)]


def unproject(pixels: Array, depths: Array, viewmats: Array, Ks: Array) -> Array:
    """World points [P, 3] of pixels at given depths.

    Args:
        pixels: [P, 2], x and y in pixels; the centre of the first pixel is (0.5, 0.5).
        depths: [P], z-depth.
        viewmats: [P, 4, 4], the camera of each pixel.
        Ks: [P, 3, 3].
    """
    rays = np.einsum("pij,pj->pi", np.linalg.inv(Ks), np.concatenate([pixels, np.ones((len(pixels), 1))], 1))
    camera = rays * depths[:, None]
    return np.einsum("pji,pj->pi", viewmats[:, :3, :3], camera - viewmats[:, :3, 3])


def project(points: Array, viewmat: Array, K: Array) -> tuple[Array, Array]:
    """Pixels [P, 2] and z-depths [P] of world points in one camera; pixels are NaN behind it."""
    camera = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    z = camera[:, 2]
    # Behind the camera, projections are mirror images; on its plane they are at infinity.
    return (camera @ K.T)[:, :2] / np.where(z > 0, z, np.nan)[:, None], z


def inside(pixels: Array, height: int, width: int) -> NDArray[np.bool_]:
    """Which pixels [P, 2] lie in the frame; NaN does not."""
    return np.all((pixels >= 0) & (pixels < [width, height]), axis=1)


def seen_colors(points: Array, images: NDArray[np.float32], viewmats: Array, Ks: Array) -> Array:
    """Mean colour at the projections of each point into the views that have it in frame; the overall mean elsewhere.

    Args:
        points: [P, 3].
        images: [C, h, w, 3].
        viewmats: [C, 4, 4].
        Ks: [C, 3, 3].
    """
    height, width = images.shape[1:3]
    total, seen = np.zeros((len(points), 3)), np.zeros(len(points))
    for image, viewmat, K in zip(images, viewmats, Ks, strict=True):
        pixels, _ = project(points, viewmat, K)
        chosen = np.flatnonzero(inside(pixels, height, width))
        x, y = pixels[chosen].astype(int).T
        total[chosen] += image[y, x]
        seen[chosen] += 1
    return np.where(seen[:, None] > 0, total / np.maximum(seen, 1)[:, None], images.mean((0, 1, 2)))


def averaged(points: Array, colors: Array) -> Array:
    """Colours averaged over the nearest points."""
    count = min(COLOR_NEIGHBOURS, len(points))
    _, nearest = cKDTree(points).query(points, k=count)
    return colors[nearest.reshape(len(points), count)].mean(1)


def fill(
    observed: list[Array], dark: NDArray[np.float32], viewmats: Array, Ks: Array, count: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Points at random pixels, as deep as the points observed next to them in the picture, and their colours.

    Inverse depth is interpolated, because it is linear across the picture of a plane.

    Args:
        observed: For each view the world points [P_i, 3] that it observes; points behind it do not count.
        dark: [R, h, w, 3].
        viewmats: [R, 4, 4].
        Ks: [R, 3, 3].
        count: How many points.
        rng: Chooses the pixels, the same number in every view that observes points.

    Returns:
        Points and colours, [count, 3] each; none if no view observes anything.
    """
    height, width = dark.shape[1:3]
    seen = [project(points, viewmats[i], Ks[i]) for i, points in enumerate(observed)]
    seen = [(at[z > 0], z[z > 0]) for at, z in seen]
    views = [i for i, (_, z) in enumerate(seen) if len(z)]
    points, colors = [np.empty((0, 3))], [np.empty((0, 3))]
    for n, i in enumerate(views):
        wanted = count * (n + 1) // len(views) - count * n // len(views)
        pixels = rng.uniform(0, [width, height], (wanted, 2))
        at, z = seen[i]
        distance, near = cKDTree(at).query(pixels, k=min(DEPTH_NEIGHBOURS, len(at)))
        distance, near = distance.reshape(wanted, -1), near.reshape(wanted, -1)
        # A pixel at an observed point takes that point's depth instead of 0 / 0.
        weights = 1 / np.maximum(distance, 1e-6)
        depths = weights.sum(1) / (weights / z[near]).sum(1)
        every = np.repeat(viewmats[i : i + 1], wanted, 0), np.repeat(Ks[i : i + 1], wanted, 0)
        points.append(unproject(pixels, depths, *every))
        x, y = pixels.astype(int).T
        colors.append(dark[i, y, x])
    return np.concatenate(points), np.concatenate(colors)
