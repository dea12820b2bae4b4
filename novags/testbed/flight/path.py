"""A smooth path of cameras through given ones."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from novags.cameras.estimate import Array, centers_of, extent_of

SAME = 1e-6  # extents or radians; closer cameras count as one, since a spline needs time between its knots


@dataclass(frozen=True)
class Flight:
    """Cameras along a path.

    Attributes:
        viewmats: World to camera [F, 4, 4] float64.
        nearest: For each of them the given camera that is nearest [F].
        distance: How far that is [F]: sqrt(angle² + (distance / extent)²), 0 where the path passes through it.
    """

    viewmats: Array
    nearest: np.ndarray
    distance: Array


def fly(viewmats: Array, frames: int) -> Flight:
    """A path of `frames` cameras through all given ones [C, 4, 4], at an even pace: cubic splines of positions and of
    rotations. It passes between some where they are denser than frames.

    They are passed in the given order, or from each to the nearest one left where that way is shorter, as for
    photographs in no order.

    Raises:
        ValueError: If there are fewer than two different cameras, or fewer than two frames.
    """
    if frames < 2:
        raise ValueError(f"a flight needs at least 2 frames, got {frames}: choose more seconds or more frames a second")
    apart = distances(viewmats, viewmats)
    order = shorter_order(apart)
    steps = np.array([apart[a, b] for a, b in zip(order, order[1:], strict=False)])
    order = [order[0], *(b for b, step in zip(order[1:], steps, strict=True) if step > SAME)]
    if len(order) < 2:
        raise ValueError(f"a flight needs at least 2 different cameras, got {len(viewmats)} at one place")
    knots = np.concatenate([[0.0], np.cumsum(steps[steps > SAME])])
    times = paced(knots, frames)
    centers = CubicSpline(knots, centers_of(viewmats)[order])(times)
    turns = RotationSpline(knots, Rotation.from_matrix(viewmats[order, :3, :3]))(times).as_matrix()
    found = np.tile(np.eye(4), (len(times), 1, 1))
    found[:, :3, :3] = turns
    found[:, :3, 3] = -np.einsum("fij,fj->fi", turns, centers)
    away = distances(found, viewmats)
    return Flight(found, away.argmin(1), away.min(1))


def paced(knots: Array, frames: int) -> Array:
    """Times at an even pace [frames], from the first knot to the last one.

    Where there are as many as knots, times are moved by up to half a frame so that knots fall on them, or one of
    several that are denser than frames.
    """
    if frames < len(knots):
        return np.linspace(knots[0], knots[-1], frames)
    at, first = np.unique(np.round((knots - knots[0]) / (knots[-1] - knots[0]) * (frames - 1)), return_index=True)
    first[-1] = len(knots) - 1
    return np.interp(np.arange(frames), at, knots[first])


def distances(a: Array, b: Array) -> Array:
    """How far cameras [A, 4, 4] are from cameras [B, 4, 4], in radians and extents of `b` together: [A, B]."""
    chord = np.linalg.norm(a[:, None, :3, :3] - b[None, :, :3, :3], axis=(-2, -1)) / np.sqrt(8)
    angle = 2 * np.arcsin(np.minimum(chord, 1.0))
    apart = np.linalg.norm(centers_of(a)[:, None] - centers_of(b)[None], axis=-1)
    found: Array = np.hypot(angle, apart / extent_of(b))
    return found


def shorter_order(apart: Array) -> list[int]:
    """The given order, or the order that goes to the nearest camera left each time, whichever is shorter.

    Args:
        apart: How far the cameras are from each other [C, C].
    """
    left, nearest = set(range(1, len(apart))), [0]
    while left:
        nearest.append(min(left, key=lambda k: (apart[nearest[-1], k], k)))
        left.remove(nearest[-1])

    def length(order: list[int]) -> float:
        return float(sum(apart[a, b] for a, b in zip(order, order[1:], strict=False)))

    given = list(range(len(apart)))
    return given if length(given) <= length(nearest) else nearest
