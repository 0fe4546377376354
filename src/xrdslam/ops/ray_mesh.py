"""Where rays first meet a triangle mesh: a hierarchy of boxes on the CPU, and a plain torch twin.

The hierarchy is split where the surface-area heuristic is least among sixteen bins of triangle centres (Wald, On fast
construction of SAH-based bounding volume hierarchies, 2007). Everything is in float64, and a triangle is met from a
rounding error outside of it: a ray between two that share an edge does not slip through.
"""

import math
from dataclasses import dataclass

import numba
import numpy as np
import torch
from jaxtyping import Float, Float64, Int64
from numpy.typing import NDArray
from torch import Tensor

from xrdslam.core.surface import TriangleMesh
from xrdslam.ops.simd import inline_kernel, kernel, parallel_kernel
from xrdslam.ops.threads import kernel_threads

__all__ = ["Hits", "RayMesh", "cast_reference"]

LEAF = 4
"""Triangles that are not split any further."""
BINS = 16
_TOLERANCE = 1e-9  # of a triangle's sides: what rounding may place outside both of two neighbours
_TINY = 1e-300
_RAYS_A_TASK = 256
_STACK = 128
"""Nodes that wait; a node deeper than half of this is a leaf, however many triangles it has."""

Rays = Float64[NDArray[np.float64], "n 3"]


@dataclass(frozen=True, eq=False)
class Hits:
    """The first meeting of each ray with a mesh."""

    distance: Float64[NDArray[np.float64], " n"]
    """In lengths of the ray's direction; infinite where it meets nothing."""
    face: Int64[NDArray[np.int64], " n"]
    """The row of `mesh.faces`, -1 where it meets nothing."""


class RayMesh:
    """A mesh that rays can be cast at, from both sides of its triangles."""

    def __init__(self, mesh: TriangleMesh) -> None:
        """Sort the triangles and bound them; a mesh without faces is met by no ray."""
        corners = np.ascontiguousarray(mesh.vertices.astype(np.float64)[mesh.faces])
        if not np.isfinite(corners).all():
            raise ValueError("a mesh with vertices that are not finite: no ray can be cast at it")
        low, high = corners.min(1), corners.max(1)
        margin = _TOLERANCE * max(1.0, float(np.abs(corners).max(initial=0.0)))
        self._order = np.arange(len(corners))
        capacity = max(1, 2 * len(corners))
        boxes, first, members = np.empty((capacity, 6)), np.empty(capacity, np.int64), np.empty(capacity, np.int64)
        count = _build(low - margin, high + margin, self._order, boxes, first, members)
        self._tree = boxes[:count].copy(), first[:count].copy(), members[:count].copy()
        self._corners = np.ascontiguousarray(corners[self._order].reshape(-1, 9))

    def cast(self, origins: Rays, directions: Rays) -> Hits:
        """Return where each ray origin + t direction, t > 0, first meets the mesh."""
        distance = np.full(len(origins), np.inf)
        place = np.full(len(origins), -1, np.int64)
        if not len(self._corners):
            return Hits(distance, place)
        with kernel_threads():
            _cast(
                *self._tree,
                self._corners,
                np.ascontiguousarray(origins, dtype=np.float64),
                np.ascontiguousarray(directions, dtype=np.float64),
                distance,
                place,
            )
        return Hits(distance, np.where(place < 0, -1, self._order[place.clip(0)]))


def cast_reference(
    corners: Float[Tensor, "f 3 3"], origins: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"]
) -> Float[Tensor, " n"]:
    """Return the distance of each ray's first hit, every ray against every triangle (Moeller and Trumbore, 1997)."""
    a, along, across = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = torch.linalg.cross(directions[:, None], across[None])
    det = (p * along).sum(-1)
    safe = torch.where(det.abs() < _TINY, torch.ones_like(det), det)
    s = origins[:, None] - a
    u = (s * p).sum(-1) / safe
    q = torch.linalg.cross(s, along[None].expand_as(s))
    v = (q * directions[:, None]).sum(-1) / safe
    t = (q * across).sum(-1) / safe
    met = (det.abs() >= _TINY) & (u >= -_TOLERANCE) & (v >= -_TOLERANCE) & (u + v <= 1 + _TOLERANCE) & (t > 0)
    found = torch.where(met, t, torch.inf)
    return found.amin(1) if len(corners) else found.new_full((len(origins),), torch.inf)


