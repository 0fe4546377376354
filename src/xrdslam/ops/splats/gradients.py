"""From the tiles' sums to the gradients of the map and of the pose: the chain rule through the projection."""

# Kernels take numpy arrays and scalars that numba types by itself:
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
# ruff: noqa: ANN001, ANN201, ANN202

import numpy as np
from numba import prange

from xrdslam.ops.simd import kernel, load, parallel_kernel, select, splat, store, transpose, zeros
from xrdslam.ops.splats import geometry, layout
from xrdslam.ops.splats.geometry import (
    LANE_BUFFER,
    LOG_SCALES,
    LOGIT,
    QUAT,
    camera_points,
    covariance,
    covariance_root,
    exponential,
    load_lanes,
    rotation_columns,
    shear,
)
from xrdslam.ops.splats.layout import f32

_ONE, _TWO, _ZERO = f32(1), f32(2), f32(0)
POSE = 12
"""Entries of the pose gradient: dL/dR row by row, then dL/dt."""
_LIVE = 10  # lane of a sum that says whether the Gaussian has slots
_MEAN, _D_LOGIT, _SCALES, _QUATS = 0, 48, 64, 112  # rows of the output lanes
_COLORS = 176
_OUT = 224


@parallel_kernel
def gaussian_gradients(
    view, means, log_scales, opacity_logits, quats, chunk, pose_only, candidates, counts, slots, moments,
    d_means, d_log_scales, d_logits, d_colors, d_quats, d_pose,
):  # fmt: skip
    """Sum each Gaussian's slots and carry them to its parameters; `d_pose` gets one row of sums per chunk.

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
        lanes, sums, out = np.empty(LANE_BUFFER, np.float32), np.zeros(256, np.float32), np.empty(_OUT, np.float32)
        pose = np.zeros(12 * 16, np.float32)
        end = first + counts[c]
        for j in range(first, end, 16):
            load_lanes(means, log_scales, opacity_logits, quats, candidates, j, end - 1, lanes)
            for k in range(16):
                _sum_slots(moments, slots, j + k, end, sums, 16 * k)
            _carry(view, lanes, log_scales.shape[1] == 1, pose_only, sums, pose, out)
            if not pose_only:
                for k in range(min(16, end - j)):
                    _scatter(out, k, candidates[j + k], d_means, d_log_scales, d_logits, d_colors, d_quats)
        _total_pose(pose, d_pose, c)


@kernel
def _sum_slots(moments, slots, j, end, sums, at):
    """Add a Gaussian's slots into a row of `sums`; without slots the row is zero, and its lane `_LIVE` says so."""
    value, count = zeros(), 0
    if j < end:
        slot, box = np.int64(slots[j, 0]), slots[j, 1]
        count = ((box >> 8 & 255) - (box & 255) + 1) * ((box >> 24 & 255) - (box >> 16 & 255) + 1)
        for k in range(slot, slot + count):
            value += load(moments, k * layout.RECORD)
    store(sums, at, value)
    sums[at + _LIVE] = f32(count)


