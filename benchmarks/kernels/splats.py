"""The splat renderer in a mapping iteration and in a tracking iteration, on a map seeded as SplaTAM seeds one."""

from typing import Literal

import torch
from torch import Tensor

from benchmarks.interleaved import median_seconds
from benchmarks.metric import Metric
from xrdslam.ops.splats import Pinhole, TileLists, render

__all__ = ["seeded_map", "splats"]

Backend = Literal["numba", "torch"]


def splats() -> list[Metric]:
    """Measure forward and backward, wall time."""
    large, half = _Workload(300_000, 640, 480), _Workload(250_000, 600, 340)
    seconds = median_seconds(
        {
            "twin": (lambda: large.mapping("torch"), 1),
            "mapping": (lambda: large.mapping("numba"), 8),
            "half_mapping": (lambda: half.mapping("numba"), 8),
            "half_tracking": (half.tracking, 8),
        }
    )
    speedup = seconds["twin"] / seconds["mapping"]
    tracking = seconds["half_tracking"] / seconds["half_mapping"]
    return [
        Metric("kernels/splats/mapping_300k_640x480_speedup", speedup, "x twin", "higher", 0.4),
        Metric("kernels/splats/tracking_over_mapping_250k_600x340", tracking, "ratio", "lower", 0.3),
    ]


class _Workload:
    """A seeded map, its camera, cotangents, and the two kinds of iteration on them."""

    def __init__(self, n: int, width: int, height: int) -> None:
        self.camera = Pinhole(width / 2, width / 2, width / 2 - 0.5, height / 2 - 0.5, width, height)
        self.map = seeded_map(n, self.camera)
        g = torch.Generator().manual_seed(1)
        shapes = ((height, width, 3), (height, width), (height, width))
        self.cotangents = [torch.randn(shape, generator=g) for shape in shapes]
        self.lists, self.step = TileLists(), 0

    def mapping(self, backend: Backend) -> None:
        """Render and differentiate by everything but the pose."""
        means, log_scales, logits, colors = (t.detach().requires_grad_() for t in self.map)
        rendered = render(means, log_scales, logits, colors, torch.eye(4), self.camera, backend=backend)
        torch.autograd.backward(list(rendered), self.cotangents)

    def tracking(self) -> None:
        """Render from a pose within millimetres of the last and differentiate by the pose."""
        self.step += 1
        pose = torch.eye(4)
        pose[0, 3] = 0.001 * (self.step % 5)
        rendered = render(*self.map, pose.requires_grad_(), self.camera, lists=self.lists)
        torch.autograd.backward(list(rendered), self.cotangents)


def seeded_map(n: int, camera: Pinhole) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return (means, log_scales, opacity_logits, colors) of a wavy surface seeded once a pixel in raster order.

    Beyond one a pixel, a random subset of pixels has a second one, as after densification.
    """
    g = torch.Generator().manual_seed(0)
    pixels = camera.width * camera.height
    whole = torch.arange(pixels).repeat(n // pixels)
    index = torch.cat((whole, torch.randperm(pixels, generator=g)[: n % pixels])).sort().values
    u = index % camera.width + torch.rand(n, generator=g) - 0.5
    v = index // camera.width + torch.rand(n, generator=g) - 0.5
    z = 2 + 0.8 * torch.sin(5 * u / camera.width) + 0.6 * torch.cos(7 * v / camera.height)
    z += 0.02 * torch.randn(n, generator=g)
    means = torch.stack(((u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z), 1)
    log_scales = (z / camera.fx).log()[:, None] + 0.2 * torch.randn(n, 1, generator=g)
    return means, log_scales, torch.randn(n, 1, generator=g) + 0.5, torch.rand(n, 3, generator=g)
