"""L1 and SSIM between two images [H, W, C], with the gradient of the first; as in `novags.splats.training.losses`.

A row is W * C interleaved floats. For the windows its values are dealt to the lanes: lane l of vector i holds value
l * length + i. A neighbour along the row is then a whole aligned vector away, like one along the column; sixteen values
in a row would straddle cache lines at every tap. Rows roll through rings that hold what the windows above and below
still need, so no picture of moments or derivatives is ever stored.
"""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..vectors.simd import LANES, from_left, from_right, load, negative_abs, select, splat, store
from ..vectors.transpose import transpose

WINDOW, HALF_WINDOW = 11, 5
MOMENTS, SLOPES = 4, 3  # x, y, x^2 + y^2, x y; derivatives of the score by the means of x, x^2, x y
RING, BLOCK = 16, 4  # rows; the windows of a block reach over BLOCK + WINDOW - 1
ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
C1, C2 = np.float32(0.01**2), np.float32(0.03**2)
LINE = 16  # floats of a cache line


@kernel
def absolute(begin, end, image, target, weight, sums, v_image):
    """Rows begin..end-1 of v_image [H, n] = weight sign(x - y); sums [H] float64 of |x - y|."""
    n = image.shape[1]
    x, y, v = image.reshape(-1), target.reshape(-1), v_image.reshape(-1)
    for row in range(begin, end):
        at, last = row * n, (row + 1) * n
        whole = last - n % LANES
        total = splat(ZERO)
        for i in range(at, whole, LANES):
            difference = load(x, i) - load(y, i)
            total += negative_abs(difference)
            store(v, i, select(difference > ZERO, weight, select(difference < ZERO, -weight, ZERO)))
        in_double = -_sum(total)
        for i in range(whole, last):
            difference = x[i] - y[i]
            in_double += abs(difference)
            v[i] = weight if difference > ZERO else (-weight if difference < ZERO else ZERO)
        sums[row] = in_double


@inline
def _sum(vector):
    lanes, total = np.empty(LANES, np.float32), 0.0
    store(lanes, 0, vector)
    for lane in range(LANES):
        total += lanes[lane]
    return total


