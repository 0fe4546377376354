"""Depth of one camera as another sees it."""

import math

import numpy as np
from jaxtyping import Float32, Float64

from xrdslam.core.camera import Camera

__all__ = ["register_depth"]


def register_depth(
    depth: Float32[np.ndarray, "h w"], of: Camera, to: Camera, T_to_of: Float64[np.ndarray, "4 4"]
) -> Float32[np.ndarray, "h2 w2"]:
    """Move every measured point into another camera and keep the nearest at each pixel; 0 where none falls.

    Both cameras are without distortion. Where the other's pixels are finer, a point covers as many of them as its own
    pixel does, so that surfaces stay closed.
    """
    v, u = np.nonzero(depth > 0)
    z = depth[v, u].astype(np.float64)
    points = np.stack(((u - of.cx) / of.fx * z, (v - of.cy) / of.fy * z, z), -1) @ T_to_of[:3, :3].T + T_to_of[:3, 3]
    points = points[points[:, 2] > 0]
    points = points[np.argsort(-points[:, 2], kind="stable")]  # the nearest is written last
    x = to.fx * points[:, 0] / points[:, 2] + to.cx
    y = to.fy * points[:, 1] / points[:, 2] + to.cy
    side = max(1, math.ceil(max(to.fx / of.fx, to.fy / of.fy) - 1e-6))
    registered = np.full((to.height, to.width), np.inf, dtype=np.float32)
    for dy in range(side):
        for dx in range(side):
            column = np.floor(x + dx - side / 2 + 1).astype(np.int64)  # rint would send both halves to even pixels
            row = np.floor(y + dy - side / 2 + 1).astype(np.int64)
            inside = (column >= 0) & (column < to.width) & (row >= 0) & (row < to.height)
            layer = np.full_like(registered, np.inf)
            layer[row[inside], column[inside]] = points[inside, 2]
            np.minimum(registered, layer, out=registered)
    return np.where(np.isfinite(registered), registered, np.float32(0))
