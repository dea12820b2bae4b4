"""EWA projection of sixteen Gaussians at a time, and its gradient. Formulas as in `raster_torch.project`."""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..vectors.simd import LANES, bits, ceil, copy, floor, load, maximum, minimum, negative_abs, select, sqrt, store
from ..vectors.transpose import to_columns3, to_columns4, transpose
from ..vectors.vector_math import log2
from .record import ALPHA_MIN, HALF_LOG2E, LOG2_ALPHA_MIN, REACH_X, REACH_Y, ROW, SLOPE, TILE, TOP, A, K, Q, X, Y

ZERO, ONE, TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
MARGIN = np.float32(0.15)  # of the image size beyond its border: where gsplat stops following the affine approximation
MAX_RADIUS = np.float32(2**30)  # still an int32
INFINITY, LARGEST = np.float32(np.inf), np.finfo(np.float32).max
EVEN = np.float32(1e23)  # px^2: variance of a splat whose exponent falls by less than rounding over any image
CLOSE = np.float32(1e5)  # px: a splat that falls so little over an image does so seen from this far, too
PER_TILE = np.float32(1 / TILE)
INPUTS = 11  # per Gaussian: mean 3, quaternion 4, scale 3, opacity
GRAIN = 512  # Gaussians per range
# columns of `camera`, a float32 vector
VIEW, FX, FY, CX, CY, WIDTH, HEIGHT, NEAR, FAR, EPS2D = 0, 12, 13, 14, 15, 16, 17, 18, 19, 20
ANTIALIASED, RADIUS_CLIP = 21, 22  # 0 or 1; pixels


@inline
def _gather(means, quats, scales, opacities, first, count, columns):
    """Transpose `count` Gaussians into columns [INPUTS * LANES]."""
    if count == LANES:
        to_columns3(means.reshape(-1), 3 * first, columns, 0)
        to_columns4(quats.reshape(-1), 4 * first, columns, 3)
        to_columns3(scales.reshape(-1), 3 * first, columns, 7)
        store(columns, 10 * LANES, load(opacities, first))
        return
    for lane in range(count):
        i = first + lane
        for j in range(3):
            columns[j * LANES + lane] = means[i, j]
            columns[(7 + j) * LANES + lane] = scales[i, j]
        for j in range(4):
            columns[(3 + j) * LANES + lane] = quats[i, j]
        columns[10 * LANES + lane] = opacities[i]


@inline
def _to_camera(c, x, y, z):
    return (
        c[0] * x + c[1] * y + c[2] * z + c[3],
        c[4] * x + c[5] * y + c[6] * z + c[7],
        c[8] * x + c[9] * y + c[10] * z + c[11],
    )


@inline
def _rotation(w, x, y, z):
    """Rotation matrix of a quaternion, row by row, then the normalised quaternion and 1 / |q|."""
    # by the largest component first: the squares of long or short quaternions leave float32
    largest = -minimum(minimum(negative_abs(w), negative_abs(x)), minimum(negative_abs(y), negative_abs(z)))
    w, x, y, z = w / largest, x / largest, y / largest, z / largest
    inv = ONE / sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * inv, x * inv, y * inv, z * inv
    inv = minimum(inv / largest, LARGEST)  # of a subnormal length it would be infinite, and no gradient times it nan
    return (
        ONE - TWO * (y * y + z * z), TWO * (x * y - w * z), TWO * (x * z + w * y),
        TWO * (x * y + w * z), ONE - TWO * (x * x + z * z), TWO * (y * z - w * x),
        TWO * (x * z - w * y), TWO * (y * z + w * x), ONE - TWO * (x * x + y * y),
        w, x, y, z, inv,
    )  # fmt: skip


@inline
def _limits(c):
    """Slopes x / z and y / z between which the Jacobian follows the point."""
    fx, fy, cx, cy, width, height = c[FX], c[FY], c[CX], c[CY], c[WIDTH], c[HEIGHT]
    mx, my = MARGIN * width / fx, MARGIN * height / fy
    return -cx / fx - mx, (width - cx) / fx + mx, -cy / fy - my, (height - cy) / fy + my


