"""Structural similarity of images, and the photometric loss made of it: torch twins and CPU kernels with a gradient."""

from typing import Any, Literal

import numpy as np
import torch
import torch.nn.functional as nnf
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from xrdslam.core.errors import ConfigError

__all__ = ["l1_dssim_loss", "ssim_map"]

_K1, _K2 = 0.01, 0.03  # Wang et al. 2004
Backend = Literal["auto", "numba", "torch"]


def ssim_map(
    x: Float[Tensor, "h w c"],
    y: Float[Tensor, "h w c"],
    *,
    window: int = 11,
    sigma: float = 1.5,
    padding: Literal["zero", "valid"] = "zero",
    data_range: float = 1.0,
    backend: Backend = "auto",
) -> Float[Tensor, "h2 w2 c"]:
    """Return the structural similarity at every pixel and channel, differentiable in x.

    SSIM = (2 mx my + c1)(2 sxy + c2) / ((mx^2 + my^2 + c1)(sx^2 + sy^2 + c2)), moments under a Gaussian window of
    `window` x `window` px, c1 = (0.01 range)^2, c2 = (0.03 range)^2 (Wang et al. 2004).
    padding: "zero" takes pixels outside as 0 and keeps the size, as splatting's losses do; "valid" keeps only whole
    windows, as evaluations do. The kernel ("numba": CPU, float32) gives no gradient to y: swap the arguments for that.
    """
    weights = _weights(window, sigma)
    constants = ((_K1 * data_range) ** 2, (_K2 * data_range) ** 2)
    if _picks_kernel(x, y, backend):
        full: Tensor = _SsimMap.apply(x, y, weights, constants)  # type: ignore[no-untyped-call]  # torch
    else:
        full = _ssim_torch(x, y, weights, constants)
    if padding == "zero":
        return full
    if min(x.shape[:2]) < window:
        raise ConfigError(
            f"padding='valid' of a {x.shape[1]}x{x.shape[0]} px image: smaller than the {window} px window"
        )
    cut = window // 2
    return full[cut : x.shape[0] - cut, cut : x.shape[1] - cut]


def l1_dssim_loss(
    x: Float[Tensor, "h w c"], y: Float[Tensor, "h w c"], weight_ssim: float = 0.2, *, backend: Backend = "auto"
) -> Float[Tensor, ""]:
    """Return (1 - w) mean|x - y| + w (1 - mean SSIM), zero padding: the photometric loss of 3-D Gaussian splatting.

    One fused forward and backward on the CPU; differentiable in x.
    """
    weights, constants = _weights(11, 1.5), (_K1**2, _K2**2)
    if _picks_kernel(x, y, backend):
        loss: Tensor = _L1Dssim.apply(x, y, weights, constants, weight_ssim)  # type: ignore[no-untyped-call]  # torch
        return loss
    dissimilarity = 1 - _ssim_torch(x, y, weights, constants).mean()
    loss = (1 - weight_ssim) * (x - y).abs().mean() + weight_ssim * dissimilarity
    return loss


