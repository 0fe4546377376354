"""The projection of 16 Gaussians at a time: what forward and backward both compute, in the same way.

Parameters are first copied into a lane-major buffer, one row of 16 per quantity (`load_lanes`): plain loads and stores
cost less than gathers.
"""

# Kernels take numpy arrays and scalars that numba types by itself:
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
# ruff: noqa: ANN001, ANN201

import math

from xrdslam.ops.simd import exp2, kernel, load, maximum, minimum, splat, zeros
from xrdslam.ops.splats import layout
from xrdslam.ops.splats.layout import f32

X, Y, Z, LOGIT, LOG_SCALES, QUAT = (16 * row for row in (0, 1, 2, 3, 4, 7))
LANE_BUFFER = 16 * 11
"""Floats of the buffer: mean, logit, up to three log scales, quaternion."""

_ONE, _TWO, LOG2E = f32(1), f32(2), f32(1 / math.log(2))
_EXPONENT_MAX = f32(120)


@kernel
def load_lanes(means, log_scales, opacity_logits, quats, candidates, j, last, lanes):
    """Copy the parameters of candidates j ... j + 15 into lanes; past the last one, its copies fill up."""
    for k in range(16):
        i = candidates[min(j + k, last)]
        lanes[X + k], lanes[Y + k], lanes[Z + k] = means[i, 0], means[i, 1], means[i, 2]
        lanes[LOGIT + k] = opacity_logits[i]
        lanes[LOG_SCALES + k] = log_scales[i, 0]
        if log_scales.shape[1] > 1:
            lanes[LOG_SCALES + 16 + k], lanes[LOG_SCALES + 32 + k] = log_scales[i, 1], log_scales[i, 2]
            for q in range(4):
                lanes[QUAT + 16 * q + k] = quats[i, q]


@kernel
def camera_points(view, lanes):
    """Return the means in camera axes."""
    x, y, z = load(lanes, X), load(lanes, Y), load(lanes, Z)
    t = layout.TRANSLATION
    return (
        x * view[0] + y * view[1] + z * view[2] + view[t],
        x * view[3] + y * view[4] + z * view[5] + view[t + 1],
        x * view[6] + y * view[7] + z * view[8] + view[t + 2],
    )


@kernel
def exponential(x):
    """Return e^x of vectors, kept within float32's normal range."""
    return exp2(maximum(minimum(x * LOG2E, _EXPONENT_MAX), -_EXPONENT_MAX))


@kernel
def shear(view, x, y, z):
    """Return (tx, ty, J00, J02, J11, J12): the point as J uses it, x/z and y/z clamped, and J = d(u, v)/d(x, y, z)."""
    limit_x, limit_y = z * view[layout.LIMIT_X], z * view[layout.LIMIT_Y]
    tx = maximum(minimum(x, limit_x), zeros() - limit_x)
    ty = maximum(minimum(y, limit_y), zeros() - limit_y)
    inverse = splat(_ONE) / z
    j00, j11 = inverse * view[layout.FX], inverse * view[layout.FY]
    return tx, ty, j00, zeros() - j00 * tx * inverse, j11, zeros() - j11 * ty * inverse


@kernel
def rotation_columns(lanes):
    """Return the nine entries of the quaternions' rotations, column by column."""
    w, x, y, z = load(lanes, QUAT), load(lanes, QUAT + 16), load(lanes, QUAT + 32), load(lanes, QUAT + 48)
    n = _TWO / (w * w + x * x + y * y + z * z)
    return (
        (_ONE - n * (y * y + z * z), n * (x * y + w * z), n * (x * z - w * y)),
        (n * (x * y - w * z), _ONE - n * (x * x + z * z), n * (y * z + w * x)),
        (n * (x * z + w * y), n * (y * z - w * x), _ONE - n * (x * x + y * y)),
    )


@kernel
def camera_axis(view, column, log_scale):
    """Return R_cw times a column of R_q, times the scale of that axis."""
    s = exponential(log_scale)
    return (
        (column[0] * view[0] + column[1] * view[1] + column[2] * view[2]) * s,
        (column[0] * view[3] + column[1] * view[4] + column[2] * view[5]) * s,
        (column[0] * view[6] + column[1] * view[7] + column[2] * view[8]) * s,
    )


@kernel
def covariance_root(view, lanes, isotropic, j00, j02, j11, j12):
    """Return the six entries, row by row, of J R_cw R_q diag(scale): the root of the covariance before the low-pass.

    An isotropic Gaussian needs no rotation: J s.
    """
    if isotropic:
        s = exponential(load(lanes, LOG_SCALES))
        return j00 * s, zeros(), j02 * s, zeros(), j11 * s, j12 * s
    first, second, third = rotation_columns(lanes)
    p0, p1, p2 = camera_axis(view, first, load(lanes, LOG_SCALES))
    q0, q1, q2 = camera_axis(view, second, load(lanes, LOG_SCALES + 16))
    r0, r1, r2 = camera_axis(view, third, load(lanes, LOG_SCALES + 32))
    return (
        j00 * p0 + j02 * p2,
        j00 * q0 + j02 * q2,
        j00 * r0 + j02 * r2,
        j11 * p1 + j12 * p2,
        j11 * q1 + j12 * q2,
        j11 * r1 + j12 * r2,
    )


@kernel
def covariance(root, lowpass):
    """Return (a, b, c) of root root^T + lowpass I and 1 / (ac - b^2).

    The determinant comes from the root's minors (Cauchy-Binet): ac - b^2 would cancel where the Gaussian is a streak.
    """
    r00, r01, r02, r10, r11, r12 = root
    a, b, c = r00 * r00 + r01 * r01 + r02 * r02, r00 * r10 + r01 * r11 + r02 * r12, r10 * r10 + r11 * r11 + r12 * r12
    m01, m02, m12 = r00 * r11 - r01 * r10, r00 * r12 - r02 * r10, r01 * r12 - r02 * r11
    det = m01 * m01 + m02 * m02 + m12 * m12 + (a + c + lowpass) * lowpass
    return a + lowpass, b, c + lowpass, splat(_ONE) / det
