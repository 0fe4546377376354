"""What rays are held to: colour, depth, signed distance near the surface, free space before it."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

__all__ = ["RayLosses", "kept_rays", "ray_losses"]


class RayLosses(NamedTuple):
    """Unweighted losses."""

    rgb: Float[Tensor, ""]
    depth: Float[Tensor, ""]
    sdf: Float[Tensor, ""]
    free_space: Float[Tensor, ""]


def ray_losses(
    sdf: Float[Tensor, " m"],
    depths: Float[Tensor, " m"],
    rays: Int64[Tensor, " m"],
    rendered_rgb: Float[Tensor, "n 3"],
    rendered_depth: Float[Tensor, " n"],
    rgb: Float[Tensor, "n 3"],
    depth: Float[Tensor, " n"],
    counts: Bool[Tensor, " n"],
    truncation_m: float,
    samples_per_ray: float,
    free_for: Float[Tensor, " m"] | float = 1.0,
) -> RayLosses:
    """Return the losses of the rays that count (sampled, with measured depth D); `sdf` is in truncations.

    Colour and depth have L1 losses. Samples within the truncation of D are held to (D - z) / truncation, those before
    to 1, where one counts for `free_for`; the two are weighed by the share of the other's samples. Published, the
    squares' means are over samples padded to the longest ray of the batch; here each ray counts as `samples_per_ray`,
    whatever else is in the batch.
    Without any ray that counts all are 0.
    """
    num_rays = counts.sum().clamp(min=1)
    ahead = depth[rays] - depths
    sampled = counts[rays]
    near, free = (ahead.abs() <= truncation_m) & sampled, (ahead > truncation_m) & sampled
    num_near, num_free = near.sum(), (free_for * free).sum()
    both = (num_near + num_free).clamp(min=1)
    padded = num_rays * samples_per_ray
    free_space = (free_for * torch.where(free, sdf - 1, 0.0).square()).sum() / padded
    signed = torch.where(near, truncation_m * sdf - ahead, 0.0).square().sum() / padded
    color_error = torch.where(counts[:, None], (rendered_rgb - rgb).abs(), 0.0)
    depth_error = torch.where(counts, (rendered_depth - depth).abs(), 0.0)
    return RayLosses(
        color_error.sum() / (3 * num_rays),
        depth_error.sum() / num_rays,
        signed * (num_free / both),
        free_space * (num_near / both),
    )


def kept_rays(
    depth_error: Float[Tensor, " n"], variance: Float[Tensor, " n"], counts: Bool[Tensor, " n"], ratio: float
) -> Bool[Tensor, " n"]:
    """Return the rays that count and are no outliers: depth error over its deviation below `ratio` medians."""
    score = depth_error.abs() / (variance + 1e-10).sqrt()
    if not bool(counts.any()):
        return counts
    return counts & (score < ratio * score[counts].median())
