"""L1 and SSIM between two images [H, W, C], with the gradient of the first; definitions as in `novags.splats.losses`.

Rows are worked on as W * C interleaved floats, in which a horizontal neighbour is C floats away: plain loops over them
are what compilers vectorise best. Three passes over the rows, each parallel: horizontal window sums of the five
products; vertical ones, the score and its three derivatives; both directions of the derivatives, and the gradient.
"""

# mypy: allow-untyped-defs

import numpy as np

from .compiler import inline, kernel

WINDOW, HALF_WINDOW = 11, 5
MOMENTS = 5  # x, y, x^2, y^2, x y
ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
C1, C2 = np.float32(0.01**2), np.float32(0.03**2)


@inline
def _add_scaled(target, source, start, n, weight):
    for i in range(n):
        target[i] += weight * source[start + i]


@kernel
def horizontal(begin, end, image, target, channels, weights, moments):
    """Window sums along rows begin..end-1 of image, target [H, W * C]; writes moments [MOMENTS, H, W * C]."""
    n = image.shape[1]
    pad = HALF_WINDOW * channels
    padded = np.zeros((MOMENTS, n + 2 * pad), np.float32)  # outside counts as zero
    for y in range(begin, end):
        for i in range(n):
            a, b = image[y, i], target[y, i]
            padded[0, pad + i], padded[1, pad + i] = a, b
            padded[2, pad + i], padded[3, pad + i], padded[4, pad + i] = a * a, b * b, a * b
        for moment in range(MOMENTS):
            out, source = moments[moment, y], padded[moment]
            out[:] = ZERO
            for tap in range(WINDOW):
                _add_scaled(out, source, tap * channels, n, weights[tap])


@inline
def _vertical(source, y, weights, out):
    """Window sum over the rows around y of source [H, n]."""
    out[:] = ZERO
    for tap in range(WINDOW):
        row = y + tap - HALF_WINDOW
        if 0 <= row < len(source):
            _add_scaled(out, source[row], 0, len(out), weights[tap])


@kernel
def score(begin, end, moments, weights, slopes, sums):
    """SSIM of rows begin..end-1: sums [H] float64, and slopes [3, H, n], its derivatives to E x, E x^2, E x y."""
    n = moments.shape[2]
    m = np.empty((MOMENTS, n), np.float32)
    values = np.empty(n, np.float32)
    for y in range(begin, end):
        for moment in range(MOMENTS):
            _vertical(moments[moment], y, weights, m[moment])
        for i in range(n):
            mx, my = m[0, i], m[1, i]
            a1, a2 = TWO * mx * my + C1, TWO * (m[4, i] - mx * my) + C2
            b1, b2 = mx * mx + my * my + C1, (m[2, i] - mx * mx) + (m[3, i] - my * my) + C2
            inverse = ONE / (b1 * b2)
            s = a1 * a2 * inverse
            values[i] = s
            slopes[0, y, i] = TWO * (my * (a2 - a1) * inverse - mx * s * (b2 - b1) * inverse)
            slopes[1, y, i] = -s * b1 * inverse
            slopes[2, y, i] = TWO * a1 * inverse
        total = 0.0
        for i in range(n):
            total += values[i]
        sums[y] = total


@kernel
def gradient(begin, end, image, target, channels, weights, slopes, l1_weight, ssim_weight, sums, v_image):
    """Rows begin..end-1 of v_image [H, n] = l1_weight sign(x - y) + ssim_weight dSSIM/dx; sums [H] float64 of |x - y|.

    slopes may be empty [3, 0, 0] if ssim_weight is 0.
    """
    n = image.shape[1]
    pad = HALF_WINDOW * channels
    padded = np.zeros(n + 2 * pad, np.float32)
    out = np.zeros((3, n), np.float32)
    for y in range(begin, end):
        if ssim_weight != ZERO:
            for k in range(3):
                _vertical(slopes[k], y, weights, padded[pad : pad + n])
                out[k] = ZERO
                for tap in range(WINDOW):
                    _add_scaled(out[k], padded, tap * channels, n, weights[tap])
        for i in range(n):
            a, b = image[y, i], target[y, i]
            sign = ONE if a > b else (-ONE if a < b else ZERO)
            v_image[y, i] = l1_weight * sign + ssim_weight * (out[0, i] + TWO * a * out[1, i] + b * out[2, i])
        total = 0.0
        for i in range(n):
            total += abs(image[y, i] - target[y, i])
        sums[y] = total
