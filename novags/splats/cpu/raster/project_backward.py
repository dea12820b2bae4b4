"""Gradient of the projection, sixteen Gaussians at a time, from the gradient rows of their tiles.

Gradients are named v_<what>, after gsplat. A gradient row holds ten sums over the pixels of one tile, of g = dL / d ln
alpha times 1, u, u^2, u dy, dy, dy^2, and of the four channels' gradients.
"""

# mypy: allow-untyped-defs

import numpy as np

from ..compiler import inline, kernel
from ..vectors.simd import LANES, load, select, splat, store
from ..vectors.transpose import from_columns3, from_columns4, transpose
from .project import (
    ANTIALIASED,
    EPS2D,
    INPUTS,
    _dilation,
    _footprint,
    _gather,
    _image_axes,
    _jacobian,
    _rotation,
    _times_rotation,
    _to_camera,
)
from .record import CHANNELS, ROW

ZERO, HALF, ONE, TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
SUMS = 6
BLOCK = 512  # Gaussians per partial sum of the camera gradient: fixed, so that it does not depend on the threads
V_VIEW = 12  # entries of the world-to-camera matrix, row by row


@inline
def _sum_rows(v_rows, first, last, n_entries, n_passes, i, depth_channel, lane, sums, v_features, v_depth):
    """Add up the rows first..last-1, of Gaussian i's tiles in a fixed order, to row `lane` of sums [LANES * ROW]."""
    n_features = v_features.shape[1]
    geometry = splat(ZERO)
    for channels in range(n_passes):
        total = splat(ZERO)
        for slot in range(first, last):
            total += load(v_rows, (channels * n_entries + slot) * ROW)
        geometry += total
        store(sums, lane * ROW, total)
        for j in range(CHANNELS):
            channel = channels * CHANNELS + j
            if channel < n_features:
                v_features[i, channel] = sums[lane * ROW + SUMS + j]
            elif channel == depth_channel:
                v_depth[lane] = sums[lane * ROW + SUMS + j]
    store(sums, lane * ROW, geometry)


@kernel
def backward(
    begin, end, means, quats, scales, opacities, camera, v_rows, slots, n_passes, depth_channel,
    v_means, v_quats, v_scales, v_opacities, v_features, v_view,
):  # fmt: skip
    """Gradients of blocks begin..end-1 of BLOCK Gaussians.

    Gaussian i's rows in v_rows are slots[i]..slots[i + 1] - 1 (none: no gradient), one pass of four channels after the
    other. Writes v_means, v_quats, v_scales [N, 3 or 4], v_opacities [N], v_features [N, D]; and the camera
    gradient's partial sums v_view [blocks, V_VIEW] unless that is empty.
    """
    n = len(means)
    columns = np.ones(INPUTS * LANES, np.float32)
    sums, sum_columns = np.zeros(LANES * ROW, np.float32), np.empty(ROW * LANES, np.float32)
    rest = np.zeros(2 * LANES, np.float32)  # gradient of the depth; 1 for Gaussians in any tile's list
    camera_sums = np.empty(V_VIEW * LANES, np.float32)
    for block in range(begin, end):
        camera_sums[:] = ZERO
        for first in range(block * BLOCK, min(n, (block + 1) * BLOCK), LANES):
            count = min(LANES, n - first)
            rest[:] = ZERO
            any_listed = False
            for lane in range(count):
                i = first + lane
                if slots[i + 1] > slots[i]:
                    any_listed = True
                    rest[LANES + lane] = ONE
                    _sum_rows(
                        v_rows, slots[i], slots[i + 1], slots[n], n_passes, i, depth_channel, lane, sums, v_features,
                        rest,
                    )  # fmt: skip
                else:
                    v_features[i] = ZERO
            if not any_listed:
                v_means[first : first + count] = ZERO
                v_quats[first : first + count] = ZERO
                v_scales[first : first + count] = ZERO
                v_opacities[first : first + count] = ZERO
                continue
            _gather(means, quats, scales, opacities, first, count, columns)
            transpose(sums, 0, ROW, sum_columns, 0, LANES)
            _backward(camera, columns, sum_columns, rest, camera_sums)
            _scatter(first, count, columns, v_means, v_quats, v_scales, v_opacities)
        if len(v_view):
            for j in range(V_VIEW):
                v_view[block, j] = ZERO
                for lane in range(LANES):
                    v_view[block, j] += camera_sums[j * LANES + lane]


@inline
def _scatter(first, count, columns, v_means, v_quats, v_scales, v_opacities):
    if count == LANES:
        from_columns3(columns, 0, v_means.reshape(-1), 3 * first)
        from_columns4(columns, 3, v_quats.reshape(-1), 4 * first)
        from_columns3(columns, 7, v_scales.reshape(-1), 3 * first)
        store(v_opacities, first, load(columns, 10 * LANES))
        return
    for lane in range(count):
        i = first + lane
        for j in range(3):
            v_means[i, j] = columns[j * LANES + lane]
            v_scales[i, j] = columns[(7 + j) * LANES + lane]
        for j in range(4):
            v_quats[i, j] = columns[(3 + j) * LANES + lane]
        v_opacities[i] = columns[10 * LANES + lane]


