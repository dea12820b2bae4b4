"""Doubts about cameras before hours are spent on them: which stand apart, and whether there is enough to go by.

A wrong camera spoils all views, and a fit takes long to show that. The bounds were set so that of the photographs that
they were measured on the good ones raise no doubt.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensor_model.files.door import read_bytes
from sensor_model.files.reading import some
from simscenes.rigs import invert_rigid

Array = NDArray[np.float64]

COMPARED = 5  # cameras at least, before one can stand apart
FAR = 4.0  # times the median distance from the scene, or its inverse
GAP = 2.0  # ratio of two distances that no camera lies between; on a walk through a scene one follows on another
ZOOMED = 1.6  # times the median focal length, or its inverse
SAME_LENS, LENS = 1.05, 3  # ratio of focal lengths of one lens; so many photographs with it make it another lens
FEW_SEEN = 0.1  # of the points that the median camera sees
LEAST_SEEN = 40  # points that the median camera sees; fewer fit cameras of many kinds
LEAST_POINTS = 100
LEAST_VIEWS = 8  # of which one is held out
ONE_PLACE = 0.02  # largest distance between cameras over their distance from the scene: less shows no depth
LARGE_ERROR = 2.0  # px of reprojection
SQUEEZED = 1.15  # ratio of the focal lengths along x and y, either way: pixels are square
FOCALS = (0.1, 10.0)  # over the longest side: beyond them COLMAP, too, holds a camera for wrong
MIDDLE = (0.25, 0.75)  # of a side: no lens is mounted so that its axis leaves this part, and a crop is rarely so much


def camera_doubts(
    labels: Sequence[str], viewmats: Array, focals: Array, *, points: Array | None = None,
    seen: Sequence[int] | None = None,
) -> list[str]:  # fmt: skip
    """In words what speaks against cameras; [] if nothing does.

    Args:
        labels: Of the pictures.
        viewmats: World to camera [C,4,4].
        focals: Focal lengths over the longest side of the picture [C].
        points: World points [P,3] that the cameras were found with; None: not known.
        seen: How many of them each camera sees.
    """
    found = []
    centres = invert_rigid(viewmats)[:, :3, 3]
    scene = _focus(viewmats) if points is None or not len(points) else np.median(points, 0)
    distance = np.linalg.norm(centres - scene, axis=1)
    apart = _apart(labels, distance, _nearest(centres), focals, seen)
    if apart:
        found.append(f"{len(apart)} of {len(labels)} cameras stand apart from the others: {some(apart, 6)}; look at "
                     "these photographs, and leave out what shows another place")  # fmt: skip
    if points is not None and (len(points) < LEAST_POINTS or np.median(seen or [0]) < LEAST_SEEN):
        found.append(f"few points hold the cameras together: {len(points)} in all, {np.median(seen or [0]):g} in the "
                     f"median photograph, of at least {LEAST_POINTS} and {LEAST_SEEN}: cameras may be wrong; take "
                     "photographs with more overlap, sharp, with texture and little noise")  # fmt: skip
    spread = np.linalg.norm(centres[:, None] - centres[None], axis=-1).max() if len(centres) < 1000 else np.inf
    if len(labels) > 1 and spread <= ONE_PLACE * np.median(distance):
        found.append("all photographs are taken from one place, as if the camera only turned: they show no depth; walk "
                     "around the scene")  # fmt: skip
    return found


def lens_doubts(Ks: Array, size: tuple[int, int]) -> list[str]:
    """In words what speaks against calibrated lenses; [] if nothing does.

    Args:
        Ks: Intrinsics [C,3,3], of the pictures as they were taken: undoing distortion may stretch them.
        size: Width and height of the pictures, px.
    """
    ratio, focal = Ks[:, 0, 0] / Ks[:, 1, 1], Ks[:, 0, 0] / max(size)
    found = []
    if len(squeezed := ratio[(ratio > SQUEEZED) | (ratio < 1 / SQUEEZED)]):
        worst = squeezed[np.argmax(np.abs(np.log(squeezed)))]
        found.append(f"{len(squeezed)} of {len(Ks)} cameras have another focal length along x than along y, the worst "
                     f"{worst:.3g} times it, of at most {SQUEEZED:g} either way: pixels are square, so that the "
                     "calibration is wrong (of too few photographs, say) or pictures were stretched; calibrate again "
                     "with one focal length")  # fmt: skip
    if len(odd := focal[(focal < FOCALS[0]) | (focal > FOCALS[1])]):
        found.append(f"{len(odd)} of {len(Ks)} cameras have a focal length of {odd.min():.3g} to {odd.max():.3g} times "
                     f"the longer side of the picture, usual is {FOCALS[0]:g} to {FOCALS[1]:g}: a wrong calibration, "
                     "or one of pictures of another size")  # fmt: skip
    centres = Ks[:, :2, 2] / size
    if len(outside := centres[((centres < MIDDLE[0]) | (centres > MIDDLE[1])).any(1)]):
        x, y = outside[0]
        found.append(f"{len(outside)} of {len(Ks)} cameras have their principal point beside the middle half of the "
                     f"picture, the first at {x:.2g} of its width and {y:.2g} of its height: cx and cy are probably "
                     "not in px from the corner, or of pictures before a crop")  # fmt: skip
    return found


def few_views(count: int) -> list[str]:
    """A doubt where fewer than `LEAST_VIEWS` photographs have a camera."""
    return [] if count >= LEAST_VIEWS else [
        f"only {count} photographs have a camera, at least {LEAST_VIEWS} are of use: what lies between so few views is "
        "anybody's guess, and a score rests on one of them; take more"
    ]  # fmt: skip


def same_photographs(files: Sequence[Path]) -> list[str]:
    """A doubt where files of several names hold the same bytes.

    Raises:
        OSError: If one cannot be read.
    """
    sizes = Counter(file.stat().st_size for file in files)
    first: dict[bytes, Path] = {}
    pairs = []
    for file in files:
        if sizes[file.stat().st_size] > 1:
            other = first.setdefault(hashlib.sha256(read_bytes(file)).digest(), file)
            pairs += (
                []
                if other is file
                else [
                    " and ".join(
                        one.name if file.name != other.name else f"{one.parent.name}/{one.name}"
                        for one in (file, other)
                    )
                ]
            )
    return [] if not pairs else [
        f"{len(pairs)} of {len(files)} photographs are copies of another one ({some(pairs)}): what is held out of one "
        "name may be trained on under the other; remove the copies"
    ]  # fmt: skip


def _apart(
    labels: Sequence[str], distance: Array, nearest: Array, focals: Array, seen: Sequence[int] | None
) -> list[str]:
    """The cameras that stand apart, each with its reasons."""
    if len(labels) < COMPARED:
        return []
    reasons: dict[int, list[str]] = {}
    counts = () if seen is None else tuple(seen)
    far, zoom = distance / max(np.median(distance), 1e-300), focals / np.median(focals)
    # Where cameras look side by side, walk through a scene or come close to it, some are near as a matter of course.
    alone = (nearest > GAP * np.median(nearest)) & (nearest > distance)
    inside = _alone(1 / np.maximum(far, 1e-300)) & alone
    for i in np.flatnonzero(_alone(far) | inside).tolist():
        reasons.setdefault(i, []).append(f"{far[i]:.2g} times as far from the scene")
    rising = np.sort(zoom)
    alike = np.searchsorted(rising, zoom * SAME_LENS) - np.searchsorted(rising, zoom / SAME_LENS)
    odd = np.flatnonzero(((zoom > ZOOMED) | (zoom < 1 / ZOOMED)) & (alike < LENS))
    for i in odd.tolist() if len(odd) <= len(labels) / 4 else ():  # else several lenses were used
        reasons.setdefault(i, []).append(f"focal length {zoom[i]:.2g} times as long")
    usual = float(np.median(counts)) if counts else 0.0
    for i, count in enumerate(counts):
        if count < FEW_SEEN * usual:
            reasons.setdefault(i, []).append(f"{count} points where others see {usual:.0f}")
    return [f"{labels[i]} ({', '.join(why)})" for i, why in sorted(reasons.items())]


def _alone(ratio: Array) -> NDArray[np.bool_]:
    """Which of the ratios to a median lie beyond `FAR` and beyond a gap."""
    rising = np.sort(ratio[ratio >= 1])
    after = rising[1:][rising[1:] > GAP * rising[:-1]]
    return np.asarray((ratio > FAR) & (ratio >= after.min(initial=np.inf)))


def _nearest(centres: Array) -> Array:
    """Distance of each to its nearest neighbour."""
    from scipy.spatial import KDTree  # a list imports this module, and computes nothing

    return np.asarray(KDTree(centres).query(centres, k=min(2, len(centres)))[0]).reshape(len(centres), -1)[:, -1]


def _focus(viewmats: Array) -> Array:
    """The point nearest to all optical axes."""
    centres, axes = invert_rigid(viewmats)[:, :3, 3], viewmats[:, 2, :3]
    planes = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    ridge = 1e-3 * len(axes) * np.eye(3)  # of parallel axes, which meet nowhere
    right = np.einsum("cij,cj->i", planes, centres) + ridge @ centres.mean(0)
    return np.asarray(np.linalg.solve(planes.sum(0) + ridge, right))
