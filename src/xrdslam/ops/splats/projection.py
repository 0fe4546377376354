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

from xrdslam.ops.simd import (
    ceil,
    floor,
    kernel,
    load,
    log2,
    maximum,
    minimum,
    pack_pair,
    parallel_kernel,
    select,
    splat,
    sqrt,
    store,
    transpose,
    zeros,
)
from xrdslam.ops.splats import layout
from xrdslam.ops.splats.geometry import (
    LANE_BUFFER,
    LOG2E,
    LOGIT,
    camera_points,
    covariance,
    covariance_root,
    exponential,
    load_lanes,
    shear,
)
from xrdslam.ops.splats.layout import f32
from xrdslam.ops.splats.types import FOOTPRINT_MAX_SQ

_HALF, _ONE, _ZERO = f32(0.5), f32(1), f32(0)
_LOG2_255, _2LN2 = f32(math.log2(255)), f32(2 * math.log(2))
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
def _may_be_seen(view, width, height, means, log_scales, i):
    """Say whether a ball about the mean, as large as the slack, reaches the frustum widened by the footprint."""
    px, py, pz, t = means[i, 0], means[i, 1], means[i, 2], layout.TRANSLATION
    x = view[0] * px + view[1] * py + view[2] * pz + view[t]
    y = view[3] * px + view[4] * py + view[5] * pz + view[t + 1]
    z = view[6] * px + view[7] * py + view[8] * pz + view[t + 2]
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
def _pixel_range(centre, half, last):
    """Return the first and last pixel within `half` of the centre, cut to [0, last]; first > last if there is none."""
    return ceil(maximum(centre - half, _ZERO)), floor(minimum(centre + half, last))


@kernel
def _pixel_box(u, v, half_u, half_v, visible, right, bottom):
    """Return the packed pixel ranges of both axes, empty ones where nothing of the footprint is in the image."""
    left_u, right_u = _pixel_range(u, half_u, right)
    top_v, bottom_v = _pixel_range(v, half_v, bottom)
    seen = visible & (right_u >= left_u) & (bottom_v >= top_v)  # NaN ends here as well
    one, none = splat(_ONE), zeros()
    return (
        pack_pair(select(seen, left_u, one), select(seen, right_u, none)),
        pack_pair(select(seen, top_v, one), select(seen, bottom_v, none)),
    )


@kernel
def _write_records(view, width, height, lanes, isotropic, colors, records, j):
    """Project the 16 Gaussians in the lanes into records j ... j + 15.

    The records' last two entries are the pixel box grown by the margin, which decides the tiles.
    """
    x, y, z = camera_points(view, lanes)
    _, _, j00, j02, j11, j12 = shear(view, x, y, z)
    root = covariance_root(view, lanes, isotropic, j00, j02, j11, j12)
    a, b, c, inverse = covariance(root, view[layout.LOWPASS])
    u, v = j00 * x + view[layout.CX], j11 * y + view[layout.CY]
    log2_opacity = zeros() - log2(exponential(zeros() - load(lanes, LOGIT)) + _ONE)
    reach_sq = (log2_opacity + _LOG2_255) * _2LN2  # where alpha has fallen to 1/255, in standard deviations
    visible = (z > view[layout.NEAR]) & (reach_sq > _ZERO)
    half_u, half_v = sqrt(reach_sq * a), sqrt(reach_sq * c)
    right, bottom, margin = f32(width - 1), f32(height - 1), view[layout.MARGIN_PX]
    pixels_x, pixels_y = _pixel_box(u, v, half_u, half_v, visible, right, bottom)
    wide_x, wide_y = _pixel_box(u, v, half_u + margin, half_v + margin, visible, right, bottom)
    scale = inverse * LOG2E
    xx, xy, yy = c * scale * -_HALF, b * scale, a * scale * -_HALF
    red, green, blue = load(colors, 0), load(colors, 16), load(colors, 32)
    entries = (
        u,
        v,
        xx,
        xy,
        yy,
        log2_opacity,
        red,
        green,
        blue,
        z,
        pixels_x,
        pixels_y,
        zeros(),
        zeros(),
        wide_x,
        wide_y,
    )
    columns = transpose(entries)
    for k in range(16):
        store(records, (j + k) * layout.RECORD, columns[k])