@inline
def _keep(b, column, seen, value):
    # selected, not multiplied: a Gaussian that is in no list may be anywhere, even in the camera plane
    store(b, column * LANES, select(seen, value, ZERO))


@inline
def _covariance_backward(a, k, q, v_a, v_k, v_q, eps, m):
    """Gradient of M = J W R S (2x3, row by row) from the footprint's gradient."""
    m00, m01, m02, m10, m11, m12 = m
    inv_det = a * q  # a = c_yy / det and q = 1 / c_yy
    v_det = -a * inv_det * v_a
    v_cyy, v_cxy = v_a * inv_det - v_k * k * q - v_q * q * q, -v_k * q
    d01, d02, d12 = m00 * m11 - m01 * m10, m00 * m12 - m02 * m10, m01 * m12 - m02 * m11
    two = v_det * TWO
    e01, e02, e12, e = d01 * two, d02 * two, d12 * two, two * eps
    f = e + v_cyy * TWO
    return (
        e01 * m11 + e02 * m12 + e * m00 + v_cxy * m10,
        e12 * m12 - e01 * m10 + e * m01 + v_cxy * m11,
        e * m02 - e02 * m10 - e12 * m11 + v_cxy * m12,
        f * m10 - e01 * m01 - e02 * m02 + v_cxy * m00,
        e01 * m00 - e12 * m02 + f * m11 + v_cxy * m01,
        e02 * m00 + e12 * m01 + f * m12 + v_cxy * m02,
    )


@inline
def _compensation_backward(g, eps, m):
    """Gradient of m from g, the gradient of ln peak, through ln sqrt(det / det dilated) alone."""
    m00, m01, m02, m10, m11, m12 = m
    sharp, dilation = _dilation(m, eps)
    d01, d02, d12 = m00 * m11 - m01 * m10, m00 * m12 - m02 * m10, m01 * m12 - m02 * m11
    v_rows = -g / ((ONE + dilation) * sharp)
    e = v_rows * eps
    two = -v_rows * dilation
    e01, e02, e12 = d01 * two, d02 * two, d12 * two
    return (
        e01 * m11 + e02 * m12 + e * m00, e12 * m12 - e01 * m10 + e * m01, e * m02 - e02 * m10 - e12 * m11,
        e * m10 - e01 * m01 - e02 * m02, e01 * m00 - e12 * m02 + e * m11, e02 * m00 + e12 * m01 + e * m12,
    )  # fmt: skip


@inline
def _rotation_backward(r, t, h):
    """Gradient of the unnormalised quaternion from h, the gradient of T R."""
    w, x, y, z, inv = r[9], r[10], r[11], r[12], r[13]
    v00, v01, v02 = t[0] * h[0] + t[3] * h[3], t[0] * h[1] + t[3] * h[4], t[0] * h[2] + t[3] * h[5]
    v10, v11, v12 = t[1] * h[0] + t[4] * h[3], t[1] * h[1] + t[4] * h[4], t[1] * h[2] + t[4] * h[5]
    v20, v21, v22 = t[2] * h[0] + t[5] * h[3], t[2] * h[1] + t[5] * h[4], t[2] * h[2] + t[5] * h[5]
    vw = (x * (v21 - v12) + y * (v02 - v20) + z * (v10 - v01)) * TWO
    vx = (y * (v10 + v01) + z * (v20 + v02) + w * (v21 - v12)) * TWO - x * (v11 + v22) * (TWO * TWO)
    vy = (x * (v10 + v01) + z * (v21 + v12) + w * (v02 - v20)) * TWO - y * (v00 + v22) * (TWO * TWO)
    vz = (x * (v20 + v02) + y * (v21 + v12) + w * (v10 - v01)) * TWO - z * (v00 + v11) * (TWO * TWO)
    along = vw * w + vx * x + vy * y + vz * z
    return (vw - along * w) * inv, (vx - along * x) * inv, (vy - along * y) * inv, (vz - along * z) * inv


