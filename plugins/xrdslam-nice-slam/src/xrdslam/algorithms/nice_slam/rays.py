"""Rays in the box: where they leave it, where they are sampled, what they see."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from xrdslam.algorithms.nice_slam.config import NiceSlamMapConfig
from xrdslam.algorithms.nice_slam.field import Level, NiceField
from xrdslam.ops.sampling import jittered, linear_depths, merged
from xrdslam.ops.volume_rendering import Composite, composite, occupancy_weights

__all__ = ["exit_depths", "sample_depths", "see"]

SOLID = 100.0
"""The logit beyond the box."""
_NEGLIGIBLE_GRADIENT = 1e-4
"""Below this a sample's pull on the losses (metres and intensities, summed over rays) is taken as none: its weight is
below 1e-5, and going back through it costs as much as through any other."""
_NEGLIGIBLE_WEIGHT = 1e-4
"""Samples below this weight are not asked for their colour."""


def exit_depths(
    origins_world: Float[Tensor, "n 3"], directions_world: Float[Tensor, "n 3"], bounds: Float[Tensor, "2 3"]
) -> Float[Tensor, " n"]:
    """Return the depth at which each ray leaves the box for good, negative where that is behind the camera."""
    safe = torch.where(directions_world.abs() < 1e-9, torch.full_like(directions_world, 1e-9), directions_world)
    ends = (bounds[:, None] - origins_world) / safe
    return torch.maximum(ends[0], ends[1]).amin(1)


@torch.no_grad()
def sample_depths(
    depth: Float[Tensor, " n"],
    exit_depth: Float[Tensor, " n"],
    config: NiceSlamMapConfig,
    generator: torch.Generator,
) -> Float[Tensor, "n s"]:
    """Return depths in order: from the camera to a little behind the surface, and about the surface.

    Without measured depth they go on to where the ray leaves the box. The first kind is jittered: at fixed shares of
    the depth, things could grow between them that no loss sees, and that stand in the way where no depth is given.
    """
    has_depth = depth > 0
    end = exit_depth + 0.01
    near = torch.where(has_depth, 0.01 * depth, 0.01)
    far = torch.where(has_depth, torch.minimum(config.far_share * depth, end), end)
    even = jittered(linear_depths(near, far, config.num_uniform), generator)
    low = torch.where(has_depth, (1 - config.surface_share) * depth, 0.01)
    high = torch.where(has_depth, torch.minimum((1 + config.surface_share) * depth, end), end)
    return merged(even, linear_depths(low, high, config.num_near_surface))


def see(
    field: NiceField,
    origins_world: Float[Tensor, "n 3"],
    directions_world: Float[Tensor, "n 3"],
    depths: Float[Tensor, "n s"],
    exit_depth: Float[Tensor, " n"],
    level: Level,
) -> Composite:
    """Composite samples by occupancy (paper, equations 5 to 8); colour is black below the level of colour."""
    points = (origins_world[:, None] + depths[..., None] * directions_world[:, None]).reshape(-1, 3)
    logits = field.logits(points, "middle" if level == "middle" else "fine").reshape(depths.shape)
    inside = depths <= exit_depth.detach()[:, None]
    logits = _Quiet.apply(torch.where(inside, logits, SOLID))  # type: ignore[no-untyped-call]  # torch
    weights = occupancy_weights(logits)
    rgb = torch.zeros(*depths.shape, 3, dtype=depths.dtype, device=depths.device)
    if level == "color":
        shown = (weights.detach().reshape(-1) > _NEGLIGIBLE_WEIGHT).nonzero()[:, 0]
        rgb = rgb.reshape(-1, 3).index_copy(0, shown, field.rgb(points[shown])).reshape(rgb.shape)
    return composite(weights, rgb, depths)


class _Quiet(torch.autograd.Function):
    """The identity, whose gradient is zero where it is negligible."""

    @staticmethod
    def forward(ctx: Any, logits: Tensor) -> Tensor:  # noqa: ANN401
        return logits.view_as(logits)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, cotangent: Tensor) -> Tensor:  # noqa: ANN401
        return torch.nn.functional.hardshrink(cotangent, _NEGLIGIBLE_GRADIENT)
