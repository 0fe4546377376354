"""What rays are held to: measured depth and colour; in tracking by their deviation and without outliers."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.ops.volume_rendering import Composite

__all__ = ["RayLosses", "mapping_losses", "tracking_losses"]


class RayLosses(NamedTuple):
    """Unweighted sums over rays."""

    depth: Float[Tensor, ""]
    rgb: Float[Tensor, ""]


def mapping_losses(seen: Composite, rgb: Float[Tensor, "n 3"], depth: Float[Tensor, " n"]) -> RayLosses:
    """Return sum |D - D^| where depth was measured, and sum |C - C^| of all rays (paper, equations 9 and 10)."""
    error = torch.where(depth > 0, seen.depth - depth, 0.0)
    return RayLosses(error.abs().sum(), (seen.rgb - rgb).abs().sum())


def tracking_losses(
    seen: Composite, rgb: Float[Tensor, "n 3"], depth: Float[Tensor, " n"], outlier_factor: float
) -> RayLosses:
    """Return both over the rays M with measured depth and r < outlier_factor * median(r) (paper, equation 12).

    r = |D - D^| / sqrt(V^ + 1e-10), V^ without a gradient; the median is of the rays that have depth.
    """
    has_depth = depth > 0
    if not bool(has_depth.any()):
        return RayLosses(0.0 * seen.depth.sum(), 0.0 * seen.rgb.sum())
    residual = (seen.depth - depth).abs() / (seen.variance.detach() + 1e-10).sqrt()
    counts = has_depth & (residual.detach() < outlier_factor * residual.detach()[has_depth].median())
    error = (seen.rgb - rgb).abs().sum(1)
    return RayLosses(torch.where(counts, residual, 0.0).sum(), torch.where(counts, error, 0.0).sum())
