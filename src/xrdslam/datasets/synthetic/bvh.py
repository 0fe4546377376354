"""A bounding-volume hierarchy over the solids, and the two questions asked of it: first hit, anything between."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from xrdslam.datasets.synthetic.compiled import inlined
from xrdslam.datasets.synthetic.scene import PackedScene, Shape
from xrdslam.datasets.synthetic.solids import ray_room, ray_solid, reciprocal

__all__ = ["STACK", "Bvh", "blocker", "build_bvh", "first_hit", "solid_boxes"]

LEAF_SIZE = 2
STACK = 64
"""Entries of the scratch stack that the searches take: more than any depth of the tree."""


Boxes = Float64[np.ndarray, "*n 6"]


class Bvh(NamedTuple):
    """Nodes, depth first: a leaf has `members` > 0 solids, from `first` in `order`; else children next and `first`."""

    box: Float64[np.ndarray, "n 6"]
    """min x, y, z, max x, y, z [m]."""
    first: Int64[np.ndarray, " n"]
    members: Int64[np.ndarray, " n"]
    order: Int64[np.ndarray, " m"]


def solid_boxes(scene: PackedScene) -> Float64[np.ndarray, "n 6"]:
    """Return each solid's axis-aligned world box (of its turned local box)."""
    half = scene.size[:, :3] + scene.size[:, 3:]
    widest = scene.size[:, :2].max(1) + scene.size[:, 3]
    is_frustum = scene.shape == Shape.FRUSTUM
    half[is_frustum, 0] = half[is_frustum, 1] = widest[is_frustum]
    extent = (np.abs(scene.R) @ half[:, :, None])[..., 0]
    return np.concatenate((scene.centre - extent, scene.centre + extent), 1)


def build_bvh(scene: PackedScene) -> Bvh:
    """Split where the surface-area heuristic is least, down to two solids; the room (solid 0) stays outside.

    A ray that meets a box meets a box inside it with the chance of their surfaces' ratio (Goldsmith & Salmon, 1987).
    """
    boxes = solid_boxes(scene)
    nodes: list[tuple[Boxes, int, int]] = []
    order: list[int] = []

    def add(members: Int64[np.ndarray, " k"]) -> None:
        index = len(nodes)
        box = np.concatenate((boxes[members, :3].min(0), boxes[members, 3:].max(0)))
        if len(members) <= LEAF_SIZE:
            nodes.append((box, len(order), len(members)))
            order.extend(int(i) for i in members)
            return
        nodes.append((box, 0, 0))
        members, cut = _best_split(boxes, members)
        add(members[:cut])
        nodes[index] = (box, len(nodes), 0)
        add(members[cut:])

    if len(scene.shape) > 1:
        add(np.arange(1, len(scene.shape)))
    box = np.array([n[0] for n in nodes], dtype=np.float64).reshape(-1, 6)
    first, count = (np.array([n[k] for n in nodes], dtype=np.int64) for k in (1, 2))
    return Bvh(box, first, count, np.array(order, dtype=np.int64))


def _best_split(boxes: Boxes, members: Int64[np.ndarray, " k"]) -> tuple[Int64[np.ndarray, " k"], int]:
    best = (np.inf, members, 1)
    for axis in range(3):
        middle = boxes[members, axis] + boxes[members, axis + 3]
        ranked = members[np.argsort(middle, kind="stable")]
        ahead = np.arange(1, len(members))
        cost = _surfaces(boxes[ranked])[:-1] * ahead + _surfaces(boxes[ranked[::-1]])[:-1][::-1] * ahead[::-1]
        cut = int(np.argmin(cost))
        if cost[cut] < best[0]:
            best = (float(cost[cut]), ranked, cut + 1)
    return best[1], best[2]


def _surfaces(boxes: Boxes) -> Float64[np.ndarray, " n"]:
    """Return the half surface of the box around the first 1, 2, ... boxes."""
    x, y, z = (np.maximum.accumulate(boxes[:, 3:]) - np.minimum.accumulate(boxes[:, :3])).T
    area: Float64[np.ndarray, " n"] = x * y + y * z + z * x
    return area


