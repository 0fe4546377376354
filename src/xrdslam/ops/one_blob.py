"""One-blob encoding of coordinates (Mueller et al., Neural Importance Sampling, 2019)."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

__all__ = ["one_blob", "one_blob_torch"]


def one_blob(points_unit: Float[Tensor, "n 3"], bins: int = 16) -> Float[Tensor, "n features"]:
    """Spread each coordinate over `bins` bins by a quartic kernel a bin wide, periodic in the unit interval.

    e_k(u) = G((k + 1) / bins - u) - G(k / bins - u), G the kernel's distribution function and its neighbours' one
    period off: the bins of a coordinate in [0, 1] sum to 1 and at most three are not zero. Outside, all are zero from
    a period on. Differentiable in the points; the output has the x bins first.
    """
    if points_unit.device.type == "cpu" and points_unit.dtype == torch.float32:
        return _OneBlob.apply(points_unit, bins)  # type: ignore[no-any-return, no-untyped-call]  # torch
    return one_blob_torch(points_unit, bins)


def one_blob_torch(points_unit: Tensor, bins: int = 16) -> Float[Tensor, "n features"]:
    """Spread each coordinate: the twin of the kernel."""
    edges = torch.arange(bins + 1, dtype=points_unit.dtype, device=points_unit.device) / bins
    offset = edges - points_unit[..., None]
    cumulative = sum((_cumulative(bins * (offset + shift)) for shift in (0, -1, 1)), torch.zeros_like(offset))
    return (cumulative[..., 1:] - cumulative[..., :-1]).flatten(1)


def _cumulative(v: Tensor) -> Tensor:
    """Return the distribution function of 15/16 (1 - v^2)^2 on [-1, 1]."""
    v = v.clamp(-1, 1)
    return 15 / 16 * v * (1 - 2 / 3 * v**2 + v**4 / 5) + 0.5


class _OneBlob(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points_unit: Tensor, bins: int) -> Tensor:  # noqa: ANN401
        from xrdslam.ops.one_blob_kernels import spread
        from xrdslam.ops.threads import kernel_threads

        points = points_unit.detach().contiguous()
        out = torch.empty(len(points), 3 * bins)
        with kernel_threads():
            spread(points.numpy(), bins, out.numpy())
        ctx.save_for_backward(points)
        ctx.bins = bins
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.ops.one_blob_kernels import spread_gradient
        from xrdslam.ops.threads import kernel_threads

        (points,) = ctx.saved_tensors
        d_points = torch.zeros_like(points)
        with kernel_threads():
            spread_gradient(points.numpy(), ctx.bins, cotangent.contiguous().numpy(), d_points.numpy())
        return d_points, None
