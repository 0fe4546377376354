"""What a field is held to along rays: colour, depth, signed distance near the surface, free space before it."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["RayLosses", "ray_losses"]


class RayLosses(NamedTuple):
    """Unweighted losses."""

    rgb: Float[Tensor, ""]
    depth: Float[Tensor, ""]
    sdf: Float[Tensor, ""]
    free_space: Float[Tensor, ""]


def ray_losses(
    sdf: Float[Tensor, "n s"],
    depths: Float[Tensor, "n s"],
    rendered_rgb: Float[Tensor, "n 3"],
    rendered_depth: Float[Tensor, " n"],
    rgb: Float[Tensor, "n 3"],
    depth: Float[Tensor, " n"],
    truncation_m: float,
    rgb_without_depth: bool,
) -> RayLosses:
    """Return the losses of paper equations 6-9; `sdf` is in truncations, `depth` 0 where nothing was measured.

    Within the truncation of the measured depth D the field is held to (D - z) / truncation, before it to 1; the two are
    weighed by the share of the other's samples, and their means are over all samples of the batch, as released. A
    batch without any depth has a colour loss only (the released code is NaN there).
    """
    has_depth = depth > 0
    ahead = depth[:, None] - depths
    near = (ahead.abs() <= truncation_m) & has_depth[:, None]
    free = ahead > truncation_m
    num_near, num_free = near.sum(), free.sum()
    both = (num_near + num_free).clamp(min=1)
    free_space = torch.where(free, sdf - 1, 0.0).square().mean() * (num_near / both)
    error_m = torch.where(near, truncation_m * sdf - ahead, 0.0)
    signed = error_m.square().mean() * (num_free / both)
    depth_error = torch.where(has_depth, rendered_depth - depth, 0.0)
    seen = 1.0 if rgb_without_depth else has_depth[:, None].to(rgb)
    return RayLosses(
        ((rendered_rgb - rgb) * seen).square().mean(),
        depth_error.square().sum() / has_depth.sum().clamp(min=1),
        signed,
        free_space,
    )
