"""One picture seen from another camera, by the true surface: which pixels it takes, and with which weights.

A pixel and its surroundings move to the other camera by the homography of its tangent plane, K' (R + t m^T) K^-1. The
value there is found by cubic convolution (Keys 1981), whose kernel hardly blurs; where the other picture is finer than
this one it is sampled several times, so that the whole pixel is averaged. The result is a sparse matrix: the variance
of the warped picture follows from the squares of its entries.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from novags.methods.averaging.config import Kernel
from novags.methods.averaging.surface import Array, Mask, SurfaceCamera, same_depth

FINER = 1.1  # pixels of the other picture along one of this one, from which on it is sampled several times
MOST_SAMPLES = 8  # along a side of a pixel; where the other picture is finer still, some of its pixels are left out
ENOUGH = 0.5  # of the kernel's weight must lie on the same surface: dividing by less would magnify noise and errors


@dataclass(frozen=True, kw_only=True)
class Rules:
    """When a view counts as seeing a pixel, and how the value between its pixels is found.

    Attributes:
        kernel: "cubic" (Keys, a = -1/2) or "linear".
        coarsest: Length of a pixel of the other picture on the surface, in pixels of this one, up to which it is used.
        mixed: Whether pixels through which an edge passes are used for pixels that show a single surface, and places
            so near to the rim of a picture that the kernel reaches beyond it.
    """

    kernel: Kernel = "cubic"
    coarsest: float = math.inf
    mixed: bool = True


def warp(target: SurfaceCamera, source: SurfaceCamera, rows: NDArray[np.intp], rules: Rules) -> tuple[csr_array, Mask]:
    """The samples that some pixels of `target` take from `source`.

    Args:
        target: The camera whose picture is wanted.
        source: The camera whose picture is there.
        rows: Flat indices [n] of the wanted pixels.
        rules: See `Rules`.

    Returns:
        Weights [n, pixels of source], of which each row sums to 1, or to 0 where the source does not see the pixel; and
        whether it does, [n].
    """
    homographies = homographies_of(target, source, rows)
    centres = centres_of(rows, target)
    seen, nearest = _seen(target, source, rows, centres, homographies, rules)
    single = target.whole.ravel()[rows] & (not rules.mixed)
    steps = _steps(homographies, centres)
    largest = np.where(seen, steps.max(-1), 1.0)
    samples = np.where(largest <= FINER, 1, np.minimum(np.ceil(largest) + 1, MOST_SAMPLES)).astype(int)
    total = csr_array((len(rows), source.size[0] * source.size[1]))
    for count in np.unique(samples[seen]):
        some = np.flatnonzero(seen & (samples == count))
        places = _places(centres[some], steps[some], homographies[some], int(count))
        columns, values = _taps(places, source.size, rules.kernel)
        values *= _on_surface(source, nearest[some], columns, single[some])
        entries = (values.ravel(), (np.repeat(some, values[0].size), columns.ravel()))
        total = total + csr_array(entries, shape=total.shape)
    weight = np.asarray(total.sum(1))
    seen &= weight >= ENOUGH
    scale = np.where(seen, 1 / np.where(seen, weight, 1.0), 0.0)
    return csr_array(total.multiply(scale[:, None])), seen


def centres_of(rows: NDArray[np.intp], camera: SurfaceCamera) -> Array:
    """Image points [n, 2] of pixels given by flat indices."""
    row, column = np.divmod(rows, camera.size[1])
    return np.stack([column, row], -1).astype(np.float64) + 0.5


def homographies_of(target: SurfaceCamera, source: SurfaceCamera, rows: NDArray[np.intp]) -> Array:
    """From image points of `target` to image points of `source`, by the plane of each of these pixels, [n, 3, 3]."""
    motion = source.viewmat @ np.linalg.inv(target.viewmat)
    planes = target.planes.reshape(-1, 3)[rows]
    between = motion[:3, :3] + motion[:3, 3][None, :, None] * planes[:, None, :]
    return np.asarray(source.K @ between @ np.linalg.inv(target.K))


def moved(homographies: Array, points: Array) -> tuple[Array, Array]:
    """Image points [n, 2] through one homography each, and the factor by which their depth changes [n]."""
    ahead = np.einsum("nij,nj->ni", homographies, np.concatenate([points, np.ones((len(points), 1))], 1))
    depth = np.where(np.abs(ahead[:, 2]) > 1e-12, ahead[:, 2], 1e-12)  # in the plane of the camera: out of every image
    return ahead[:, :2] / depth[:, None], ahead[:, 2]


def _seen(
    target: SurfaceCamera,
    source: SurfaceCamera,
    rows: NDArray[np.intp],
    centres: Array,
    homographies: Array,
    rules: Rules,
) -> tuple[Mask, NDArray[np.intp]]:
    """Whether the source sees the surface at these pixels, and its pixels nearest to them."""
    height, width = source.size
    points, factor = moved(homographies, centres)
    rim = 0.0 if rules.mixed else 1.5 if rules.kernel == "cubic" else 0.5
    inside = (factor > 0) & (points >= rim).all(-1) & (points < (width - rim, height - rim)).all(-1)
    column, row = np.where(inside[:, None], points, 0.0).astype(int).T
    nearest = row * width + column
    inverse = target.inverse_depth.ravel()[rows] / np.where(inside, factor, 1.0)
    same = same_depth(source.at(nearest, points), inverse, source.tolerance)
    fine = _finest(homographies, centres) >= 1 / rules.coarsest
    whole = source.whole.ravel()[nearest] | ~target.whole.ravel()[rows]
    return inside & same & fine & (whole | rules.mixed), nearest


def _jacobian(homographies: Array, centres: Array) -> Array:
    """How far image points of the source move with image points of the target, [n, 2 (u, v), 2 (x, y)]."""
    points, factor = moved(homographies, centres)
    factor = np.where(np.abs(factor) > 1e-12, factor, 1e-12)  # as in `moved`
    slope = homographies[:, :2, :2] - points[:, :, None] * homographies[:, 2:, :2]
    return np.asarray(slope / factor[:, None, None])


def _steps(homographies: Array, centres: Array) -> Array:
    """Pixels of the source along a pixel of the target, in x and in y, [n, 2]."""
    return np.asarray(np.linalg.norm(_jacobian(homographies, centres), axis=1))


def _finest(homographies: Array, centres: Array) -> Array:
    """Pixels of the source along a pixel of the target in the direction where they are fewest, [n]."""
    return np.asarray(np.linalg.svd(_jacobian(homographies, centres), compute_uv=False)[:, -1])


def _places(centres: Array, steps: Array, homographies: Array, count: int) -> Array:
    """Image points of the source at which pixels are sampled, [n, count^2, 2].

    A pixel of the source is an average over its own area already. The samples are spread over the rest of the area of
    the target's pixel: variances of box filters add.
    """
    reach = np.sqrt(np.maximum(0.0, 1 - 1 / np.maximum(steps, 1.0) ** 2))
    ticks = (np.arange(count) + 0.5) / count - 0.5
    grid = np.stack(np.meshgrid(ticks, ticks), -1).reshape(-1, 2)
    points = centres[:, None] + reach[:, None] * grid
    flat, _ = moved(np.repeat(homographies, len(grid), 0), points.reshape(-1, 2))
    return flat.reshape(points.shape)


def _taps(places: Array, size: tuple[int, int], kernel: Kernel) -> tuple[NDArray[np.intp], Array]:
    """Pixels of the source around each sample, and their weights, [n, samples, taps^2]; beyond the rim, the rim's."""
    height, width = size
    first = np.floor(places - 0.5)
    fraction = places - 0.5 - first
    offsets = np.arange(-1, 3) if kernel == "cubic" else np.arange(2)
    weights = _keys(fraction[..., None] - offsets) if kernel == "cubic" else 1 - np.abs(fraction[..., None] - offsets)
    index = np.clip(first[..., None] + offsets, 0, np.array([width, height])[:, None] - 1).astype(int)
    columns = index[..., 1, :, None] * width + index[..., 0, None, :]
    values = weights[..., 1, :, None] * weights[..., 0, None, :] / places.shape[1]
    return columns.reshape(*places.shape[:2], -1), values.reshape(*places.shape[:2], -1)


def _keys(x: Array) -> Array:
    """The kernel of cubic convolution with a = -1/2 (Keys 1981, equation 15)."""
    x = np.abs(x)
    inner, outer = (1.5 * x - 2.5) * x * x + 1, ((-0.5 * x + 2.5) * x - 4) * x + 2
    return np.asarray(np.where(x <= 1, inner, np.where(x < 2, outer, 0.0)))


def _on_surface(source: SurfaceCamera, nearest: NDArray[np.intp], columns: NDArray[np.intp], single: Mask) -> Mask:
    """Which pixels [n, samples, taps] may be used; of rows that show a single surface, the pixels that show it
    alone.
    """
    rows = np.broadcast_to(nearest[:, None, None], columns.shape).ravel()
    flat = columns.ravel()
    expected = source.at(rows, centres_of(flat, source))
    same = same_depth(expected, source.inverse_depth.ravel()[flat], source.tolerance) & source.whole.ravel()[flat]
    return same.reshape(columns.shape) | ~single[:, None, None]