@inline
def _jacobian(c, x, y, iz):
    """J = [[jx, 0, jxz], [0, jy, jyz]] and the slopes it was taken at."""
    x_low, x_high, y_low, y_high = _limits(c)
    sx, sy = x * iz, y * iz
    lx, ly = minimum(maximum(sx, x_low), x_high), minimum(maximum(sy, y_low), y_high)
    jx, jy = c[FX] * iz, c[FY] * iz
    return jx, jy, -jx * lx, -jy * ly, lx == sx, ly == sy


@inline
def _image_axes(c, jx, jy, jxz, jyz):
    """T = J W, the 2x3 matrix from world to image displacements."""
    return (
        jx * c[0] + jxz * c[8], jx * c[1] + jxz * c[9], jx * c[2] + jxz * c[10],
        jy * c[4] + jyz * c[8], jy * c[5] + jyz * c[9], jy * c[6] + jyz * c[10],
    )  # fmt: skip


@inline
def _times_rotation(t, r):
    """T R, 2x3."""
    return (
        t[0] * r[0] + t[1] * r[3] + t[2] * r[6], t[0] * r[1] + t[1] * r[4] + t[2] * r[7],
        t[0] * r[2] + t[1] * r[5] + t[2] * r[8], t[3] * r[0] + t[4] * r[3] + t[5] * r[6],
        t[3] * r[1] + t[4] * r[4] + t[5] * r[7], t[3] * r[2] + t[4] * r[5] + t[5] * r[8],
    )  # fmt: skip


@inline
def _footprint(m, eps):
    """a, k and q of the sheared form of the covariance M M^T + eps; its xx entry and its determinant."""
    m00, m01, m02, m10, m11, m12 = m
    row0, row1 = m00 * m00 + m01 * m01 + m02 * m02, m10 * m10 + m11 * m11 + m12 * m12
    d01, d02, d12 = m00 * m11 - m01 * m10, m00 * m12 - m02 * m10, m01 * m12 - m02 * m11
    # Cauchy-Binet: the determinant as a sum of squares. c_xx c_yy - c_xy^2 loses all digits for needles.
    det = (d01 * d01 + d02 * d02 + d12 * d12) + eps * (row0 + row1) + eps * eps
    inverse = ONE / (row1 + eps)
    return (row1 + eps) / det, -(m00 * m10 + m01 * m11 + m02 * m12) * inverse, inverse, row0 + eps, det


@inline
def _dilation(m, eps):
    """The determinant of M M^T as a sum of squares, and the share that the dilation adds to it; see `_footprint`."""
    m00, m01, m02, m10, m11, m12 = m
    rows = m00 * m00 + m01 * m01 + m02 * m02 + (m10 * m10 + m11 * m11 + m12 * m12)
    d01, d02, d12 = m00 * m11 - m01 * m10, m00 * m12 - m02 * m10, m01 * m12 - m02 * m11
    sharp = d01 * d01 + d02 * d02 + d12 * d12
    return sharp, eps * (rows + eps) / sharp


@kernel
def forward(begin, end, means, quats, scales, opacities, camera, rows, depths, radii, tiles, counts, suspect):
    """Project Gaussians begin..end-1.

    Writes rows [N, ROW] (channels zero; X and Y too where not visible), depths [N], radii [N] int32 (0: cannot reach
    ALPHA_MIN in the image), tiles [N] int32, an upper bound of the tiles that are touched, and zero to counts [N]. Sets
    suspect[0] if a value is not finite, out of range, or so large that the projection overflows.
    """
    columns = np.ones(INPUTS * LANES, np.float32)
    out = np.zeros(ROW * LANES, np.float32)
    last_rows = np.empty(ROW * LANES, np.float32)
    rest = np.empty(3 * LANES, np.float32)  # depth, radius, tiles
    flat = rows.reshape(-1)
    for first in range(begin, end, LANES):
        count = min(LANES, end - first)
        _gather(means, quats, scales, opacities, first, count, columns)
        if _project(camera, columns, out, rest) != 0:
            suspect[0] = 1
        if count == LANES:
            transpose(out, 0, LANES, flat, first * ROW, ROW)
        else:
            transpose(out, 0, LANES, last_rows, 0, ROW)
            copy(last_rows, 0, flat, first * ROW, count * ROW)
        for lane in range(count):
            i = first + lane
            depths[i] = rest[lane]
            radii[i], tiles[i] = np.int32(rest[LANES + lane]), np.int32(rest[2 * LANES + lane])
            counts[i] = 0