@kernel
def structure(begin, end, image, target, channels, weights, weight, sums, v_image):
    """Add weight dSSIM/dx to rows begin..end-1 of v_image [H, n]; sums [H] float64 of SSIM.

    Args:
        begin: First row.
        end: Past the last.
        image: x [H, W * C].
        target: y [H, W * C].
        channels: C.
        weights: Of the window [WINDOW], symmetric.
        weight: Of SSIM.
        sums: Written.
        v_image: Added to.
    """
    height, n = image.shape
    length = -(-n // (2 * channels * LANES)) * 2 * channels  # vectors of a row: windows are made by twos
    step, plane = _sizes(length, channels)
    w = weights[0], weights[1], weights[2], weights[3], weights[4], weights[5]
    moments, slopes = _scratch(MOMENTS * RING * step), _scratch(SLOPES * RING * step)
    rows, line = _scratch(BLOCK * MOMENTS * plane + LANES * LANES), _scratch((LANES + 1) * (length + LANES))
    inside = _scratch(step)
    for i in range(length):
        for lane in range(LANES):
            inside[i * LANES + lane] = ONE if lane * length + i < n else ZERO
    for new in range(begin - 2 * HALF_WINDOW, end + 2 * HALF_WINDOW, BLOCK):
        for row in range(new, new + BLOCK):
            _enter(row, image, target, length, step, line, rows, moments)
        row = new - HALF_WINDOW
        if row + BLOCK > begin - HALF_WINDOW:
            _down(moments, MOMENTS, row, length, channels, w, rows)
            for k in range(BLOCK):
                shown = ONE if 0 <= row + k < height else ZERO
                total = _score(row + k, rows, k * MOMENTS * plane, length, channels, w, inside, shown, slopes)
                if begin <= row + k < end:
                    sums[row + k] = total
        row -= HALF_WINDOW
        if row >= begin:
            _down(slopes, SLOPES, row, length, channels, w, rows)
            for k in range(min(BLOCK, end - row)):
                start = k * SLOPES * plane
                _combine(row + k, rows, start, length, channels, w, moments, weight)
                _collect(rows, start, length, line)
                for i in range(n):
                    v_image[row + k, i] += line[i]


@inline
def _sizes(length, channels):
    """Floats of a row of `length` vectors in a ring, and beside the neighbours of both ends.

    A ring's rows are an odd number of cache lines apart: multiples of 4096 bytes would share few places in the cache.
    """
    return (length | 1) * LANES, (length + 2 * HALF_WINDOW * channels) * LANES


@inline
def _scratch(size):
    """Memory that begins at a cache line."""
    whole = np.empty(size + LINE, np.float32)
    start = -(whole.ctypes.data // 4) % LINE
    return whole[start : start + size]


@inline
def _place(row, index, step):
    """Where a ring holds a row of a plane."""
    return (RING * index + row % RING) * step


@inline
def _enter(row, image, target, length, step, line, dealt, moments):
    """A row of both pictures, and their products, to the ring; zero outside."""
    inside, size, place = 0 <= row < len(image), (length + LANES) * LANES, _place(row, 0, step)
    if inside:
        _deal(image, row, line, dealt, 0, length)
        _deal(target, row, line, dealt, size, length)
    for at in range(0, length * LANES, LANES):
        x, y = splat(ZERO), splat(ZERO)
        if inside:
            x, y = load(dealt, at), load(dealt, size + at)
        store(moments, place + at, x)
        store(moments, place + RING * step + at, y)
        store(moments, place + 2 * RING * step + at, x * x + y * y)
        store(moments, place + 3 * RING * step + at, x * y)


@inline
def _deal(image, row, line, dealt, start, length):
    """The vectors of a row; those after the last are rubbish."""
    n = image.shape[1]
    for i in range(n):
        line[i] = image[row, i]
    line[n : LANES * length] = ZERO
    for i in range(0, length, LANES):
        transpose(line, i, length, dealt, start + i * LANES, LANES)


@inline
def _collect(rows, start, length, line):
    """The reverse of `_deal`, for the vectors from rows[start] on; those after the last are overwritten."""
    for at in range(start, start + -length % LANES * LANES, LANES):  # the last transposition writes these too
        store(rows, at + length * LANES, from_right(load(rows, at)))
    for i in range(0, length, LANES):
        transpose(rows, start + i * LANES, LANES, line, i, length)


@inline
def _down(ring, planes, row, length, channels, w, rows):
    """Window sums along the columns, for BLOCK rows from `row` on; to rows [BLOCK, planes, plane]."""
    step, plane = _sizes(length, channels)
    next_row, side = planes * plane, HALF_WINDOW * channels * LANES
    for index in range(planes):
        start, top = index * plane + side, row - HALF_WINDOW
        r0, r1, r2 = _place(top, index, step), _place(top + 1, index, step), _place(top + 2, index, step)
        r3, r4, r5 = _place(top + 3, index, step), _place(top + 4, index, step), _place(top + 5, index, step)
        r6, r7, r8 = _place(top + 6, index, step), _place(top + 7, index, step), _place(top + 8, index, step)
        r9, r10, r11 = _place(top + 9, index, step), _place(top + 10, index, step), _place(top + 11, index, step)
        r12, r13 = _place(top + 12, index, step), _place(top + 13, index, step)
        for at in range(0, length * LANES, LANES):
            a, b, c, d = load(ring, r0 + at), load(ring, r1 + at), load(ring, r2 + at), load(ring, r3 + at)
            e, f, g, h = load(ring, r4 + at), load(ring, r5 + at), load(ring, r6 + at), load(ring, r7 + at)
            i, j, k, m = load(ring, r8 + at), load(ring, r9 + at), load(ring, r10 + at), load(ring, r11 + at)
            p, q = load(ring, r12 + at), load(ring, r13 + at)
            store(rows, start + at, _window(a, b, c, d, e, f, g, h, i, j, k, w))
            store(rows, start + next_row + at, _window(b, c, d, e, f, g, h, i, j, k, m, w))
            store(rows, start + 2 * next_row + at, _window(c, d, e, f, g, h, i, j, k, m, p, w))
            store(rows, start + 3 * next_row + at, _window(d, e, f, g, h, i, j, k, m, p, q, w))


@inline
def _across(rows, at, neighbour, w):
    """Window sums along a row, for two neighbours: of the vectors from rows[at] on."""
    a, b, c = load(rows, at), load(rows, at + neighbour), load(rows, at + 2 * neighbour)
    d, e, f = load(rows, at + 3 * neighbour), load(rows, at + 4 * neighbour), load(rows, at + 5 * neighbour)
    g, h, i = load(rows, at + 6 * neighbour), load(rows, at + 7 * neighbour), load(rows, at + 8 * neighbour)
    j, k, m = load(rows, at + 9 * neighbour), load(rows, at + 10 * neighbour), load(rows, at + 11 * neighbour)
    return _window(a, b, c, d, e, f, g, h, i, j, k, w), _window(b, c, d, e, f, g, h, i, j, k, m, w)


@inline
def _window(a, b, c, d, e, f, g, h, i, j, k, w):
    return (a + k) * w[0] + (b + j) * w[1] + (c + i) * w[2] + (d + h) * w[3] + (e + g) * w[4] + f * w[5]


@inline
def _join(rows, start, planes, length, channels):
    """Both neighbours of dealt rows: the first vectors of the next lane, the last ones of the lane before."""
    plane, side, size = _sizes(length, channels)[1], HALF_WINDOW * channels * LANES, length * LANES
    for first in range(start + side, start + side + planes * plane, plane):
        for at in range(first, first + side, LANES):
            store(rows, at + size, from_right(load(rows, at)))
        for at in range(first - LANES, first - side - LANES, -LANES):
            store(rows, at, from_left(load(rows, at + size)))


@inline
def _score(row, rows, start, length, channels, w, inside, shown, slopes):
    """SSIM of a row, summed, and its derivatives to the ring; all zero if the row is not `shown`."""
    step, plane = _sizes(length, channels)
    neighbour, place, total = channels * LANES, _place(row, 0, step), splat(ZERO)
    _join(rows, start, MOMENTS, length, channels)
    for i in range(0, length * LANES, 2 * neighbour):
        for at in range(i, i + neighbour, LANES):
            x, x_next = _across(rows, start + at, neighbour, w)
            y, y_next = _across(rows, start + plane + at, neighbour, w)
            squares, squares_next = _across(rows, start + 2 * plane + at, neighbour, w)
            product, product_next = _across(rows, start + 3 * plane + at, neighbour, w)
            total += _ssim(x, y, squares, product, load(inside, at) * shown, slopes, place + at, step)
            counts = load(inside, at + neighbour) * shown
            total += _ssim(x_next, y_next, squares_next, product_next, counts, slopes, place + neighbour + at, step)
    return _sum(total)


@inline
def _ssim(mx, my, squares, product, counts, slopes, at, step):
    """The score from the means of x, y, x^2 + y^2 and x y; its derivatives to the ring. Zero where `counts` is."""
    both, means = mx * my, mx * mx + my * my
    a1, a2 = both * TWO + C1, (product - both) * TWO + C2
    b1, b2 = means + C1, squares - means + C2
    holds, inverse = counts > ZERO, ONE / (b1 * b2)
    s = a1 * a2 * inverse
    store(slopes, at, select(holds, (my * (a2 - a1) - mx * s * (b2 - b1)) * inverse * TWO, ZERO))
    store(slopes, at + RING * step, select(holds, -(s * b1 * inverse), ZERO))
    store(slopes, at + 2 * RING * step, select(holds, a1 * inverse * TWO, ZERO))
    return select(holds, s, ZERO)


@inline
def _combine(row, rows, start, length, channels, w, moments, weight):
    """The gradient of a row, weight dSSIM/dx, in place of the first plane."""
    step, plane = _sizes(length, channels)
    neighbour, place = channels * LANES, _place(row, 0, step)
    _join(rows, start, SLOPES, length, channels)
    for i in range(0, length * LANES, 2 * neighbour):
        for at in range(i, i + neighbour, LANES):
            v_x, v_x_next = _across(rows, start + at, neighbour, w)
            v_xx, v_xx_next = _across(rows, start + plane + at, neighbour, w)
            v_xy, v_xy_next = _across(rows, start + 2 * plane + at, neighbour, w)
            x, y = load(moments, place + at), load(moments, place + RING * step + at)
            store(rows, start + at, (v_x + TWO * x * v_xx + y * v_xy) * weight)  # no window needs this place any more
            x = load(moments, place + neighbour + at)
            y = load(moments, place + RING * step + neighbour + at)
            store(rows, start + neighbour + at, (v_x_next + TWO * x * v_xx_next + y * v_xy_next) * weight)
