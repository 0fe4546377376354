"""The surface of a field that can be asked anywhere, meshed only near points that are known to lie on it.

A map rendered from where the scene was seen gives such points: what was never seen is never asked for, and a lattice of
millimetres over a house costs what its surface costs.
"""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.geometry import se3
from xrdslam.core.model import Model, View
from xrdslam.core.surface import TriangleMesh
from xrdslam.ops.coordinate_hash import rehash
from xrdslam.ops.isosurface import extract
from xrdslam.ops.tsdf_kernels import SIDE

__all__ = ["field_surface", "rendered_points"]

Progress = Callable[[float], None]
_SAMPLES = 1 << 19
"""Samples of a field asked for at once."""


def field_surface(
    points_world: Float[np.ndarray, "n 3"],
    voxel_m: float,
    field: Callable[[Tensor], Tensor],
    color: Callable[[Tensor], Tensor] | None = None,
    reach_m: float | None = None,
    progress: Progress | None = None,
) -> TriangleMesh:
    """Return the zero surface of `field` within about `reach_m` (two voxels) of the points, in blocks of 8^3 samples.

    `field` maps world points (n, 3) [m] to values (n,), positive in front of the surface; `color` maps vertices to
    colours (n, 3). Seamless across blocks; faces are counter-clockwise seen from where the field is positive.
    """
    reach = 2 * voxel_m if reach_m is None else reach_m
    coords = _blocks(points_world, voxel_m, reach)
    size = 1 << max(4, (2 * len(coords)).bit_length())
    keys, rows = np.full(size, -1, np.int64), np.full(size, -1, np.int32)
    rehash(keys, rows, coords, len(coords))
    values = _sampled(coords, voxel_m, field, progress)
    colors = np.zeros((*values.shape, 4), np.float32)  # never written: takes no memory
    mesh = extract(keys, rows, coords, values, np.ones_like(values), colors, voxel_m, 0.0)
    if color is None or not len(mesh.vertices):
        return TriangleMesh(mesh.vertices, mesh.faces)
    vertices = torch.from_numpy(np.ascontiguousarray(mesh.vertices, dtype=np.float32))
    tints = [color(part).clamp(0, 1).cpu().numpy() for part in torch.split(vertices, _SAMPLES)]
    return TriangleMesh(mesh.vertices, mesh.faces, np.concatenate(tints))


def rendered_points(model: Model, views: Sequence[View], width_px: int = 160) -> Float[np.ndarray, "n 3"]:
    """Return world points [m] of what a map renders from views, at `width_px` or the camera's own width if smaller."""
    found = [np.zeros((0, 3), np.float32)]
    for view in views:
        scale = min(1.0, width_px / view.camera.width)
        small = view.camera.resized(max(1, round(view.camera.width * scale)), max(1, round(view.camera.height * scale)))
        with torch.no_grad():
            rendering = model.render(small, view.T_world_camera)
        seen = (rendering.opacity > 0.5) & (rendering.depth > 0)
        points_camera = (small.rays(device=rendering.depth.device) * rendering.depth[..., None])[seen]
        found.append(se3.transform(view.T_world_camera, points_camera).cpu().numpy())
    return np.concatenate(found)


def _blocks(points_world: np.ndarray, voxel_m: float, reach_m: float) -> np.ndarray:
    """Return the blocks that come within the reach of a point, sorted."""
    points = points_world[np.isfinite(points_world).all(1)].astype(np.float64)
    cells = np.unique(np.floor(points / (2 * voxel_m)).astype(np.int64), axis=0)  # thinned to one a cell of two voxels
    centers = (cells + 0.5) * 2 * voxel_m
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    corners = (centers[:, None, :] + signs * (reach_m + voxel_m)).reshape(-1, 3)
    return np.unique(np.floor(corners / (voxel_m * SIDE)).astype(np.int32), axis=0)


def _sampled(
    coords: np.ndarray, voxel_m: float, field: Callable[[Tensor], Tensor], progress: Progress | None
) -> Float[np.ndarray, "b 8 8 8"]:
    """Return the field at the samples of every block."""
    side = np.arange(SIDE)
    inner = np.stack(np.meshgrid(side, side, side, indexing="ij"), -1).reshape(-1, 3)
    values = np.empty((len(coords), SIDE**3), np.float32)
    step = max(1, _SAMPLES // SIDE**3)
    for start in range(0, len(coords), step):
        part = coords[start : start + step]
        lattice = (part[:, None, :] * SIDE + inner).reshape(-1, 3)
        points = torch.from_numpy((lattice * voxel_m).astype(np.float32))
        values[start : start + step] = field(points).detach().cpu().numpy().reshape(len(part), -1)
        if progress is not None:
            progress(min(1.0, (start + step) / len(coords)))
    return values.reshape(-1, SIDE, SIDE, SIDE)
