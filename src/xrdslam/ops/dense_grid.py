"""Features at the vertices of a dense grid, interpolated between them; gradients only where an optimiser looks."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int32, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from xrdslam.core.errors import ConfigError

__all__ = ["Chosen", "DenseGridLayout", "dense_grid", "dense_grid_torch"]


@dataclass(frozen=True)
class DenseGridLayout:
    """Where the vertices of a grid are: lattice vertex (i, j, k) lies at (i, j, k) * voxel_m in the world.

    A grid is the lattice from vertex `first` on, `size` vertices along x, y, z; a table has a row a vertex, x fastest.
    The lattice does not move when a grid grows, so that features stay where they are.
    """

    voxel_m: float
    first: tuple[int, int, int]
    size: tuple[int, int, int]

    def __post_init__(self) -> None:
        if not self.voxel_m > 0 or min(self.size) < 2:
            raise ConfigError(f"grid of {self.size} vertices {self.voxel_m} m apart: at least 2 an axis, apart")

    @classmethod
    def covering(cls, bounds: Float[Tensor, "2 3"], voxel_m: float) -> "DenseGridLayout":
        """Return the smallest grid whose outer vertices are at or beyond the corners (min, max) [m]."""
        low = [math.floor(v / voxel_m + 1e-4) for v in bounds[0].tolist()]
        high = [math.ceil(v / voxel_m - 1e-4) for v in bounds[1].tolist()]
        size = [max(2, b - a + 1) for a, b in zip(low, high, strict=True)]
        return cls(voxel_m, (low[0], low[1], low[2]), (size[0], size[1], size[2]))

    @property
    def num_rows(self) -> int:
        """Vertices."""
        return math.prod(self.size)

    @property
    def box(self) -> Float[Tensor, "2 3"]:
        """The outermost vertices (min, max) [m]."""
        last = [a + n - 1 for a, n in zip(self.first, self.size, strict=True)]
        return torch.tensor([self.first, last], dtype=torch.float32) * self.voxel_m

    @cached_property
    def arrays(self) -> tuple[np.float32, np.ndarray, np.ndarray]:
        """Vertices a metre, first vertex, vertices an axis, as kernels read them."""
        return np.float32(1 / self.voxel_m), np.array(self.first, np.float32), np.array(self.size, np.int64)

    def vertices(self, device: torch.device | str = "cpu") -> Float[Tensor, "v 3"]:
        """Return the world points [m] of all vertices, in the order of the table's rows."""
        axes = [
            torch.arange(a, a + n, device=device, dtype=torch.float32) * self.voxel_m
            for a, n in zip(self.first, self.size, strict=True)
        ]
        z, y, x = torch.meshgrid(axes[2], axes[1], axes[0], indexing="ij")
        return torch.stack((x, y, z), -1).reshape(-1, 3)

    def rows_in(self, other: "DenseGridLayout") -> Int64[Tensor, " v"]:
        """Return the rows that this grid's vertices have in another, larger one of the same lattice."""
        offset = [a - b for a, b in zip(self.first, other.first, strict=True)]
        x, y, z = (torch.arange(n) + o for n, o in zip(self.size, offset, strict=True))
        return ((z[:, None, None] * other.size[1] + y[:, None]) * other.size[0] + x).reshape(-1)


class Chosen(NamedTuple):
    """The vertices that an optimiser moves: only their features get a gradient, the others are read from the table."""

    values: Float[Tensor, "m c"]
    """Their features, in place of the table's."""
    rows: Int64[Tensor, " m"]
    slots: Int32[Tensor, " v"]
    """The place of each vertex among the chosen ones, -1 for the others."""

    @classmethod
    def of(cls, table: Float[Tensor, "v c"], rows: Int64[Tensor, " m"]) -> "Chosen":
        """Choose rows of a table; `values` is a leaf of its own."""
        slots = torch.full((len(table),), -1, dtype=torch.int32, device=table.device)
        slots[rows] = torch.arange(len(rows), dtype=torch.int32, device=table.device)
        return cls(torch.nn.Parameter(table.detach()[rows].clone()), rows, slots)


