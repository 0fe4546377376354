"""The surface of a sparse field of blocks: marching cubes on chunks of blocks, joined without seams."""

import numpy as np

from xrdslam.core.surface import TriangleMesh
from xrdslam.ops.coordinate_hash import find
from xrdslam.ops.simd import kernel
from xrdslam.ops.tsdf_kernels import SIDE

__all__ = ["extract"]

_BLOCKS = 8
"""Blocks along a chunk's edge: marching cubes runs on chunks, since a call of it costs as much as a block."""
_CELLS = _BLOCKS * SIDE


@kernel
def _gather(
    chunk: np.ndarray,
    keys: np.ndarray,
    rows: np.ndarray,
    values: np.ndarray,
    weights: np.ndarray,
    colors: np.ndarray,
    min_weight: float,
    field: np.ndarray,
    weighty: np.ndarray,
    color: np.ndarray,
) -> None:
    """Copy a chunk's samples, and the first layer of the next chunks' (the cells between belong to this one)."""
    field[:] = 1
    weighty[:] = False
    color[:] = 0
    for bi in range(_BLOCKS + 1):
        for bj in range(_BLOCKS + 1):
            for bk in range(_BLOCKS + 1):
                x, y, z = chunk[0] * _BLOCKS + bi, chunk[1] * _BLOCKS + bj, chunk[2] * _BLOCKS + bk
                row = find(keys, rows, x, y, z)
                if row < 0:
                    continue
                for i in range(1 if bi == _BLOCKS else SIDE):
                    for j in range(1 if bj == _BLOCKS else SIDE):
                        for k in range(1 if bk == _BLOCKS else SIDE):
                            if weights[row, i, j, k] > min_weight:
                                a, b, c = bi * SIDE + i, bj * SIDE + j, bk * SIDE + k
                                weighty[a, b, c] = True
                                field[a, b, c] = values[row, i, j, k]
                                color[a, b, c] = colors[row, i, j, k]


@kernel
def _cells(field: np.ndarray, weighty: np.ndarray, usable: np.ndarray) -> bool:
    """Mark the cells (by their far corner) whose corners all have weight; say whether the surface crosses one."""
    crossed = False
    usable[:] = False
    for i in range(_CELLS):
        for j in range(_CELLS):
            for k in range(_CELLS):
                known, positive = True, 0
                for corner in range(8):
                    a, b, c = i + (corner >> 2), j + ((corner >> 1) & 1), k + (corner & 1)
                    known &= weighty[a, b, c]
                    positive += field[a, b, c] > 0
                usable[i + 1, j + 1, k + 1] = known
                crossed |= known and 0 < positive < 8
    return crossed


@kernel
def _sample(color: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Interpolate colours at points [samples], trilinearly among the samples that have one (a vertex has two or so)."""
    out = np.zeros((len(points), 3), np.float32)
    for n in range(len(points)):
        total = 0.0
        for corner in range(8):
            share = 1.0
            index = np.empty(3, np.int64)
            for a in range(3):
                base = min(int(points[n, a]), _CELLS - 1)
                far = (corner >> a) & 1
                fraction = points[n, a] - base
                share *= fraction if far else 1 - fraction
                index[a] = base + far
            sample = color[index[0], index[1], index[2]]
            if share > 0 and sample[3] > 0:
                total += share
                out[n] += share * sample[:3]
        if total > 0:
            out[n] /= total
    return out


def extract(
    keys: np.ndarray,
    rows: np.ndarray,
    coords: np.ndarray,
    values: np.ndarray,
    weights: np.ndarray,
    colors: np.ndarray,
    voxel_m: float,
    min_weight: float,
) -> TriangleMesh:
    """Return the zero surface, faces counter-clockwise seen from where the field is positive (Lewiner et al., 2003)."""
    from skimage.measure import marching_cubes

    size = _CELLS + 1
    field, color = np.empty((size, size, size), np.float32), np.empty((size, size, size, 4), np.float32)
    weighty, usable = np.empty(field.shape, np.bool_), np.empty(field.shape, np.bool_)
    points, faces, tints, total = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], [np.empty((0, 3), np.float32)], 0
    for chunk in _chunks(coords):
        _gather(chunk, keys, rows, values, weights, colors, min_weight, field, weighty, color)
        if not _cells(field, weighty, usable):
            continue
        found = marching_cubes(  # type: ignore[no-untyped-call]  # not annotated
            field, 0.0, gradient_direction="descent", mask=usable
        )
        points.append(found[0].astype(np.float64) + chunk * _CELLS)
        faces.append(found[1].astype(np.int64) + total)
        tints.append(_sample(color, found[0].astype(np.float64)))
        total += len(found[0])
    return _welded(np.concatenate(points), np.concatenate(faces), np.concatenate(tints), voxel_m)


def _chunks(coords: np.ndarray) -> np.ndarray:
    """Return the chunks that hold a block or end at one, in a fixed order."""
    corners = np.stack(np.meshgrid(*[[0, -1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    near = (coords[:, None, :] + corners).reshape(-1, 3)
    return np.unique(np.floor_divide(near, _BLOCKS), axis=0)


def _welded(points: np.ndarray, faces: np.ndarray, colors: np.ndarray, voxel_m: float) -> TriangleMesh:
    """Join the vertices that chunks have in common, and drop the faces that become lines.

    A vertex lies on an edge of the lattice: two coordinates are whole. The doubled floor of each, plus one where it is
    not whole, names the edge. A vertex inside a cell (an ambiguous case) has three broken ones and its cell to itself.
    """
    if len(points) == 0:
        return TriangleMesh(points.astype(np.float32), faces.astype(np.int32), colors)
    whole = np.floor(points)
    edges = 2 * whole.astype(np.int64) + (points > whole)
    edges -= edges.min(0)
    keys = (edges[:, 0] << 42) | (edges[:, 1] << 21) | edges[:, 2]  # 2^20 samples along an axis: 10 km of centimetres
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    joined = inverse.astype(np.int32)[faces]
    a, b, c = joined.T
    joined = joined[(a != b) & (b != c) & (c != a)]
    return TriangleMesh((points[first] * voxel_m).astype(np.float32), joined, colors[first])
