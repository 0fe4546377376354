"""Trilinear interpolation on the CPU: parallel over points forward, over sixteen channels at a time back to features.

A vertex's channels lie side by side, so that a corner is one or two cache lines. A channel belongs to one thread, which
goes through the points in order: bits do not depend on the number of threads.
"""

import numba
import numpy as np

from xrdslam.ops.simd import (
    absolute,
    any_true,
    inline_kernel,
    load,
    parallel_kernel,
    store,
    sum_lanes_of_16,
    zeros,
)

__all__ = ["feature_gradient", "interpolate", "point_gradient"]

_CHUNK = 512
_ZERO, _ONE = np.float32(0), np.float32(1)


@inline_kernel
def _place(coordinate: np.float32, vertices: int) -> tuple[np.int64, np.float32]:
    """Return the cell of a coordinate in vertices and the share of its upper vertex; the border outside."""
    q = coordinate
    last = np.float32(vertices - 1)
    if not q > _ZERO:  # holds for NaN too
        q = _ZERO
    if q > last:
        q = last
    cell = np.int64(q)
    if cell > vertices - 2:
        cell = np.int64(vertices - 2)
    return cell, q - np.float32(cell)


@inline_kernel
def _corners(
    points: np.ndarray,
    n: int,
    scale: np.float32,
    first: np.ndarray,
    size: np.ndarray,
    slots: np.ndarray,
    rows: np.ndarray,
    shares: np.ndarray,
) -> None:
    """Find the eight vertices about a point and their shares; x runs fastest.

    A vertex that is among the chosen ones is named by its place there, any other as -1 - vertex.
    """
    x, fx = _place(points[n, 0] * scale - first[0], size[0])
    y, fy = _place(points[n, 1] * scale - first[1], size[1])
    z, fz = _place(points[n, 2] * scale - first[2], size[2])
    for k in range(8):
        i, j, m = k & 1, (k >> 1) & 1, k >> 2
        vertex = ((z + m) * size[1] + y + j) * size[0] + x + i
        slot = slots[vertex] if slots.size > 0 else -1
        rows[k] = slot if slot >= 0 else -1 - vertex
        shares[k] = (fx if i else _ONE - fx) * (fy if j else _ONE - fy) * (fz if m else _ONE - fz)


@parallel_kernel
def interpolate(
    points: np.ndarray,
    scale: np.float32,
    first: np.ndarray,
    size: np.ndarray,
    table: np.ndarray,
    values: np.ndarray,
    slots: np.ndarray,
    out: np.ndarray,
    column: int,
) -> None:
    """Write each point's features into the columns of `out` from `column` on."""
    count, channels, width = points.shape[0], table.shape[1], out.shape[1]
    for chunk in numba.prange((count + _CHUNK - 1) // _CHUNK):
        rows, shares = np.empty(8, np.int64), np.empty(8, np.float32)
        for n in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            _corners(points, n, scale, first, size, slots, rows, shares)
            for c in range(0, channels, 16):
                total = zeros()
                for k in range(8):
                    row = rows[k]
                    if row >= 0:
                        total += load(values, row * channels + c) * shares[k]
                    else:
                        total += load(table, (-1 - row) * channels + c) * shares[k]
                store(out, n * width + column + c, total)


@parallel_kernel
def feature_gradient(
    points: np.ndarray,
    scale: np.float32,
    first: np.ndarray,
    size: np.ndarray,
    slots: np.ndarray,
    upstream: np.ndarray,
    column: int,
    grown: np.ndarray,
) -> None:
    """Add each point's share to its corners' rows: of the chosen vertices, or of all where `slots` is empty."""
    count, channels, width = points.shape[0], grown.shape[1], upstream.shape[1]
    everything = slots.size == 0
    for part in numba.prange(channels // 16):
        rows, shares = np.empty(8, np.int64), np.empty(8, np.float32)
        c = part * 16
        for n in range(count):
            d = load(upstream, n * width + column + c)
            if not any_true(absolute(d) > _ZERO):
                continue
            _corners(points, n, scale, first, size, slots, rows, shares)
            for k in range(8):
                row = -1 - rows[k] if everything else rows[k]
                if row >= 0:
                    at = row * channels + c
                    store(grown, at, load(grown, at) + d * shares[k])


@parallel_kernel
def point_gradient(
    points: np.ndarray,
    scale: np.float32,
    first: np.ndarray,
    size: np.ndarray,
    table: np.ndarray,
    values: np.ndarray,
    slots: np.ndarray,
    upstream: np.ndarray,
    column: int,
    d_points: np.ndarray,
) -> None:
    """Add to each point's gradient: along an axis, far corners minus near corners; none where the border is taken."""
    count, channels, width = points.shape[0], table.shape[1], upstream.shape[1]
    for chunk in numba.prange((count + _CHUNK - 1) // _CHUNK):
        rows, shares = np.empty(8, np.int64), np.empty(8, np.float32)
        dots = np.zeros(16 * 8, np.float32)
        s = np.empty(16, np.float32)
        for n in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            some = False
            for c in range(0, channels, 16):
                some = some or any_true(absolute(load(upstream, n * width + column + c)) > _ZERO)
            if not some:
                continue
            _corners(points, n, scale, first, size, slots, rows, shares)
            for k in range(8):
                row = rows[k]
                total = zeros()
                for c in range(0, channels, 16):
                    d = load(upstream, n * width + column + c)
                    if row >= 0:
                        total += load(values, row * channels + c) * d
                    else:
                        total += load(table, (-1 - row) * channels + c) * d
                store(dots, 16 * k, total)
            store(
                s,
                0,
                sum_lanes_of_16(
                    (
                        load(dots, 0),
                        load(dots, 16),
                        load(dots, 32),
                        load(dots, 48),
                        load(dots, 64),
                        load(dots, 80),
                        load(dots, 96),
                        load(dots, 112),
                    )
                ),
            )
            for axis in range(3):
                q = points[n, axis] * scale - first[axis]
                if not (q >= _ZERO and q <= np.float32(size[axis] - 1)):
                    continue
                step = 1 << axis
                slope = _ZERO
                for k in range(8):
                    if k & step:
                        # The share of the other two axes is that of both corners together.
                        slope += (shares[k] + shares[k - step]) * (s[k] - s[k - step])
                d_points[n, axis] += slope * scale
