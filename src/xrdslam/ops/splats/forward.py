"""Compositing: each tile's Gaussians, nearest first, onto its pixels; colour, depth and transmittance in one pass.

The outer loop runs over Gaussians, the inner one over the 4x4 blocks under the footprint, 16 pixels at a time. It has
no branches: mispredicting them costs more than the empty blocks do.
"""

# Kernels take numpy arrays and scalars that numba types by itself:
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
# ruff: noqa: ANN001, ANN201, ANN202

import math

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
    zeros,
)
from xrdslam.ops.splats import layout
from xrdslam.ops.splats.binning import sort_tile
from xrdslam.ops.splats.blocks import join_rgb, store_block
from xrdslam.ops.splats.layout import f32
from xrdslam.ops.splats.types import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

_ALPHA_MAX, _TRANSMITTANCE_MIN, _POWER_MIN = f32(ALPHA_MAX), f32(TRANSMITTANCE_MIN), f32(math.log2(ALPHA_MIN))
_ZERO, _ONE = f32(0), f32(1)
_COLUMNS, _ROWS = layout.COLUMNS, layout.ROWS
_LAST = layout.TILE - 1
_AHEAD = 6
_OPEN_CHECK = 64
STATE = 5 * layout.LANES
"""Floats of state per block: transmittance, red, green, blue, depth. A full pixel has its transmittance negated."""


@parallel_kernel
def render_tiles(
    workers, width, height, records, offsets, is_sorted, keys, spare, entries, stops, next_tile, state,
    histograms, rgb, depth, opacity,
):  # fmt: skip
    """Sort (unless sorted already) and composite every tile; `stops` gets where in its list each tile was full."""
    tiles = offsets.shape[0] - 1
    tiles_x = (width + layout.TILE - 1) // layout.TILE
    next_tile[0] = 0
    for worker in prange(workers):
        own = state[worker]
        while True:
            tile = fetch_add(next_tile, 0, 1)
            if tile >= tiles:
                break
            start, stop = offsets[tile], offsets[tile + 1]
            if not is_sorted:
                sort_tile(start, stop, keys, spare, entries, histograms[worker])
            left, top = tile % tiles_x * layout.TILE, tile // tiles_x * layout.TILE
            _clear(left, top, width, height, own)
            stops[tile] = _composite(records, entries, start, stop, left, top, own)
            _write(left, top, width, height, own, rgb, depth, opacity)


@kernel
def _clear(left, top, width, height, state):
    """Set every pixel of the tile to black and clear, those outside the image to full."""
    for block in range(layout.BLOCKS * layout.BLOCKS):
        base = block * STATE
        x = load(_COLUMNS, block % layout.BLOCKS * layout.LANES) + f32(left)
        y = load(_ROWS, block // layout.BLOCKS * layout.LANES) + f32(top)
        inside = (x < f32(width)) & (y < f32(height))
        store(state, base, select(inside, splat(_ONE), zeros()))
        for channel in range(1, 5):
            store(state, base + channel * layout.LANES, zeros())


@kernel
def _is_full(state):
    """Say whether no pixel of the tile takes any more."""
    for block in range(layout.BLOCKS * layout.BLOCKS):  # noqa: SIM110  # numba has no all()
        if any_true(load(state, block * STATE) > _ZERO):
            return False
    return True


@kernel
def _composite(records, entries, start, stop, left, top, state):
    """Blend a tile's list; returns the position where it was found full, or its end."""
    bits = records.view(np.int32)
    for e in range(start, stop):
        if (e - start) % _OPEN_CHECK == _OPEN_CHECK - 1 and _is_full(state):
            return e
        prefetch(records, np.int64(entries[min(e + _AHEAD, stop - 1)]) * layout.RECORD)
        i = entries[e]
        px, py = bits[i, layout.PIXELS_X], bits[i, layout.PIXELS_Y]
        x0, x1 = max((px & 65535) - left, 0), min((px >> 16) - left, _LAST)
        y0, y1 = max((py & 65535) - top, 0), min((py >> 16) - top, _LAST)
        if x0 <= x1 and y0 <= y1:  # lists that are used again hold Gaussians that are not here now
            _blend(records, i, x0 >> 2, x1 >> 2, y0 >> 2, y1 >> 2, left, top, state)
    return stop


@inline_kernel
def _blend(records, i, column0, column1, row0, row1, left, top, state):
    """Blend one Gaussian onto the blocks of a tile."""
    u, v = records[i, layout.U] - f32(left), records[i, layout.V] - f32(top)
    xx, xy, yy = records[i, layout.POWER_XX], records[i, layout.POWER_XY], records[i, layout.POWER_YY]
    log2_opacity = records[i, layout.LOG2_OPACITY]
    red, green, blue = splat(records[i, layout.RED]), splat(records[i, layout.GREEN]), splat(records[i, layout.BLUE])
    z = splat(records[i, layout.DEPTH])
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
        weight = select(reached, alpha * T, zeros())
        after = T - weight
        is_open = after >= _TRANSMITTANCE_MIN
        weight = select(is_open, weight, zeros())
        store(state, base, select(is_open, after, zeros() - absolute(T)))
        store(state, base + 16, load(state, base + 16) + weight * red)
        store(state, base + 32, load(state, base + 32) + weight * green)
        store(state, base + 48, load(state, base + 48) + weight * blue)
        store(state, base + 64, load(state, base + 64) + weight * z)


@kernel
def _write(left, top, width, height, state, rgb, depth, opacity):
    """Copy a tile into the images, block by block; the image's edge may cut the last ones."""
    for block in range(layout.BLOCKS * layout.BLOCKS):
        base = block * STATE
        x = left + block % layout.BLOCKS * layout.BLOCK
        y = top + block // layout.BLOCKS * layout.BLOCK
        if x + layout.BLOCK > width or y + layout.BLOCK > height:
            _write_cut(x, y, width, height, state, base, rgb, depth, opacity)
            continue
        pixel = y * width + x
        store_block(opacity, pixel, width, splat(_ONE) - absolute(load(state, base)))
        store_block(depth, pixel, width, load(state, base + 64))
        first, second, third = join_rgb(load(state, base + 16), load(state, base + 32), load(state, base + 48))
        store_block(rgb, 3 * pixel, 3 * width, first)
        store_block(rgb, 3 * pixel + 4, 3 * width, second)
        store_block(rgb, 3 * pixel + 8, 3 * width, third)


@kernel
def _write_cut(left, top, width, height, state, base, rgb, depth, opacity):
    """Copy what is inside the image of one block."""
    for y in range(top, min(top + layout.BLOCK, height)):
        for x in range(left, min(left + layout.BLOCK, width)):
            at = base + (y - top) * layout.BLOCK + x - left
            opacity[y, x], depth[y, x] = _ONE - abs(state[at]), state[at + 64]
            rgb[y, x, 0], rgb[y, x, 1], rgb[y, x, 2] = state[at + 16], state[at + 32], state[at + 48]
