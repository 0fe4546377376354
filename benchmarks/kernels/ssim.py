"""The photometric loss of a mapping iteration: L1 + D-SSIM with its gradient, 600x340."""

from typing import Literal

import torch

from benchmarks.interleaved import median_seconds
from benchmarks.metric import Metric
from xrdslam.ops.ssim import l1_dssim_loss

__all__ = ["ssim"]


def ssim() -> list[Metric]:
    """Measure forward and backward of the fused loss."""
    g = torch.Generator().manual_seed(0)
    x, y = torch.rand(340, 600, 3, generator=g).requires_grad_(), torch.rand(340, 600, 3, generator=g)

    def run(backend: Literal["numba", "torch"]) -> None:
        x.grad = None
        torch.autograd.backward(l1_dssim_loss(x, y, backend=backend))

    seconds = median_seconds({"twin": (lambda: run("torch"), 1), "kernel": (lambda: run("numba"), 10)})
    ratio = seconds["twin"] / seconds["kernel"]
    return [Metric("kernels/ssim/l1_dssim_600x340_speedup", ratio, "x twin", "higher", 0.4)]
