"""Cameras and first points from the depths of a network: in its own cameras, or in those that are known.

Networks that take known cameras have the setting `known`. With "lenses" they are told the intrinsics of the set, which
the estimate then has; with "cameras" the poses too, and the estimate has the cameras of the set, exactly, with the
network's depths for first points. It is a setting of the network's source and not of `known`, because weights and
thresholds are settings of that source. Poses are told in the frame of the first camera; the network answers in a scale
of its own, and its cameras, aligned with the known ones, give the scale of its depths.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from novags.cameras.align import align
from novags.cameras.estimate import Array, CameraEstimate, centers_of
from novags.cameras.networks.dense import Index, Window, as_matrices, choose, from_pixels, inverted, refuse_elsewhere
from novags.cameras.points import inside, project, unproject
from novags.cameras.settings import Known
from simscenes.rigs import Rig

HEADS_MISS = 10.0  # px of a prepared picture, of points that are as right as the network is
# Between the cameras that a network is told and the cameras that it returns. Other conventions turn cameras by the
# angles between views, or give focal lengths of the original pictures, or shares of a side.
LARGEST_TURN = 10.0  # degrees
LARGEST_ZOOM = 1.25  # a factor


@dataclass(frozen=True)
class NetworkAnswer:
    """What a network says of the prepared pictures.

    Attributes:
        viewmats: [C, 4, 4], or without their last row, in a frame and unit of its own.
        Ks: [C, 3, 3].
        depths: Z-depths [C, H, W]; others than positive, finite ones give no points.
        confidence: [C, H, W].
        points: World points that are not made with these cameras and depths [C, H, W, 3]; None: it has none.
    """

    viewmats: Array
    Ks: Array
    depths: Array
    confidence: Array
    points: Array | None = None


def told(source: str, known: Known, cameras: Rig, window: Window) -> tuple[Array | None, Array | None]:
    """What a network is told of known cameras.

    Args:
        source: The camera source, for messages.
        known: Its setting.
        cameras: Of the pictures.
        window: Which part of the pictures the network sees.

    Returns:
        Poses, world-to-camera [C, 4, 4], in the frame of the first camera and in units of the median distance from it,
        if known are "cameras"; intrinsics [C, 3, 3] of the prepared pictures, unless known is "nothing"; None for what
        it is not told.

    Raises:
        ValueError: If all cameras stand at one place, so that they have no scale.
    """
    Ks = None if known == "nothing" else window.prepared_Ks(cameras.Ks)
    if known != "cameras":
        return None, Ks
    viewmats = cameras.viewmats @ inverted(cameras.viewmats[:1])
    distances = np.sort(np.linalg.norm(centers_of(viewmats), axis=1))
    # Below rounding of the coordinates, distances are noise, which would become the unit.
    noise = 1e-9 * np.abs(cameras.viewmats[:, :3, 3]).max()
    # The first camera, at distance 0, is counted, as Depth Anything 3 does; of two the median would be that 0.
    middle = distances[(len(distances) - 1) // 2]
    unit = middle if middle > noise else distances[-1]
    if not unit > noise:
        raise ValueError(
            f"{source} cannot scale its depths by known cameras that all stand at one place: take "
            f"{source}:known=nothing"
        )
    viewmats[:, :3, 3] /= unit
    return viewmats, Ks


def estimate_of(
    source: str, found: NetworkAnswer, window: Window, colors_from: Tensor, *, n_points: int, drop_percent: float,
    seed: int, known: Known = "nothing", cameras: Rig | None = None,
) -> CameraEstimate:  # fmt: skip
    """Cameras and points from depths.

    Args:
        source: The camera source, for messages.
        found: The network's answer.
        window: Which part of the pictures it saw.
        colors_from: [C, h, w, 3] dark images, 0..1.
        n_points: Maximum number of points.
        drop_percent: Of all pixels, the share of the least confident that are left out.
        seed: Of the choice of points.
        known: What the network was told.
        cameras: The known ones; needed unless known is "nothing".

    Raises:
        ValueError: If values have other shapes or are not finite, no depth is positive, or the answer contradicts
            itself or what the network was told.
    """
    _check_shapes(source, found, (len(colors_from), window.height, window.width))
    usable = np.isfinite(found.depths) & (found.depths > 0)
    chosen = choose(source, found.confidence, usable, drop_percent, n_points, seed)
    view, y, x = chosen.T
    viewmats = as_matrices(found.viewmats[:, :3, :3], found.viewmats[:, :3, 3])
    Ks, depths, pixels = found.Ks, found.depths, np.stack([x, y], -1) + 0.5
    if found.points is None:
        own = unproject(pixels, depths[view, y, x], viewmats[view], Ks[view])
    else:
        own = found.points[view, y, x]
    refuse_elsewhere(source, chosen, own, viewmats, Ks, HEADS_MISS)
    given = None if known == "nothing" else cameras
    if given is not None:
        Ks = _same_lenses(source, Ks, window.prepared_Ks(given.Ks))
    if given is not None and known == "cameras":
        depths, viewmats = depths * _scale(source, viewmats, given.viewmats), np.array(given.viewmats)
        # In the frame that it was told them in: others would be the inverses that it would take them for.
        refuse_other_conventions(source, chosen, depths, viewmats @ inverted(viewmats[:1]), Ks)
    elif found.points is None:
        refuse_other_conventions(source, chosen, depths, viewmats, Ks)
    points = unproject(pixels, depths[view, y, x], viewmats[view], Ks[view])
    estimate = from_pixels(source, chosen, points, viewmats, Ks, window, colors_from)
    if given is None:
        return estimate
    return replace(estimate, rig=replace(given, viewmats=viewmats))  # without the rounding of there and back


def _check_shapes(source: str, found: NetworkAnswer, shape: tuple[int, int, int]) -> None:
    count = shape[0]
    wanted = {"viewmats": (count, len(found.viewmats[0]), 4), "Ks": (count, 3, 3), "depths": shape,
              "confidence": shape, "points": (*shape, 3)}  # fmt: skip
    for name, want in wanted.items():
        value = getattr(found, name)
        if value is not None and value.shape != want:
            raise ValueError(
                f"{source} returned {name} {list(value.shape)}, expected {list(want)}: this version of the package has "
                "other conventions than novags.cameras.networks"
            )


def _same_lenses(source: str, Ks: Array, known: Array) -> Array:
    """The known intrinsics [C, 3, 3].

    Raises:
        ValueError: If the network's focal lengths are others.
    """
    factors = np.abs(np.log(Ks[:, [0, 1], [0, 1]] / known[:, [0, 1], [0, 1]]))
    if not (zoom := float(np.exp(np.median(factors)))) <= LARGEST_ZOOM:
        raise ValueError(
            f"{source} was told the lenses and returned others, whose focal lengths differ by a factor of {zoom:.3g} "
            f"(median, at most {LARGEST_ZOOM:g}): take {source}:known=nothing, or check the version of the package"
        )
    return known


def _scale(source: str, viewmats: Array, known: Array) -> float:
    """Length in the known cameras' world of a unit of the network's, from its own cameras.

    Raises:
        ValueError: If these are not the known ones in another frame.
    """
    try:
        found = align(torch.from_numpy(viewmats), torch.from_numpy(np.array(known)))
    except ValueError as error:
        raise ValueError(f"{source} cannot scale its depths by the known cameras: {error}") from error
    if not (turned := float(found.rotation_deg.median())) <= LARGEST_TURN:
        raise ValueError(
            f"{source} was told the cameras and returned others, {turned:.3g} degrees from them (median, at most "
            f"{LARGEST_TURN:g}), so its depths have no known scale: take {source}:known=nothing, or check the version "
            "of the package"
        )
    return found.similarity.scale


def refuse_other_conventions(source: str, chosen: Index, depths: Array, viewmats: Array, Ks: Array) -> None:
    """Refuse cameras with which the depths of neighbouring views contradict each other, and not by other conventions.

    For networks without points of their own and for known cameras, which see points at their pixels whatever they are.

    Args:
        source: The camera source, for messages.
        chosen: View, row and column [P, 3] of some pixels.
        depths: Z-depths of all views [C, H, W].
        viewmats: [C, 4, 4].
        Ks: [C, 3, 3].

    Raises:
        ValueError: If depths differ half as much with the inverse cameras, or with the other signs of y and z.
    """
    own = _depths_apart(chosen, depths, viewmats, Ks)
    others = (inverted(viewmats), np.diag([1.0, -1, -1, 1]) @ viewmats)
    if min(_depths_apart(chosen, depths, other, Ks) for other in others) < own / 2:
        raise ValueError(
            f"{source} returned depths that differ between neighbouring views by {own:.1%} (median), and by less than "
            "half of that if cameras were camera-to-world or had OpenGL's axes: this version of the package has other "
            "conventions than novags.cameras.networks"
        )


def _depths_apart(chosen: Index, depths: Array, viewmats: Array, Ks: Array) -> float:
    """Median of |ln| of the depth of a pixel, seen from the next view, over the depth there; inf where none is seen."""
    count, height, width = depths.shape
    off = [np.full(1, np.inf)]
    for i in range(count):
        view, y, x = chosen[chosen[:, 0] == i].T
        points = unproject(np.stack([x, y], -1) + 0.5, depths[view, y, x], viewmats[view], Ks[view])
        other = (i + 1) % count
        seen, depth = project(points, viewmats[other], Ks[other])
        there = inside(seen, height, width)
        column, row = seen[there].astype(int).T
        depth, shown = depth[there], depths[other, row, column]
        usable = np.isfinite(shown) & (shown > 0)
        off.append(np.abs(np.log(depth[usable] / shown[usable])))
    return float(np.median(np.concatenate(off)))
