"""L1 and SSIM between two images [H, W, C], with the gradient of the first; as in `novags.splats.training.losses`.

A row is worked on as W * C interleaved floats, in which a horizontal neighbour is C floats away. Three passes over the
rows, each parallel: horizontal window sums of the five products; vertical ones, the score and its three derivatives;
both directions of the derivatives, and the gradient. Planes of `moments` and `slopes` are H + 2 HALF_WINDOW rows of
`stride` floats, a multiple of LANES; the outer rows are zero, so that every window has all of its taps.
"""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..vectors.simd import LANES, constant, load, select, splat, store

WINDOW, HALF_WINDOW = 11, 5
MOMENTS, SLOPES = 5, 3  # means of x, y, x^2, y^2, x y; derivatives of the score by the means of x, x^2, x y
ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
C1, C2 = np.float32(0.01**2), np.float32(0.03**2)
LANE = constant(list(range(LANES)))


def plane(height: int, n: int) -> int:
    """Floats that a plane of moments or slopes takes."""
    return (height + 2 * HALF_WINDOW) * stride(n)


def stride(n: int) -> int:
    """Floats that a row of n takes in moments and slopes."""
    return -(-n // LANES) * LANES


@kernel
def horizontal(begin, end, image, target, channels, weights, moments):
    """Window sums along rows begin..end-1 of image, target [H, W * C]; writes the flat moments [MOMENTS, plane]."""
    height, n = image.shape
    padding, step = HALF_WINDOW * channels, -(-n // LANES) * LANES
    size = (height + 2 * HALF_WINDOW) * step
    # outside counts as zero
    xs, ys = np.zeros(step + 2 * padding, np.float32), np.zeros(step + 2 * padding, np.float32)
    for row in range(begin, end):
        for i in range(n):
            xs[padding + i], ys[padding + i] = image[row, i], target[row, i]
        for i in range(0, n, LANES):
            zero = splat(ZERO)
            sx, sy, sxx, syy, sxy = zero, zero, zero, zero, zero
            for tap in range(WINDOW):
                x, y = load(xs, i + tap * channels), load(ys, i + tap * channels)
                wx, wy = x * weights[tap], y * weights[tap]
                sx += wx
                sy += wy
                sxx += wx * x
                syy += wy * y
                sxy += wx * y
            at = (row + HALF_WINDOW) * step + i
            store(moments, at, sx)
            store(moments, at + size, sy)
            store(moments, at + 2 * size, sxx)
            store(moments, at + 3 * size, syy)
            store(moments, at + 4 * size, sxy)
        _clear_border(moments, MOMENTS, row, height, step)


@inline
def _clear_border(planes, n_planes, row, height, step):
    """The band with the first or last image row zeroes the rows beyond it."""
    for index in range(n_planes):
        start = index * (height + 2 * HALF_WINDOW) * step
        if row == 0:
            planes[start : start + HALF_WINDOW * step] = ZERO
        if row == height - 1:
            start += (height + HALF_WINDOW) * step
            planes[start : start + HALF_WINDOW * step] = ZERO


@inline
def _vertical(source, index, row, i, height, step, weights):
    """Window sum over the rows around `row` of one plane, at sixteen columns."""
    at = (index * (height + 2 * HALF_WINDOW) + row) * step + i
    total = splat(ZERO)
    for tap in range(WINDOW):
        total += load(source, at + tap * step) * weights[tap]
    return total


@kernel
def score(begin, end, height, n, moments, weights, slopes, sums):
    """SSIM of rows begin..end-1, summed to sums [H] float64; its derivatives to the flat slopes [SLOPES, plane]."""
    step = -(-n // LANES) * LANES
    size = (height + 2 * HALF_WINDOW) * step
    lanes = np.empty(LANES, np.float32)
    for row in range(begin, end):
        total = splat(ZERO)
        for i in range(0, n, LANES):
            mx = _vertical(moments, 0, row, i, height, step, weights)
            my = _vertical(moments, 1, row, i, height, step, weights)
            xx = _vertical(moments, 2, row, i, height, step, weights)
            yy = _vertical(moments, 3, row, i, height, step, weights)
            xy = _vertical(moments, 4, row, i, height, step, weights)
            a1, a2 = mx * my * TWO + C1, (xy - mx * my) * TWO + C2
            b1, b2 = mx * mx + my * my + C1, (xx - mx * mx) + (yy - my * my) + C2
            inverse = ONE / (b1 * b2)
            s = a1 * a2 * inverse
            inside = LANE() < np.float32(n - i)  # columns beyond the image do not count
            total += select(inside, s, ZERO)
            at = (row + HALF_WINDOW) * step + i
            store(slopes, at, select(inside, (my * (a2 - a1) - mx * s * (b2 - b1)) * inverse * TWO, ZERO))
            store(slopes, at + size, select(inside, -(s * b1 * inverse), ZERO))
            store(slopes, at + 2 * size, select(inside, a1 * inverse * TWO, ZERO))
        _clear_border(slopes, SLOPES, row, height, step)
        store(lanes, 0, total)
        in_double = 0.0
        for lane in range(LANES):
            in_double += lanes[lane]
        sums[row] = in_double


@kernel
def gradient(begin, end, image, target, channels, weights, slopes, l1_weight, ssim_weight, sums, v_image):
    """Rows begin..end-1 of v_image [H, n] = l1_weight sign(x - y) + ssim_weight dSSIM/dx; sums [H] float64 of |x - y|.

    slopes may be empty if ssim_weight is 0.
    """
    height, n = image.shape
    padding, step = HALF_WINDOW * channels, -(-n // LANES) * LANES
    length = step + 2 * padding
    padded, out = np.zeros(SLOPES * length, np.float32), np.zeros(SLOPES * step, np.float32)
    for row in range(begin, end):
        if ssim_weight != ZERO:
            for index in range(SLOPES):
                for i in range(0, n, LANES):
                    value = _vertical(slopes, index, row, i, height, step, weights)
                    store(padded, index * length + padding + i, value)
                for i in range(0, n, LANES):
                    total = splat(ZERO)
                    for tap in range(WINDOW):
                        total += load(padded, index * length + i + tap * channels) * weights[tap]
                    store(out, index * step + i, total)
        absolute = 0.0
        for i in range(n):
            a, b = image[row, i], target[row, i]
            sign = ONE if a > b else (-ONE if a < b else ZERO)
            ssim = out[i] + TWO * a * out[step + i] + b * out[2 * step + i]
            v_image[row, i] = l1_weight * sign + ssim_weight * ssim
        for i in range(n):
            absolute += abs(image[row, i] - target[row, i])
        sums[row] = absolute
