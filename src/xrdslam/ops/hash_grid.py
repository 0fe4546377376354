"""Multi-resolution hash encoding of points (Mueller et al., Instant Neural Graphics Primitives, 2022).

Levels, indices and the half-cell shift are those of tiny-cuda-nn's "HashGrid", so that published settings carry over.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from xrdslam.core.errors import ConfigError

__all__ = ["HashGridLayout", "hash_grid", "hash_grid_torch"]

PRIMES = (1, 2654435761, 805459861)


@dataclass(frozen=True)
class HashGridLayout:
    """How the rows of a table are shared between levels.

    Level l has the scale s = base * b^l - 1 and r = ceil(s) + 1 vertices an axis; it has a row for each vertex where
    2^log2_rows rows are enough (a few more, to a multiple of eight), else 2^log2_rows rows that vertices share by hash.
    """

    finest: int
    """Vertices an axis of the last level."""
    log2_rows: int
    levels: int = 16
    features: int = 2
    base: int = 16

    def __post_init__(self) -> None:
        if self.finest < self.base or self.levels < 1 or self.features != 2 or not 3 <= self.log2_rows <= 30:
            raise ConfigError(
                f"hash grid of {self.levels} levels from {self.base} to {self.finest} vertices, 2^{self.log2_rows} rows"
                f" of {self.features}: the finest level must not be coarser than the first, rows lie between 2^3 and "
                "2^30 and have 2 features"
            )

    @classmethod
    def build(
        cls, finest: int, log2_rows: int, levels: int = 16, features: int = 2, base: int = 16
    ) -> "HashGridLayout":
        """Build the layout whose last level has `finest` vertices an axis."""
        return cls(finest, log2_rows, levels, features, base)

    @cached_property
    def scales(self) -> Float[np.ndarray, " levels"]:
        """Cells an axis of each level (a float: vertices lie half a cell off)."""
        growth = np.float32(2 ** (math.log2(self.finest / self.base) / max(1, self.levels - 1)))
        powers = np.exp2(np.arange(self.levels, dtype=np.float32) * np.log2(growth))
        scales: np.ndarray = (powers * np.float32(self.base) - np.float32(1)).astype(np.float32)
        return scales

    @cached_property
    def resolutions(self) -> Int64[np.ndarray, " levels"]:
        """Vertices an axis of each level."""
        vertices: np.ndarray = (np.ceil(self.scales) + 1).astype(np.int64)
        return vertices

    @cached_property
    def offsets(self) -> Int64[np.ndarray, " bounds"]:
        """The first row of each level, and the number of all rows."""
        rows = [min(-(-(int(r) ** 3) // 8) * 8, 1 << self.log2_rows) for r in self.resolutions]
        return np.concatenate(([0], np.cumsum(rows))).astype(np.int64)

    @property
    def num_rows(self) -> int:
        """Rows of the table."""
        return int(self.offsets[-1])

    @property
    def num_features(self) -> int:
        """Numbers that a point is encoded in, level by level."""
        return self.levels * self.features

    @property
    def num_dense(self) -> int:
        """How many levels have a row for each vertex."""
        return sum(int(r) ** 3 <= int(n) for r, n in zip(self.resolutions, np.diff(self.offsets), strict=True))

    def rows_of(self, level: int, vertices: Int64[Tensor, "*n 3"]) -> Int64[Tensor, "*n"]:
        """Return the table's rows of a level's vertices."""
        r, first = int(self.resolutions[level]), int(self.offsets[level])
        count = int(self.offsets[level + 1]) - first
        x, y, z = vertices.unbind(-1)
        hashed = (x * PRIMES[0]) ^ (y * PRIMES[1]) ^ (z * PRIMES[2])
        index = x + y * r + z * r * r if r**3 <= count else hashed
        return first + (index & 0xFFFFFFFF) % count


def hash_grid(
    points_unit: Float[Tensor, "n 3"], table: Float[Tensor, "rows 2"], layout: HashGridLayout
) -> Float[Tensor, "n features"]:
    """Interpolate the table at points of the unit cube; outside of it the rows go on by the same rule.

    Differentiable in the table and the points.
    """
    if all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (points_unit, table)):
        return _HashGrid.apply(points_unit, table, layout)  # type: ignore[no-any-return, no-untyped-call]  # torch
    return hash_grid_torch(points_unit, table, layout)


def hash_grid_torch(points_unit: Tensor, table: Tensor, layout: HashGridLayout) -> Float[Tensor, "n features"]:
    """Interpolate the table: the twin of the kernel."""
    features = []
    corners = torch.tensor([[i, j, k] for k in (0, 1) for j in (0, 1) for i in (0, 1)], device=points_unit.device)
    for level in range(layout.levels):
        position = points_unit * float(layout.scales[level]) + 0.5
        cell = position.detach().floor()
        fraction = (position - cell)[:, None, :]
        weights = torch.where(corners.bool(), fraction, 1 - fraction).prod(-1)
        rows = layout.rows_of(level, cell.long()[:, None, :] + corners)
        features.append((weights[..., None] * table[rows]).sum(1))
    return torch.cat(features, 1)


class _HashGrid(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points_unit: Tensor, table: Tensor, layout: HashGridLayout) -> Tensor:  # noqa: ANN401
        from xrdslam.ops.hash_grid_kernels import encode
        from xrdslam.ops.threads import kernel_threads

        out = torch.empty(len(points_unit), layout.num_features)
        points, rows = points_unit.detach().contiguous(), table.detach().contiguous()
        with kernel_threads():
            encode(points.numpy(), rows.numpy(), layout.scales, layout.resolutions, layout.offsets, out.numpy())
        ctx.save_for_backward(points, rows)
        ctx.layout = layout
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.ops.hash_grid_kernels import point_gradient, table_gradient
        from xrdslam.ops.threads import kernel_threads

        points, table = ctx.saved_tensors
        layout, upstream = ctx.layout, cotangent.contiguous().numpy()
        grid = (layout.scales, layout.resolutions, layout.offsets)
        d_points, d_table = None, None
        with kernel_threads():
            if ctx.needs_input_grad[0]:
                d_points = torch.zeros_like(points)
                point_gradient(points.numpy(), table.numpy(), *grid, upstream, d_points.numpy())
            if ctx.needs_input_grad[1]:
                d_table = torch.zeros_like(table)
                table_gradient(points.numpy(), *grid, upstream, d_table.numpy())
        return d_points, d_table, None
