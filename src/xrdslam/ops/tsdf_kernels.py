"""Numba kernels of the sparse TSDF: block allocation and integration.

Voxels are samples at lattice points: sample (i, j, k) lies at voxel_m * (i, j, k) in the world. A block is SIDE^3
samples; a hash table with open addressing leads from its coordinates to its row in the arrays.
"""

import numpy as np
from numba import prange

from xrdslam.ops.coordinate_hash import REACH, pack, slot_of
from xrdslam.ops.simd import inline_kernel, kernel, parallel_kernel

__all__ = ["SIDE", "allocate", "integrate"]

SIDE = 8
"""Samples along a block's edge."""


@kernel
def allocate(
    depth: np.ndarray,
    intrinsics: np.ndarray,
    T_world_camera: np.ndarray,
    voxel_m: float,
    truncation_m: float,
    keys: np.ndarray,
    rows: np.ndarray,
    coords: np.ndarray,
    count: int,
    start: int,
) -> tuple[int, int]:
    """Enter every block that comes within the truncation (in the maximum norm) of a measured point, in raster order.

    Returns the pixel to go on with and the number of blocks; it stops early where `coords` may not hold what a pixel
    adds, and goes on when it is called again with more room.
    """
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    block_m = voxel_m * SIDE
    room = len(coords) - (int(np.ceil(2 * truncation_m / block_m)) + 2) ** 3
    low, high, before = np.empty(3, np.int64), np.empty(3, np.int64), np.full(6, REACH, np.int64)
    for pixel in range(start, height * width):
        v, u = divmod(pixel, width)
        z = depth[v, u]
        if z <= 0:
            continue
        x, y = (u - cx) / fx * z, (v - cy) / fy * z
        same, inside = True, True
        for a in range(3):
            R, t = T_world_camera[a], T_world_camera[a, 3]
            p = R[0] * x + R[1] * y + R[2] * z + t
            low[a], high[a] = int(np.floor((p - truncation_m) / block_m)), int(np.floor((p + truncation_m) / block_m))
            same &= low[a] == before[a] and high[a] == before[3 + a]
            inside &= low[a] >= -REACH and high[a] < REACH
        if same or not inside:
            continue
        if count > room:
            return pixel, count
        before[:3], before[3:] = low, high
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    key = pack(i, j, k)
                    slot = slot_of(keys, key)
                    if keys[slot] == -1:
                        keys[slot], rows[slot] = key, count
                        coords[count, 0], coords[count, 1], coords[count, 2] = i, j, k
                        count += 1
    return height * width, count


@inline_kernel
def _outside(
    x: float, y: float, z: float, radius: float, intrinsics: np.ndarray, width: int, height: int, far: float
) -> bool:
    """Say whether a sphere [camera frame] lies wholly outside the image's pyramid or beyond `far`."""
    fx, fy, cx, cy = intrinsics
    if z + radius <= 0 or z - radius > far:
        return True
    left, right = cx + 0.5, width - 0.5 - cx  # px from the principal point to the image's edges
    top, bottom = cy + 0.5, height - 0.5 - cy
    beside = fx * x + left * z < -radius * np.hypot(fx, left) or -fx * x + right * z < -radius * np.hypot(fx, right)
    above = fy * y + top * z < -radius * np.hypot(fy, top) or -fy * y + bottom * z < -radius * np.hypot(fy, bottom)
    return bool(beside or above)


