"""Triangles and points drawn into a depth buffer: which one each pixel sees, and how far away it is."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Int32
from numpy.typing import NDArray

from xrdslam.ops.simd import kernel

__all__ = ["Buffers", "draw_points", "draw_triangles"]

NEAR_M = 0.02
"""What is nearer than this is not drawn, a triangle that comes nearer not at all."""


class Buffers(NamedTuple):
    """What each pixel sees."""

    depth: Float[NDArray[np.float32], "h w"]
    """Along z [m], inf where nothing is seen."""
    which: Int32[NDArray[np.int32], "h w"]
    """Of the triangle or point seen, -1 for none."""

    @classmethod
    def empty(cls, width: int, height: int) -> "Buffers":
        """Return buffers that see nothing."""
        return cls(np.full((height, width), np.inf, np.float32), np.full((height, width), -1, np.int32))


def draw_triangles(
    points_camera: Float[np.ndarray, "n 3"],
    faces: Int[np.ndarray, "f 3"],
    intrinsics: tuple[float, float, float, float],
    size: tuple[int, int],
    is_culled: bool = True,
) -> Buffers:
    """Draw a mesh given in the camera's frame (OpenCV axes) [m].

    `intrinsics` are fx, fy, cx, cy [px], `size` is width, height [px]. Of a culled mesh only triangles that turn their
    front to the camera are drawn, so that one looks into a room through the backs of its walls. A pixel is inside where
    its centre is; depth is interpolated as 1/z is linear in it.
    """
    buffers = Buffers.empty(*size)
    corners = np.ascontiguousarray(points_camera, dtype=np.float64)
    _triangles(corners, np.ascontiguousarray(faces, dtype=np.int64), *intrinsics, is_culled, *buffers)
    return buffers


def draw_points(
    points_camera: Float[np.ndarray, "n 3"],
    radius_m: float,
    intrinsics: tuple[float, float, float, float],
    size: tuple[int, int],
) -> Buffers:
    """Draw points as squares of this half side that face the camera, at least a pixel wide."""
    buffers = Buffers.empty(*size)
    _points(np.ascontiguousarray(points_camera, dtype=np.float64), radius_m, *intrinsics, *buffers)
    return buffers


@kernel
def _triangles(
    points: np.ndarray,
    faces: np.ndarray,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    is_culled: bool,
    depth: np.ndarray,
    index: np.ndarray,
) -> None:
    height, width = depth.shape
    for f in range(len(faces)):
        a, b, c = faces[f]
        za, zb, zc = points[a, 2], points[b, 2], points[c, 2]
        if not (za > NEAR_M and zb > NEAR_M and zc > NEAR_M):
            continue
        ua, va = fx * points[a, 0] / za + cx, fy * points[a, 1] / za + cy
        ub, vb = fx * points[b, 0] / zb + cx, fy * points[b, 1] / zb + cy
        uc, vc = fx * points[c, 0] / zc + cx, fy * points[c, 1] / zc + cy
        area = (ub - ua) * (vc - va) - (vb - va) * (uc - ua)  # negative where the front is seen: v points down
        if area == 0.0 or (is_culled and area > 0.0):
            continue
        first_u, last_u = max(0, int(np.ceil(min(ua, ub, uc)))), min(width - 1, int(np.floor(max(ua, ub, uc))))
        first_v, last_v = max(0, int(np.ceil(min(va, vb, vc)))), min(height - 1, int(np.floor(max(va, vb, vc))))
        for v in range(first_v, last_v + 1):
            for u in range(first_u, last_u + 1):
                wa = ((ub - u) * (vc - v) - (vb - v) * (uc - u)) / area
                wb = ((uc - u) * (va - v) - (vc - v) * (ua - u)) / area
                wc = 1.0 - wa - wb
                if wa < 0.0 or wb < 0.0 or wc < 0.0:
                    continue
                z = 1.0 / (wa / za + wb / zb + wc / zc)
                if z < depth[v, u]:
                    depth[v, u] = z
                    index[v, u] = f


@kernel
def _points(
    points: np.ndarray,
    radius_m: float,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    depth: np.ndarray,
    index: np.ndarray,
) -> None:
    height, width = depth.shape
    for p in range(len(points)):
        x, y, z = points[p]
        if not z > NEAR_M:
            continue
        u, v, radius = fx * x / z + cx, fy * y / z + cy, max(fx * radius_m / z, 0.5)
        if not (u + radius >= 0.0 and u - radius < width and v + radius >= 0.0 and v - radius < height):
            continue
        for row in range(max(0, int(np.ceil(v - radius))), min(height - 1, int(np.floor(v + radius))) + 1):
            for column in range(max(0, int(np.ceil(u - radius))), min(width - 1, int(np.floor(u + radius))) + 1):
                if z < depth[row, column]:
                    depth[row, column] = z
                    index[row, column] = p
