"""Hash encoding on the CPU: forward and the points' gradient parallel over points, the table's over levels.

A level belongs to one thread, which goes through the points in order: bits do not depend on the number of threads.
Rows hold two features.
"""

# ruff: noqa: ANN401

from typing import Any

import numba
import numpy as np

from xrdslam.ops.simd import LANES, inline_kernel, load, parallel_kernel, store
from xrdslam.ops.simd_cells import PRIMES, gather_dense, gather_hashed
from xrdslam.ops.simd_corners import add_to_rows, corner_weights, paired

__all__ = ["encode", "point_gradient", "table_gradient"]

_CHUNK = 512
_ROWS, _GROUPS = 4096, 4
_ONE, _HALF = np.float32(1), np.float32(0.5)
_BOUND = np.float32(1 << 24)
_P1, _P2 = np.uint32(PRIMES[0]), np.uint32(PRIMES[1])
_CORNERS = 19 * LANES
"""Fractions and corners' features of 16 points."""


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
def _mixed(a: Any, b: Any, c: Any, d: Any, s: Any, t: Any) -> Any:
    """Return the bilinear mean of four values: a, b along s, then c, d, the pairs along t."""
    low, high = a + s * (b - a), c + s * (d - c)
    return low + t * (high - low)


@inline_kernel
def _columns(points: np.ndarray, start: int, stop: int, columns: np.ndarray) -> None:
    """Write x, y and z of points apart from each other, `_CHUNK` places for each."""
    for n in range(start, stop):
        for axis in range(3):
            columns[axis * _CHUNK + n - start] = points[n, axis]


@inline_kernel
def _gather(
    columns: np.ndarray,
    at: int,
    scale: np.float32,
    r: np.int64,
    first: np.int64,
    rows: np.int64,
    table: np.ndarray,
    corners: np.ndarray,
) -> None:
    """Write the fractions and the corners' features of 16 points of a level, one by one where one lies outside."""
    if r * r * r > rows:
        gather_hashed(columns, at, _CHUNK, scale, rows, first, table, corners)
    elif not gather_dense(columns, at, _CHUNK, scale, r, first, table, corners):
        for lane in range(LANES):
            x, corners[lane] = _place(columns[at + lane], scale)
            y, corners[LANES + lane] = _place(columns[_CHUNK + at + lane], scale)
            z, corners[2 * LANES + lane] = _place(columns[2 * _CHUNK + at + lane], scale)
            seen = _rows(x, y, z, r, first, rows)
            for k in range(8):
                for feature in range(2):
                    corners[(3 + 8 * feature + k) * LANES + lane] = table[seen[k], feature]


@inline_kernel
def _corner_values(corners: np.ndarray, feature: int) -> Any:
    """Return a feature at the eight corners."""
    at = (3 + 8 * feature) * LANES
    return (
        load(corners, at),
        load(corners, at + LANES),
        load(corners, at + 2 * LANES),
        load(corners, at + 3 * LANES),
        load(corners, at + 4 * LANES),
        load(corners, at + 5 * LANES),
        load(corners, at + 6 * LANES),
        load(corners, at + 7 * LANES),
    )


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
        start, stop = chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)
        columns, corners = np.zeros(3 * _CHUNK, np.float32), np.empty(_CORNERS, np.float32)
        features = np.empty((2 * scales.shape[0], _CHUNK), np.float32)
        _columns(points, start, stop, columns)
        for level in range(scales.shape[0]):
            scale, r, first = scales[level], resolutions[level], offsets[level]
            rows = offsets[level + 1] - first
            for at in range(0, stop - start, LANES):
                _gather(columns, at, scale, r, first, rows, table, corners)
                fx, fy, fz = load(corners, 0), load(corners, LANES), load(corners, 2 * LANES)
                for feature in range(2):
                    v = _corner_values(corners, feature)
                    low, high = _mixed(v[0], v[1], v[2], v[3], fx, fy), _mixed(v[4], v[5], v[6], v[7], fx, fy)
                    store(features, (2 * level + feature) * _CHUNK + at, low + fz * (high - low))
        for n in range(start, stop):
            for column in range(2 * scales.shape[0]):
                out[n, column] = features[column, n - start]


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
        start, stop = chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)
        columns, corners = np.zeros(3 * _CHUNK, np.float32), np.empty(_CORNERS, np.float32)
        pull, slopes = np.zeros((2 * scales.shape[0], _CHUNK), np.float32), np.zeros(3 * _CHUNK, np.float32)
        _columns(points, start, stop, columns)
        for n in range(start, stop):
            for column in range(2 * scales.shape[0]):
                pull[column, n - start] = upstream[n, column]
        for level in range(scales.shape[0]):
            scale, r, first = scales[level], resolutions[level], offsets[level]
            rows = offsets[level + 1] - first
            for at in range(0, stop - start, LANES):
                _gather(columns, at, scale, r, first, rows, table, corners)
                fx, fy, fz = load(corners, 0), load(corners, LANES), load(corners, 2 * LANES)
                g, h = load(pull, 2 * level * _CHUNK + at), load(pull, (2 * level + 1) * _CHUNK + at)
                a, b = _corner_values(corners, 0), _corner_values(corners, 1)
                v0, v1, v2, v3 = g * a[0] + h * b[0], g * a[1] + h * b[1], g * a[2] + h * b[2], g * a[3] + h * b[3]
                v4, v5, v6, v7 = g * a[4] + h * b[4], g * a[5] + h * b[5], g * a[6] + h * b[6], g * a[7] + h * b[7]
                along_x = _mixed(v1 - v0, v3 - v2, v5 - v4, v7 - v6, fy, fz)
                along_y = _mixed(v2 - v0, v3 - v1, v6 - v4, v7 - v5, fx, fz)
                along_z = _mixed(v4 - v0, v5 - v1, v6 - v2, v7 - v3, fx, fy)
                store(slopes, at, load(slopes, at) + along_x * scale)
                store(slopes, _CHUNK + at, load(slopes, _CHUNK + at) + along_y * scale)
                store(slopes, 2 * _CHUNK + at, load(slopes, 2 * _CHUNK + at) + along_z * scale)
        for n in range(start, stop):
            for axis in range(3):
                d_points[n, axis] += slopes[axis * _CHUNK + n - start]
