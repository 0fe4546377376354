"""The gradient of compositing: each tile replays its list from the front and leaves one slot of sums per Gaussian.

With w_i = alpha_i T_i and q_i = (f_i . g), g the pixel's cotangent and f_i = (r, g, b, z, 1):
dL/dalpha_i = T_i q_i - (sum of w_j q_j behind i) / (1 - alpha_i). The sum behind is the pixel's total, known from the
rendered image, less what has been passed: one scalar per pixel instead of a suffix per channel. A slot belongs to one
Gaussian in one tile, so nothing is added by two threads and the result does not depend on their number.
"""

# Kernels take numpy arrays and scalars that numba types by itself:
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
# ruff: noqa: ANN001, ANN201, ANN202

import numpy as np
from numba import prange

from xrdslam.ops.simd import (
    absolute,
    any_true,
    exp2,
    fetch_add,
    inline_kernel,
    kernel,
    load,
    minimum,
    parallel_kernel,
    prefetch,
    select,
    splat,
    store,
    sum_lanes_of_16,
    zeros,
)
from xrdslam.ops.splats import layout
from xrdslam.ops.splats.blocks import load_block, split_rgb
from xrdslam.ops.splats.forward import (
    _AHEAD,
    _ALPHA_MAX,
    _COLUMNS,
    _LAST,
    _ONE,
    _POWER_MIN,
    _ROWS,
    _TRANSMITTANCE_MIN,
    _ZERO,
)
from xrdslam.ops.splats.layout import f32

_SLOTS_AHEAD = 3  # less than `_AHEAD`: finding the slot reads the record
STATE = 7 * layout.LANES
"""Floats of state per block: transmittance, total behind, cotangents of opacity, red, green, blue, depth."""


@parallel_kernel
def tile_gradients(
    workers, width, height, with_color, records, offsets, entries, stops, next_tile, state, rgb, depth,
    opacity, d_rgb, d_depth, d_opacity, moments,
):  # fmt: skip
    """Fill the gradient slots of all Gaussians in all tiles; without `with_color` those of the colours stay zero."""
    tiles = offsets.shape[0] - 1
    tiles_x = (width + layout.TILE - 1) // layout.TILE
    next_tile[0] = 0
    for worker in prange(workers):
        own = state[worker]
        while True:
            tile = fetch_add(next_tile, 0, 1)
            if tile >= tiles:
                break
            left, top = tile % tiles_x * layout.TILE, tile // tiles_x * layout.TILE
            _read(left, top, width, height, rgb, depth, opacity, d_rgb, d_depth, d_opacity, own)
            start, stop, end = offsets[tile], stops[tile], offsets[tile + 1]
            tile_x, tile_y = tile % tiles_x, tile // tiles_x
            _replay(with_color, records, entries, start, stop, tile_x, tile_y, own, moments)
            for e in range(stop, end):
                store(moments, _slot(records, entries[e], tile_x, tile_y) * layout.RECORD, zeros())


@inline_kernel
def _slot(records, i, tile_x, tile_y):
    """Return the gradient slot of a Gaussian in a tile."""
    bits = records.view(np.int32)
    box = bits[i, layout.TILES]
    left, right, top = box & 255, box >> 8 & 255, box >> 16 & 255
    return np.int64(bits[i, layout.SLOT]) + (tile_y - top) * (right - left + 1) + (tile_x - left)


@kernel
def _read(left, top, width, height, rgb, depth, opacity, d_rgb, d_depth, d_opacity, state):
    """Copy a tile of the cotangents in; the total behind is their product with the rendered image."""
    for block in range(layout.BLOCKS * layout.BLOCKS):
        base = block * STATE
        x = left + block % layout.BLOCKS * layout.BLOCK
        y = top + block // layout.BLOCKS * layout.BLOCK
        if x + layout.BLOCK > width or y + layout.BLOCK > height:
            _read_cut(x, y, width, height, rgb, depth, opacity, d_rgb, d_depth, d_opacity, state, base)
            continue
        red, green, blue = _load_rgb(rgb, x, y, width)
        d_red, d_green, d_blue = _load_rgb(d_rgb, x, y, width)
        pixel = y * width + x
        d_z, d_silhouette = load_block(d_depth, pixel, width), load_block(d_opacity, pixel, width)
        total = d_z * load_block(depth, pixel, width) + d_silhouette * load_block(opacity, pixel, width)
        store(state, base, splat(_ONE))
        store(state, base + 16, total + d_red * red + d_green * green + d_blue * blue)
        store(state, base + 32, d_silhouette)
        store(state, base + 48, d_red)
        store(state, base + 64, d_green)
        store(state, base + 80, d_blue)
        store(state, base + 96, d_z)


@kernel
def _load_rgb(image, x, y, width):
    """Return the three channels of a block."""
    at = 3 * (y * width + x)
    first, second = load_block(image, at, 3 * width), load_block(image, at + 4, 3 * width)
    return split_rgb(first, second, load_block(image, at + 8, 3 * width))


