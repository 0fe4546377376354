"""From the map to the image: which Gaussians can be seen, and the record that the tiles read of each.

Gaussians are worked on in chunks of `chunk_size`; what a chunk finds is packed at the chunk's own start in the output
arrays, so that no second pass is needed to know where to write.
"""

# Kernels take numpy arrays and scalars that numba types by itself:
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
# ruff: noqa: ANN001, ANN201, ANN202

import math

import numpy as np
from numba import prange

from xrdslam.ops.simd import kernel, parallel_kernel
from xrdslam.ops.splats import layout
from xrdslam.ops.splats.layout import f32
from xrdslam.ops.splats.types import FOOTPRINT_MAX_SQ

_HALF, _ONE, _TWO, _ZERO = f32(0.5), f32(1), f32(2), f32(0)
_LN255, _LOG2E = f32(math.log(255)), f32(1 / math.log(2))
_LOGIT_MIN = f32(-math.log(254))
_FOOTPRINT_MAX_SQ = f32(FOOTPRINT_MAX_SQ)


@parallel_kernel
def find_candidates(view, width, height, means, log_scales, opacity_logits, chunk, candidates, counts):
    """List the Gaussians that may leave a mark, each chunk's indices packed at its start; `counts` says how many.

    With a slack in the view, whatever may leave a mark from a pose that is no further away than that is listed as well.
    """
    n = means.shape[0]
    for c in prange(counts.shape[0]):
        found = 0
        for i in range(c * chunk, min(n, c * chunk + chunk)):
            if opacity_logits[i] > _LOGIT_MIN and _may_be_seen(view, width, height, means, log_scales, i):
                candidates[c * chunk + found] = i
                found += 1
        counts[c] = found


@kernel
def to_camera(view, means, i):
    """Return one mean in camera axes."""
    px, py, pz = means[i, 0], means[i, 1], means[i, 2]
    return (
        view[0] * px + view[1] * py + view[2] * pz + view[layout.TRANSLATION],
        view[3] * px + view[4] * py + view[5] * pz + view[layout.TRANSLATION + 1],
        view[6] * px + view[7] * py + view[8] * pz + view[layout.TRANSLATION + 2],
    )


@kernel
def _may_be_seen(view, width, height, means, log_scales, i):
    """Say whether a ball about the mean, as large as the slack, reaches the frustum widened by the footprint."""
    x, y, z = to_camera(view, means, i)
    reach = view[layout.SLACK_TRANSLATION] + view[layout.SLACK_ROTATION] * math.sqrt(x * x + y * y + z * z)
    near = view[layout.NEAR]
    if not z + reach > near:
        return False
    fx, fy, cx, cy = view[layout.FX], view[layout.FY], view[layout.CX], view[layout.CY]
    u, v = fx * x + cx * z, fy * y + cy * z  # times z
    right, bottom = f32(width - 1), f32(height - 1)
    if z > near and u >= _ZERO and v >= _ZERO and u <= right * z and v <= bottom * z:
        return True
    scale = log_scales[i, 0]
    for k in range(1, log_scales.shape[1]):
        scale = max(scale, log_scales[i, k])
    spread = math.exp(scale) / max(near, z - reach)
    sx, sy = spread * fx, spread * fy
    lx, ly = view[layout.LIMIT_X], view[layout.LIMIT_Y]
    lowpass, margin = view[layout.LOWPASS], view[layout.MARGIN_PX] + _ONE
    half_u = math.sqrt(_FOOTPRINT_MAX_SQ * (sx * sx * (_ONE + lx * lx) + lowpass)) + margin
    half_v = math.sqrt(_FOOTPRINT_MAX_SQ * (sy * sy * (_ONE + ly * ly) + lowpass)) + margin
    low_u, low_v, high_u, high_v = cx + half_u, cy + half_v, cx - right - half_u, cy - bottom - half_v
    return (
        fx * x + low_u * z + reach * math.sqrt(fx * fx + low_u * low_u) >= _ZERO
        and fy * y + low_v * z + reach * math.sqrt(fy * fy + low_v * low_v) >= _ZERO
        and fx * x + high_u * z - reach * math.sqrt(fx * fx + high_u * high_u) <= _ZERO
        and fy * y + high_v * z - reach * math.sqrt(fy * fy + high_v * high_v) <= _ZERO
    )