@kernel
def _load_colors(colors, candidates, j, last, lanes):
    """Copy the colours of candidates j ... j + 15 into lanes."""
    for k in range(16):
        i = candidates[min(j + k, last)]
        lanes[k], lanes[16 + k], lanes[32 + k] = colors[i, 0], colors[i, 1], colors[i, 2]


@kernel
def _project_chunk(
    view, width, height, means, log_scales, opacity_logits, colors, quats, candidates, first, count, records,
    lanes, color_lanes,
):  # fmt: skip
    """Write the records of a chunk's candidates; the last batch may write past them, within the chunk."""
    last = first + count - 1
    isotropic = log_scales.shape[1] == 1
    for j in range(first, last + 1, 16):
        load_lanes(means, log_scales, opacity_logits, quats, candidates, j, last, lanes)
        _load_colors(colors, candidates, j, last, color_lanes)
        _write_records(view, width, height, lanes, isotropic, color_lanes, records, j)


@kernel
def _tile_box(wide_x, wide_y):
    """Return the packed tiles that a pixel box touches."""
    if (wide_x & 65535) > (wide_x >> 16):
        return layout.EMPTY_TILES
    left, right = (wide_x & 65535) // layout.TILE, (wide_x >> 16) // layout.TILE
    top, bottom = (wide_y & 65535) // layout.TILE, (wide_y >> 16) // layout.TILE
    return left | right << 8 | top << 16 | bottom << 24


@parallel_kernel
def project_fresh(
    view, width, height, means, log_scales, opacity_logits, colors, quats, chunk, candidates, counts, records,
    slots, tile_counts, slot_counts,
):  # fmt: skip
    """Write the candidates' records and tile boxes, and count how many Gaussians each tile gets.

    `slots` gets each Gaussian's first slot, counted from its chunk's first, and its tiles.
    """
    bits = records.view(np.int32)
    tiles_x = (width + layout.TILE - 1) // layout.TILE
    for c in prange(counts.shape[0]):
        lanes, color_lanes = np.empty(LANE_BUFFER, np.float32), np.empty(48, np.float32)
        first = c * chunk
        _project_chunk(
            view,
            width,
            height,
            means,
            log_scales,
            opacity_logits,
            colors,
            quats,
            candidates,
            first,
            counts[c],
            records,
            lanes,
            color_lanes,
        )
        tile_counts[c, :] = 0
        slot = 0
        for j in range(first, first + counts[c]):
            box = _tile_box(bits[j, layout.WIDE_X], bits[j, layout.WIDE_Y])
            slots[j, 0], slots[j, 1] = slot, box
            for ty in range(box >> 16 & 255, (box >> 24 & 255) + 1):
                for tx in range(box & 255, (box >> 8 & 255) + 1):
                    tile_counts[c, ty * tiles_x + tx] += 1
                    slot += 1
        slot_counts[c] = slot


@parallel_kernel
def project_again(
    view, width, height, means, log_scales, opacity_logits, colors, quats, chunk, candidates, counts, slots,
    records, broken,
):  # fmt: skip
    """Write the records of Gaussians whose tile lists exist; `broken` marks chunks where a footprint left its tiles."""
    bits = records.view(np.int32)
    for c in prange(counts.shape[0]):
        lanes, color_lanes = np.empty(LANE_BUFFER, np.float32), np.empty(48, np.float32)
        first = c * chunk
        _project_chunk(
            view,
            width,
            height,
            means,
            log_scales,
            opacity_logits,
            colors,
            quats,
            candidates,
            first,
            counts[c],
            records,
            lanes,
            color_lanes,
        )
        left_tiles = 0
        for j in range(first, first + counts[c]):
            bits[j, layout.SLOT], bits[j, layout.TILES] = slots[j, 0], slots[j, 1]
            left_tiles |= _leaves_tiles(bits[j, layout.PIXELS_X], bits[j, layout.PIXELS_Y], slots[j, 1])
        broken[c] = left_tiles


@kernel
def _leaves_tiles(px, py, box):
    """Return 1 if a pixel box reaches outside the tiles that list it, else 0."""
    x0, x1, y0, y1 = px & 65535, px >> 16, py & 65535, py >> 16
    if x0 > x1:
        return 0
    inside = (
        x0 // layout.TILE >= (box & 255)
        and x1 // layout.TILE <= (box >> 8 & 255)
        and y0 // layout.TILE >= (box >> 16 & 255)
        and y1 // layout.TILE <= (box >> 24 & 255)
    )
    return 0 if inside else 1