@inline_kernel
def _integrate_sample(
    x: float,
    y: float,
    z: float,
    row: int,
    i: int,
    j: int,
    k: int,
    tsdf: np.ndarray,
    weights: np.ndarray,
    colors: np.ndarray,
    rgb: np.ndarray,
    depth: np.ndarray,
    pixel_weights: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    voxel_m: float,
    truncation_m: float,
) -> None:
    """Average one view into the sample at (x, y, z) [camera frame]."""
    height, width = depth.shape
    if z <= 0:
        return
    u, v = fx * x / z + cx, fy * y / z + cy
    if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
        return
    column, line = int(np.floor(u + 0.5)), int(np.floor(v + 0.5))
    measured = float(depth[line, column])
    if measured <= 0 or measured - z <= -2 * truncation_m:
        return
    u0, v0 = min(max(int(np.floor(u)), 0), width - 2), min(max(int(np.floor(v)), 0), height - 2)
    a, b, c, d = depth[v0, u0], depth[v0, u0 + 1], depth[v0 + 1, u0], depth[v0 + 1, u0 + 1]
    nearest, farthest = min(min(a, b), min(c, d)), max(max(a, b), max(c, d))
    s, r = u - u0, v - v0
    smooth = nearest > 0 and farthest - nearest < truncation_m and 0 <= s <= 1 and 0 <= r <= 1
    if smooth:
        measured = (1 - r) * ((1 - s) * a + s * b) + r * ((1 - s) * c + s * d)
    distance = measured - z
    if distance <= -truncation_m:
        return
    new = pixel_weights[line, column] * min(1.0, (truncation_m + distance) / (truncation_m - voxel_m))
    if new <= 0:
        return
    total = weights[row, i, j, k] + new
    share = new / total
    weights[row, i, j, k] = total
    tsdf[row, i, j, k] += share * (min(1.0, distance / truncation_m) - tsdf[row, i, j, k])
    if distance >= truncation_m:  # free space: what is seen behind it is not its colour
        return
    total = colors[row, i, j, k, 3] + new
    colors[row, i, j, k, 3] = total
    share = new / total
    for channel in range(3):
        value = float(rgb[line, column, channel])
        if smooth:
            upper = (1 - s) * rgb[v0, u0, channel] + s * rgb[v0, u0 + 1, channel]
            lower = (1 - s) * rgb[v0 + 1, u0, channel] + s * rgb[v0 + 1, u0 + 1, channel]
            value = (1 - r) * upper + r * lower
        colors[row, i, j, k, channel] += share * (value - colors[row, i, j, k, channel])


@parallel_kernel
def integrate(
    coords: np.ndarray,
    count: int,
    tsdf: np.ndarray,
    weights: np.ndarray,
    colors: np.ndarray,
    rgb: np.ndarray,
    depth: np.ndarray,
    pixel_weights: np.ndarray,
    intrinsics: np.ndarray,
    T_camera_world: np.ndarray,
    voxel_m: float,
    truncation_m: float,
) -> None:
    """Average one view into every block in sight, each on its own; the equations are in `tsdf_reference.integrate`."""
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    T = T_camera_world
    far = depth.max() + truncation_m
    radius = 0.5 * np.sqrt(3.0) * voxel_m * SIDE
    for row in prange(count):
        bx, by, bz = SIDE * coords[row, 0], SIDE * coords[row, 1], SIDE * coords[row, 2]
        mx, my, mz = voxel_m * (bx + 0.5 * SIDE), voxel_m * (by + 0.5 * SIDE), voxel_m * (bz + 0.5 * SIDE)
        x = T[0, 0] * mx + T[0, 1] * my + T[0, 2] * mz + T[0, 3]
        y = T[1, 0] * mx + T[1, 1] * my + T[1, 2] * mz + T[1, 3]
        z = T[2, 0] * mx + T[2, 1] * my + T[2, 2] * mz + T[2, 3]
        if _outside(x, y, z, radius, intrinsics, width, height, far):
            continue
        for i in range(SIDE):
            for j in range(SIDE):
                px, py, pz = voxel_m * (bx + i), voxel_m * (by + j), voxel_m * bz
                x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
                y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
                z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
                for k in range(SIDE):
                    step = k * voxel_m
                    _integrate_sample(
                        x + step * T[0, 2],
                        y + step * T[1, 2],
                        z + step * T[2, 2],
                        row,
                        i,
                        j,
                        k,
                        tsdf,
                        weights,
                        colors,
                        rgb,
                        depth,
                        pixel_weights,
                        fx,
                        fy,
                        cx,
                        cy,
                        voxel_m,
                        truncation_m,
                    )