@kernel
def covariance_root(view, log_scales, quats, i, x, y, z, root):
    """Write the 2x3 matrix whose square is the image-plane covariance before the low-pass: J R_cw R_q diag(scale).

    Isotropic Gaussians are the case without rotations. Also returns (tx, ty): x and y, clamped as J uses them.
    """
    tx = max(-view[layout.LIMIT_X] * z, min(view[layout.LIMIT_X] * z, x))
    ty = max(-view[layout.LIMIT_Y] * z, min(view[layout.LIMIT_Y] * z, y))
    jx, jy = view[layout.FX] / z, view[layout.FY] / z
    kx, ky = -jx * tx / z, -jy * ty / z
    if log_scales.shape[1] == 1:
        s = math.exp(log_scales[i, 0])
        root[0, 0], root[0, 1], root[0, 2] = jx * s, _ZERO, kx * s
        root[1, 0], root[1, 1], root[1, 2] = _ZERO, jy * s, ky * s
        return tx, ty
    for col in range(3):
        # column of R_cw R_q diag(s)
        q0, q1, q2 = rotation_column(quats, i, col)
        s = math.exp(log_scales[i, col])
        m0 = view[0] * q0 + view[1] * q1 + view[2] * q2
        m1 = view[3] * q0 + view[4] * q1 + view[5] * q2
        m2 = view[6] * q0 + view[7] * q1 + view[8] * q2
        root[0, col] = (jx * m0 + kx * m2) * s
        root[1, col] = (jy * m1 + ky * m2) * s
    return tx, ty


@kernel
def covariance(root, lowpass):
    """Return (a, b, c) of root root^T + lowpass I and 1 / (ac - b^2).

    The determinant comes from the root's minors (Cauchy-Binet): ac - b^2 would cancel where the Gaussian is a streak.
    """
    a = root[0, 0] * root[0, 0] + root[0, 1] * root[0, 1] + root[0, 2] * root[0, 2]
    b = root[0, 0] * root[1, 0] + root[0, 1] * root[1, 1] + root[0, 2] * root[1, 2]
    c = root[1, 0] * root[1, 0] + root[1, 1] * root[1, 1] + root[1, 2] * root[1, 2]
    m01 = root[0, 0] * root[1, 1] - root[0, 1] * root[1, 0]
    m02 = root[0, 0] * root[1, 2] - root[0, 2] * root[1, 0]
    m12 = root[0, 1] * root[1, 2] - root[0, 2] * root[1, 1]
    det = m01 * m01 + m02 * m02 + m12 * m12 + lowpass * (a + c + lowpass)
    return a + lowpass, b, c + lowpass, _ONE / det


@kernel
def rotation_column(quats, i, column):
    """Return a column of the rotation of a quaternion of any length."""
    w, x, y, z = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
    n = _TWO / (w * w + x * x + y * y + z * z)
    if column == 0:
        return _ONE - n * (y * y + z * z), n * (x * y + w * z), n * (x * z - w * y)
    if column == 1:
        return n * (x * y - w * z), _ONE - n * (x * x + z * z), n * (y * z + w * x)
    return n * (x * z + w * y), n * (y * z - w * x), _ONE - n * (x * x + y * y)


@kernel
def _pixel_range(centre, half, size):
    """Return the first and last pixel within `half` of `centre`, cut to the image; first > last if there is none."""
    low, high = centre - half, centre + half
    if not (high >= _ZERO and low <= f32(size - 1)):  # NaN ends here as well
        return 1, 0
    return np.int64(math.ceil(max(low, _ZERO))), np.int64(math.floor(min(high, f32(size - 1))))


@kernel
def _write_record(view, width, height, means, log_scales, opacity_logits, colors, quats, i, root, record, bits):
    """Project one Gaussian into its record; returns the half sides of its footprint [px], negative if unseen."""
    x, y, z = to_camera(view, means, i)
    bits[layout.PIXELS_X] = layout.EMPTY_PIXELS
    bits[layout.PIXELS_Y] = layout.EMPTY_PIXELS
    log_opacity = -math.log(_ONE + math.exp(-opacity_logits[i]))
    k = _TWO * (_LN255 + log_opacity)
    if not (z > view[layout.NEAR] and k > _ZERO):
        return -_ONE, -_ONE
    covariance_root(view, log_scales, quats, i, x, y, z, root)
    a, b, c, inverse = covariance(root, view[layout.LOWPASS])
    scale = _LOG2E * inverse
    u = view[layout.FX] * x / z + view[layout.CX]
    v = view[layout.FY] * y / z + view[layout.CY]
    record[layout.U], record[layout.V] = u, v
    record[layout.POWER_XX], record[layout.POWER_YY] = -_HALF * c * scale, -_HALF * a * scale
    record[layout.POWER_XY] = b * scale
    record[layout.LOG2_OPACITY] = log_opacity * _LOG2E
    record[layout.RED], record[layout.GREEN], record[layout.BLUE] = colors[i, 0], colors[i, 1], colors[i, 2]
    record[layout.DEPTH] = z
    half_u, half_v = math.sqrt(k * a), math.sqrt(k * c)
    x0, x1 = _pixel_range(u, half_u, width)
    y0, y1 = _pixel_range(v, half_v, height)
    if x0 <= x1 and y0 <= y1:
        bits[layout.PIXELS_X], bits[layout.PIXELS_Y] = x0 | x1 << 16, y0 | y1 << 16
    return half_u, half_v


