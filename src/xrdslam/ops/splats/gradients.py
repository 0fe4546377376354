"""From the tiles' sums to the gradients of the map and of the pose: the chain rule through the projection."""

# Kernels take numpy arrays and scalars that numba types by itself:
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
# ruff: noqa: ANN001, ANN201, ANN202

import math

import numpy as np
from numba import prange

from xrdslam.ops.simd import kernel, load, parallel_kernel, store, zeros
from xrdslam.ops.splats import layout
from xrdslam.ops.splats.layout import f32
from xrdslam.ops.splats.projection import covariance, covariance_root, rotation_column, to_camera

_HALF, _ONE, _TWO, _ZERO = f32(0.5), f32(1), f32(2), f32(0)
POSE = 12
"""Entries of the pose gradient: dL/dR row by row, then dL/dt."""


@parallel_kernel
def gaussian_gradients(
    view,
    means,
    log_scales,
    opacity_logits,
    quats,
    chunk,
    pose_only,
    candidates,
    counts,
    slots,
    moments,
    d_means,
    d_log_scales,
    d_logits,
    d_colors,
    d_quats,
    d_pose,
):
    """Sum each Gaussian's slots and carry them to its parameters; `d_pose` gets one row of twelve sums per chunk.

    With `pose_only` the map's gradients are left alone; otherwise those of Gaussians that are not seen become zero.
    """
    n = means.shape[0]
    for c in prange(counts.shape[0]):
        first, last = c * chunk, min(n, c * chunk + chunk)
        if not pose_only:
            d_means[first:last] = _ZERO
            d_log_scales[first:last] = _ZERO
            d_logits[first:last] = _ZERO
            d_colors[first:last] = _ZERO
            d_quats[first : min(last, d_quats.shape[0])] = _ZERO
        pose, total = np.zeros(POSE, np.float64), np.empty(layout.RECORD, np.float32)
        root, d_root = np.empty((2, 3), np.float32), np.empty((2, 3), np.float32)
        d_rotation = np.zeros((3, 3), np.float32)
        for j in range(first, first + counts[c]):
            if not _sum_slots(moments, slots[j, 0], slots[j, 1], total):
                continue
            i = candidates[j]
            x, y, z = to_camera(view, means, i)
            tx, ty = covariance_root(view, log_scales, quats, i, x, y, z, root)
            du, dv = _covariance_gradient(view, root, total, d_root)
            dx, dy, dz = _point_gradient(view, log_scales, quats, i, x, y, z, tx, ty, du, dv, root, d_root, d_rotation)
            dz += total[layout.M_DEPTH]
            _add_pose(pose, means, i, dx, dy, dz)
            if not pose_only:
                d_means[i, 0] = view[0] * dx + view[3] * dy + view[6] * dz
                d_means[i, 1] = view[1] * dx + view[4] * dy + view[7] * dz
                d_means[i, 2] = view[2] * dx + view[5] * dy + view[8] * dz
                d_logits[i] = total[layout.M_1] / (_ONE + math.exp(opacity_logits[i]))
                for k in range(3):
                    d_colors[i, k] = total[layout.M_RED + k]
                _scale_gradient(view, log_scales, quats, i, x, y, z, tx, ty, root, d_root, d_log_scales, d_quats)
        for k in range(3):
            for m in range(3):
                pose[3 * k + m] += d_rotation[k, m]
        d_pose[c, :] = pose


@kernel
def _sum_slots(moments, slot, box, total):
    """Add a Gaussian's slots; returns False if it has none."""
    count = ((box >> 8 & 255) - (box & 255) + 1) * ((box >> 24 & 255) - (box >> 16 & 255) + 1)
    if count == 0:
        return False
    value = zeros()
    for k in range(slot, slot + count):
        value += load(moments, k * layout.RECORD)
    store(total, 0, value)
    return True


@kernel
def _covariance_gradient(view, root, total, d_root):
    """Carry the moments to the centre (returned, du and dv) and to the covariance's root.

    The conic is the inverse of (a b; b c), so dL/dcov = conic (second moments of g) conic / 2.
    """
    a, b, c, inverse = covariance(root, view[layout.LOWPASS])
    A, B, C = c * inverse, -b * inverse, a * inverse
    m_xx, m_xy, m_yy = total[layout.M_XX], total[layout.M_XY], total[layout.M_YY]
    px, py, qx, qy = A * m_xx + B * m_xy, A * m_xy + B * m_yy, B * m_xx + C * m_xy, B * m_xy + C * m_yy
    ga, gb, gc = px * A + py * B, px * B + py * C, qx * B + qy * C  # twice dL/da, dL/db, twice dL/dc
    for k in range(3):
        d_root[0, k] = ga * root[0, k] + gb * root[1, k]
        d_root[1, k] = gb * root[0, k] + gc * root[1, k]
    m_x, m_y = total[layout.M_X], total[layout.M_Y]
    return A * m_x + B * m_y, B * m_x + C * m_y


