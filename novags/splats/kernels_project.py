"""CPU kernels: EWA projection of 3D Gaussians to image-plane splats, and its gradient.

A splat's footprint is kept in sheared form, because the usual conic cancels catastrophically in float32 for needles:

    ln alpha = ln o - (a u^2 + q dy^2) / 2,   u = dx + k dy,
    a = c_yy / det,   k = -c_xy / c_yy,   q = 1 / c_yy

with (dx, dy) from the splat centre to the pixel and c the 2D covariance. Both terms are squares, so nothing cancels, and
det = |minors of J W R S|^2 + eps2d |J W R S|^2 + eps2d^2 is a sum of squares too.

A splat is the row (mean x, mean y, a, k, q, opacity, reach x, reach y) of SPLAT_SIZE floats; its gradient has the first six.
"""
# mypy: allow-untyped-defs
# numba infers the types of kernels; shapes are in the docstrings

import numpy as np
from numba import njit, prange

SPLAT_SIZE = 8
ALPHA_MIN = np.float32(1.0 / 255.0)
ZERO, HALF, ONE, TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
JACOBIAN_MARGIN = np.float32(0.15)  # of the image size, beyond its border; as in gsplat
FAST = {"contract", "nsz"}  # no reassociation, no nnan: results do not depend on the compiler's mood


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _rotation(quats, i):
    """Rotation matrix of quaternion i as nine numbers, and 1 / |q|."""
    w, x, y, z = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
    inv = ONE / np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * inv, x * inv, y * inv, z * inv
    return (
        ONE - TWO * (y * y + z * z), TWO * (x * y - w * z), TWO * (x * z + w * y),
        TWO * (x * y + w * z), ONE - TWO * (x * x + z * z), TWO * (y * z - w * x),
        TWO * (x * z - w * y), TWO * (y * z + w * x), ONE - TWO * (x * x + y * y),
        w, x, y, z, inv,
    )  # fmt: skip


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _camera_point(means, view, i):
    x, y, z = means[i, 0], means[i, 1], means[i, 2]
    return (
        view[0, 0] * x + view[0, 1] * y + view[0, 2] * z + view[0, 3],
        view[1, 0] * x + view[1, 1] * y + view[1, 2] * z + view[1, 3],
        view[2, 0] * x + view[2, 1] * y + view[2, 2] * z + view[2, 3],
    )


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _clamped(t, z, f, c, size):
    """Slope t / z limited to the image plus a margin, times z; and whether the limit was active."""
    margin = JACOBIAN_MARGIN * size / f
    slope = t / z
    limited = min(max(slope, -c / f - margin), (size - c) / f + margin)
    return z * limited, limited != slope


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def project_forward(means, quats, scales, opacities, view, K, width, height, near, far, eps2d, splats, depths, radii):
    """Project N Gaussians into one camera.

    Writes splats [N, SPLAT_SIZE], depths [N] and radii [N] int32; radius 0 means that the Gaussian cannot reach
    ALPHA_MIN anywhere in the image. All arrays float32; view [4, 4] world to camera, K [3, 3].
    """
    for i in prange(len(means)):
        _project_one(
            means, quats, scales, opacities, view, K, width, height, near, far, eps2d, splats, depths, radii, i
        )


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _project_one(means, quats, scales, opacities, view, K, width, height, near, far, eps2d, splats, depths, radii, i):
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    x, y, z = _camera_point(means, view, i)
    depths[i] = z
    radii[i] = 0
    o = opacities[i]
    if not (z > near and z < far and o >= ALPHA_MIN):
        return
    m, tx, ty, _, _ = _footprint(quats, scales, view, x, y, z, fx, fy, cx, cy, width, height, i)
    m00, m01, m02, m10, m11, m12 = m
    row0 = m00 * m00 + m01 * m01 + m02 * m02
    row1 = m10 * m10 + m11 * m11 + m12 * m12
    d01, d02, d12 = m00 * m11 - m01 * m10, m00 * m12 - m02 * m10, m01 * m12 - m02 * m11
    det = (d01 * d01 + d02 * d02 + d12 * d12) + eps2d * (row0 + row1) + eps2d * eps2d
    cxx, cyy, cxy = row0 + eps2d, row1 + eps2d, m00 * m10 + m01 * m11 + m02 * m12
    mx, my = fx * x / z + cx, fy * y / z + cy
    reach = np.sqrt(TWO * np.log(o / ALPHA_MIN))
    ex, ey = reach * np.sqrt(cxx), reach * np.sqrt(cyy)
    inside = mx + ex > ZERO and mx - ex < width and my + ey > ZERO and my - ey < height
    if not (inside and det > ZERO):
        return
    radii[i] = np.int32(max(ONE, min(np.ceil(max(ex, ey)), np.float32(2**30))))
    splats[i, 0], splats[i, 1] = mx, my
    splats[i, 2], splats[i, 3], splats[i, 4] = cyy / det, -cxy / cyy, ONE / cyy
    splats[i, 5], splats[i, 6], splats[i, 7] = o, ex, ey


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _footprint(quats, scales, view, x, y, z, fx, fy, cx, cy, width, height, i):
    """M = J W R S, the 2x3 matrix whose M M^T is the splat's covariance before dilation."""
    r = _rotation(quats, i)
    tx, clamped_x = _clamped(x, z, fx, cx, width)
    ty, clamped_y = _clamped(y, z, fy, cy, height)
    iz = ONE / z
    jx, jy, jxz, jyz = fx * iz, fy * iz, -fx * tx * iz * iz, -fy * ty * iz * iz
    s0, s1, s2 = scales[i, 0], scales[i, 1], scales[i, 2]
    # T = J W, the 2x3 matrix from world to image displacements
    t00, t01, t02 = (
        jx * view[0, 0] + jxz * view[2, 0],
        jx * view[0, 1] + jxz * view[2, 1],
        jx * view[0, 2] + jxz * view[2, 2],
    )
    t10, t11, t12 = (
        jy * view[1, 0] + jyz * view[2, 0],
        jy * view[1, 1] + jyz * view[2, 1],
        jy * view[1, 2] + jyz * view[2, 2],
    )
    m = (
        (t00 * r[0] + t01 * r[3] + t02 * r[6]) * s0,
        (t00 * r[1] + t01 * r[4] + t02 * r[7]) * s1,
        (t00 * r[2] + t01 * r[5] + t02 * r[8]) * s2,
        (t10 * r[0] + t11 * r[3] + t12 * r[6]) * s0,
        (t10 * r[1] + t11 * r[4] + t12 * r[7]) * s1,
        (t10 * r[2] + t11 * r[5] + t12 * r[8]) * s2,
    )
    return m, tx, ty, clamped_x, clamped_y


