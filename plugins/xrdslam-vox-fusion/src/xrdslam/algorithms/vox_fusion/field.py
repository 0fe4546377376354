"""The field of Vox-Fusion: interpolated voxel features, decoded; colour only where it is wanted.

The fused pass is exact, and cheaper than the layers one by one: the colour branch begins with two linear layers in a
row, which are multiplied into one; chunks of rows stay in the cache; a frozen map has no gradients of its weights.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from xrdslam.algorithms.vox_fusion.decoder import DecoderWeights, decode_color_torch, decode_geometry_torch
from xrdslam.ops.dense_layers import linear
from xrdslam.ops.voxel_features import features_backward, features_into, takes, voxel_features_torch
from xrdslam.ops.voxel_hash import SparseVoxels

__all__ = ["FieldSamples", "VoxelField", "Wanted", "voxel_field", "voxel_field_torch"]

_CHUNK = 4096
"""Rows at a time."""
Wanted = Callable[[Float[Tensor, " n"]], Tensor]
"""Signed distances -> which samples' colours are wanted; no gradient passes."""


class FieldSamples(NamedTuple):
    """What the field is at points."""

    sdf: Float[Tensor, " n"]
    """Signed distance [truncations]."""
    rgb: Float[Tensor, "k 3"]
    """Colours of the chosen points."""
    chosen: Int64[Tensor, " k"]
    """Which points have a colour, in order."""


def voxel_field(
    points_world: Float[Tensor, "n 3"],
    voxels: Int64[Tensor, " n"],
    table: Float[Tensor, "rows f"],
    weights: DecoderWeights,
    grid: SparseVoxels,
    wanted: Wanted,
    precision: torch.dtype = torch.float32,
) -> FieldSamples:
    """Evaluate the field at points in their voxels; differentiable in the points, the table and the weights.

    `precision` is that of the wide layers' products on the CPU; what goes in and comes out is float32.
    """
    if takes(points_world, table):
        return FieldSamples(*_VoxelField.apply(points_world, table, *weights, voxels, grid, wanted, precision))  # type: ignore[no-untyped-call]  # torch
    return voxel_field_torch(points_world, voxels, table, weights, grid, wanted)


def voxel_field_torch(
    points_world: Tensor, voxels: Tensor, table: Tensor, weights: DecoderWeights, grid: SparseVoxels, wanted: Wanted
) -> FieldSamples:
    """Evaluate layer by layer: the twin of the fused pass."""
    features = voxel_features_torch(points_world, voxels, table, grid)
    geometry = decode_geometry_torch(features, weights)
    chosen = wanted(geometry[:, 0].detach()).nonzero()[:, 0]
    rgb = decode_color_torch(geometry[chosen, 1:], features[chosen], weights)
    return FieldSamples(geometry[:, 0], rgb, chosen)


@dataclass
class VoxelField:
    """Voxels, features on their corners, and what decodes them."""

    grid: SparseVoxels
    table: Float[Tensor, "rows f"]
    weights: DecoderWeights
    precision: torch.dtype = torch.float32

    def at(self, points_world: Float[Tensor, "n 3"], voxels: Int64[Tensor, " n"], wanted: Wanted) -> FieldSamples:
        """Evaluate at points in their voxels."""
        return voxel_field(points_world, voxels, self.table, self.weights, self.grid, wanted, self.precision)

    def distance(self, points_world: Float[Tensor, "n 3"], voxels: Int64[Tensor, " n"]) -> Float[Tensor, " n"]:
        """Return the signed distance alone [truncations], without a gradient."""
        with torch.no_grad():
            return self.at(points_world, voxels, torch.zeros_like).sdf

    def color(self, points_world: Float[Tensor, "n 3"], voxels: Int64[Tensor, " n"]) -> Float[Tensor, "n 3"]:
        """Return the colour alone, without a gradient."""
        with torch.no_grad():
            return self.at(points_world, voxels, torch.ones_like).rgb


def _folded(weights: DecoderWeights) -> tuple[Tensor, Tensor]:
    """Return the one layer from [second hidden | features] that the geometry features and the tint layer amount to."""
    split = len(weights.head) - 1
    by_geometry = weights.tint[:, :split]
    matrix = torch.cat((by_geometry @ weights.head[1:], weights.tint[:, split:]), 1)
    return matrix, weights.tint_bias + by_geometry @ weights.head_bias[1:]