@kernel
def _carry(view, lanes, isotropic, pose_only, sums, pose, out):
    """Carry the sums of 16 Gaussians to their parameters (`out`) and add their part of the pose gradient.

    root = J M, with M = R_cw R_q diag(s) or s I: dL/dJ = d_root M^T and dL/dM = J^T d_root.
    """
    m = transpose(_rows(sums))
    x, y, z = camera_points(view, lanes)
    tx, ty, j00, j02, j11, j12 = shear(view, x, y, z)
    root = covariance_root(view, lanes, isotropic, j00, j02, j11, j12)
    du, dv, d_root = _image_gradient(view, root, m)
    if isotropic:
        s = exponential(load(lanes, LOG_SCALES))
        d00, d02, d11, d12 = d_root[0] * s, d_root[2] * s, d_root[4] * s, d_root[5] * s
    else:
        d00, d02, d11, d12 = _anisotropic(view, lanes, m[_LIVE] > _ZERO, (j00, j02, j11, j12), d_root, pose, out)
    inverse = splat(_ONE) / z
    dx = du * j00 - select(_same(tx, x), j00 * inverse * d02, zeros())  # a clamped x/z is a constant
    dy = dv * j11 - select(_same(ty, y), j11 * inverse * d12, zeros())
    dz = du * j00 * x + dv * j11 * y + d00 * j00 + d11 * j11 + (d02 * j02 + d12 * j12) * _TWO
    dz = m[layout.M_DEPTH] - dz * inverse
    live = m[_LIVE] > _ZERO
    dx, dy, dz = select(live, dx, zeros()), select(live, dy, zeros()), select(live, dz, zeros())
    _add_pose(lanes, dx, dy, dz, pose)
    if not pose_only:
        store(out, _MEAN, dx * view[0] + dy * view[3] + dz * view[6])
        store(out, _MEAN + 16, dx * view[1] + dy * view[4] + dz * view[7])
        store(out, _MEAN + 32, dx * view[2] + dy * view[5] + dz * view[8])
        store(out, _D_LOGIT, m[layout.M_1] / (exponential(load(lanes, LOGIT)) + _ONE))
        if isotropic:
            d_scale = root[0] * d_root[0] + root[2] * d_root[2] + root[4] * d_root[4] + root[5] * d_root[5]
            store(out, _SCALES, select(live, d_scale, zeros()))
        store(out, _COLORS, m[layout.M_RED])
        store(out, _COLORS + 16, m[layout.M_GREEN])
        store(out, _COLORS + 32, m[layout.M_BLUE])


@kernel
def _rows(sums):
    """Return the 16 rows of a 16x16 buffer."""
    return (
        load(sums, 0), load(sums, 16), load(sums, 32), load(sums, 48), load(sums, 64), load(sums, 80), load(sums, 96),
        load(sums, 112), load(sums, 128), load(sums, 144), load(sums, 160), load(sums, 176), load(sums, 192),
        load(sums, 208), load(sums, 224), load(sums, 240),
    )  # fmt: skip


@kernel
def _same(a, b):
    """Say where two vectors are equal."""
    return (a >= b) & (b >= a)


@kernel
def _image_gradient(view, root, m):
    """Return dL/du, dL/dv and dL/droot.

    The conic K is the covariance's inverse, so dL/dcov = K (second moments of g) K / 2; and cov = root root^T.
    """
    a, b, c, inverse = covariance(root, view[layout.LOWPASS])
    A, B, C = c * inverse, zeros() - b * inverse, a * inverse
    m_xx, m_xy, m_yy = m[layout.M_XX], m[layout.M_XY], m[layout.M_YY]
    px, py, qx, qy = A * m_xx + B * m_xy, A * m_xy + B * m_yy, B * m_xx + C * m_xy, B * m_xy + C * m_yy
    ga, gb, gc = px * A + py * B, px * B + py * C, qx * B + qy * C
    r00, r01, r02, r10, r11, r12 = root
    d_root = (
        ga * r00 + gb * r10,
        ga * r01 + gb * r11,
        ga * r02 + gb * r12,
        gb * r00 + gc * r10,
        gb * r01 + gc * r11,
        gb * r02 + gc * r12,
    )
    return A * m[layout.M_X] + B * m[layout.M_Y], B * m[layout.M_X] + C * m[layout.M_Y], d_root


@kernel
def _anisotropic(view, lanes, live, J, d_root, pose, out):
    """Write dL/dlog(scale) and dL/dquaternion, add dL/dR_cw of the covariance; returns dL/dJ where J varies."""
    first, second, third = rotation_columns(lanes)
    a = _axis(view, load(lanes, LOG_SCALES), first, live, J, d_root[0], d_root[3], pose, out, _SCALES)
    b = _axis(view, load(lanes, LOG_SCALES + 16), second, live, J, d_root[1], d_root[4], pose, out, _SCALES + 16)
    c = _axis(view, load(lanes, LOG_SCALES + 32), third, live, J, d_root[2], d_root[5], pose, out, _SCALES + 32)
    _quaternion_gradient(lanes, (a[4], a[5], a[6]), (b[4], b[5], b[6]), (c[4], c[5], c[6]), out)
    return a[0] + b[0] + c[0], a[1] + b[1] + c[1], a[2] + b[2] + c[2], a[3] + b[3] + c[3]