BLOCK = 512  # Gaussians per partial sum of the camera gradient: fixed, so the sum does not depend on the thread count


@njit(parallel=True, cache=True, error_model="numpy", fastmath=FAST)
def project_backward(
    means, quats, scales, view, K, width, height, eps2d, splats, radii, v_splats, v_depths,
    v_means, v_quats, v_scales, v_opacities, v_view_blocks,
):  # fmt: skip
    """Gradients of `project_forward`; v_depths is the gradient of the camera z.

    Writes v_means [N, 3], v_quats [N, 4], v_scales [N, 3], v_opacities [N]; and, unless v_view_blocks is empty, the
    partial sums v_view_blocks [ceil(N / BLOCK), 3, 4] of the gradient of view[:3].
    """
    n = len(means)
    for block in prange((n + BLOCK - 1) // BLOCK):
        v_view = np.zeros((3, 4), np.float32)
        for i in range(block * BLOCK, min(n, (block + 1) * BLOCK)):
            if radii[i] == 0:
                v_means[i] = ZERO
                v_quats[i] = ZERO
                v_scales[i] = ZERO
                v_opacities[i] = ZERO
                continue
            v_opacities[i] = v_splats[i, 5]
            _project_one_backward(
                means, quats, scales, view, K, width, height, eps2d, splats, v_splats, v_depths,
                v_means, v_quats, v_scales, v_view, i,
            )  # fmt: skip
        if len(v_view_blocks):
            v_view_blocks[block] = v_view


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _project_one_backward(
    means, quats, scales, view, K, width, height, eps2d, splats, v_splats, v_depths,
    v_means, v_quats, v_scales, v_view, i,
):  # fmt: skip
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    x, y, z = _camera_point(means, view, i)
    m, tx, ty, clamped_x, clamped_y = _footprint(quats, scales, view, x, y, z, fx, fy, cx, cy, width, height, i)
    g = _covariance_backward(m, splats, v_splats, eps2d, i)

    # M = T R S with T = J W: to the scales, the rotation and T
    r = _rotation(quats, i)
    iz = ONE / z
    jx, jy, jxz, jyz = fx * iz, fy * iz, -fx * tx * iz * iz, -fy * ty * iz * iz
    v_t = np.zeros((2, 3), np.float32)
    v_r = np.zeros((3, 3), np.float32)
    for k in range(3):
        s = scales[i, k]
        v_s = ZERO
        for row in range(2):
            gk = g[3 * row + k]
            tr = ZERO
            for j in range(3):
                t = jx * view[0, j] + jxz * view[2, j] if row == 0 else jy * view[1, j] + jyz * view[2, j]
                tr += t * r[3 * j + k]
                v_r[j, k] += t * gk * s
                v_t[row, j] += gk * s * r[3 * j + k]
            v_s += gk * tr
        v_scales[i, k] = v_s
    _rotation_backward(r, v_r, v_quats, i)

    # T = J W, the pixel position and the depth: to the camera-space point
    v_jx = v_t[0, 0] * view[0, 0] + v_t[0, 1] * view[0, 1] + v_t[0, 2] * view[0, 2]
    v_jxz = v_t[0, 0] * view[2, 0] + v_t[0, 1] * view[2, 1] + v_t[0, 2] * view[2, 2]
    v_jy = v_t[1, 0] * view[1, 0] + v_t[1, 1] * view[1, 1] + v_t[1, 2] * view[1, 2]
    v_jyz = v_t[1, 0] * view[2, 0] + v_t[1, 1] * view[2, 1] + v_t[1, 2] * view[2, 2]
    v_mx, v_my = v_splats[i, 0], v_splats[i, 1]
    v_x = jx * v_mx
    v_y = jy * v_my
    v_z = v_depths[i] - (jx * x * v_mx + jy * y * v_my + jx * v_jx + jy * v_jy) * iz
    # d(-f t / z^2)/dz is 2 f t / z^3 for t itself, but f t / z^3 where t = z * limit
    v_z -= jxz * iz * v_jxz * (ONE if clamped_x else TWO)
    v_z -= jyz * iz * v_jyz * (ONE if clamped_y else TWO)
    if not clamped_x:
        v_x -= fx * iz * iz * v_jxz
    if not clamped_y:
        v_y -= fy * iz * iz * v_jyz
    for j in range(3):
        v_means[i, j] = view[0, j] * v_x + view[1, j] * v_y + view[2, j] * v_z
        v_view[0, j] += v_x * means[i, j] + jx * v_t[0, j]
        v_view[1, j] += v_y * means[i, j] + jy * v_t[1, j]
        v_view[2, j] += v_z * means[i, j] + jxz * v_t[0, j] + jyz * v_t[1, j]
    v_view[0, 3] += v_x
    v_view[1, 3] += v_y
    v_view[2, 3] += v_z


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _covariance_backward(m, splats, v_splats, eps2d, i):
    """Gradient of M (2x3, row by row) from that of (a, k, q)."""
    m00, m01, m02, m10, m11, m12 = m
    a, k, q = splats[i, 2], splats[i, 3], splats[i, 4]
    v_a, v_k, v_q = v_splats[i, 2], v_splats[i, 3], v_splats[i, 4]
    inv_det = a * q  # a = cyy / det
    v_det = -a * inv_det * v_a
    v_cyy = v_a * inv_det - v_k * k * q - v_q * q * q
    v_cxy = -v_k * q
    d01, d02, d12 = m00 * m11 - m01 * m10, m00 * m12 - m02 * m10, m01 * m12 - m02 * m11
    e01, e02, e12, e = TWO * d01 * v_det, TWO * d02 * v_det, TWO * d12 * v_det, TWO * eps2d * v_det
    f = e + TWO * v_cyy
    return (
        e01 * m11 + e02 * m12 + e * m00 + v_cxy * m10,
        -e01 * m10 + e12 * m12 + e * m01 + v_cxy * m11,
        -e02 * m10 - e12 * m11 + e * m02 + v_cxy * m12,
        -e01 * m01 - e02 * m02 + f * m10 + v_cxy * m00,
        e01 * m00 - e12 * m02 + f * m11 + v_cxy * m01,
        e02 * m00 + e12 * m01 + f * m12 + v_cxy * m02,
    )


@njit(forceinline=True, error_model="numpy", fastmath=FAST)
def _rotation_backward(r, v, v_quats, i):
    """Gradient of the unnormalised quaternion from that of its rotation matrix."""
    w, x, y, z, inv = r[9], r[10], r[11], r[12], r[13]
    vw = TWO * (x * (v[2, 1] - v[1, 2]) + y * (v[0, 2] - v[2, 0]) + z * (v[1, 0] - v[0, 1]))
    vx = TWO * (
        y * (v[1, 0] + v[0, 1]) + z * (v[2, 0] + v[0, 2]) + w * (v[2, 1] - v[1, 2]) - TWO * x * (v[1, 1] + v[2, 2])
    )
    vy = TWO * (
        x * (v[1, 0] + v[0, 1]) + z * (v[2, 1] + v[1, 2]) + w * (v[0, 2] - v[2, 0]) - TWO * y * (v[0, 0] + v[2, 2])
    )
    vz = TWO * (
        x * (v[2, 0] + v[0, 2]) + y * (v[2, 1] + v[1, 2]) + w * (v[1, 0] - v[0, 1]) - TWO * z * (v[0, 0] + v[1, 1])
    )
    along = vw * w + vx * x + vy * y + vz * z
    v_quats[i, 0] = (vw - along * w) * inv
    v_quats[i, 1] = (vx - along * x) * inv
    v_quats[i, 2] = (vy - along * y) * inv
    v_quats[i, 3] = (vz - along * z) * inv
