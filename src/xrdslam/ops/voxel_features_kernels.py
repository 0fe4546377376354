"""Trilinear interpolation of voxels' corner features on the CPU, 16 features in a vector.

Samples and voxels are shared between threads, never one sum: bits do not depend on the number of threads.
"""

import numba
import numpy as np

from xrdslam.ops.simd import (
    LANES,
    inline_kernel,
    kernel,
    load,
    parallel_kernel,
    store,
    sum_lanes_of_16,
    zeros,
)

__all__ = ["gather_rows", "interpolate", "order_by_voxel", "point_gradient", "voxel_gradient"]

_CHUNK = 256


@inline_kernel
def _local(points: np.ndarray, coords: np.ndarray, n: int, voxel: int, inverse: float, a: int) -> np.float32:
    """Return a point's coordinate within its voxel, in [0, 1]; worked out in double, for points far from the origin."""
    return np.float32(np.float64(points[n, a]) * inverse - np.float64(coords[voxel, a]))


@parallel_kernel
def interpolate(
    points: np.ndarray,
    voxels: np.ndarray,
    coords: np.ndarray,
    corners: np.ndarray,
    table: np.ndarray,
    voxel_m: float,
    out: np.ndarray,
) -> None:
    """Write each point's features."""
    count, width, inverse = len(points), table.shape[1], 1 / voxel_m
    for chunk in numba.prange((count + _CHUNK - 1) // _CHUNK):
        for n in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            v = voxels[n]
            x = _local(points, coords, n, v, inverse, 0)
            y = _local(points, coords, n, v, inverse, 1)
            z = _local(points, coords, n, v, inverse, 2)
            for f in range(0, width, LANES):
                a, b = load(table, corners[v, 0] * width + f), load(table, corners[v, 1] * width + f)
                c, d = load(table, corners[v, 2] * width + f), load(table, corners[v, 3] * width + f)
                near0, near1 = a + (b - a) * z, c + (d - c) * z
                a, b = load(table, corners[v, 4] * width + f), load(table, corners[v, 5] * width + f)
                c, d = load(table, corners[v, 6] * width + f), load(table, corners[v, 7] * width + f)
                far0, far1 = a + (b - a) * z, c + (d - c) * z
                near, far = near0 + (near1 - near0) * y, far0 + (far1 - far0) * y
                store(out, n * width + f, near + (far - near) * x)


@parallel_kernel
def point_gradient(
    points: np.ndarray,
    voxels: np.ndarray,
    coords: np.ndarray,
    corners: np.ndarray,
    table: np.ndarray,
    voxel_m: float,
    upstream: np.ndarray,
    d_points: np.ndarray,
) -> None:
    """Write each point's gradient: the upstream one times the features' slopes along the axes."""
    count, width, inverse = len(points), table.shape[1], 1 / voxel_m
    scale = np.float32(inverse)
    for chunk in numba.prange((count + _CHUNK - 1) // _CHUNK):
        sums = np.empty(LANES, np.float32)
        for n in range(chunk * _CHUNK, min(count, (chunk + 1) * _CHUNK)):
            v = voxels[n]
            x = _local(points, coords, n, v, inverse, 0)
            y = _local(points, coords, n, v, inverse, 1)
            z = _local(points, coords, n, v, inverse, 2)
            to_x, to_y, to_z = zeros(), zeros(), zeros()
            for f in range(0, width, LANES):
                g = load(upstream, n * width + f)
                a, b = load(table, corners[v, 0] * width + f), load(table, corners[v, 1] * width + f)
                c, d = load(table, corners[v, 2] * width + f), load(table, corners[v, 3] * width + f)
                near0, near1 = a + (b - a) * z, c + (d - c) * z
                near_z = (b - a) + ((d - c) - (b - a)) * y
                a, b = load(table, corners[v, 4] * width + f), load(table, corners[v, 5] * width + f)
                c, d = load(table, corners[v, 6] * width + f), load(table, corners[v, 7] * width + f)
                far0, far1 = a + (b - a) * z, c + (d - c) * z
                far_z = (b - a) + ((d - c) - (b - a)) * y
                near, far = near0 + (near1 - near0) * y, far0 + (far1 - far0) * y
                to_x += (far - near) * g
                to_y += ((near1 - near0) + ((far1 - far0) - (near1 - near0)) * x) * g
                to_z += (near_z + (far_z - near_z) * x) * g
            store(sums, 0, sum_lanes_of_16((to_x, to_y, to_z)))
            for a in range(3):
                d_points[n, a] = scale * sums[a]


@kernel
def order_by_voxel(voxels: np.ndarray, starts: np.ndarray, order: np.ndarray) -> None:
    """Write where each voxel's samples begin (and end), and the samples voxel by voxel, otherwise in their order."""
    starts[:] = 0
    for n in range(len(voxels)):
        starts[voxels[n] + 1] += 1
    for v in range(1, len(starts)):
        starts[v] += starts[v - 1]
    for n in range(len(voxels) - 1, -1, -1):
        v = voxels[n] + 1
        starts[v] -= 1
        order[starts[v]] = n
    # Every start has moved down to its voxel's first sample, one place too far to the right.
    for v in range(len(starts) - 1):
        starts[v] = starts[v + 1]
    starts[len(starts) - 1] = len(voxels)


@parallel_kernel
def voxel_gradient(
    points: np.ndarray,
    coords: np.ndarray,
    voxel_m: float,
    starts: np.ndarray,
    order: np.ndarray,
    upstream: np.ndarray,
    d_corners: np.ndarray,
) -> None:
    """Sum the gradients of each voxel's corners over its samples; voxels without samples are not written."""
    width, inverse, one = upstream.shape[1], 1 / voxel_m, np.float32(1)
    for v in numba.prange(len(starts) - 1):
        if starts[v] == starts[v + 1]:
            continue
        for f in range(0, width, LANES):
            s0, s1, s2, s3 = zeros(), zeros(), zeros(), zeros()
            s4, s5, s6, s7 = zeros(), zeros(), zeros(), zeros()
            for place in range(starts[v], starts[v + 1]):
                n = order[place]
                x = _local(points, coords, n, v, inverse, 0)
                y = _local(points, coords, n, v, inverse, 1)
                z = _local(points, coords, n, v, inverse, 2)
                g = load(upstream, n * width + f)
                near, far = g * (one - x), g * x
                n0, n1, f0, f1 = near * (one - y), near * y, far * (one - y), far * y
                s0 += n0 * (one - z)
                s1 += n0 * z
                s2 += n1 * (one - z)
                s3 += n1 * z
                s4 += f0 * (one - z)
                s5 += f0 * z
                s6 += f1 * (one - z)
                s7 += f1 * z
            at = 8 * v * width + f
            store(d_corners, at, s0)
            store(d_corners, at + width, s1)
            store(d_corners, at + 2 * width, s2)
            store(d_corners, at + 3 * width, s3)
            store(d_corners, at + 4 * width, s4)
            store(d_corners, at + 5 * width, s5)
            store(d_corners, at + 6 * width, s6)
            store(d_corners, at + 7 * width, s7)


@kernel
def gather_rows(starts: np.ndarray, corners: np.ndarray, d_corners: np.ndarray, d_table: np.ndarray) -> None:
    """Add the corners' gradients to their rows, voxel by voxel."""
    width = d_table.shape[1]
    for v in range(len(starts) - 1):
        if starts[v] == starts[v + 1]:
            continue
        for corner in range(8):
            at, row = (8 * v + corner) * width, corners[v, corner] * width
            for f in range(0, width, LANES):
                store(d_table, row + f, load(d_table, row + f) + load(d_corners, at + f))