@inlined
def solid_hit(
    scene: PackedScene, i: int, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, far: float
) -> float:
    """Return where the world ray meets solid i before `far`, or inf."""
    R, c, s = scene.R[i], scene.centre[i], scene.size[i]
    px, py, pz = ox - c[0], oy - c[1], oz - c[2]
    return ray_solid(
        scene.shape[i], s[0], s[1], s[2], s[3],
        R[0, 0] * px + R[1, 0] * py + R[2, 0] * pz,
        R[0, 1] * px + R[1, 1] * py + R[2, 1] * pz,
        R[0, 2] * px + R[1, 2] * py + R[2, 2] * pz,
        R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz,
        R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz,
        R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz,
        far,
    )  # fmt: skip


@inlined
def box_entry(
    box: np.ndarray, n: int, ox: float, oy: float, oz: float, ix: float, iy: float, iz: float, far: float
) -> float:
    """Return where the ray of inverse direction (ix, iy, iz) enters node n's box before `far`, or inf."""
    x0, x1 = (box[n, 0] - ox) * ix, (box[n, 3] - ox) * ix
    y0, y1 = (box[n, 1] - oy) * iy, (box[n, 4] - oy) * iy
    z0, z1 = (box[n, 2] - oz) * iz, (box[n, 5] - oz) * iz
    near = max(max(min(x0, x1), min(y0, y1)), max(min(z0, z1), 0.0))
    end = min(min(max(x0, x1), max(y0, y1)), min(max(z0, z1), far))
    return near if near <= end else math.inf


@inlined
def nearest_solid(
    scene: PackedScene, bvh: Bvh, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, far: float,
    is_any_enough: bool, guess: int, stack: np.ndarray,
) -> tuple[float, int]:  # fmt: skip
    """Return (t, solid) of the first hit before `far`, or (far, 0); with `is_any_enough`, of any hit.

    A good `guess` (what the ray beside this one met) shortens the ray before the search; it never changes the answer.
    """
    best, who = far, 0
    if guess != 0:
        t = solid_hit(scene, guess, ox, oy, oz, dx, dy, dz, best)
        if t < best:
            best, who = t, guess
    ix, iy, iz = reciprocal(dx), reciprocal(dy), reciprocal(dz)
    top = 0
    if len(bvh.first) > 0:
        stack[0], top = 0, 1
    while top > 0 and not (is_any_enough and who != 0):
        top -= 1
        node = stack[top]
        if bvh.members[node] > 0:
            for k in range(bvh.first[node], bvh.first[node] + bvh.members[node]):
                i = bvh.order[k]
                t = solid_hit(scene, i, ox, oy, oz, dx, dy, dz, best)
                if t < best or (t == best and i < who):
                    best, who = t, i
            continue
        left, right = node + 1, bvh.first[node]
        tl = box_entry(bvh.box, left, ox, oy, oz, ix, iy, iz, best)
        tr = box_entry(bvh.box, right, ox, oy, oz, ix, iy, iz, best)
        if tl < tr:  # the nearer child is looked at first, so it goes on the stack last
            left, right, tl, tr = right, left, tr, tl
        if tl < math.inf:
            stack[top] = left
            top += 1
        if tr < math.inf:
            stack[top] = right
            top += 1
    return best, who


@inlined
def first_hit(
    scene: PackedScene, bvh: Bvh, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float,
    guess: int, stack: np.ndarray,
) -> tuple[float, int]:  # fmt: skip
    """Return (t, solid) of the first surface along o + t d from inside the room; the room itself is solid 0."""
    h, c = scene.size[0], scene.centre[0]
    far = ray_room(h[0], h[1], h[2], ox - c[0], oy - c[1], oz - c[2], dx, dy, dz)
    return nearest_solid(scene, bvh, ox, oy, oz, dx, dy, dz, far, False, guess, stack)


@inlined
def blocker(
    scene: PackedScene, bvh: Bvh, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float,
    guess: int, stack: np.ndarray,
) -> int:  # fmt: skip
    """Return a solid that lies on o + t d for t in [0, 1), or 0; the last answer is a good guess for the next."""
    return nearest_solid(scene, bvh, ox, oy, oz, dx, dy, dz, 0.999, True, guess, stack)[1]