@inline
def _project(c, b, out, rest):
    """Project the sixteen Gaussians in the columns b to columns out and rest; returns nonzero if an input is bad."""
    mx, my, mz = load(b, 0 * LANES), load(b, 1 * LANES), load(b, 2 * LANES)
    qw, qx, qy, qz = load(b, 3 * LANES), load(b, 4 * LANES), load(b, 5 * LANES), load(b, 6 * LANES)
    s0, s1, s2, o = load(b, 7 * LANES), load(b, 8 * LANES), load(b, 9 * LANES), load(b, 10 * LANES)
    x, y, z = _to_camera(c, mx, my, mz)
    iz = ONE / z
    jx, jy, jxz, jyz, _, _ = _jacobian(c, x, y, iz)
    r = _rotation(qw, qx, qy, qz)
    tr = _times_rotation(_image_axes(c, jx, jy, jxz, jyz), r)
    m00, m01, m02, m10, m11, m12 = tr[0] * s0, tr[1] * s1, tr[2] * s2, tr[3] * s0, tr[4] * s1, tr[5] * s2
    a, k, q, cxx, det = _footprint((m00, m01, m02, m10, m11, m12), c[EPS2D])
    px, py = jx * x + c[CX], jy * y + c[CY]
    peak = o
    if c[ANTIALIASED] > ZERO:  # sqrt(det / det dilated): a splat is dilated, but no brighter. 0 for one seen edge on
        peak = o * sqrt(ONE / (ONE + _dilation((m00, m01, m02, m10, m11, m12), c[EPS2D])[1]))
    top = log2(maximum(peak, ALPHA_MIN))
    log2_reach = (top - LOG2_ALPHA_MIN) / HALF_LOG2E
    rx, ry = sqrt(log2_reach * cxx), sqrt(log2_reach / q)
    # 0 * x is 0 for finite x and nan otherwise; a zero or non-finite quaternion has no unit quaternion
    zeros = ZERO * (x + y + z + s0 + s1 + s2 + r[9])
    good = (zeros == ZERO) & (o >= ZERO) & (o <= ONE) & (minimum(minimum(s0, s1), s2) >= ZERO)
    visible = (z > c[NEAR]) & (z < c[FAR]) & (peak >= ALPHA_MIN) & (det > ZERO)
    # an infinite determinant gives a = 0, which is wrong unless q is as good as 0 too, and the centre not far off
    near = (maximum(px, -px) < CLOSE) & (maximum(py, -py) < CLOSE)
    even = (cxx < EVEN) & (q * EVEN > ONE) & near
    good = good & ((det < INFINITY) | even | (z <= c[NEAR]) | (z >= c[FAR]))
    visible = visible & (px + rx > ZERO) & (px - rx < c[WIDTH]) & (py + ry > ZERO) & (py - ry < c[HEIGHT])
    extent = minimum(maximum(ceil(maximum(rx, ry)), ONE), MAX_RADIUS)
    visible = visible & (extent > c[RADIUS_CLIP])
    # a visible Gaussian must have a direction, too: the direction of its colour is divided by this length
    good = good & (select(visible, x * x + y * y + z * z, ZERO) < INFINITY)
    radius = select(visible, extent, ZERO)

    store(out, X * LANES, select(visible, px, ZERO))
    store(out, Y * LANES, select(visible, py, ZERO))
    store(out, A * LANES, a * HALF_LOG2E)
    store(out, K * LANES, k)
    store(out, Q * LANES, q * HALF_LOG2E)
    store(out, TOP * LANES, top)
    store(out, SLOPE * LANES, -a * k / (a * k * k + q))
    store(out, REACH_X * LANES, rx)
    store(out, REACH_Y * LANES, ry)
    store(rest, 0, z)
    store(rest, LANES, radius)
    nx = floor(minimum(px + rx, c[WIDTH]) * PER_TILE) - floor(maximum(px - rx, ZERO) * PER_TILE) + ONE
    ny = floor(minimum(py + ry, c[HEIGHT]) * PER_TILE) - floor(maximum(py - ry, ZERO) * PER_TILE) + ONE
    store(rest, 2 * LANES, select(visible, minimum(nx * ny, MAX_RADIUS), ZERO))
    return bits(good) - 0xFFFF
