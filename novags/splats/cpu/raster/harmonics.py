"""Spherical harmonics of sixteen Gaussians at a time, and the gradient. Conventions as in `novags.splats.sh`."""

# mypy: allow-untyped-defs

import numpy as np

from ...sh import C0, C1, C2, C3
from ..compiler import inline, kernel
from ..vectors.simd import LANES, bits, load, maximum, select, splat, sqrt, store
from ..vectors.transpose import add3, gather3, transpose
from .record import CHANNEL

ZERO, HALF, ONE, TWO, THREE, FOUR = (np.float32(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0, 4.0))
SIX, EIGHT = np.float32(6.0), np.float32(8.0)
B0, B1 = np.float32(C0), np.float32(C1)
B20, B21, B22, B23, B24 = (np.float32(c) for c in C2)
B30, B31, B32, B33, B34, B35, B36 = (np.float32(c) for c in C3)
# eps: a Gaussian exactly at the camera centre has no direction; without it 1 / 0
SHORTEST = np.float32(1e-12)
# Slack of the cut: the fused sum of a colour of exactly 0 may round to below it (-7e-9 where only the first coefficient
# counts), and a Gaussian that starts black would then have no gradient for ever
BLACK = np.float32(-(2.0**-22))


@inline
def _direction(points):
    """Unit vectors of the columns `points` [3 * LANES], and 1 / length."""
    x, y, z = load(points, 0), load(points, LANES), load(points, 2 * LANES)
    inv = ONE / maximum(sqrt(x * x + y * y + z * z), SHORTEST)
    return x * inv, y * inv, z * inv, inv


@inline
def _basis(degree, x, y, z, basis):
    """Basis functions to columns [16 * LANES]."""
    store(basis, 0, splat(B0))
    if degree >= 1:
        store(basis, LANES, y * (-B1))
        store(basis, 2 * LANES, z * B1)
        store(basis, 3 * LANES, x * (-B1))
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        store(basis, 4 * LANES, x * y * B20)
        store(basis, 5 * LANES, y * z * B21)
        store(basis, 6 * LANES, (zz * TWO - xx - yy) * B22)
        store(basis, 7 * LANES, x * z * B23)
        store(basis, 8 * LANES, (xx - yy) * B24)
        if degree >= 3:
            store(basis, 9 * LANES, y * (xx * THREE - yy) * B30)
            store(basis, 10 * LANES, x * y * z * B31)
            store(basis, 11 * LANES, y * (zz * FOUR - xx - yy) * B32)
            store(basis, 12 * LANES, z * (zz * TWO - (xx + yy) * THREE) * B33)
            store(basis, 13 * LANES, x * (zz * FOUR - xx - yy) * B34)
            store(basis, 14 * LANES, z * (xx - yy) * B35)
            store(basis, 15 * LANES, x * (xx - yy * THREE) * B36)


@inline
def _gather(means, center, sh, first, count, n_coefficients, points, coefficients):
    """Transpose positions relative to the camera centre, and coefficients, into columns."""
    gather3(means, first, count, points, 0)
    for j in range(3):
        store(points, j * LANES, load(points, j * LANES) - center[j])
    n, stride = 3 * n_coefficients, sh.shape[1]
    if count == LANES and n >= LANES:
        flat = sh.reshape(-1)
        for j in range(0, n, LANES):
            at = min(j, n - LANES)  # the last sixteen may overlap the ones before
            transpose(flat, first * stride + at, stride, coefficients, at * LANES, LANES)
        return
    for lane in range(count):
        for j in range(n):
            coefficients[j * LANES + lane] = sh[first + lane, j]


@inline
def _color(n_coefficients, channel, basis, coefficients):
    """Colour before it is cut at zero."""
    total = splat(HALF)
    for j in range(n_coefficients):
        total += load(basis, j * LANES) * load(coefficients, (3 * j + channel) * LANES)
    return total


