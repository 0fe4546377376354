"""The field of Co-SLAM: a point's hash features and one-blob coordinates through two small networks."""

import math
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from xrdslam.ops.hash_grid import HashGridLayout, hash_grid_torch
from xrdslam.ops.one_blob import one_blob_torch

__all__ = ["FieldWeights", "JointField", "joint_field", "joint_field_torch"]

BINS, HIDDEN, GEO = 16, 32, 15


class FieldWeights(NamedTuple):
    """The table of the hash grid and the four matrices, none with a bias."""

    table: Float[Tensor, "rows 2"]
    hidden: Float[Tensor, "32 in"]
    geometry: Float[Tensor, "16 32"]
    color_hidden: Float[Tensor, "32 63"]
    color: Float[Tensor, "3 32"]


def joint_field(
    points_unit: Float[Tensor, "n 3"], weights: FieldWeights, layout: HashGridLayout
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 3"]]:
    """Return signed distance [truncations] and colour before its sigmoid at points of the unit cube.

    [hash | one-blob] -> 32 -> (distance, 15 features); [one-blob | features] -> 32 -> colour (paper, equations 2-4).
    Differentiable in all that is given.
    """
    tensors = (points_unit, *weights)
    if layout.num_features == 32 and all(t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors):
        return _JointField.apply(*tensors, layout)  # type: ignore[no-any-return, no-untyped-call]  # torch
    return joint_field_torch(points_unit, weights, layout)


def joint_field_torch(
    points_unit: Tensor, weights: FieldWeights, layout: HashGridLayout
) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 3"]]:
    """Return distance and colour: the twin of the fused path."""
    blob = one_blob_torch(points_unit, BINS)
    encoded = torch.cat((hash_grid_torch(points_unit, weights.table, layout), blob), 1)
    geometry = (encoded @ weights.hidden.mT).relu() @ weights.geometry.mT
    color = (torch.cat((blob, geometry[:, 1:]), 1) @ weights.color_hidden.mT).relu() @ weights.color.mT
    return geometry[:, 0], color


class JointField(nn.Module):
    """The parameters, initialised as published: table U(-1e-4, 1e-4), matrices U(-1, 1) / sqrt(inputs)."""

    def __init__(self, layout: HashGridLayout, seed: int = 0) -> None:
        super().__init__()
        self.layout = layout
        g = torch.Generator().manual_seed(seed)
        encoded = layout.num_features + 3 * BINS
        self.table = nn.Parameter((torch.rand(layout.num_rows, layout.features, generator=g) * 2 - 1) * 1e-4)
        self.hidden = nn.Parameter(_uniform(HIDDEN, encoded, g))
        self.geometry = nn.Parameter(_uniform(1 + GEO, HIDDEN, g))
        self.color_hidden = nn.Parameter(_uniform(HIDDEN, 3 * BINS + GEO, g))
        self.color = nn.Parameter(_uniform(3, HIDDEN, g))

    @property
    def weights(self) -> FieldWeights:
        """All parameters, in the order that `joint_field` takes."""
        return FieldWeights(self.table, self.hidden, self.geometry, self.color_hidden, self.color)

    def decoder(self) -> list[nn.Parameter]:
        """Return the matrices."""
        return [self.hidden, self.geometry, self.color_hidden, self.color]

    def forward(self, points_unit: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 3"]]:
        return joint_field(points_unit, self.weights, self.layout)

    @torch.no_grad()
    def distance(self, points_unit: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Return the signed distance alone [truncations], without a gradient."""
        if points_unit.device.type == "cpu" and points_unit.dtype == torch.float32:
            return _decoded(points_unit.contiguous(), self.weights, self.layout, False)[1]
        return joint_field_torch(points_unit, self.weights, self.layout)[0]


def _uniform(rows: int, columns: int, generator: torch.Generator) -> Tensor:
    return (torch.rand(rows, columns, generator=generator) * 2 - 1) / math.sqrt(columns)


class _JointField(torch.autograd.Function):
    """The grid, then the networks; the backward pass is written out, so that nothing needless is computed."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, *rest: Any) -> tuple[Tensor, Tensor]:  # noqa: ANN401
        *tensors, layout = rest
        points, weights = points.contiguous(), FieldWeights(*tensors)
        encoded, distance, color = _decoded(points, weights, layout, True)
        ctx.save_for_backward(points, encoded, *weights)
        ctx.layout = layout
        return distance, color

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_distance: Tensor, d_color: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.algorithms.co_slam.field_kernels import CHUNK, GRADIENTS, decode_backward
        from xrdslam.ops.hash_grid_kernels import point_gradient, table_gradient
        from xrdslam.ops.threads import kernel_threads

        points, encoded, *tensors = ctx.saved_tensors
        weights, layout = FieldWeights(*tensors), ctx.layout
        needs_points, needs_table, needs_weights = ctx.needs_input_grad[:3]
        grid = (layout.scales, layout.resolutions, layout.offsets)
        d_encoded = torch.empty_like(encoded)
        d_points = torch.zeros_like(points) if needs_points else points.new_empty(0, 3)
        chunks = -(-len(points) // CHUNK) if needs_weights else 0
        grown = points.new_zeros(chunks, GRADIENTS if needs_weights else 0)
        d_table = None
        with kernel_threads():
            decode_backward(
                points.numpy(),
                encoded.numpy(),
                _forward_pack(weights).numpy(),
                _backward_pack(weights).numpy(),
                d_distance.contiguous().numpy(),
                d_color.contiguous().numpy(),
                d_encoded.numpy(),
                d_points.numpy(),
                grown.numpy(),
            )
            if needs_points:
                point_gradient(points.numpy(), weights.table.numpy(), *grid, d_encoded.numpy(), d_points.numpy())
            if needs_table:
                d_table = torch.zeros_like(weights.table)
                table_gradient(points.numpy(), *grid, d_encoded.numpy(), d_table.numpy())
        d_weights = _unpacked(grown.sum(0)) if needs_weights else [None] * 4
        return d_points if needs_points else None, d_table, *d_weights, None


def _decoded(
    points: Tensor, weights: FieldWeights, layout: HashGridLayout, wants_color: bool
) -> tuple[Tensor, Tensor, Tensor]:
    """Return hash features, distance and colour (empty where it is not wanted)."""
    from xrdslam.algorithms.co_slam.field_kernels import decode
    from xrdslam.ops.hash_grid_kernels import encode
    from xrdslam.ops.threads import kernel_threads

    count = len(points)
    encoded, distance = points.new_empty(count, layout.num_features), points.new_empty(count)
    color = points.new_empty(count if wants_color else 0, 3)
    grid = (layout.scales, layout.resolutions, layout.offsets)
    with kernel_threads():
        encode(points.numpy(), weights.table.detach().numpy(), *grid, encoded.numpy())
        decode(points.numpy(), encoded.numpy(), _forward_pack(weights).numpy(), distance.numpy(), color.numpy())
    return encoded, distance, color


def _forward_pack(weights: FieldWeights) -> Tensor:
    """Lay the matrices out as `field_kernels` wants them."""
    parts = (weights.hidden, weights.geometry.roll(-1, 0), weights.color_hidden, _filled(weights.color, rows=8))
    return torch.cat([w.detach().mT.reshape(-1) for w in parts])


def _backward_pack(weights: FieldWeights) -> Tensor:
    parts = (weights.hidden, weights.geometry.roll(-1, 0), _filled(weights.color_hidden, columns=64), weights.color)
    return torch.cat([w.detach().reshape(-1) for w in parts])


def _filled(matrix: Tensor, rows: int = 0, columns: int = 0) -> Tensor:
    """Add rows and columns of zeros up to a size."""
    below, beside = max(0, rows - matrix.shape[0]), max(0, columns - matrix.shape[1])
    return nn.functional.pad(matrix.detach(), (0, beside, 0, below))


def _unpacked(grown: Float[Tensor, " gradients"]) -> list[Tensor]:
    """Return the gradients of the four matrices."""
    hidden, geometry, color_hidden, color = torch.split(grown, [80 * HIDDEN, 16 * HIDDEN, 64 * HIDDEN, 8 * HIDDEN])
    return [
        hidden.reshape(80, HIDDEN).mT,
        geometry.reshape(16, HIDDEN).roll(1, 0),
        color_hidden.reshape(64, HIDDEN)[:63].mT,
        color.reshape(8, HIDDEN)[:3],
    ]