@kernel
def _point_gradient(view, log_scales, quats, i, x, y, z, tx, ty, du, dv, root, d_root, d_rotation):
    """Return dL/d(x, y, z) through the centre and through J; for anisotropic Gaussians adds dL/dR_cw of the covariance.

    root = J M with M = R_cw R_q diag(s), or M = s I: dL/dJ = d_root M^T, dL/dM = J^T d_root.
    """
    fx, fy = view[layout.FX], view[layout.FY]
    j00, j02, j11, j12 = fx / z, -fx * tx / (z * z), fy / z, -fy * ty / (z * z)
    d00 = d02 = d11 = d12 = _ZERO
    if log_scales.shape[1] == 1:
        s = math.exp(log_scales[i, 0])
        d00, d02, d11, d12 = d_root[0, 0] * s, d_root[0, 2] * s, d_root[1, 1] * s, d_root[1, 2] * s
    else:
        for col in range(3):
            q0, q1, q2 = rotation_column(quats, i, col)
            s = math.exp(log_scales[i, col])
            m0 = (view[0] * q0 + view[1] * q1 + view[2] * q2) * s
            m1 = (view[3] * q0 + view[4] * q1 + view[5] * q2) * s
            m2 = (view[6] * q0 + view[7] * q1 + view[8] * q2) * s
            e0, e1 = d_root[0, col], d_root[1, col]
            d00 += e0 * m0
            d02 += e0 * m2
            d11 += e1 * m1
            d12 += e1 * m2
            g0, g1, g2 = j00 * e0 * s, j11 * e1 * s, (j02 * e0 + j12 * e1) * s
            d_rotation[0, 0] += g0 * q0
            d_rotation[0, 1] += g0 * q1
            d_rotation[0, 2] += g0 * q2
            d_rotation[1, 0] += g1 * q0
            d_rotation[1, 1] += g1 * q1
            d_rotation[1, 2] += g1 * q2
            d_rotation[2, 0] += g2 * q0
            d_rotation[2, 1] += g2 * q1
            d_rotation[2, 2] += g2 * q2
    dx, dy = j00 * du, j11 * dv
    dz = -(j00 * x * du + j11 * y * dv) / z
    dz -= (j00 * d00 + j11 * d11 + _TWO * (j02 * d02 + j12 * d12)) / z
    if tx == x:
        dx -= fx / (z * z) * d02
    if ty == y:
        dy -= fy / (z * z) * d12
    return dx, dy, dz


@kernel
def _add_pose(pose, means, i, dx, dy, dz):
    """Add dL/dR += dX X_w^T and dL/dt += dX."""
    for k in range(3):
        pose[k] += dx * means[i, k]
        pose[3 + k] += dy * means[i, k]
        pose[6 + k] += dz * means[i, k]
    pose[9] += dx
    pose[10] += dy
    pose[11] += dz


@kernel
def _scale_gradient(view, log_scales, quats, i, x, y, z, tx, ty, root, d_root, d_log_scales, d_quats):
    """Write dL/dlog(scale), and dL/dq of anisotropic Gaussians: each column of the root carries one scale."""
    if log_scales.shape[1] == 1:
        total = _ZERO
        for k in range(3):
            total += root[0, k] * d_root[0, k] + root[1, k] * d_root[1, k]
        d_log_scales[i, 0] = total
        return
    j00, j11 = view[layout.FX] / z, view[layout.FY] / z
    j02, j12 = -j00 * tx / z, -j11 * ty / z
    w, qx, qy, qz = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
    norm_sq = w * w + qx * qx + qy * qy + qz * qz
    n = _TWO / norm_sq
    gw = gx = gy = gz = _ZERO
    for col in range(3):
        d_log_scales[i, col] = root[0, col] * d_root[0, col] + root[1, col] * d_root[1, col]
        s = math.exp(log_scales[i, col]) * n
        e0, e1 = j00 * d_root[0, col] * s, j11 * d_root[1, col] * s
        e2 = (j02 * d_root[0, col] + j12 * d_root[1, col]) * s
        g0 = view[0] * e0 + view[3] * e1 + view[6] * e2  # n times dL/d(R_q column)
        g1 = view[1] * e0 + view[4] * e1 + view[7] * e2
        g2 = view[2] * e0 + view[5] * e1 + view[8] * e2
        if col == 0:
            gw += g1 * qz - g2 * qy
            gx += g1 * qy + g2 * qz
            gy += -_TWO * g0 * qy + g1 * qx - g2 * w
            gz += -_TWO * g0 * qz + g1 * w + g2 * qx
        elif col == 1:
            gw += -g0 * qz + g2 * qx
            gx += g0 * qy - _TWO * g1 * qx + g2 * w
            gy += g0 * qx + g2 * qz
            gz += -g0 * w - _TWO * g1 * qz + g2 * qy
        else:
            gw += g0 * qy - g1 * qx
            gx += g0 * qz - g1 * w - _TWO * g2 * qx
            gy += g0 * w + g1 * qz - _TWO * g2 * qy
            gz += g0 * qx + g1 * qy
    radial = (gw * w + gx * qx + gy * qy + gz * qz) / norm_sq  # the length of q does not matter
    d_quats[i, 0] = gw - radial * w
    d_quats[i, 1] = gx - radial * qx
    d_quats[i, 2] = gy - radial * qy
    d_quats[i, 3] = gz - radial * qz
