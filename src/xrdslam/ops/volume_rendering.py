"""Samples along rays to colour, depth and variance: occupancy, truncated signed distance, or density.

Each kind has its weights (`sdf_weights`, ...), and `composite` sums under weights; a map that is expensive to ask for
colour asks only where the weights are.
"""

from typing import Any, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable

__all__ = [
    "Composite",
    "composite",
    "composite_density",
    "composite_occupancy",
    "composite_sdf",
    "density_weights",
    "occupancy_weights",
    "sdf_weights",
]


class Composite(NamedTuple):
    """What rays see."""

    rgb: Float[Tensor, "n 3"]
    depth: Float[Tensor, " n"]
    """Mean depth under the weights [m]."""
    variance: Float[Tensor, " n"]
    """Of the depth under the weights [m^2]."""
    opacity: Float[Tensor, " n"]
    """Sum of the weights."""


def composite(weights: Float[Tensor, "n s"], rgb: Float[Tensor, "n s 3"], depths: Float[Tensor, "n s"]) -> Composite:
    """Sum under weights: C = sum w c, D = sum w z, V = sum w (z - D)^2. Differentiable in weights and rgb."""
    if _on_cpu(weights, rgb, depths):
        return Composite(*_Composite.apply(weights, rgb, depths))  # type: ignore[no-untyped-call]  # torch
    return composite_torch(weights, rgb, depths)


def composite_torch(weights: Tensor, rgb: Tensor, depths: Tensor) -> Composite:
    """Sum under weights: the twin of the kernel."""
    depth = (weights * depths).sum(1)
    variance = (weights * (depths - depth[:, None]) ** 2).sum(1)
    return Composite((weights[..., None] * rgb).sum(1), depth, variance, weights.sum(1))


def sdf_weights(
    sdf: Float[Tensor, "n s"],
    depths: Float[Tensor, "n s"],
    truncation_m: float,
    valid: Bool[Tensor, "n s"] | None = None,
) -> Float[Tensor, "n s"]:
    """Weigh samples by a bell about the surface; `sdf` is in truncations, the weights of a ray sum to 1.

    w ~ sigmoid(s / t) sigmoid(-s / t) 1[z < z* + t]: s is divided by t once more (Neural RGB-D's formula on a distance
    that is already in truncations), since published weights of losses were tuned with it. z* is the depth of the sample
    before the first change of sign, or the first sample's where there is none. A sample on the surface counts as a
    change (a strict test misses it and sees the camera).
    """
    if _on_cpu(sdf, depths):
        mask = torch.empty(0, 0, dtype=torch.bool) if valid is None else valid
        return _SdfWeights.apply(sdf, depths, mask, truncation_m)  # type: ignore[no-any-return, no-untyped-call]  # torch
    return sdf_weights_torch(sdf, depths, truncation_m, valid)


def sdf_weights_torch(
    sdf: Tensor, depths: Tensor, truncation_m: float, valid: Tensor | None = None
) -> Float[Tensor, "n s"]:
    """Weigh samples by a bell about the surface: the twin of the kernel."""
    valid = torch.ones_like(sdf, dtype=torch.bool) if valid is None else valid
    if sdf.shape[1] == 0:
        return torch.zeros_like(sdf)
    crosses = torch.zeros_like(valid)
    crosses[:, :-1] = (sdf[:, :-1] * sdf[:, 1:] <= 0) & valid[:, :-1] & valid[:, 1:]
    first = torch.where(crosses.any(1), crosses.int().argmax(1), valid.int().argmax(1))
    limit = depths.gather(1, first[:, None]) + truncation_m
    scaled = sdf / truncation_m
    bell = torch.sigmoid(scaled) * torch.sigmoid(-scaled) * (valid & (depths < limit))
    return bell / (bell.sum(1, keepdim=True) + 1e-8)


def occupancy_weights(logits: Float[Tensor, "n s"], scale: float = 10.0) -> Float[Tensor, "n s"]:
    """Weigh samples by where a ray ends: w_i = o_i prod_{j<i} (1 - o_j + 1e-10), o = sigmoid(scale * logit).

    The weights of a ray are not normalised: what is missing to 1 has passed (NICE-SLAM, equations 5 and 6).
    """
    if _on_cpu(logits):
        return _OccupancyWeights.apply(logits, scale)  # type: ignore[no-any-return, no-untyped-call]  # torch
    return occupancy_weights_torch(logits, scale)


def occupancy_weights_torch(logits: Tensor, scale: float = 10.0) -> Float[Tensor, "n s"]:
    """Weigh samples by where a ray ends: the twin of the kernel."""
    occupancy = torch.sigmoid(scale * logits)
    return occupancy * _passed(1 - occupancy + 1e-10)