def _weights(window: int, sigma: float) -> np.ndarray:
    """Return the taps of a normalised one-dimensional Gaussian window."""
    if window < 1 or window % 2 == 0 or not sigma > 0:
        raise ConfigError(f"SSIM window={window}, sigma={sigma}: the window must be odd, sigma positive")
    taps = np.exp(-((np.arange(window) - window // 2) ** 2) / (2 * sigma**2))
    normalised: np.ndarray = taps / taps.sum()
    return normalised


def _picks_kernel(x: Tensor, y: Tensor, backend: Backend) -> bool:
    """Say whether the CPU kernel is to be used; it needs rows of at least one vector of 16 floats."""
    if x.shape != y.shape:
        raise ConfigError(f"SSIM of images of shapes {tuple(x.shape)} and {tuple(y.shape)}: they must be equal")
    fits = all(t.device.type == "cpu" and t.dtype == torch.float32 for t in (x, y))
    fits &= x.shape[1] * x.shape[2] >= 16 and not y.requires_grad
    if backend == "numba" and not fits:
        raise ConfigError(
            f"backend='numba' takes float32 CPU images with rows of 16 values or more and no gradient for y, got "
            f"{x.dtype} on {x.device} of shape {tuple(x.shape)}; use backend='torch'"
        )
    return fits and backend != "torch"


def _ssim_torch(
    x: Float[Tensor, "h w c"], y: Float[Tensor, "h w c"], weights: np.ndarray, constants: tuple[float, float]
) -> Float[Tensor, "h w c"]:
    """Compute the map with convolutions: the twin of the kernel."""
    taps = torch.as_tensor(weights, dtype=x.dtype, device=x.device)
    channels, radius = x.shape[2], len(weights) // 2
    images = torch.cat((x, y, x * x, y * y, x * y), 2).permute(2, 0, 1)[:, None]
    rows = nnf.conv2d(images, taps.view(1, 1, -1, 1), padding=(radius, 0))
    moments = nnf.conv2d(rows, taps.view(1, 1, 1, -1), padding=(0, radius))[:, 0].permute(1, 2, 0)
    mx, my, xx, yy, xy = torch.split(moments, channels, 2)
    c1, c2 = constants
    numerator = (2 * mx * my + c1) * (2 * (xy - mx * my) + c2)
    result: Tensor = numerator / ((mx * mx + my * my + c1) * (xx - mx * mx + yy - my * my + c2))
    return result


def _run(
    x: Tensor, y: Tensor, weights: np.ndarray, constants: tuple[float, float], with_gradient: bool
) -> tuple[Tensor, Tensor, np.ndarray]:
    """Return the map, its derivatives by the three moments that hold x, and per-row sums of (SSIM, |x - y|)."""
    from xrdslam.ops.ssim_kernels import similarity  # here, so that the torch twin needs no numba
    from xrdslam.ops.threads import kernel_threads

    image = torch.empty(x.shape)
    partials = torch.empty(3, *(x.shape if with_gradient else (0, 0, 0)))
    sums = np.empty((x.shape[0], 2), np.float64)
    arrays = (t.detach().contiguous().numpy() for t in (x, y))
    flat = (weights.astype(np.float32), *(np.float32(c) for c in constants), x.shape[2])
    with kernel_threads():
        similarity(*arrays, *flat, image.numpy(), partials.numpy(), sums)
    return image, partials, sums


def _pull_back(
    x: Tensor, y: Tensor, partials: Tensor, weights: np.ndarray, cotangent: Tensor, scales: tuple[float, float]
) -> Tensor:
    """Return dL/dx: scale_ssim * cotangent on the map (empty: ones) and scale_l1 * sign(x - y)."""
    from xrdslam.ops.ssim_kernels import gradient
    from xrdslam.ops.threads import kernel_threads

    d_x = torch.empty(x.shape)
    arrays = [t.detach().contiguous().numpy() for t in (x, y, partials, cotangent)]
    with kernel_threads():
        gradient(*arrays, weights.astype(np.float32), *(np.float32(s) for s in scales), x.shape[2], d_x.numpy())
    return d_x


class _SsimMap(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, y: Tensor, weights: np.ndarray, constants: tuple[float, float]) -> Tensor:  # noqa: ANN401
        image, partials, _ = _run(x, y, weights, constants, ctx.needs_input_grad[0])
        ctx.save_for_backward(x, y)
        ctx.partials, ctx.weights = partials, weights
        return image

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        x, y = ctx.saved_tensors
        return _pull_back(x, y, ctx.partials, ctx.weights, cotangent, (1.0, 0.0)), None, None, None


class _L1Dssim(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> Tensor:  # noqa: ANN401
        x, y, weights, constants, w = arguments
        _, partials, sums = _run(x, y, weights, constants, ctx.needs_input_grad[0])
        ctx.save_for_backward(x, y)
        ctx.partials, ctx.weights, ctx.weight_ssim = partials, weights, w
        similarity, difference = sums.sum(0) / x.numel()
        loss: Tensor = x.new_tensor((1 - w) * difference + w * (1 - similarity))
        return loss

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        x, y = ctx.saved_tensors
        unit = float(cotangent) / x.numel()
        scales = (-ctx.weight_ssim * unit, (1 - ctx.weight_ssim) * unit)
        return _pull_back(x, y, ctx.partials, ctx.weights, x.new_empty(0, 0, 0), scales), None, None, None, None
