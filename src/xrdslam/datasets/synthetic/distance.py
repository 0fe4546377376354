"""Signed distance to the union of everything solid in a scene, walls included."""

import numpy as np
from jaxtyping import Float64

from xrdslam.datasets.synthetic.compiled import compiled, inlined
from xrdslam.datasets.synthetic.rows import over_rows
from xrdslam.datasets.synthetic.scene import PackedScene
from xrdslam.datasets.synthetic.shading import to_local
from xrdslam.datasets.synthetic.solids import core_gradient

__all__ = ["nearest", "signed_distance", "solid_distance"]


@inlined
def solid_distance(scene: PackedScene, i: int, x: float, y: float, z: float) -> float:
    """Return the signed distance [m] of a world point to solid i; the room (solid 0) is solid outside."""
    s = scene.size[i]
    px, py, pz = to_local(scene, i, x, y, z)
    d: float = core_gradient(scene.shape[i], px, py, pz, s[0], s[1], s[2])[0] - s[3]
    return -d if i == 0 else d


@inlined
def nearest(scene: PackedScene, x: float, y: float, z: float) -> tuple[float, int]:
    """Return the distance of a world point to the union, and the solid it is owed to."""
    best, who = solid_distance(scene, 0, x, y, z), 0
    for i in range(1, len(scene.shape)):
        d = solid_distance(scene, i, x, y, z)
        if d < best:
            best, who = d, i
    return best, who


@compiled
def _distances(begin: int, end: int, scene: PackedScene, points: np.ndarray, out: np.ndarray) -> None:
    for k in range(begin, end):
        out[k] = nearest(scene, points[k, 0], points[k, 1], points[k, 2])[0]


def signed_distance(scene: PackedScene, points_world: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch"]:
    """Return the signed distance [m], negative inside solids and outside the room.

    Exact in free space (the least of exact distances); inside overlapping solids a bound on the true depth.
    """
    flat = np.ascontiguousarray(points_world, dtype=np.float64).reshape(-1, 3)
    distances = np.empty(len(flat))
    over_rows(_distances, len(flat), scene, flat, distances)
    return distances.reshape(points_world.shape[:-1])
