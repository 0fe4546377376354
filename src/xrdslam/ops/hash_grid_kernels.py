"""Hash encoding on the CPU: forward and the points' gradient parallel over points, the table's over levels.

A level belongs to one thread, which goes through the points in order: bits do not depend on the number of threads.
Rows hold two features; `out` and `upstream` may have more columns than the encoding, which has the first ones.
"""

import numba
import numpy as np

from xrdslam.ops.simd import inline_kernel, parallel_kernel
from xrdslam.ops.simd_corners import add_to_rows, corner_weights, paired

__all__ = ["encode", "point_gradient", "table_gradient"]

_CHUNK = 1024
_ROWS, _GROUPS = 4096, 4
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
def _wrapped(index: np.int64, count: np.int64) -> np.int64:
    """Return an index beyond a level's rows as unsigned 32 bits, taken around."""
    return np.int64(np.uint32(index)) % count


Rows8 = tuple[np.int64, np.int64, np.int64, np.int64, np.int64, np.int64, np.int64, np.int64]


@inline_kernel
def _rows(x: np.int32, y: np.int32, z: np.int32, r: np.int64, first: np.int64, count: np.int64) -> Rows8:
    """Return the rows of a cell's eight corners: x runs fastest, then y, then z."""
    if r * r * r <= count:
        base = np.int64(x) + np.int64(y) * r + np.int64(z) * r * r
        if base >= 0 and base + 1 + r + r * r < count:
            a, b, c, d = first + base, first + base + r, first + base + r * r, first + base + r + r * r
            return a, a + 1, b, b + 1, c, c + 1, d, d + 1
        return (
            first + _wrapped(base, count),
            first + _wrapped(base + 1, count),
            first + _wrapped(base + r, count),
            first + _wrapped(base + r + 1, count),
            first + _wrapped(base + r * r, count),
            first + _wrapped(base + r * r + 1, count),
            first + _wrapped(base + r * r + r, count),
            first + _wrapped(base + r * r + r + 1, count),
        )
    mask = np.uint32(count - 1)  # a level that shares its rows has a power of two of them
    x0, x1 = np.uint32(x), np.uint32(x + 1)
    y0 = np.uint32(np.uint32(y) * _P1)
    z0 = np.uint32(np.uint32(z) * _P2)
    y1, z1 = np.uint32(y0 + _P1), np.uint32(z0 + _P2)
    return (
        first + np.int64((x0 ^ y0 ^ z0) & mask),
        first + np.int64((x1 ^ y0 ^ z0) & mask),
        first + np.int64((x0 ^ y1 ^ z0) & mask),
        first + np.int64((x1 ^ y1 ^ z0) & mask),
        first + np.int64((x0 ^ y0 ^ z1) & mask),
        first + np.int64((x1 ^ y0 ^ z1) & mask),
        first + np.int64((x0 ^ y1 ^ z1) & mask),
        first + np.int64((x1 ^ y1 ^ z1) & mask),
    )


@inline_kernel
def _mixed(a: np.float32, b: np.float32, c: np.float32, d: np.float32, s: np.float32, t: np.float32) -> np.float32:
    """Return the bilinear mean of four values: a, b along s, then c, d, the pairs along t."""
    low, high = a + s * (b - a), c + s * (d - c)
    return low + t * (high - low)


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
            for n in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
                x, fx = _place(points[n, 0], scale)
                y, fy = _place(points[n, 1], scale)
                z, fz = _place(points[n, 2], scale)
                r0, r1, r2, r3, r4, r5, r6, r7 = _rows(x, y, z, r, first, rows)
                for feature in range(2):
                    low = _mixed(table[r0, feature], table[r1, feature], table[r2, feature], table[r3, feature], fx, fy)
                    high = _mixed(
                        table[r4, feature], table[r5, feature], table[r6, feature], table[r7, feature], fx, fy
                    )
                    out[n, 2 * level + feature] = low + fz * (high - low)


@parallel_kernel
def table_gradient(
    points: np.ndarray,
    scales: np.ndarray,
    resolutions: np.ndarray,
    offsets: np.ndarray,
    upstream: np.ndarray,
    d_table: np.ndarray,
) -> None:
    """Add each point's share to the rows of its corners.

    Levels are dealt out to four groups in turn. A group goes through its levels chunk by chunk: a chunk's rows of
    `upstream`, of which a level reads two numbers, then come from memory once a group and not once a level.
    """
    levels, count = scales.shape[0], points.shape[0]
    for group in numba.prange(_GROUPS):
        for chunk in range((count + _ROWS - 1) // _ROWS):
            for level in range(group, levels, _GROUPS):
                scale, r, first = scales[level], resolutions[level], offsets[level]
                rows = offsets[level + 1] - first
                for n in range(chunk * _ROWS, min(count, (chunk + 1) * _ROWS)):
                    g, h = upstream[n, 2 * level], upstream[n, 2 * level + 1]
                    if g == 0 and h == 0:
                        continue
                    x, fx = _place(points[n, 0], scale)
                    y, fy = _place(points[n, 1], scale)
                    z, fz = _place(points[n, 2], scale)
                    at = _rows(x, y, z, r, first, rows)
                    add_to_rows(d_table, at, corner_weights(fx, fy, fz) * paired(g, h))


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
            for n in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
                g, h = upstream[n, 2 * level], upstream[n, 2 * level + 1]
                if g == 0 and h == 0:
                    continue
                x, fx = _place(points[n, 0], scale)
                y, fy = _place(points[n, 1], scale)
                z, fz = _place(points[n, 2], scale)
                r0, r1, r2, r3, r4, r5, r6, r7 = _rows(x, y, z, r, first, rows)
                v0, v1 = g * table[r0, 0] + h * table[r0, 1], g * table[r1, 0] + h * table[r1, 1]
                v2, v3 = g * table[r2, 0] + h * table[r2, 1], g * table[r3, 0] + h * table[r3, 1]
                v4, v5 = g * table[r4, 0] + h * table[r4, 1], g * table[r5, 0] + h * table[r5, 1]
                v6, v7 = g * table[r6, 0] + h * table[r6, 1], g * table[r7, 0] + h * table[r7, 1]
                d_points[n, 0] += scale * _mixed(v1 - v0, v3 - v2, v5 - v4, v7 - v6, fy, fz)
                d_points[n, 1] += scale * _mixed(v2 - v0, v3 - v1, v6 - v4, v7 - v5, fx, fz)
                d_points[n, 2] += scale * _mixed(v4 - v0, v5 - v1, v6 - v2, v7 - v3, fx, fy)
