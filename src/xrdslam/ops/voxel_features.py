"""Features on the corners of sparse voxels, interpolated at points."""

from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from xrdslam.ops.voxel_hash import SparseVoxels

__all__ = ["features_backward", "features_into", "voxel_features", "voxel_features_torch"]


def voxel_features(
    points_world: Float[Tensor, "n 3"],
    voxels: Int64[Tensor, " n"],
    table: Float[Tensor, "rows f"],
    grid: SparseVoxels,
) -> Float[Tensor, "n f"]:
    """Interpolate the table's rows trilinearly at points, each within (or on) the voxel that is given with it.

    Differentiable in the points and the table; continuous across voxels that share their rows. The kernel takes
    features in sixteens; other widths go the way of the twin.
    """
    if not takes(points_world, table):
        return voxel_features_torch(points_world, voxels, table, grid)
    return _VoxelFeatures.apply(points_world, table, voxels, grid)  # type: ignore[no-any-return, no-untyped-call]  # torch


def voxel_features_torch(points_world: Tensor, voxels: Tensor, table: Tensor, grid: SparseVoxels) -> Tensor:
    """Interpolate: the twin of the kernel. Weights are prod_a (q_a p_a + (1 - q_a) (1 - p_a)) for corner q."""
    coords, corners = grid.coords.to(table.device)[voxels], grid.corners.to(table.device)[voxels]
    local = (points_world.double() / grid.voxel_m - coords).to(points_world.dtype)
    sides = torch.tensor([[c >> 2, (c >> 1) & 1, c & 1] for c in range(8)], device=table.device).bool()
    weights = torch.where(sides, local[:, None], 1 - local[:, None]).prod(-1)
    return (weights[..., None] * table[corners.long()]).sum(1)


def takes(points_world: Tensor, table: Tensor) -> bool:
    """Say whether the kernel takes these."""
    on_cpu = all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (points_world, table))
    return on_cpu and table.shape[1] % 16 == 0


def features_into(
    points_world: Float[Tensor, "n 3"],
    voxels: Int64[Tensor, " n"],
    table: Float[Tensor, "rows f"],
    grid: SparseVoxels,
    out: Float[Tensor, "n f"],
) -> None:
    """Interpolate into `out` on the CPU, without a gradient: a building block of fused fields."""
    from xrdslam.ops.threads import kernel_threads
    from xrdslam.ops.voxel_features_kernels import interpolate

    arrays = [t.detach().contiguous().numpy() for t in (points_world, voxels, grid.coords, grid.corners, table)]
    with kernel_threads():
        interpolate(*arrays, grid.voxel_m, out.numpy())


def features_backward(
    points_world: Float[Tensor, "n 3"],
    voxels: Int64[Tensor, " n"],
    table: Float[Tensor, "rows f"],
    grid: SparseVoxels,
    upstream: Float[Tensor, "n f"],
    needs_points: bool = True,
    needs_table: bool = True,
) -> tuple[Float[Tensor, "n 3"] | None, Float[Tensor, "rows f"] | None]:
    """Return the gradients to the points and to the table, those that are needed."""
    from xrdslam.ops import voxel_features_kernels as kernels
    from xrdslam.ops.threads import kernel_threads

    points, where, rows, g = (t.detach().contiguous().numpy() for t in (points_world, voxels, table, upstream))
    coords, corners = grid.coords.numpy(), grid.corners.numpy()
    d_points, d_table = None, None
    with kernel_threads():
        if needs_points:
            d_points = torch.empty(points_world.shape)
            kernels.point_gradient(points, where, coords, corners, rows, grid.voxel_m, g, d_points.numpy())
        if needs_table:
            d_table = torch.zeros(table.shape)
            starts, order = torch.empty(len(grid) + 1, dtype=torch.int64), torch.empty(len(where), dtype=torch.int64)
            d_corners = torch.empty(len(grid), 8, table.shape[1])
            kernels.order_by_voxel(where, starts.numpy(), order.numpy())
            kernels.voxel_gradient(points, coords, grid.voxel_m, starts.numpy(), order.numpy(), g, d_corners.numpy())
            kernels.gather_rows(starts.numpy(), corners, d_corners.numpy(), d_table.numpy())
    return d_points, d_table


class _VoxelFeatures(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, table: Tensor, voxels: Tensor, grid: SparseVoxels) -> Tensor:  # noqa: ANN401
        out = torch.empty(len(points), table.shape[1])
        features_into(points, voxels, table, grid, out)
        ctx.save_for_backward(points, table, voxels)
        ctx.grid = grid
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        points, table, voxels = ctx.saved_tensors
        needed = ctx.needs_input_grad[:2]
        return (*features_backward(points, voxels, table, ctx.grid, upstream, *needed), None, None)
