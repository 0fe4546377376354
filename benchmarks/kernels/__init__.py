"""Kernels against their torch twins; the figure is twin time over kernel time."""

from benchmarks.kernels.dense_grid import dense_grids
from benchmarks.kernels.hash_grid import hash_grids
from benchmarks.kernels.splats import splats
from benchmarks.kernels.ssim import ssim
from benchmarks.kernels.voxels import voxels
from benchmarks.metric import Metric

__all__ = ["kernels"]


def kernels() -> list[Metric]:
    """Measure every kernel."""
    return [*splats(), *ssim(), *hash_grids(), *dense_grids(), *voxels()]
