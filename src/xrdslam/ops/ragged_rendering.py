"""Volume rendering of rays whose numbers of samples differ: all samples in one row, ray after ray."""

from typing import Any

import torch
from jaxtyping import Float, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from xrdslam.ops.volume_rendering import sdf_weights_torch

__all__ = ["ragged_sdf_weights", "ragged_sdf_weights_torch", "ragged_sums"]


def ragged_sdf_weights(
    sdf: Float[Tensor, " m"], depths: Float[Tensor, " m"], offsets: Int64[Tensor, " n1"], truncation_m: float
) -> Float[Tensor, " m"]:
    """Weigh samples as `volume_rendering.sdf_weights` does; ray r has the samples `offsets[r]` to `offsets[r + 1]`."""
    if all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (sdf, depths)):
        return _Weights.apply(sdf, depths, offsets, truncation_m)  # type: ignore[no-any-return, no-untyped-call]  # torch
    return ragged_sdf_weights_torch(sdf, depths, offsets, truncation_m)


def ragged_sdf_weights_torch(sdf: Tensor, depths: Tensor, offsets: Tensor, truncation_m: float) -> Tensor:
    """Weigh samples, padded to the longest ray: the twin of the kernel."""
    counts = offsets.diff()
    width = max(1, int(counts.max())) if len(counts) else 1
    column = torch.arange(width, device=sdf.device)
    valid = column < counts[:, None]
    padded = torch.zeros(valid.shape, dtype=sdf.dtype, device=sdf.device).masked_scatter(valid, sdf)
    places = torch.zeros_like(padded).masked_scatter(valid, depths)
    return sdf_weights_torch(padded, places, truncation_m, valid)[valid]


def ragged_sums(values: Float[Tensor, "m *c"], offsets: Int64[Tensor, " n1"]) -> Float[Tensor, "n *c"]:
    """Return the sum over each ray's samples, 0 for a ray without. Differentiable."""
    return torch.segment_reduce(values, "sum", offsets=offsets, initial=0)


class _Weights(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, sdf: Tensor, depths: Tensor, offsets: Tensor, truncation_m: float) -> Tensor:  # noqa: ANN401
        from xrdslam.ops.ragged_rendering_kernels import bell_weights
        from xrdslam.ops.threads import kernel_threads

        sdf, weights = sdf.detach().contiguous(), torch.empty(sdf.shape)
        with kernel_threads():
            bell_weights(
                sdf.numpy(), depths.contiguous().numpy(), offsets.contiguous().numpy(), truncation_m, weights.numpy()
            )
        ctx.save_for_backward(sdf, weights, offsets)
        ctx.truncation_m = truncation_m
        return weights

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.ops.ragged_rendering_kernels import bell_weights_backward
        from xrdslam.ops.threads import kernel_threads

        sdf, weights, offsets = ctx.saved_tensors
        d_sdf = torch.empty(sdf.shape)
        with kernel_threads():
            bell_weights_backward(
                *(t.contiguous().numpy() for t in (sdf, weights, cotangent, offsets)), ctx.truncation_m, d_sdf.numpy()
            )
        return d_sdf, None, None, None
