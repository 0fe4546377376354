"""The mesh of the voxels' field: marching cubes on a lattice that divides every voxel, without seams."""

import numpy as np
import torch
from jaxtyping import Bool, Float, Int32
from torch import Tensor

from xrdslam.algorithms.vox_fusion.field import VoxelField
from xrdslam.core.surface import TriangleMesh
from xrdslam.ops.coordinate_hash import rehash
from xrdslam.ops.isosurface import extract
from xrdslam.ops.tsdf_kernels import SIDE

__all__ = ["voxel_surface"]

_SLACK = 1e-3
"""Samples on an outer face belong to the voxel inside of it [voxels]."""
_BLOCKS = 1024
"""Blocks sampled at once."""


def voxel_surface(field: VoxelField, resolution: int) -> TriangleMesh:
    """Return the zero surface within all voxels, coloured; faces are counter-clockwise seen from free space.

    Voxels are sampled at `resolution` + 1 lattice points along each edge; on shared faces neighbours share the
    samples, and a cell counts where its eight corners lie in one voxel or in several.
    """
    grid, spacing = field.grid, field.grid.voxel_m / resolution
    blocks = _blocks(grid.coords, resolution // SIDE)
    inner = torch.stack(torch.meshgrid(*[torch.arange(SIDE)] * 3, indexing="ij"), -1).reshape(-1, 3)
    values, known = np.ones((len(blocks), SIDE**3), np.float32), np.zeros((len(blocks), SIDE**3), np.float32)
    for start in range(0, len(blocks), _BLOCKS):
        part = blocks[start : start + _BLOCKS].long()
        points = ((part[:, None] * SIDE + inner).double() * spacing).float().reshape(-1, 3)
        inside, found = _sampled(field, points)
        shape = (len(part), SIDE**3)
        known[start : start + len(part)] = inside.reshape(shape).numpy()
        values[start : start + len(part)].reshape(-1)[inside.numpy()] = found.numpy()
    size = 1 << max(4, (2 * len(blocks)).bit_length())
    keys, rows = np.full(size, -1, np.int64), np.full(size, -1, np.int32)
    coords = np.ascontiguousarray(blocks.numpy())
    rehash(keys, rows, coords, len(coords))
    cube = (len(blocks), SIDE, SIDE, SIDE)
    colors = np.zeros((*cube, 4), np.float32)  # never written: takes no memory
    mesh = extract(keys, rows, coords, values.reshape(cube), known.reshape(cube), colors, spacing, 0.0)
    return TriangleMesh(mesh.vertices, mesh.faces, _colors(field, torch.from_numpy(mesh.vertices.astype(np.float32))))


def _blocks(coords: Int32[Tensor, "v 3"], per_voxel: int) -> Int32[Tensor, "b 3"]:
    """Return the blocks of 8^3 samples that lie in voxels or begin on their far faces, sorted."""
    steps = torch.stack(torch.meshgrid(*[torch.arange(per_voxel + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    blocks = (coords.long()[:, None] * per_voxel + steps).reshape(-1, 3)
    return torch.unique(blocks, dim=0).to(torch.int32) if len(blocks) else blocks.to(torch.int32)


def _sampled(field: VoxelField, points: Float[Tensor, "n 3"]) -> tuple[Bool[Tensor, " n"], Float[Tensor, " k"]]:
    """Say which points lie in voxels, and the field there."""
    device = field.table.device
    points = points.to(device)
    voxels = field.grid.locate(points, _SLACK)
    inside = voxels >= 0
    return inside.cpu(), field.distance(points[inside], voxels[inside]).cpu()


def _colors(field: VoxelField, vertices: Float[Tensor, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the field's colours at vertices, which all lie in voxels."""
    device = field.table.device
    parts = [torch.zeros(0, 3)]
    for points in torch.split(vertices, 1 << 17):
        voxels = field.grid.locate(points.to(device), _SLACK)
        colors = torch.zeros(len(points), 3)
        inside = (voxels >= 0).cpu()
        colors[inside] = field.color(points.to(device)[inside], voxels[inside]).cpu()
        parts.append(colors)
    found: np.ndarray = torch.cat(parts).clamp(0, 1).numpy()
    return found