def dense_grid(
    points: Float[Tensor, "n 3"], table: Float[Tensor, "v c"], layout: DenseGridLayout, chosen: Chosen | None = None
) -> Float[Tensor, "n c"]:
    """Interpolate features at world points [m], linearly along each axis; outside, those of the nearest border point.

    Differentiable in the points and in the table, or with `chosen` in its values alone. Points whose cotangent is zero
    cost nothing. The CPU kernel wants channels in sixteens.
    """
    values = table if chosen is None else chosen.values
    fast = all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (points, table, values))
    if fast and table.shape[1] % 16 == 0:
        slots = torch.empty(0, dtype=torch.int32) if chosen is None else chosen.slots
        source = table if chosen is None else table.detach()
        return _DenseGrid.apply(points, source, values, slots, layout)  # type: ignore[no-any-return, no-untyped-call]  # torch
    return dense_grid_torch(points, table, layout, chosen)


def dense_grid_torch(
    points: Tensor, table: Tensor, layout: DenseGridLayout, chosen: Chosen | None = None
) -> Float[Tensor, "n c"]:
    """Interpolate features: the twin of the kernel."""
    if chosen is not None:
        table = table.detach().index_copy(0, chosen.rows, chosen.values)
    first, size = (torch.tensor(v, device=points.device) for v in (layout.first, layout.size))
    position = points / layout.voxel_m - first
    position = torch.minimum(position.clamp(min=0), (size - 1).to(position))
    cell = torch.minimum(position.detach().floor().long(), size - 2)
    fraction = (position - cell)[:, None, :]
    corners = torch.tensor([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], device=points.device)
    shares = torch.where(corners.bool(), fraction, 1 - fraction).prod(-1)
    x, y, z = (cell[:, None, :] + corners).unbind(-1)
    rows = (z * size[1] + y) * size[0] + x
    return (shares[..., None] * table[rows]).sum(1)


class _DenseGrid(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,  # noqa: ANN401
        points: Tensor,
        table: Tensor,
        values: Tensor,
        slots: Tensor,
        layout: DenseGridLayout,
    ) -> Tensor:
        from xrdslam.ops.dense_grid_kernels import interpolate
        from xrdslam.ops.threads import kernel_threads

        points, table, values = points.contiguous(), table.contiguous(), values.contiguous()
        out = torch.empty(len(points), table.shape[1])
        with kernel_threads():
            given = (table.detach().numpy(), values.detach().numpy(), slots.numpy())
            interpolate(points.detach().numpy(), *layout.arrays, *given, out.numpy(), 0)
        ctx.save_for_backward(points, table, values, slots)
        ctx.layout = layout
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.ops.dense_grid_kernels import feature_gradient, point_gradient
        from xrdslam.ops.threads import kernel_threads

        points, table, values, slots = (t.detach() for t in ctx.saved_tensors)
        grid, upstream = ctx.layout.arrays, cotangent.contiguous().numpy()
        d_points, d_table, d_values = None, None, None
        with kernel_threads():
            if ctx.needs_input_grad[0]:
                d_points = torch.zeros_like(points)
                given = (table.numpy(), values.numpy(), slots.numpy())
                point_gradient(points.numpy(), *grid, *given, upstream, 0, d_points.numpy())
            if ctx.needs_input_grad[2] and len(slots):
                d_values = torch.zeros_like(values)
                feature_gradient(points.numpy(), *grid, slots.numpy(), upstream, 0, d_values.numpy())
            elif ctx.needs_input_grad[1]:
                d_table = torch.zeros_like(table)
                feature_gradient(points.numpy(), *grid, slots.numpy(), upstream, 0, d_table.numpy())
        return d_points, d_table, d_values, None, None
