"""CPU kernels: spherical harmonics to colours, and the gradient. Conventions as in `sh.py`; colours are cut at zero."""
# mypy: allow-untyped-defs
# numba infers the types of kernels; shapes are in the docstrings

import numpy as np
from numba import njit, prange

from .sh import C0, C1, C2, C3

ZERO, HALF, ONE, TWO, THREE, FOUR = (np.float32(v) for v in (0.0, 0.5, 1.0, 2.0, 3.0, 4.0))
B0, B1 = np.float32(C0), np.float32(C1)
B20, B21, B22, B23, B24 = (np.float32(c) for c in C2)
B30, B31, B32, B33, B34, B35, B36 = (np.float32(c) for c in C3)
BLOCK = 512  # Gaussians per partial sum of the camera gradient: fixed, so it does not depend on the thread count
FAST = {"contract", "nsz"}


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _direction(means, center, i):
    x, y, z = means[i, 0] - center[0], means[i, 1] - center[1], means[i, 2] - center[2]
    # eps: a Gaussian exactly at the camera centre has no direction; without it 1 / 0
    inv = ONE / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-12))
    return x * inv, y * inv, z * inv, inv


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _basis(degree, x, y, z, basis):
    basis[0] = B0
    if degree >= 1:
        basis[1], basis[2], basis[3] = -B1 * y, B1 * z, -B1 * x
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        basis[4], basis[5], basis[6] = B20 * x * y, B21 * y * z, B22 * (TWO * zz - xx - yy)
        basis[7], basis[8] = B23 * x * z, B24 * (xx - yy)
        if degree >= 3:
            basis[9], basis[10] = B30 * y * (THREE * xx - yy), B31 * x * y * z
            basis[11] = B32 * y * (FOUR * zz - xx - yy)
            basis[12] = B33 * z * (TWO * zz - THREE * xx - THREE * yy)
            basis[13] = B34 * x * (FOUR * zz - xx - yy)
            basis[14], basis[15] = B35 * z * (xx - yy), B36 * x * (xx - THREE * yy)


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def sh_forward(degree, means, sh, center, radii, colors):
    """Write colors [N, 3] of the visible Gaussians (radius > 0); sh [N, K, 3], camera centre [3]."""
    k = (degree + 1) * (degree + 1)
    n = len(means)
    for block in prange((n + BLOCK - 1) // BLOCK):
        basis = np.empty(16, np.float32)
        for i in range(block * BLOCK, min(n, (block + 1) * BLOCK)):
            if radii[i] == 0:
                continue
            x, y, z, _ = _direction(means, center, i)
            _basis(degree, x, y, z, basis)
            r = g = b = HALF
            for j in range(k):
                r += basis[j] * sh[i, j, 0]
                g += basis[j] * sh[i, j, 1]
                b += basis[j] * sh[i, j, 2]
            colors[i, 0], colors[i, 1], colors[i, 2] = max(r, ZERO), max(g, ZERO), max(b, ZERO)


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _basis_backward(degree, x, y, z, v):
    """Gradient of the direction from that of the basis."""
    vx = vy = vz = ZERO
    if degree >= 1:
        vx -= B1 * v[3]
        vy -= B1 * v[1]
        vz += B1 * v[2]
    if degree >= 2:
        vx += B20 * y * v[4] - TWO * B22 * x * v[6] + B23 * z * v[7] + TWO * B24 * x * v[8]
        vy += B20 * x * v[4] + B21 * z * v[5] - TWO * B22 * y * v[6] - TWO * B24 * y * v[8]
        vz += B21 * y * v[5] + FOUR * B22 * z * v[6] + B23 * x * v[7]
    if degree >= 3:
        xx, yy, zz, six, eight = x * x, y * y, z * z, TWO * THREE, TWO * FOUR
        vx += B30 * six * x * y * v[9] + B31 * y * z * v[10] - TWO * B32 * x * y * v[11] - six * B33 * x * z * v[12]
        vx += B34 * (FOUR * zz - THREE * xx - yy) * v[13] + TWO * B35 * x * z * v[14] + THREE * B36 * (xx - yy) * v[15]
        vy += THREE * B30 * (xx - yy) * v[9] + B31 * x * z * v[10] + B32 * (FOUR * zz - xx - THREE * yy) * v[11]
        vy += (
            -six * B33 * y * z * v[12]
            - TWO * B34 * x * y * v[13]
            - TWO * B35 * y * z * v[14]
            - six * B36 * x * y * v[15]
        )
        vz += B31 * x * y * v[10] + eight * B32 * y * z * v[11] + B33 * (six * zz - THREE * xx - THREE * yy) * v[12]
        vz += eight * B34 * x * z * v[13] + B35 * (xx - yy) * v[14]
    return vx, vy, vz


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def sh_backward(degree, means, sh, center, radii, colors, v_colors, v_sh, v_means, v_center_blocks):
    """Gradients of `sh_forward`.

    Writes v_sh [N, K, 3], adds to v_means [N, 3], and writes the partial sums v_center_blocks [ceil(N / BLOCK), 3].
    """
    k = (degree + 1) * (degree + 1)
    n = len(means)
    for block in prange((n + BLOCK - 1) // BLOCK):
        basis = np.empty(16, np.float32)
        v_basis = np.empty(16, np.float32)
        v_center_blocks[block] = ZERO
        for i in range(block * BLOCK, min(n, (block + 1) * BLOCK)):
            v_sh[i] = ZERO
            if radii[i] == 0:
                continue
            x, y, z, inv = _direction(means, center, i)
            _basis(degree, x, y, z, basis)
            r = v_colors[i, 0] if colors[i, 0] > ZERO else ZERO  # cut at zero: no slope there
            g = v_colors[i, 1] if colors[i, 1] > ZERO else ZERO
            b = v_colors[i, 2] if colors[i, 2] > ZERO else ZERO
            for j in range(k):
                v_sh[i, j, 0], v_sh[i, j, 1], v_sh[i, j, 2] = basis[j] * r, basis[j] * g, basis[j] * b
                v_basis[j] = sh[i, j, 0] * r + sh[i, j, 1] * g + sh[i, j, 2] * b
            vx, vy, vz = _basis_backward(degree, x, y, z, v_basis)
            along = vx * x + vy * y + vz * z
            for j, v in enumerate(((vx - along * x) * inv, (vy - along * y) * inv, (vz - along * z) * inv)):
                v_means[i, j] += v
                v_center_blocks[block, j] -= v
