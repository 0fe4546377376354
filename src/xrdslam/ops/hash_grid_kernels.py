"""Hash encoding on the CPU: forward and the points' gradient parallel over points, the table's over levels.

A level belongs to one thread, which goes through the points in order: bits do not depend on the number of threads.
Rows hold two features; `out` and `upstream` may have more columns than the encoding, which has the first ones.
"""

import numba
import numpy as np

from xrdslam.ops.simd import inline_kernel, parallel_kernel

__all__ = ["encode", "point_gradient", "table_gradient"]

_CHUNK = 1024
_ONE, _HALF = np.float32(1), np.float32(0.5)
_BOUND = np.float32(1 << 24)
_P1, _P2 = np.uint32(2654435761), np.uint32(805459861)


@inline_kernel
def _place(u: np.float32, scale: np.float32) -> tuple[np.int32, np.float32]:
    """Return the cell of a coordinate and the fraction within; what is no number, or far outside, falls into cell 0."""
    v = u * scale + _HALF
    if not abs(v) < _BOUND:
        return np.int32(0), np.float32(0)
    cell = np.floor(v)
    return np.int32(cell), v - cell


@inline_kernel
def _row(
    x: np.int32, y: np.int32, z: np.int32, r: np.int64, count: np.int64, is_dense: bool, is_power: bool
) -> np.int64:
    """Return the row of a vertex within its level."""
    if is_dense:
        index = np.uint32(np.int64(x) + np.int64(y) * r + np.int64(z) * r * r)
        return np.int64(index) if index < count else np.int64(index) % count
    hashed = np.uint32(x) ^ np.uint32(np.uint32(y) * _P1) ^ np.uint32(np.uint32(z) * _P2)
    return np.int64(hashed & np.uint32(count - 1)) if is_power else np.int64(hashed) % count


@parallel_kernel
def encode(
    points: np.ndarray,
    table: np.ndarray,
    scales: np.ndarray,
    resolutions: np.ndarray,
    offsets: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write each point's features."""
    count = points.shape[0]
    for chunk in numba.prange((count + _CHUNK - 1) // _CHUNK):
        for level in range(scales.shape[0]):
            scale, r, first = scales[level], resolutions[level], offsets[level]
            rows = offsets[level + 1] - first
            is_dense, is_power = r * r * r <= rows, rows & (rows - 1) == 0
            for n in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
                x, fx = _place(points[n, 0], scale)
                y, fy = _place(points[n, 1], scale)
                z, fz = _place(points[n, 2], scale)
                a, b = np.float32(0), np.float32(0)
                for corner in range(8):
                    i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
                    w = (fx if i else _ONE - fx) * (fy if j else _ONE - fy) * (fz if k else _ONE - fz)
                    row = first + _row(x + i, y + j, z + k, r, rows, is_dense, is_power)
                    a += w * table[row, 0]
                    b += w * table[row, 1]
                out[n, 2 * level] = a
                out[n, 2 * level + 1] = b


@parallel_kernel
def table_gradient(
    points: np.ndarray,
    scales: np.ndarray,
    resolutions: np.ndarray,
    offsets: np.ndarray,
    upstream: np.ndarray,
    d_table: np.ndarray,
) -> None:
    """Add each point's share to the rows of its corners; even levels first, so that two threads have equal loads."""
    levels = scales.shape[0]
    half = (levels + 1) // 2
    for turn in numba.prange(levels):
        level = 2 * turn if turn < half else 2 * (turn - half) + 1
        scale, r, first = scales[level], resolutions[level], offsets[level]
        rows = offsets[level + 1] - first
        is_dense, is_power = r * r * r <= rows, rows & (rows - 1) == 0
        for n in range(points.shape[0]):
            g, h = upstream[n, 2 * level], upstream[n, 2 * level + 1]
            if g == 0 and h == 0:
                continue
            x, fx = _place(points[n, 0], scale)
            y, fy = _place(points[n, 1], scale)
            z, fz = _place(points[n, 2], scale)
            for corner in range(8):
                i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
                w = (fx if i else _ONE - fx) * (fy if j else _ONE - fy) * (fz if k else _ONE - fz)
                row = first + _row(x + i, y + j, z + k, r, rows, is_dense, is_power)
                d_table[row, 0] += w * g
                d_table[row, 1] += w * h


@parallel_kernel
def point_gradient(
    points: np.ndarray,
    table: np.ndarray,
    scales: np.ndarray,
    resolutions: np.ndarray,
    offsets: np.ndarray,
    upstream: np.ndarray,
    d_points: np.ndarray,
) -> None:
    """Add to each point's gradient: along an axis, scale * (far corners - near corners) under the others' weights."""
    count = points.shape[0]
    for chunk in numba.prange((count + _CHUNK - 1) // _CHUNK):
        for level in range(scales.shape[0]):
            scale, r, first = scales[level], resolutions[level], offsets[level]
            rows = offsets[level + 1] - first
            is_dense, is_power = r * r * r <= rows, rows & (rows - 1) == 0
            for n in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
                g, h = upstream[n, 2 * level], upstream[n, 2 * level + 1]
                if g == 0 and h == 0:
                    continue
                x, fx = _place(points[n, 0], scale)
                y, fy = _place(points[n, 1], scale)
                z, fz = _place(points[n, 2], scale)
                dx, dy, dz = np.float32(0), np.float32(0), np.float32(0)
                for corner in range(8):
                    i, j, k = corner & 1, (corner >> 1) & 1, corner >> 2
                    row = first + _row(x + i, y + j, z + k, r, rows, is_dense, is_power)
                    value = g * table[row, 0] + h * table[row, 1]
                    wx, wy, wz = fx if i else _ONE - fx, fy if j else _ONE - fy, fz if k else _ONE - fz
                    dx += value * wy * wz if i else -value * wy * wz
                    dy += value * wx * wz if j else -value * wx * wz
                    dz += value * wx * wy if k else -value * wx * wy
                d_points[n, 0] += dx * scale
                d_points[n, 1] += dy * scale
                d_points[n, 2] += dz * scale