@kernel
def _read_cut(left, top, width, height, rgb, depth, opacity, d_rgb, d_depth, d_opacity, state, base):
    """Copy in what is inside the image of one block; the rest is full and has no cotangents."""
    for channel in range(7):
        store(state, base + channel * layout.LANES, zeros())
    for y in range(top, min(top + layout.BLOCK, height)):
        for x in range(left, min(left + layout.BLOCK, width)):
            at = base + (y - top) * layout.BLOCK + x - left
            total = d_depth[y, x] * depth[y, x] + d_opacity[y, x] * opacity[y, x]
            for channel in range(3):
                total += d_rgb[y, x, channel] * rgb[y, x, channel]
                state[at + 48 + 16 * channel] = d_rgb[y, x, channel]
            state[at], state[at + 16], state[at + 32], state[at + 96] = _ONE, total, d_opacity[y, x], d_depth[y, x]


@kernel
def _replay(with_color, records, entries, start, stop, tile_x, tile_y, state, moments):
    """Walk a tile's list as the forward did and write every entry's slot."""
    bits = records.view(np.int32)
    left, top = tile_x * layout.TILE, tile_y * layout.TILE
    for e in range(start, stop):
        prefetch(records, np.int64(entries[min(e + _AHEAD, stop - 1)]) * layout.RECORD)
        ahead = entries[min(e + _SLOTS_AHEAD, stop - 1)]
        prefetch(moments, _slot(records, ahead, tile_x, tile_y) * layout.RECORD)
        i = entries[e]
        slot = _slot(records, i, tile_x, tile_y) * layout.RECORD
        px, py = bits[i, layout.PIXELS_X], bits[i, layout.PIXELS_Y]
        x0, x1 = max((px & 65535) - left, 0), min((px >> 16) - left, _LAST)
        y0, y1 = max((py & 65535) - top, 0), min((py >> 16) - top, _LAST)
        if x0 > x1 or y0 > y1:
            store(moments, slot, zeros())
        else:
            _accumulate(with_color, records, i, x0 >> 2, x1 >> 2, y0 >> 2, y1 >> 2, left, top, state, moments, slot)


@inline_kernel
def _accumulate(with_color, records, i, column0, column1, row0, row1, left, top, state, moments, slot):
    """Replay one Gaussian on the blocks of a tile and write its sums (`layout.M_*`)."""
    u, v = records[i, layout.U] - f32(left), records[i, layout.V] - f32(top)
    xx, xy, yy = records[i, layout.POWER_XX], records[i, layout.POWER_XY], records[i, layout.POWER_YY]
    log2_opacity = records[i, layout.LOG2_OPACITY]
    red, green, blue = splat(records[i, layout.RED]), splat(records[i, layout.GREEN]), splat(records[i, layout.BLUE])
    z = splat(records[i, layout.DEPTH])
    m_1 = m_x = m_y = m_xx = m_xy = m_yy = zeros()
    m_red = m_green = m_blue = m_depth = zeros()
    row, column = row0, column0
    num_blocks = (row1 - row0 + 1) * (column1 - column0 + 1)
    for _ in range(num_blocks):  # one loop, not two: its end is mispredicted once
        base = (row * layout.BLOCKS + column) * STATE
        dx, dy = load(_COLUMNS, column * layout.LANES) - u, load(_ROWS, row * layout.LANES) - v
        column += 1
        wraps = column > column1
        row, column = row + 1 if wraps else row, column0 if wraps else column
        power = (dx * xx + dy * xy) * dx + (dy * yy * dy + log2_opacity)
        reached, T = power >= _POWER_MIN, load(state, base)
        if num_blocks > layout.MANY_BLOCKS and not any_true(reached & (T > _ZERO)):
            continue
        alpha = minimum(exp2(power), _ALPHA_MAX)
        alpha = select(reached, alpha, zeros())
        weight = alpha * T
        after = T - weight
        is_open = after >= _TRANSMITTANCE_MIN
        weight = select(is_open, weight, zeros())
        store(state, base, select(is_open, after, zeros() - absolute(T)))
        d_red, d_green, d_blue = load(state, base + 48), load(state, base + 64), load(state, base + 80)
        d_z = load(state, base + 96)
        q = load(state, base + 32) + red * d_red + green * d_green + blue * d_blue + z * d_z
        behind = load(state, base + 16) - weight * q
        store(state, base + 16, behind)
        g = weight * q - alpha * behind / (_ONE - alpha)
        g = select(is_open & (alpha < _ALPHA_MAX), g, zeros())
        g_x, g_y = g * dx, g * dy
        m_1 += g
        m_x += g_x
        m_y += g_y
        m_xx += g_x * dx
        m_xy += g_x * dy
        m_yy += g_y * dy
        m_depth += weight * d_z
        if with_color:
            m_red += weight * d_red
            m_green += weight * d_green
            m_blue += weight * d_blue
    sums = sum_lanes_of_16((m_1, m_x, m_y, m_xx, m_xy, m_yy, m_red, m_green, m_blue, m_depth))
    store(moments, slot, sums)