@kernel
def forward(begin, end, degree, means, sh, center, depths, depth_gain, radii, rows, suspect):
    """Write the colours of Gaussians begin..end-1, and depth_gain times their depths, to the channels of rows [N, ROW].

    sh is [N, 3 K], camera centre [3]. Sets suspect[0] if a coefficient in use is not finite.
    """
    n_coefficients = (degree + 1) * (degree + 1)
    points, basis = np.ones(3 * LANES, np.float32), np.empty(16 * LANES, np.float32)
    coefficients, colors = np.zeros(48 * LANES, np.float32), np.empty(3 * LANES, np.float32)
    for first in range(begin, end, LANES):
        count = min(LANES, end - first)
        _gather(means, center, sh, first, count, n_coefficients, points, coefficients)
        x, y, z, _ = _direction(points)
        _basis(degree, x, y, z, basis)
        for channel in range(3):
            color = _color(n_coefficients, channel, basis, coefficients)
            if bits(color * ZERO == ZERO) != 0xFFFF:
                suspect[0] = 1
            store(colors, channel * LANES, maximum(color, ZERO))
        for lane in range(count):
            if radii[first + lane] > 0:
                for channel in range(3):
                    rows[first + lane, CHANNEL + channel] = colors[channel * LANES + lane]
                rows[first + lane, CHANNEL + 3] = depth_gain * depths[first + lane]


@inline
def _basis_backward(degree, x, y, z, v, axis):
    """Gradient of one component of the direction from the basis's gradient, columns v."""
    total = splat(ZERO)
    if degree >= 1:
        v1, v2, v3 = load(v, LANES), load(v, 2 * LANES), load(v, 3 * LANES)
        total = v3 * (-B1) if axis == 0 else (v1 * (-B1) if axis == 1 else v2 * B1)
    if degree >= 2:
        v4, v5, v6, v7 = load(v, 4 * LANES), load(v, 5 * LANES), load(v, 6 * LANES), load(v, 7 * LANES)
        v8 = load(v, 8 * LANES)
        if axis == 0:
            total += y * v4 * B20 - x * v6 * (TWO * B22) + z * v7 * B23 + x * v8 * (TWO * B24)
        elif axis == 1:
            total += x * v4 * B20 + z * v5 * B21 - y * v6 * (TWO * B22) - y * v8 * (TWO * B24)
        else:
            total += y * v5 * B21 + z * v6 * (FOUR * B22) + x * v7 * B23
    if degree >= 3:
        total += _cubic_backward(x, y, z, v, axis)
    return total


@inline
def _cubic_backward(x, y, z, v, axis):
    v9, v10, v11, v12 = load(v, 9 * LANES), load(v, 10 * LANES), load(v, 11 * LANES), load(v, 12 * LANES)
    v13, v14, v15 = load(v, 13 * LANES), load(v, 14 * LANES), load(v, 15 * LANES)
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
    if axis == 0:
        total = xy * v9 * (SIX * B30) + yz * v10 * B31 - xy * v11 * (TWO * B32) - xz * v12 * (SIX * B33)
        total += (zz * FOUR - xx * THREE - yy) * v13 * B34 + xz * v14 * (TWO * B35) + (xx - yy) * v15 * (THREE * B36)
    elif axis == 1:
        total = (xx - yy) * v9 * (THREE * B30) + xz * v10 * B31 + (zz * FOUR - xx - yy * THREE) * v11 * B32
        total += yz * v12 * (-SIX * B33) - xy * v13 * (TWO * B34) - yz * v14 * (TWO * B35) - xy * v15 * (SIX * B36)
    else:
        total = xy * v10 * B31 + yz * v11 * (EIGHT * B32) + (zz * TWO - xx - yy) * v12 * (THREE * B33)
        total += xz * v13 * (EIGHT * B34) + (xx - yy) * v14 * B35
    return total