def _pull_back_fold(
    weights: DecoderWeights, d_matrix: Tensor, d_bias: Tensor, d_head: Tensor, d_head_bias: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the gradients of the tint layer, and write those of the head's geometry rows."""
    split, width = len(weights.head) - 1, weights.head.shape[1]
    by_geometry, through = weights.tint[:, :split], d_matrix[:, :width]
    torch.mm(by_geometry.mT, through, out=d_head[1:])
    torch.mv(by_geometry.mT, d_bias, out=d_head_bias[1:])
    d_by_geometry = through @ weights.head[1:].mT + torch.outer(d_bias, weights.head_bias[1:])
    return torch.cat((d_by_geometry, d_matrix[:, width:]), 1), d_bias


def _chunk_bounds(chosen: Tensor, count: int) -> list[int]:
    """Return where each chunk's part of the chosen rows begins, and the end of all."""
    edges = torch.arange(0, max(count, 1) + _CHUNK, _CHUNK, dtype=chosen.dtype)
    bounds: list[int] = torch.searchsorted(chosen, edges).tolist()
    return bounds


def _masked_(gradient: Tensor, activation: Tensor) -> Tensor:
    """Set to 0 what a ReLU did not let through."""
    return torch.ops.aten.threshold_backward.grad_input(gradient, activation, 0, grad_input=gradient)  # type: ignore[no-any-return]


class _VoxelField(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, table: Tensor, *rest: Any) -> tuple[Tensor, ...]:  # noqa: ANN401
        *matrices, voxels, grid, wanted, precision = rest
        w = DecoderWeights(*(m.detach() for m in matrices))
        count, width = len(points), len(w.second)
        features = torch.empty(count, table.shape[1])
        features_into(points, voxels, table, grid, features)
        firsts, seconds, parts = [], [], [points.new_zeros(0)]
        middle, middle_bias = w.second.to(precision), w.second_bias.to(precision)
        for rows in torch.split(features, _CHUNK):
            first = linear(rows, w.first, w.first_bias, relu=True).to(precision)
            second = linear(first, middle, middle_bias, relu=True)
            parts.append(torch.mv(second.float(), w.head[0]) + w.head_bias[0])
            firsts.append(first)
            seconds.append(second)
        sdf = torch.cat(parts)
        chosen = wanted(sdf).nonzero()[:, 0]
        inputs = torch.empty(len(chosen), width + table.shape[1], dtype=precision)
        bounds = _chunk_bounds(chosen, count)
        for k, second in enumerate(seconds):
            part = slice(bounds[k], bounds[k + 1])
            inputs[part, :width] = second.index_select(0, chosen[part] - k * _CHUNK)
        inputs[:, width:] = features.index_select(0, chosen)
        matrix, bias = (t.to(precision) for t in _folded(w))
        tints = [linear(rows, matrix, bias, relu=True) for rows in torch.split(inputs, _CHUNK)]
        colors = [linear(tint.float(), w.color, w.color_bias).sigmoid_() for tint in tints]
        rgb = torch.cat([points.new_zeros(0, 3), *colors])
        ctx.save_for_backward(points, table, voxels, features, inputs, chosen, rgb, *matrices)
        ctx.chunks = firsts, seconds, tints
        ctx.grid, ctx.bounds = grid, bounds
        ctx.mark_non_differentiable(chosen)
        return sdf, rgb, chosen

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_sdf: Tensor, d_rgb: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        points, table, voxels, features, inputs, chosen, rgb, *matrices = ctx.saved_tensors
        w = DecoderWeights(*(m.detach() for m in matrices))
        firsts, seconds, tints = ctx.chunks
        needs_weights, width = any(ctx.needs_input_grad[2:12]), len(w.second)
        d = DecoderWeights(*(torch.zeros_like(m) for m in w)) if needs_weights else None
        d_inputs = _color_backward(w, d, d_rgb * rgb * (1 - rgb), inputs, tints)
        d_features, middle = torch.empty_like(features), w.second.to(firsts[0].dtype)
        for k, (first, second) in enumerate(zip(firsts, seconds, strict=True)):
            rows = slice(k * _CHUNK, k * _CHUNK + len(first))
            part = slice(ctx.bounds[k], ctx.bounds[k + 1])
            back = torch.outer(d_sdf[rows], w.head[0])
            back.index_add_(0, chosen[part] - rows.start, d_inputs[part, :width])
            d_second = _masked_(back.to(second.dtype), second)
            d_first = _masked_(linear(d_second, middle.mT), first)
            d_features[rows] = linear(d_first, w.first.to(first.dtype).mT)
            if d is not None:
                d.head[0].add_(torch.mv(second.mT, d_sdf[rows].to(second.dtype)))
                d.second.add_(d_second.mT @ first)
                d.second_bias.add_(d_second.sum(0, dtype=torch.float32))
                d.first.add_(d_first.mT @ features[rows].to(first.dtype))
                d.first_bias.add_(d_first.sum(0, dtype=torch.float32))
        d_features.index_add_(0, chosen, d_inputs[:, width:])
        if d is not None:
            d.head_bias[0] = d_sdf.sum()
        needs_points, needs_table = ctx.needs_input_grad[:2]
        back_to = features_backward(points, voxels, table, ctx.grid, d_features, needs_points, needs_table)
        return (*back_to, *(d if d is not None else [None] * len(w)), None, None, None, None)


def _color_backward(
    w: DecoderWeights, d: DecoderWeights | None, d_raw: Tensor, inputs: Tensor, tints: list[Tensor]
) -> Tensor:
    """Return the gradient of the colour branch's inputs, and add those of its weights to `d`."""
    matrix, bias = _folded(w)
    d_inputs, d_matrix, d_bias = torch.empty(inputs.shape), torch.zeros_like(matrix), torch.zeros_like(bias)
    matrix = matrix.to(inputs.dtype)
    for k, tint in enumerate(tints):
        rows = slice(k * _CHUNK, k * _CHUNK + len(tint))
        d_tint = _masked_(linear(d_raw[rows], w.color.mT).to(tint.dtype), tint)
        d_inputs[rows] = linear(d_tint, matrix.mT)
        if d is not None:
            d.color.add_(d_raw[rows].mT @ tint.float())
            d_matrix.add_(d_tint.mT @ inputs[rows])
            d_bias.add_(d_tint.sum(0, dtype=torch.float32))
    if d is not None:
        d.color_bias.copy_(d_raw.sum(0))
        d_tint_matrix, d_tint_bias = _pull_back_fold(w, d_matrix, d_bias, d.head, d.head_bias)
        d.tint.copy_(d_tint_matrix)
        d.tint_bias.copy_(d_tint_bias)
    return d_inputs