@inline_kernel
def _area(box: np.ndarray) -> float:
    """Return half the surface of a box, 0 of an empty one."""
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x if x >= 0 else 0.0


@inline_kernel
def _grow(box: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    for a in range(3):
        box[a] = min(box[a], low[a])
        box[a + 3] = max(box[a + 3], high[a])


@inline_kernel
def _clear(box: np.ndarray) -> None:
    for a in range(3):
        box[a], box[a + 3] = math.inf, -math.inf


@inline_kernel
def _bin(low: np.ndarray, high: np.ndarray, i: int, axis: int, start: float, scale: float) -> int:
    """Return the bin of triangle i's centre along an axis."""
    return min(BINS - 1, max(0, int(((low[i, axis] + high[i, axis]) / 2 - start) * scale)))


@kernel
def _split(
    low: np.ndarray, high: np.ndarray, order: np.ndarray, begin: int, end: int, bins: np.ndarray, counts: np.ndarray
) -> int:
    """Sort order[begin:end] into two parts where that costs rays least; return where the second begins."""
    best, best_axis, best_cut, best_start, best_scale = math.inf, -1, 0, 0.0, 0.0
    side = np.empty(6)
    behind = np.empty(BINS)
    for axis in range(3):
        start, stop = math.inf, -math.inf
        for k in range(begin, end):
            middle = (low[order[k], axis] + high[order[k], axis]) / 2
            start, stop = min(start, middle), max(stop, middle)
        if not stop > start:
            continue
        scale = BINS / (stop - start)
        for b in range(BINS):
            _clear(bins[b])
            counts[b] = 0
        for k in range(begin, end):
            b = _bin(low, high, order[k], axis, start, scale)
            _grow(bins[b], low[order[k]], high[order[k]])
            counts[b] += 1
        _clear(side)
        number = 0
        for b in range(BINS - 1, 0, -1):
            _grow(side, bins[b, :3], bins[b, 3:])
            number += counts[b]
            behind[b] = number * _area(side)
        _clear(side)
        number = 0
        for b in range(BINS - 1):
            _grow(side, bins[b, :3], bins[b, 3:])
            number += counts[b]
            cost = number * _area(side) + behind[b + 1]
            if 0 < number < end - begin and cost < best:
                best, best_axis, best_cut, best_start, best_scale = cost, axis, b, start, scale
    if best_axis < 0:
        return begin + (end - begin) // 2  # all centres in one place
    left, right = begin, end - 1
    while left <= right:
        if _bin(low, high, order[left], best_axis, best_start, best_scale) <= best_cut:
            left += 1
        else:
            order[left], order[right] = order[right], order[left]
            right -= 1
    return left


@kernel
def _build(
    low: np.ndarray, high: np.ndarray, order: np.ndarray, boxes: np.ndarray, first: np.ndarray, members: np.ndarray
) -> int:
    """Fill the nodes, depth first, and sort `order`; return their number.

    A leaf has `members` > 0 triangles, from `first` in the order; another node has its children next and at `first`.
    """
    bins, counts = np.empty((BINS, 6)), np.empty(BINS, np.int64)
    waiting = np.empty((_STACK, 4), np.int64)  # begin, end, the node whose second child this is or -1, depth
    waiting[0, 0], waiting[0, 1], waiting[0, 2], waiting[0, 3] = 0, len(order), -1, 0
    top, count = 1, 0
    while top > 0:
        top -= 1
        begin, end, parent, depth = waiting[top, 0], waiting[top, 1], waiting[top, 2], waiting[top, 3]
        node = count
        count += 1
        if parent >= 0:
            first[parent] = node
        _clear(boxes[node])
        for k in range(begin, end):
            _grow(boxes[node], low[order[k]], high[order[k]])
        first[node], members[node] = begin, end - begin
        if end - begin <= LEAF or depth >= _STACK // 2:
            continue
        cut = _split(low, high, order, begin, end, bins, counts)
        members[node] = 0
        waiting[top, 0], waiting[top, 1], waiting[top, 2], waiting[top, 3] = cut, end, node, depth + 1
        waiting[top + 1, 0], waiting[top + 1, 1], waiting[top + 1, 2], waiting[top + 1, 3] = begin, cut, -1, depth + 1
        top += 2
    return count


@inline_kernel
def _entry(
    boxes: np.ndarray, n: int, ox: float, oy: float, oz: float, ix: float, iy: float, iz: float, far: float
) -> float:
    """Return where a ray of inverse direction (ix, iy, iz) enters node n's box before `far`, or infinity."""
    x0, x1 = (boxes[n, 0] - ox) * ix, (boxes[n, 3] - ox) * ix
    y0, y1 = (boxes[n, 1] - oy) * iy, (boxes[n, 4] - oy) * iy
    z0, z1 = (boxes[n, 2] - oz) * iz, (boxes[n, 5] - oz) * iz
    near = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), 0.0))
    end = min(min(max(x0, x1), max(y0, y1)), min(max(z0, z1), far))
    return near if near <= end else math.inf