@kernel
def _tile_box(record, half_u, half_v, margin, width, height):
    """Return the packed tiles that the footprint, grown by the margin, touches, and how many they are."""
    if half_u < _ZERO:
        return 0, 0
    x0, x1 = _pixel_range(record[layout.U], half_u + margin, width)
    y0, y1 = _pixel_range(record[layout.V], half_v + margin, height)
    if x0 > x1 or y0 > y1:
        return 0, 0
    left, right, top, bottom = x0 // layout.TILE, x1 // layout.TILE, y0 // layout.TILE, y1 // layout.TILE
    return left | right << 8 | top << 16 | bottom << 24, (right - left + 1) * (bottom - top + 1)


@parallel_kernel
def project_fresh(
    view,
    width,
    height,
    means,
    log_scales,
    opacity_logits,
    colors,
    quats,
    chunk,
    keep_unseen,
    candidates,
    counts,
    records,
    slots,
    tile_counts,
    slot_counts,
):
    """Write the candidates' records, drop those that touch no tile, and count how many Gaussians each tile gets.

    `slots` gets each Gaussian's first slot, counted from its chunk's first; `keep_unseen` keeps, for lists that will be
    used again, what only the slack can bring into view: it has no tile and no slot.
    """
    bits = records.view(np.int32)
    tiles_x = (width + layout.TILE - 1) // layout.TILE
    for c in prange(counts.shape[0]):
        root = np.empty((2, 3), np.float32)
        found, slot = c * chunk, 0
        tile_counts[c, :] = 0
        for j in range(c * chunk, c * chunk + counts[c]):
            i = candidates[j]
            half_u, half_v = _write_record(
                view,
                width,
                height,
                means,
                log_scales,
                opacity_logits,
                colors,
                quats,
                i,
                root,
                records[found],
                bits[found],
            )
            box, touched = _tile_box(records[found], half_u, half_v, view[layout.MARGIN_PX], width, height)
            if touched == 0 and not keep_unseen:
                continue
            candidates[found] = i
            slots[found, 0], slots[found, 1] = slot, box if touched > 0 else layout.EMPTY_TILES
            slot += touched
            found += 1
            if touched > 0:
                for ty in range(box >> 16 & 255, (box >> 24 & 255) + 1):
                    for tx in range(box & 255, (box >> 8 & 255) + 1):
                        tile_counts[c, ty * tiles_x + tx] += 1
        counts[c] = found - c * chunk
        slot_counts[c] = slot


@parallel_kernel
def project_again(
    view,
    width,
    height,
    means,
    log_scales,
    opacity_logits,
    colors,
    quats,
    chunk,
    candidates,
    counts,
    slots,
    records,
    broken,
):
    """Write the records of Gaussians whose tile lists exist; `broken` marks chunks where a footprint left its tiles."""
    bits = records.view(np.int32)
    for c in prange(counts.shape[0]):
        root = np.empty((2, 3), np.float32)
        left_tiles = 0
        for j in range(c * chunk, c * chunk + counts[c]):
            _write_record(
                view,
                width,
                height,
                means,
                log_scales,
                opacity_logits,
                colors,
                quats,
                candidates[j],
                root,
                records[j],
                bits[j],
            )
            bits[j, layout.SLOT], bits[j, layout.TILES] = slots[j, 0], slots[j, 1]
            left_tiles |= _leaves_tiles(bits[j])
        broken[c] = left_tiles


@kernel
def _leaves_tiles(bits):
    """Return 1 if a record's pixels reach outside the tiles it is listed in, else 0."""
    px, py, box = bits[layout.PIXELS_X], bits[layout.PIXELS_Y], bits[layout.TILES]
    x0, x1, y0, y1 = px & 65535, px >> 16, py & 65535, py >> 16
    if x0 > x1 or y0 > y1:
        return 0
    inside = (
        x0 // layout.TILE >= (box & 255)
        and x1 // layout.TILE <= (box >> 8 & 255)
        and y0 // layout.TILE >= (box >> 16 & 255)
        and y1 // layout.TILE <= (box >> 24 & 255)
    )
    return 0 if inside else 1