@kernel
def _axis(view, log_scale, column, live, J, e0, e1, pose, out, scale_row):
    """Handle one axis: its dL/dlog(scale), its parts of dL/dJ and dL/dR_cw; returns dL/dJ and dL/d(column of R_q)."""
    j00, j02, j11, j12 = J
    s = exponential(log_scale)
    m0, m1, m2 = geometry.camera_axis(view, column, log_scale)
    d_scale = (j00 * m0 + j02 * m2) * e0 + (j11 * m1 + j12 * m2) * e1
    store(out, scale_row, select(live, d_scale, zeros()))
    g0, g1, g2 = j00 * e0 * s, j11 * e1 * s, (j02 * e0 + j12 * e1) * s
    g0, g1, g2 = select(live, g0, zeros()), select(live, g1, zeros()), select(live, g2, zeros())
    for k in range(3):
        _accumulate(pose, 16 * k, g0 * column[k])
        _accumulate(pose, 48 + 16 * k, g1 * column[k])
        _accumulate(pose, 96 + 16 * k, g2 * column[k])
    d0 = g0 * view[0] + g1 * view[3] + g2 * view[6]
    d1 = g0 * view[1] + g1 * view[4] + g2 * view[7]
    d2 = g0 * view[2] + g1 * view[5] + g2 * view[8]
    return e0 * m0, e0 * m2, e1 * m1, e1 * m2, d0, d1, d2


@kernel
def _quaternion_gradient(lanes, p, q, r, out):
    """Carry dL/dR_q, given column by column, to quaternions of any length."""
    w, x, y, z = load(lanes, QUAT), load(lanes, QUAT + 16), load(lanes, QUAT + 32), load(lanes, QUAT + 48)
    norm_sq = w * w + x * x + y * y + z * z
    dw = (p[1] * z - p[2] * y) + (q[2] * x - q[0] * z) + (r[0] * y - r[1] * x)
    dx = (p[1] * y + p[2] * z) + (q[0] * y + q[2] * w) + (r[0] * z - r[1] * w) - (q[1] + r[2]) * x * _TWO
    dy = (p[1] * x - p[2] * w) + (q[0] * x + q[2] * z) + (r[0] * w + r[1] * z) - (p[0] + r[2]) * y * _TWO
    dz = (p[1] * w + p[2] * x) + (q[2] * y - q[0] * w) + (r[0] * x + r[1] * y) - (p[0] + q[1]) * z * _TWO
    radial = (dw * w + dx * x + dy * y + dz * z) / norm_sq  # the length does not matter
    scale = _TWO / norm_sq
    store(out, _QUATS, (dw - radial * w) * scale)
    store(out, _QUATS + 16, (dx - radial * x) * scale)
    store(out, _QUATS + 32, (dy - radial * y) * scale)
    store(out, _QUATS + 48, (dz - radial * z) * scale)


@kernel
def _accumulate(array, at, value):
    store(array, at, load(array, at) + value)


@kernel
def _add_pose(lanes, dx, dy, dz, pose):
    """Add dL/dR += dX X_w^T and dL/dt += dX, lane by lane."""
    for k in range(3):
        mean = load(lanes, 16 * k)
        _accumulate(pose, 16 * k, dx * mean)
        _accumulate(pose, 48 + 16 * k, dy * mean)
        _accumulate(pose, 96 + 16 * k, dz * mean)
    _accumulate(pose, 144, dx)
    _accumulate(pose, 160, dy)
    _accumulate(pose, 176, dz)


@kernel
def _total_pose(pose, d_pose, c):
    """Add up the lanes of the pose gradient."""
    for k in range(12):
        total = 0.0
        for lane in range(16):
            total += pose[16 * k + lane]
        d_pose[c, k] = total


@kernel
def _scatter(out, k, i, d_means, d_log_scales, d_logits, d_colors, d_quats):
    """Write one lane's gradients to the place of its Gaussian."""
    d_logits[i] = out[_D_LOGIT + k]
    for axis in range(3):
        d_means[i, axis] = out[_MEAN + 16 * axis + k]
        d_colors[i, axis] = out[_COLORS + 16 * axis + k]
    for axis in range(d_log_scales.shape[1]):
        d_log_scales[i, axis] = out[_SCALES + 16 * axis + k]
    for entry in range(4 if d_quats.shape[0] > 0 else 0):
        d_quats[i, entry] = out[_QUATS + 16 * entry + k]