@inline
def _backward(c, b, sums, rest, camera_sums):
    """Replace the inputs in the columns b by their gradients, and add to the camera's."""
    mx, my, mz = load(b, 0 * LANES), load(b, 1 * LANES), load(b, 2 * LANES)
    s0, s1, s2 = load(b, 7 * LANES), load(b, 8 * LANES), load(b, 9 * LANES)
    g, gu, guu = load(sums, 0), load(sums, LANES), load(sums, 2 * LANES)
    gud, gd, gdd = load(sums, 3 * LANES), load(sums, 4 * LANES), load(sums, 5 * LANES)

    x, y, z = _to_camera(c, mx, my, mz)
    iz = ONE / z
    jx, jy, jxz, jyz, free_x, free_y = _jacobian(c, x, y, iz)
    r = _rotation(load(b, 3 * LANES), load(b, 4 * LANES), load(b, 5 * LANES), load(b, 6 * LANES))
    t = _image_axes(c, jx, jy, jxz, jyz)
    tr = _times_rotation(t, r)
    m = tr[0] * s0, tr[1] * s1, tr[2] * s2, tr[3] * s0, tr[4] * s1, tr[5] * s2
    a, k, q, _, _ = _footprint(m, c[EPS2D])
    v_px, v_py = a * gu, a * k * gu + q * gd
    v_m = _covariance_backward(a, k, q, guu * (-HALF), -a * gud, gdd * (-HALF), c[EPS2D], m)
    if c[ANTIALIASED] > ZERO:
        w = _compensation_backward(g, c[EPS2D], m)
        v_m = v_m[0] + w[0], v_m[1] + w[1], v_m[2] + w[2], v_m[3] + w[3], v_m[4] + w[4], v_m[5] + w[5]
    h = v_m[0] * s0, v_m[1] * s1, v_m[2] * s2, v_m[3] * s0, v_m[4] * s1, v_m[5] * s2
    vw, vx, vy, vz = _rotation_backward(r, t, h)
    vt = (
        h[0] * r[0] + h[1] * r[1] + h[2] * r[2], h[0] * r[3] + h[1] * r[4] + h[2] * r[5],
        h[0] * r[6] + h[1] * r[7] + h[2] * r[8], h[3] * r[0] + h[4] * r[1] + h[5] * r[2],
        h[3] * r[3] + h[4] * r[4] + h[5] * r[5], h[3] * r[6] + h[4] * r[7] + h[5] * r[8],
    )  # fmt: skip

    v_jx, v_jxz = vt[0] * c[0] + vt[1] * c[1] + vt[2] * c[2], vt[0] * c[8] + vt[1] * c[9] + vt[2] * c[10]
    v_jy, v_jyz = vt[3] * c[4] + vt[4] * c[5] + vt[5] * c[6], vt[3] * c[8] + vt[4] * c[9] + vt[5] * c[10]
    # d(-f t / z^2)/dz is 2 f t / z^3 for t itself, but f t / z^3 where t = z * limit
    v_x = jx * (v_px - select(free_x, iz * v_jxz, ZERO))
    v_y = jy * (v_py - select(free_y, iz * v_jyz, ZERO))
    v_z = jx * x * v_px + jy * y * v_py + jx * v_jx + jy * v_jy
    v_z += jxz * v_jxz * select(free_x, TWO, ONE) + jyz * v_jyz * select(free_y, TWO, ONE)
    v_z = load(rest, 0) - v_z * iz

    seen = load(rest, LANES) > ZERO
    _camera_backward(seen, v_x, v_y, v_z, mx, my, mz, jx, jy, jxz, jyz, vt, camera_sums)
    _keep(b, 0, seen, v_x * c[0] + v_y * c[4] + v_z * c[8])
    _keep(b, 1, seen, v_x * c[1] + v_y * c[5] + v_z * c[9])
    _keep(b, 2, seen, v_x * c[2] + v_y * c[6] + v_z * c[10])
    _keep(b, 3, seen, vw)
    _keep(b, 4, seen, vx)
    _keep(b, 5, seen, vy)
    _keep(b, 6, seen, vz)
    _keep(b, 7, seen, v_m[0] * tr[0] + v_m[3] * tr[3])
    _keep(b, 8, seen, v_m[1] * tr[1] + v_m[4] * tr[4])
    _keep(b, 9, seen, v_m[2] * tr[2] + v_m[5] * tr[5])
    _keep(b, 10, seen, g / load(b, 10 * LANES))


@inline
def _accumulate(sums, entry, seen, value):
    # selected, not multiplied: an invisible Gaussian in the camera plane gives 0 * inf
    store(sums, entry * LANES, load(sums, entry * LANES) + select(seen, value, ZERO))


@inline
def _camera_backward(seen, v_x, v_y, v_z, mx, my, mz, jx, jy, jxz, jyz, vt, sums):
    """Add the gradient of the world-to-camera matrix."""
    _accumulate(sums, 0, seen, v_x * mx + jx * vt[0])
    _accumulate(sums, 1, seen, v_x * my + jx * vt[1])
    _accumulate(sums, 2, seen, v_x * mz + jx * vt[2])
    _accumulate(sums, 3, seen, v_x)
    _accumulate(sums, 4, seen, v_y * mx + jy * vt[3])
    _accumulate(sums, 5, seen, v_y * my + jy * vt[4])
    _accumulate(sums, 6, seen, v_y * mz + jy * vt[5])
    _accumulate(sums, 7, seen, v_y)
    _accumulate(sums, 8, seen, v_z * mx + jxz * vt[0] + jyz * vt[3])
    _accumulate(sums, 9, seen, v_z * my + jxz * vt[1] + jyz * vt[4])
    _accumulate(sums, 10, seen, v_z * mz + jxz * vt[2] + jyz * vt[5])
    _accumulate(sums, 11, seen, v_z)