@inline
def _scatter(coefficients, first, count, n, v_sh):
    """Transpose columns back to rows of v_sh [N, 3 K], whose further coefficients become zero."""
    stride = v_sh.shape[1]
    if count == LANES and n >= LANES:
        flat = v_sh.reshape(-1)
        for j in range(0, n, LANES):
            at = min(j, n - LANES)
            transpose(coefficients, at * LANES, LANES, flat, first * stride + at, stride)
    else:
        for lane in range(count):
            for j in range(n):
                v_sh[first + lane, j] = coefficients[j * LANES + lane]
    for lane in range(count):
        for j in range(n, stride):
            v_sh[first + lane, j] = ZERO


@inline
def _any(columns):
    """Whether one of three columns is not zero anywhere."""
    zero = (load(columns, 0) == ZERO) & (load(columns, LANES) == ZERO) & (load(columns, 2 * LANES) == ZERO)
    return bits(zero) != 0xFFFF


@kernel
def backward(begin, end, block_size, degree, means, sh, center, v_colors, v_sh, v_means, v_center):
    """Gradients of blocks begin..end-1 of block_size Gaussians: v_sh [N, 3 K]; added to v_means [N, 3].

    Unless v_center is empty, writes its partial sums [blocks, 3] of the gradient of the camera centre.
    """
    n, n_coefficients = len(means), (degree + 1) * (degree + 1)
    points, basis = np.ones(3 * LANES, np.float32), np.empty(16 * LANES, np.float32)
    v_basis, coefficients = np.empty(16 * LANES, np.float32), np.zeros(48 * LANES, np.float32)
    v_color, v_points = np.zeros(3 * LANES, np.float32), np.empty(3 * LANES, np.float32)
    total = np.empty(3, np.float32)
    for block in range(begin, end):
        total[:] = ZERO
        for first in range(block * block_size, min(n, (block + 1) * block_size), LANES):
            count = min(LANES, n - first)
            v_color[:] = ZERO
            gather3(v_colors, first, count, v_color, 0)
            if not _any(v_color):
                v_sh[first : first + count] = ZERO
                continue
            _gather(means, center, sh, first, count, n_coefficients, points, coefficients)
            _backward(degree, n_coefficients, points, basis, v_basis, coefficients, v_color, v_points)
            _scatter(coefficients, first, count, 3 * n_coefficients, v_sh)
            for j in range(3):
                for lane in range(count):
                    total[j] -= v_points[j * LANES + lane]
            add3(v_points, 0, first, count, v_means)
        if len(v_center):
            for j in range(3):
                v_center[block, j] = total[j]


@inline
def _backward(degree, n_coefficients, points, basis, v_basis, coefficients, v_color, v_points):
    """Replace the coefficients by their gradients, and write the gradients of the positions."""
    x, y, z, inv = _direction(points)
    _basis(degree, x, y, z, basis)
    for channel in range(3):
        color = _color(n_coefficients, channel, basis, coefficients)
        # cut at zero: no slope below
        store(v_color, channel * LANES, select(color > BLACK, load(v_color, channel * LANES), ZERO))
    r, g, b = load(v_color, 0), load(v_color, LANES), load(v_color, 2 * LANES)
    for j in range(n_coefficients):
        at, value = 3 * j * LANES, load(basis, j * LANES)
        old_r, old_g, old_b = load(coefficients, at), load(coefficients, at + LANES), load(coefficients, at + 2 * LANES)
        store(v_basis, j * LANES, old_r * r + old_g * g + old_b * b)
        store(coefficients, at, value * r)
        store(coefficients, at + LANES, value * g)
        store(coefficients, at + 2 * LANES, value * b)
    vx = _basis_backward(degree, x, y, z, v_basis, 0)
    vy = _basis_backward(degree, x, y, z, v_basis, 1)
    vz = _basis_backward(degree, x, y, z, v_basis, 2)
    along = vx * x + vy * y + vz * z
    store(v_points, 0, (vx - x * along) * inv)
    store(v_points, LANES, (vy - y * along) * inv)
    store(v_points, 2 * LANES, (vz - z * along) * inv)