def density_weights(density: Float[Tensor, "n s"], depths: Float[Tensor, "n s"]) -> Float[Tensor, "n s"]:
    """Weigh samples by alpha = 1 - exp(-density * distance to the next), front to back (NeRF, equation 3).

    The last sample has no next; it takes the distance from the one before.
    """
    if depths.shape[1] < 2:
        distances = torch.ones_like(depths)
    else:
        steps = depths[:, 1:] - depths[:, :-1]
        distances = torch.cat((steps, steps[:, -1:]), 1)
    alpha = -torch.expm1(-density.clamp(min=0) * distances)
    return alpha * _passed(1 - alpha)


def composite_sdf(
    sdf: Float[Tensor, "n s"],
    rgb: Float[Tensor, "n s 3"],
    depths: Float[Tensor, "n s"],
    truncation_m: float,
    valid: Bool[Tensor, "n s"] | None = None,
) -> Composite:
    """Composite under `sdf_weights`."""
    return composite(sdf_weights(sdf, depths, truncation_m, valid), rgb, depths)


def composite_occupancy(
    logits: Float[Tensor, "n s"], rgb: Float[Tensor, "n s 3"], depths: Float[Tensor, "n s"], scale: float = 10.0
) -> Composite:
    """Composite under `occupancy_weights`."""
    return composite(occupancy_weights(logits, scale), rgb, depths)


def composite_density(
    density: Float[Tensor, "n s"], rgb: Float[Tensor, "n s 3"], depths: Float[Tensor, "n s"]
) -> Composite:
    """Composite under `density_weights`."""
    return composite(density_weights(density, depths), rgb, depths)


def _passed(through: Tensor) -> Tensor:
    """Return what reaches each sample: the product of `through` over the samples before it."""
    ones = torch.ones_like(through[:, :1])
    return torch.cat((ones, through[:, :-1]), 1).cumprod(1)


def _on_cpu(*tensors: Tensor) -> bool:
    return all(t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors)


def _arrays(*tensors: Tensor) -> list[Any]:
    return [t.detach().contiguous().numpy() for t in tensors]


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, weights: Tensor, rgb: Tensor, depths: Tensor) -> tuple[Tensor, ...]:  # noqa: ANN401
        from xrdslam.ops.threads import kernel_threads
        from xrdslam.ops.volume_rendering_kernels import sums

        count = len(weights)
        out = (torch.empty(count, 3), torch.empty(count), torch.empty(count), torch.empty(count))
        with kernel_threads():
            sums(*_arrays(weights, rgb, depths, *out))
        ctx.save_for_backward(weights, rgb, depths, out[1], out[3])
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *cotangents: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.ops.threads import kernel_threads
        from xrdslam.ops.volume_rendering_kernels import sums_backward

        weights, rgb, depths, depth, opacity = ctx.saved_tensors
        d_weights, d_rgb = torch.empty(weights.shape), torch.empty(rgb.shape)
        with kernel_threads():
            sums_backward(*_arrays(weights, rgb, depths, depth, opacity, *cotangents, d_weights, d_rgb))
        return d_weights, d_rgb, None


class _SdfWeights(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, sdf: Tensor, depths: Tensor, valid: Tensor, truncation_m: float) -> Tensor:  # noqa: ANN401
        from xrdslam.ops.threads import kernel_threads
        from xrdslam.ops.volume_rendering_kernels import bell_weights

        weights = torch.empty(sdf.shape)
        totals = torch.empty(len(sdf))
        with kernel_threads():
            bell_weights(*_arrays(sdf, depths, valid), truncation_m, *_arrays(weights, totals))
        ctx.save_for_backward(sdf, weights)
        ctx.truncation_m = truncation_m
        return weights

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.ops.threads import kernel_threads
        from xrdslam.ops.volume_rendering_kernels import bell_weights_backward

        sdf, weights = ctx.saved_tensors
        d_sdf = torch.empty(sdf.shape)
        with kernel_threads():
            bell_weights_backward(*_arrays(sdf, weights, cotangent), ctx.truncation_m, *_arrays(d_sdf))
        return d_sdf, None, None, None


class _OccupancyWeights(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, logits: Tensor, scale: float) -> Tensor:  # noqa: ANN401
        from xrdslam.ops.threads import kernel_threads
        from xrdslam.ops.volume_rendering_kernels import stop_weights

        weights = torch.empty(logits.shape)
        with kernel_threads():
            stop_weights(*_arrays(logits), scale, *_arrays(weights))
        ctx.save_for_backward(logits, weights)
        ctx.scale = scale
        return weights

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.ops.threads import kernel_threads
        from xrdslam.ops.volume_rendering_kernels import stop_weights_backward

        logits, weights = ctx.saved_tensors
        d_logits = torch.empty(logits.shape)
        with kernel_threads():
            stop_weights_backward(*_arrays(logits, weights, cotangent), ctx.scale, *_arrays(d_logits))
        return d_logits, None
