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
_CHUNK = 4096
"""Points at a time: what a chunk needs stays in the cache."""


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
    if all(t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors):
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
        first = self.geometry[:1]
        parts = [
            ((_encoded(part, self.table, self.layout) @ self.hidden.mT).relu_() @ first.mT)[:, 0]
            for part in torch.split(points_unit, _CHUNK)
        ]
        return torch.cat(parts) if parts else points_unit.new_zeros(0)


def _uniform(rows: int, columns: int, generator: torch.Generator) -> Tensor:
    return (torch.rand(rows, columns, generator=generator) * 2 - 1) / math.sqrt(columns)


def _encoded(points: Tensor, table: Tensor, layout: HashGridLayout) -> Tensor:
    """Return [hash | one-blob] without a gradient."""
    if points.device.type != "cpu" or points.dtype != torch.float32:
        return torch.cat((hash_grid_torch(points, table, layout), one_blob_torch(points, BINS)), 1)
    out = torch.empty(len(points), layout.num_features + 3 * BINS)
    _encode_into(points.contiguous(), table, layout, out)
    return out


def _encode_into(points: Tensor, table: Tensor, layout: HashGridLayout, out: Tensor) -> None:
    from xrdslam.ops.hash_grid_kernels import encode
    from xrdslam.ops.one_blob_kernels import spread
    from xrdslam.ops.threads import kernel_threads

    grid = (layout.scales, layout.resolutions, layout.offsets)
    with kernel_threads():
        encode(points.numpy(), table.detach().numpy(), *grid, out.numpy())
        spread(points.numpy(), BINS, layout.num_features, out.numpy())


class _JointField(torch.autograd.Function):
    """The chain in chunks of points; the backward pass is written out, so that nothing needless is computed."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, *rest: Any) -> tuple[Tensor, Tensor]:  # noqa: ANN401
        table, hidden, geometry, color_hidden, color, layout = rest
        points, count, blob = points.contiguous(), len(points), layout.num_features
        encoded = torch.empty(count, blob + 3 * BINS)
        first, geo, second = torch.empty(count, HIDDEN), torch.empty(count, 1 + GEO), torch.empty(count, HIDDEN)
        rgb = torch.empty(count, 3)
        _encode_into(points, table, layout, encoded)
        by_blob, by_geo = color_hidden[:, : 3 * BINS].mT, color_hidden[:, 3 * BINS :].mT
        for start in range(0, count, _CHUNK):
            part = slice(start, start + _CHUNK)
            torch.mm(encoded[part], hidden.mT, out=first[part])
            first[part].relu_()
            torch.mm(first[part], geometry.mT, out=geo[part])
            torch.mm(encoded[part, blob:], by_blob, out=second[part])
            second[part].addmm_(geo[part, 1:], by_geo).relu_()
            torch.mm(second[part], color.mT, out=rgb[part])
        ctx.save_for_backward(points, table, hidden, geometry, color_hidden, color, encoded, first, geo, second)
        ctx.layout = layout
        return geo[:, 0].clone(), rgb

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_distance: Tensor, d_rgb: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        points, table, hidden, geometry, color_hidden, color, encoded, first, geo, second = ctx.saved_tensors
        needs_points, needs_table, needs_weights = (
            ctx.needs_input_grad[0],
            ctx.needs_input_grad[1],
            ctx.needs_input_grad[2],
        )
        count, blob, split = len(points), ctx.layout.num_features, 3 * BINS
        relu_back = torch.ops.aten.threshold_backward
        d_weights = [torch.zeros_like(w) for w in (hidden, geometry, color_hidden, color)]
        d_encoded = torch.empty(count, blob + split if needs_points else blob)
        d_geo = torch.empty(min(count, _CHUNK), 1 + GEO)
        for start in range(0, count, _CHUNK):
            part = slice(start, min(start + _CHUNK, count))
            d_second = relu_back(torch.mm(d_rgb[part], color), second[part], 0)
            back = d_geo[: part.stop - start]
            back[:, 0] = d_distance[part]
            torch.mm(d_second, color_hidden[:, split:], out=back[:, 1:])
            d_first = relu_back(torch.mm(back, geometry), first[part], 0)
            torch.mm(d_first, hidden if needs_points else hidden[:, :blob], out=d_encoded[part])
            if needs_points:
                d_encoded[part, blob:].addmm_(d_second, color_hidden[:, :split])
            if needs_weights:
                d_weights[0].addmm_(d_first.mT, encoded[part])
                d_weights[1].addmm_(back.mT, first[part])
                d_weights[2][:, :split].addmm_(d_second.mT, encoded[part, blob:])
                d_weights[2][:, split:].addmm_(d_second.mT, geo[part, 1:])
                d_weights[3].addmm_(d_rgb[part].mT, second[part])
        d_points, d_table = _pull_back_encoding(points, table, ctx.layout, d_encoded, needs_points, needs_table)
        return d_points, d_table, *(d_weights if needs_weights else [None] * 4), None


def _pull_back_encoding(
    points: Tensor, table: Tensor, layout: HashGridLayout, d_encoded: Tensor, needs_points: bool, needs_table: bool
) -> tuple[Tensor | None, Tensor | None]:
    from xrdslam.ops.hash_grid_kernels import point_gradient, table_gradient
    from xrdslam.ops.one_blob_kernels import spread_gradient
    from xrdslam.ops.threads import kernel_threads

    grid = (layout.scales, layout.resolutions, layout.offsets)
    d_points, d_table = None, None
    with kernel_threads():
        if needs_points:
            d_points = torch.zeros_like(points)
            point_gradient(points.numpy(), table.detach().numpy(), *grid, d_encoded.numpy(), d_points.numpy())
            spread_gradient(points.numpy(), BINS, layout.num_features, d_encoded.numpy(), d_points.numpy())
        if needs_table:
            d_table = torch.zeros_like(table)
            table_gradient(points.numpy(), *grid, d_encoded.numpy(), d_table.numpy())
    return d_points, d_table
