"""The points a reconstruction starts from, with cameras given: as many as are asked for, where the scene is.

In this order of trust: depth of the set, its sparse model and the surface between the model's points, and depths found
by comparing the pictures themselves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from novags.cameras.estimate import Array, centers_of
from novags.cameras.points import fill, inside, project, seen_colors, subset, unproject
from novags.cameras.sweep import sweep
from simscenes.sets.geometry.plausible import not_hidden

Float = NDArray[np.float32]


@dataclass(frozen=True)
class FirstPoints:
    """Points [P, 3], their colours in the dark pictures [P, 3], and where they come from (`CameraEstimate.made_of`)."""

    xyz: Array
    colors: Array
    made_of: dict[str, int]


def from_depths(
    depths: Array, images: Float, viewmats: Array, Ks: Array, count: int, rng: np.random.Generator
) -> FirstPoints:
    """Points behind randomly chosen pixels; where there are too few, further ones elsewhere in these pixels.

    Args:
        depths: z-depths [C, h, w], inf in front of empty space.
        images: [C, h, w, 3], 0..1.
        viewmats: [C, 4, 4].
        Ks: [C, 3, 3].
        count: How many points.
        rng: Chooses the pixels.
    """
    every = np.flatnonzero(np.isfinite(depths) & (depths > 0))
    chosen = subset(every, count, rng)
    offsets = np.full((len(chosen), 2), 0.5)
    if len(chosen) < count:
        more = count - len(chosen)
        chosen = np.concatenate([chosen, every[rng.integers(0, len(every), more)]])
        offsets = np.concatenate([offsets, rng.random((more, 2))])
    view, y, x = np.unravel_index(chosen, depths.shape)
    xyz = unproject(np.stack([x, y], -1) + offsets, depths[view, y, x], viewmats[view], Ks[view])
    return FirstPoints(xyz, np.asarray(images[view, y, x]), {"from depth": count})


def from_model(
    model: Array, images: Float, viewmats: Array, Ks: Array, count: int, rng: np.random.Generator
) -> FirstPoints:
    """Points of a sparse model; where there are too few, further ones between the points that each view sees.

    Args:
        model: World points [M, 3].
        images: [C, h, w, 3], 0..1.
        viewmats: [C, 4, 4].
        Ks: [C, 3, 3].
        count: How many points.
        rng: Chooses points and pixels.
    """
    xyz = subset(model, count, rng)
    colors = seen_colors(xyz, images, viewmats, Ks)
    if len(xyz) == count:
        return FirstPoints(xyz, colors, {"of the sparse model": count})
    between, shown = fill(_seen(model, viewmats, Ks, *images.shape[1:3]), images, viewmats, Ks, count - len(xyz), rng)
    made_of = {"of the sparse model": len(xyz), "between its points": len(between)}
    parts = [FirstPoints(np.concatenate([xyz, between]), np.concatenate([colors, shown]), made_of)]
    if len(xyz) + len(between) < count:  # no view of these sees any of its points
        parts.append(from_pictures(images, viewmats, Ks, count - len(xyz), rng))
    return FirstPoints(
        np.concatenate([part.xyz for part in parts]), np.concatenate([part.colors for part in parts]),
        {what: n for part in parts for what, n in part.made_of.items() if n},
    )  # fmt: skip


def _seen(xyz: Array, viewmats: Array, Ks: Array, height: int, width: int) -> list[Array]:
    """The points that each view sees: all points in its frame that no other hides. Tracks would leave most of them
    out.
    """
    found = []
    for viewmat, K in zip(viewmats, Ks, strict=True):
        in_frame = inside(project(xyz, viewmat, K)[0], height, width)
        found.append(xyz[in_frame & not_hidden(xyz, -viewmat[:3, :3].T @ viewmat[:3, 3])])
    return found


def from_pictures(images: Float, viewmats: Array, Ks: Array, count: int, rng: np.random.Generator) -> FirstPoints:
    """Points at depths found by comparing the pictures; around where the cameras look if no two can be compared.

    Args:
        images: [C, h, w, 3], 0..1.
        viewmats: [C, 4, 4].
        Ks: [C, 3, 3].
        count: How many points.
        rng: Chooses places in the pictures.
    """
    found = sweep(images, viewmats, Ks)
    if found is None:
        xyz = _around_focus(viewmats, count, rng)
        return FirstPoints(xyz, seen_colors(xyz, images, viewmats, Ks), {"at random": count})
    # Every pixel, also where no other map agrees: leaving those out leaves holes that a fit fills slowly.
    good = np.argwhere(np.isfinite(found.depth))
    place, y, x = good[rng.integers(0, len(good), count)].T
    pixels = np.stack([x, y], -1) + rng.random((count, 2))
    view = found.views[place]
    xyz = unproject(pixels, found.depth[place, y, x], viewmats[view], found.Ks[place])
    scale = np.array(images.shape[2:0:-1]) / found.depth.shape[:0:-1]
    column, row = (pixels * scale).astype(int).T
    return FirstPoints(xyz, images[view, row, column], {"from a plane sweep": count})


def _around_focus(viewmats: Array, count: int, rng: np.random.Generator) -> Array:
    """Uniform points in a cube around where the cameras look, half as wide as they stand away from it."""
    centers, axes = centers_of(viewmats), viewmats[:, 2, :3]
    # The point nearest to all optical axes; the ridge makes it unique for parallel axes, which never meet.
    planes = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    ridge = 1e-3 * len(axes) * np.eye(3)
    focus = np.linalg.solve(planes.sum(0) + ridge, np.einsum("cij,cj->i", planes, centers) + ridge @ centers.mean(0))
    reach = np.median(np.linalg.norm(centers - focus, axis=1))
    # A single camera does not define such a point: its own surroundings, of unit size, serve instead.
    return focus + (reach if reach > 1e-6 else 1.0) / 2 * rng.uniform(-1, 1, (count, 3))
