"""Sparse voxels on the CPU: insertion by one thread in the points' order, look-up and ray traversal in parallel."""

import numba
import numpy as np

from xrdslam.ops.coordinate_hash import REACH, find, pack, slot_of
from xrdslam.ops.simd import inline_kernel, kernel, parallel_kernel

__all__ = ["count_hits", "fill_hits", "insert", "insert_cells", "locate"]

SHORTEST = 1e-6
"""Stretches of a ray [of its parameter] below this are no hits: a ray along an edge has none, or any."""


@inline_kernel
def _enter(
    x: int,
    y: int,
    z: int,
    keys: np.ndarray,
    rows: np.ndarray,
    coords: np.ndarray,
    corners: np.ndarray,
    vertex_keys: np.ndarray,
    vertex_rows: np.ndarray,
    vertices: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Enter a voxel where it is missing, and those of its corners that are; `counts` are of voxels and of vertices."""
    key = pack(x, y, z)
    slot = slot_of(keys, key)
    if keys[slot] != -1:
        return
    voxel = counts[0]
    keys[slot], rows[slot] = key, voxel
    coords[voxel, 0], coords[voxel, 1], coords[voxel, 2] = x, y, z
    counts[0] += 1
    for corner in range(8):
        a, b, c = x + (corner >> 2), y + ((corner >> 1) & 1), z + (corner & 1)
        key = pack(a, b, c)
        slot = slot_of(vertex_keys, key)
        if vertex_keys[slot] == -1:
            row = counts[1]
            vertex_keys[slot], vertex_rows[slot] = key, row
            vertices[row, 0], vertices[row, 1], vertices[row, 2] = a, b, c
            counts[1] += 1
        corners[voxel, corner] = vertex_rows[slot]


@kernel
def insert(
    points: np.ndarray,
    start: int,
    voxel_m: float,
    keys: np.ndarray,
    rows: np.ndarray,
    coords: np.ndarray,
    corners: np.ndarray,
    vertex_keys: np.ndarray,
    vertex_rows: np.ndarray,
    vertices: np.ndarray,
    counts: np.ndarray,
) -> int:
    """Enter the voxels of points in their order; return the point to go on with, where there was no more room.

    A point that is not finite, or farther than REACH voxels from the origin, has none.
    """
    before = np.full(3, np.float64(REACH))
    for n in range(start, len(points)):
        x, y, z = (
            np.floor(np.float64(points[n, 0]) / voxel_m),
            np.floor(np.float64(points[n, 1]) / voxel_m),
            np.floor(np.float64(points[n, 2]) / voxel_m),
        )
        if x == before[0] and y == before[1] and z == before[2]:
            continue
        if not (abs(x) < REACH - 1 and abs(y) < REACH - 1 and abs(z) < REACH - 1):
            continue
        if counts[0] == len(coords):
            return n
        before[0], before[1], before[2] = x, y, z
        cell = (np.int64(x), np.int64(y), np.int64(z))
        _enter(*cell, keys, rows, coords, corners, vertex_keys, vertex_rows, vertices, counts)
    return len(points)


@kernel
def insert_cells(
    cells: np.ndarray,
    keys: np.ndarray,
    rows: np.ndarray,
    coords: np.ndarray,
    corners: np.ndarray,
    vertex_keys: np.ndarray,
    vertex_rows: np.ndarray,
    vertices: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Enter voxels by their coordinates; there must be room."""
    for n in range(len(cells)):
        x, y, z = np.int64(cells[n, 0]), np.int64(cells[n, 1]), np.int64(cells[n, 2])
        _enter(x, y, z, keys, rows, coords, corners, vertex_keys, vertex_rows, vertices, counts)


@parallel_kernel
def locate(
    points: np.ndarray, voxel_m: float, slack: float, keys: np.ndarray, rows: np.ndarray, out: np.ndarray
) -> None:
    """Write each point's voxel, -1 where there is none; within `slack` [voxels] of a face the neighbour will do."""
    for n in numba.prange(len(points)):
        out[n] = -1
        p = (np.float64(points[n, 0]) / voxel_m, np.float64(points[n, 1]) / voxel_m, np.float64(points[n, 2]) / voxel_m)
        if not (abs(p[0]) < REACH - 1 and abs(p[1]) < REACH - 1 and abs(p[2]) < REACH - 1):
            continue
        for corner in range(8):  # the point's own voxel first, then those across the faces that it is close to
            x = np.int64(np.floor(p[0] + _shift(p[0], slack, corner >> 2)))
            y = np.int64(np.floor(p[1] + _shift(p[1], slack, (corner >> 1) & 1)))
            z = np.int64(np.floor(p[2] + _shift(p[2], slack, corner & 1)))
            row = find(keys, rows, x, y, z)
            if row >= 0:
                out[n] = row
                break


@inline_kernel
def _shift(coordinate: float, slack: float, far: int) -> float:
    """Return how to come across the nearer face, 0 where `far` is 0 or the face is not within the slack."""
    if far == 0:
        return 0.0
    fraction = coordinate - np.floor(coordinate)
    if fraction <= slack:
        return -2 * slack - 1e-9
    return 2 * slack + 1e-9 if fraction >= 1 - slack else 0.0


@inline_kernel
def _crossing(cell: int, origin: float, direction: float) -> float:
    """Return where a ray leaves a cell along one axis."""
    if direction == 0:
        return np.inf
    return (cell + (1 if direction > 0 else 0) - origin) / direction


@inline_kernel
def _follow(
    ray: int,
    origins: np.ndarray,
    directions: np.ndarray,
    far: np.ndarray,
    voxel_m: float,
    box: np.ndarray,
    keys: np.ndarray,
    rows: np.ndarray,
    write: bool,
    at: int,
    voxels: np.ndarray,
    entries: np.ndarray,
    exits: np.ndarray,
) -> int:
    """Walk a ray from cell to cell through the box of all voxels (Amanatides and Woo, 1987); return its hits.

    Each crossing is worked out anew from its plane: errors do not add up, and entries are those of a slab test.
    """
    start, end = 0.0, np.float64(far[ray])
    for a in range(3):
        o, d = np.float64(origins[ray, a]) / voxel_m, np.float64(directions[ray, a]) / voxel_m
        if d == 0:
            if not (o >= box[0, a] and o < box[1, a]):
                return 0
        else:
            one, two = (box[0, a] - o) / d, (box[1, a] - o) / d
            start, end = max(start, min(one, two)), min(end, max(one, two))
    if not end > start:
        return 0
    ox, oy, oz = origins[ray, 0] / voxel_m, origins[ray, 1] / voxel_m, origins[ray, 2] / voxel_m
    dx, dy, dz = directions[ray, 0] / voxel_m, directions[ray, 1] / voxel_m, directions[ray, 2] / voxel_m
    x = min(max(np.int64(np.floor(ox + start * dx)), box[0, 0]), box[1, 0] - 1)
    y = min(max(np.int64(np.floor(oy + start * dy)), box[0, 1]), box[1, 1] - 1)
    z = min(max(np.int64(np.floor(oz + start * dz)), box[0, 2]), box[1, 2] - 1)
    count, t = 0, start
    while True:
        tx, ty, tz = _crossing(x, ox, dx), _crossing(y, oy, dy), _crossing(z, oz, dz)
        leave = min(tx, ty, tz)
        until = min(leave, end)
        if until - t > SHORTEST:
            row = find(keys, rows, x, y, z)
            if row >= 0:
                if write:
                    voxels[at + count], entries[at + count], exits[at + count] = row, t, until
                count += 1
        if leave >= end:
            return count
        t = max(t, until)
        if tx <= ty and tx <= tz:
            x += 1 if dx > 0 else -1
            if x < box[0, 0] or x >= box[1, 0]:
                return count
        elif ty <= tz:
            y += 1 if dy > 0 else -1
            if y < box[0, 1] or y >= box[1, 1]:
                return count
        else:
            z += 1 if dz > 0 else -1
            if z < box[0, 2] or z >= box[1, 2]:
                return count


@parallel_kernel
def count_hits(
    origins: np.ndarray,
    directions: np.ndarray,
    far: np.ndarray,
    voxel_m: float,
    box: np.ndarray,
    keys: np.ndarray,
    rows: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Count each ray's hits."""
    voxels, places = np.empty(0, np.int64), np.empty(0, np.float32)
    for ray in numba.prange(len(origins)):
        counts[ray] = _follow(ray, origins, directions, far, voxel_m, box, keys, rows, False, 0, voxels, places, places)


@parallel_kernel
def fill_hits(
    origins: np.ndarray,
    directions: np.ndarray,
    far: np.ndarray,
    voxel_m: float,
    box: np.ndarray,
    keys: np.ndarray,
    rows: np.ndarray,
    offsets: np.ndarray,
    voxels: np.ndarray,
    entries: np.ndarray,
    exits: np.ndarray,
) -> None:
    """Write each ray's hits from its offset on."""
    for ray in numba.prange(len(origins)):
        at = offsets[ray]
        _follow(ray, origins, directions, far, voxel_m, box, keys, rows, True, at, voxels, entries, exits)