@inline_kernel
def _triangle(c: np.ndarray, k: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    """Return where a ray meets triangle k, or infinity."""
    ex, ey, ez = c[k, 3] - c[k, 0], c[k, 4] - c[k, 1], c[k, 5] - c[k, 2]
    fx, fy, fz = c[k, 6] - c[k, 0], c[k, 7] - c[k, 1], c[k, 8] - c[k, 2]
    px, py, pz = dy * fz - dz * fy, dz * fx - dx * fz, dx * fy - dy * fx
    det = px * ex + py * ey + pz * ez
    if abs(det) < _TINY:
        return math.inf
    sx, sy, sz = ox - c[k, 0], oy - c[k, 1], oz - c[k, 2]
    u = (sx * px + sy * py + sz * pz) / det
    qx, qy, qz = sy * ez - sz * ey, sz * ex - sx * ez, sx * ey - sy * ex
    v = (qx * dx + qy * dy + qz * dz) / det
    t = (qx * fx + qy * fy + qz * fz) / det
    met = u >= -_TOLERANCE and v >= -_TOLERANCE and u + v <= 1 + _TOLERANCE and t > 0
    return t if met else math.inf


@inline_kernel
def _inverse(d: float) -> float:
    """Return 1 / d, huge where d is 0: 0 times it must stay 0, which infinity does not keep to."""
    return 1.0 / d if abs(d) > _TINY else math.copysign(1.0 / _TINY, d)


@parallel_kernel
def _cast(
    boxes: np.ndarray,
    first: np.ndarray,
    members: np.ndarray,
    corners: np.ndarray,
    origins: np.ndarray,
    directions: np.ndarray,
    distance: np.ndarray,
    place: np.ndarray,
) -> None:
    """Fill distance and place (a row of `corners`) of each ray; nearer children are looked at first."""
    tasks = (len(origins) + _RAYS_A_TASK - 1) // _RAYS_A_TASK
    for task in numba.prange(tasks):
        stack = np.empty(_STACK, np.int64)
        for r in range(task * _RAYS_A_TASK, min((task + 1) * _RAYS_A_TASK, len(origins))):
            ox, oy, oz = origins[r, 0], origins[r, 1], origins[r, 2]
            dx, dy, dz = directions[r, 0], directions[r, 1], directions[r, 2]
            ix, iy, iz = _inverse(dx), _inverse(dy), _inverse(dz)
            best, who, top = math.inf, -1, 0
            if _entry(boxes, 0, ox, oy, oz, ix, iy, iz, best) < math.inf:
                stack[0], top = 0, 1
            while top > 0:
                top -= 1
                node = stack[top]
                if members[node] > 0:
                    for k in range(first[node], first[node] + members[node]):
                        t = _triangle(corners, k, ox, oy, oz, dx, dy, dz)
                        if t < best:
                            best, who = t, k
                    continue
                left, right = node + 1, first[node]
                tl = _entry(boxes, left, ox, oy, oz, ix, iy, iz, best)
                tr = _entry(boxes, right, ox, oy, oz, ix, iy, iz, best)
                if tl < tr:  # the nearer child goes on the stack last
                    left, right, tl, tr = right, left, tr, tl
                if tl < math.inf:
                    stack[top] = left
                    top += 1
                if tr < math.inf:
                    stack[top] = right
                    top += 1
            distance[r], place[r] = best, who
