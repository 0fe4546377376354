"""The field of Co-SLAM: a point's hash features and one-blob coordinates through two small networks."""

import math
from typing import Any, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from xrdslam.ops.dense_layers import linear, outer_sum
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
        first = self.geometry[0]
        parts = [
            torch.mv(linear(_encoded(part, self.table, self.layout), self.hidden, relu=True), first)
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
        _encode_into(points, table, layout, encoded)
        firsts, inputs, seconds, distances, colors = [], [], [], [points.new_zeros(0)], [points.new_zeros(0, 3)]
        for rows in torch.split(encoded, _CHUNK):
            firsts.append(linear(rows, hidden, relu=True))
            geo = linear(firsts[-1], geometry)
            distances.append(geo[:, 0])
            inputs.append(torch.cat((rows[:, blob:], geo[:, 1:]), 1))
            seconds.append(linear(inputs[-1], color_hidden, relu=True))
            colors.append(linear(seconds[-1], color))
        ctx.save_for_backward(points, table, hidden, geometry, color_hidden, color, encoded)
        ctx.chunks = firsts, inputs, seconds
        ctx.layout = layout
        return torch.cat(distances), torch.cat(colors)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_distance: Tensor, d_rgb: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        points, table, hidden, geometry, color_hidden, color, encoded = ctx.saved_tensors
        needs_points, needs_table, needs_weights = ctx.needs_input_grad[:3]
        count, blob, split = len(points), ctx.layout.num_features, 3 * BINS
        d_weights = [torch.zeros_like(w) for w in (hidden, geometry, color_hidden, color)]
        d_encoded = torch.empty(count, blob + split if needs_points else blob)
        back_hidden = hidden.mT if needs_points else hidden[:, :blob].mT
        for k, (first, given, second) in enumerate(zip(*ctx.chunks, strict=True)):
            part = slice(k * _CHUNK, k * _CHUNK + len(first))
            d_second = _masked_(torch.mm(d_rgb[part], color), second)
            d_given = linear(d_second, color_hidden.mT)
            d_geo = torch.cat((d_distance[part, None], d_given[:, split:]), 1)
            d_first = _masked_(linear(d_geo, geometry.mT), first)
            d_encoded[part] = linear(d_first, back_hidden)
            if needs_points:
                d_encoded[part, blob:] += d_given[:, :split]
            if needs_weights:
                pairs = ((d_first, encoded[part]), (d_geo, first), (d_second, given), (d_rgb[part], second))
                for d_weight, (back, forth) in zip(d_weights, pairs, strict=True):
                    d_weight.add_(outer_sum(back, forth))
        d_points, d_table = _pull_back_encoding(points, table, ctx.layout, d_encoded, needs_points, needs_table)
        return d_points, d_table, *(d_weights if needs_weights else [None] * 4), None


def _masked_(gradient: Tensor, activation: Tensor) -> Tensor:
    """Set to 0 what a ReLU did not let through."""
    return torch.ops.aten.threshold_backward.grad_input(gradient, activation, 0, grad_input=gradient)  # type: ignore[no-any-return]


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
