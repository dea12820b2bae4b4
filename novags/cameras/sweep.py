"""Depth of pictures with known cameras and nothing else: a plane sweep at low resolution (Collins 1996).

Each picture is compared, on planes of every depth in front of it, with its neighbours; the score is the normalised
cross-correlation of small windows, which neither noise nor exposure biases. Semi-global matching (Hirschmueller 2008)
carries depths from where pictures agree to where they show nothing.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from novags.cameras.estimate import Array, centers_of

SIZE = 64  # px, longest side: averaging makes dark pictures comparable, and first points need no more
PLANES = 64  # depths tried, about a pixel of parallax apart at this size
NEIGHBOURS = 4  # pictures that each one is compared with
WINDOW = 5  # px
# Costs of a depth that changes by one plane, or by more, from pixel to pixel; a match costs 0..1.
SMOOTH, JUMP = 0.1, 0.6
REFERENCES = 48  # views with a depth map, at most
FARTHEST = 30.0  # of a plane, in extents of the cameras

Float = NDArray[np.float32]


@dataclass(frozen=True)
class Sweep:
    """Depth maps at low resolution.

    Attributes:
        views: Index of the view of each map [M].
        Ks: Intrinsics at this size [M, 3, 3].
        depth: z-depths [M, h, w]; nan where fewer than two views see anything.
    """

    views: NDArray[np.intp]
    Ks: Array
    depth: Array


def sweep(images: Float, viewmats: Array, Ks: Array) -> Sweep | None:
    """Depth maps of some of the views; None if no two of them see one place from different positions.

    Args:
        images: [C, h, w, 3], any exposure.
        viewmats: [C, 4, 4].
        Ks: [C, 3, 3].
    """
    small, small_Ks = reduced(images, Ks)
    references = np.unique(np.linspace(0, len(images) - 1, min(len(images), REFERENCES)).round().astype(int))
    views, maps = [], []
    for i in references:
        near = neighbours(viewmats, i)
        inverse = planes(viewmats, small_Ks, i, near, small.shape[1:])
        if inverse is None:
            continue
        cost = costs(small, viewmats, small_Ks, i, near, inverse)
        total = semi_global(np.nan_to_num(cost, nan=1.0))
        best = total.argmin(0)
        seen = np.isfinite(np.take_along_axis(cost, best[None], 0)[0])
        steps = between(total, best)
        views.append(i)
        maps.append(np.where(seen, 1 / np.interp(steps, np.arange(len(inverse)), inverse), np.nan))
    if not maps:
        return None
    return Sweep(np.array(views), small_Ks[views], np.stack(maps))


def reduced(images: Float, Ks: Array) -> tuple[Float, Array]:
    """Grey pictures [C, h, w] at most `SIZE` large, and their intrinsics."""
    height, width = images.shape[1:3]
    factor = min(1.0, SIZE / max(height, width))
    size = max(8, round(width * factor)), max(8, round(height * factor))
    small = np.stack([cv2.resize(image.mean(-1), size, interpolation=cv2.INTER_AREA) for image in images])
    return small.astype(np.float32), Ks * np.array([size[0] / width, size[1] / height, 1.0])[:, None]


def neighbours(viewmats: Array, i: int) -> NDArray[np.intp]:
    """The nearest other cameras of view `i` that look the same way, within 60 degrees, and stand elsewhere."""
    centers, axes = centers_of(viewmats), viewmats[:, 2, :3]
    distance = np.linalg.norm(centers - centers[i], axis=1)
    apart = distance > 1e-3 * distance.max(initial=0.0)
    usable = np.flatnonzero(apart & (axes @ axes[i] > 0.5))
    return usable[np.argsort(distance[usable], kind="stable")][:NEIGHBOURS]


def planes(viewmats: Array, Ks: Array, i: int, near: NDArray[np.intp], shape: tuple[int, ...]) -> Array | None:
    """Inverse depths [PLANES], uniform over the range in which neighbours see some of the picture; None: they see
    nothing.
    """
    if not len(near):
        return None
    height, width = shape
    y, x = np.meshgrid(np.linspace(0.5, height - 0.5, 8), np.linspace(0.5, width - 0.5, 8), indexing="ij")
    rays = np.stack([x.ravel(), y.ravel(), np.ones(64)], -1) @ np.linalg.inv(Ks[i]).T
    reach = np.linalg.norm(centers_of(viewmats) - centers_of(viewmats)[i], axis=1).max()
    tried = np.geomspace(1 / (FARTHEST * reach), 1e3 / reach, 200)
    seen = np.zeros((len(tried), 64), int)
    for j in near:
        relative = viewmats[j] @ np.linalg.inv(viewmats[i])
        at = (rays @ relative[:3, :3].T)[None] + tried[:, None, None] * relative[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = (at @ Ks[j].T)[..., :2] / at[..., 2:]
        seen += (at[..., 2] > 0) & ((pixels >= 0) & (pixels < [width, height])).all(-1)
    some = np.flatnonzero((seen >= min(2, len(near))).mean(1) >= 0.1)
    return np.linspace(tried[some[0]], tried[some[-1]], PLANES) if len(some) > 1 else None


def costs(small: Float, viewmats: Array, Ks: Array, i: int, near: NDArray[np.intp], inverse: Array) -> Float:
    """How badly view `i` agrees with its neighbours on each plane [D, h, w]: 0..1, nan where too few see it.

    The mean over the two best neighbours: the place may be hidden from the others.
    """
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV counts pixel centres from 0
    here = _Windows.of(small[i])
    others = [np.stack([small[j], np.ones_like(small[j])], -1) for j in near]
    moves = [viewmats[j] @ np.linalg.inv(viewmats[i]) for j in near]
    after, before = [np.linalg.inv(half) @ Ks[j] for j in near], np.linalg.inv(Ks[i]) @ half
    found = np.full((len(inverse), *small.shape[1:]), np.nan, np.float32)
    for d, w in enumerate(inverse):
        first = second = np.full(small.shape[1:], -np.inf, np.float32)
        for n, move in enumerate(moves):
            plane = move[:3, :3].copy()
            plane[:, 2] += w * move[:3, 3]
            score = here.correlation(others[n], after[n] @ plane @ before)
            first, second = np.maximum(first, score), np.maximum(second, np.minimum(first, score))
        best = first if len(near) == 1 else (first + second) / 2
        found[d] = np.where(best >= -1, (1 - best) / 2, np.nan)
    return found


@dataclass(frozen=True)
class _Windows:
    """A picture [h, w] with mean and variance of the window around each pixel."""

    image: Float
    mean: Float
    variance: Float

    @staticmethod
    def of(image: Float) -> "_Windows":
        mean, square = np.moveaxis(cv2.blur(np.stack([image, image * image], -1), (WINDOW, WINDOW)), -1, 0)
        return _Windows(image, mean, np.maximum(square - mean * mean, 0))

    def correlation(self, other: Float, H: Array) -> Float:
        """Normalised cross-correlation with the windows of another picture warped onto it [h, w]; -inf outside that.

        Args:
            other: [h, w, 2], the picture, and ones.
            H: From pixels here to pixels there, [3, 3].
        """
        height, width = self.image.shape
        corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]]) @ H[2]
        if corners.min() <= 0:  # partly behind the other camera, where it sees nothing
            return np.full((height, width), -np.inf, np.float32)
        warped = cv2.warpPerspective(other, H, (width, height), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        there = warped[..., 0]
        sums = cv2.blur(np.stack([there, there * there, there * self.image], -1), (WINDOW, WINDOW))
        mean = sums[..., 0]
        variance = np.maximum(sums[..., 1] - mean * mean, 0)
        # 1e-8: a window of one shade correlates with nothing; codes of dark pictures differ by 4e-3 and more
        score = (sums[..., 2] - self.mean * mean) / np.sqrt(self.variance * variance + 1e-8)
        score[warped[..., 1] < 0.999] = -np.inf
        return np.asarray(score)


def semi_global(cost: Float) -> Float:
    """Costs [D, h, w] with the costs of smooth paths from four sides added."""
    total = np.zeros_like(cost)
    for axis, flip in ((1, False), (1, True), (2, False), (2, True)):
        volume = np.moveaxis(np.flip(cost, axis) if flip else cost, axis, 0)  # [steps, D, across]
        paths = np.empty_like(volume)
        paths[0] = volume[0]
        for k in range(1, len(volume)):
            before = paths[k - 1]
            least = before.min(0)
            step = np.minimum(before, least + JUMP)
            step[1:] = np.minimum(step[1:], before[:-1] + SMOOTH)
            step[:-1] = np.minimum(step[:-1], before[1:] + SMOOTH)
            paths[k] = volume[k] + step - least
        back = np.moveaxis(paths, 0, axis)
        total += np.flip(back, axis) if flip else back
    return total


def between(cost: Float, best: NDArray[np.intp]) -> Array:
    """Planes of least cost [h, w] as fractions: the lowest points of parabolas through the best and its neighbours."""
    inner = np.clip(best, 1, len(cost) - 2)
    below, here, above = (np.take_along_axis(cost, (inner + k)[None], 0)[0].astype(np.float64) for k in (-1, 0, 1))
    bend = below - 2 * here + above
    # 1e-6: three equal costs are not a parabola. At the ends of the range the lowest point may lie outside it.
    shift = np.where(bend > 1e-6, (below - above) / np.maximum(2 * bend, 1e-6), 0.0)
    return np.where(inner == best, inner + np.clip(shift, -0.5, 0.5), best)
