"""Sparse voxels as a mapping iteration of five frames sees them: traversal, and features with their gradients."""

import torch

from benchmarks.interleaved import median_seconds
from benchmarks.kernels.speedup import speedups
from benchmarks.metric import Metric
from xrdslam.ops.voxel_features import voxel_features, voxel_features_torch
from xrdslam.ops.voxel_hash import SparseVoxels, traverse, traverse_torch

__all__ = ["voxels"]


def voxels() -> list[Metric]:
    """Measure rays through the walls of a room of 8 x 8 x 4 m and a fiftieth of what is in it, and 100k samples."""
    g = torch.Generator().manual_seed(0)
    inside = torch.rand(40, 40, 20, generator=g) < 0.02
    inside[[0, -1]] = inside[:, [0, -1]] = inside[:, :, [0, -1]] = True
    grid = SparseVoxels(0.2)
    grid.insert_cells(inside.nonzero().int() - 20)
    directions = torch.nn.functional.normalize(torch.randn(1024, 3, generator=g), dim=1)
    origins, far = torch.tensor([[0.05, 0.07, -1.97]]).repeat(1024, 1), torch.full((1024,), 12.0)
    walk = median_seconds(
        {
            "twin": (lambda: traverse_torch(grid, origins, directions, far), 1),
            "kernel": (lambda: traverse(grid, origins, directions, far), 5),
        }
    )
    metrics = [Metric("kernels/voxels/traversal_speedup", walk["twin"] / walk["kernel"], "x twin", "higher", 0.6)]
    at = torch.randint(len(grid), (100_000,), generator=g).sort().values
    points = ((grid.coords[at] + torch.rand(len(at), 3, generator=g)) * grid.voxel_m).requires_grad_()
    table = torch.randn(grid.num_vertices, 16, generator=g).requires_grad_()
    return metrics + speedups(
        "kernels/voxels/features",
        lambda: voxel_features_torch(points, at, table, grid),
        lambda: voxel_features(points, at, table, grid),
        (points, table),
    )
