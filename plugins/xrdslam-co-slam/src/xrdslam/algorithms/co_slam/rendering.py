"""Rays through the field without measured depth: search for the first surface, then sample about it."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.algorithms.co_slam.config import CoSlamMapConfig
from xrdslam.algorithms.co_slam.field import JointField
from xrdslam.ops.volume_rendering import composite_sdf

__all__ = ["render_rays"]

_RAYS = 16384
_SEGMENT = 16
"""Steps of the search before rays that have found their surface leave it."""
_FINE = 16
"""Samples about a surface."""


def render_rays(
    field: JointField,
    to_unit: Callable[[Tensor], Tensor],
    bounds: Float[Tensor, "2 3"],
    origins_world: Float[Tensor, "n 3"],
    directions_world: Float[Tensor, "n 3"],
    config: CoSlamMapConfig,
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Return colour, depth [m] (0 where no surface is met) and opacity.

    The search steps by 0.8 truncations, so that no surface with a truncation of solid behind it is stepped over. About
    the crossing, one step and a truncation to either side are sampled evenly and composited as in training.
    """
    parts = [
        _chunk(field, to_unit, bounds, o, d, config)
        for o, d in zip(torch.split(origins_world, _RAYS), torch.split(directions_world, _RAYS), strict=True)
    ]
    rgb, depth, opacity = (torch.cat(column) for column in zip(*parts, strict=True))
    return rgb, depth, opacity


def _chunk(
    field: JointField,
    to_unit: Callable[[Tensor], Tensor],
    bounds: Tensor,
    origins: Tensor,
    directions: Tensor,
    config: CoSlamMapConfig,
) -> tuple[Tensor, Tensor, Tensor]:
    # What was seen may lie outside of the box, where the field goes on: the search goes as far as the box is long.
    far = (bounds[1] - bounds[0]).norm().expand(len(origins))
    step = 0.8 * config.truncation_m
    crossing = first_crossing(lambda p: field.distance(to_unit(p)), origins, directions, far, step)
    rgb = torch.zeros_like(origins)
    depth, opacity = torch.zeros_like(crossing), torch.zeros_like(crossing)
    hit = (crossing > 0).nonzero()[:, 0]
    if len(hit) == 0:
        return rgb, depth, opacity
    # Training's weights begin at the camera: only the part about the crossing carries any.
    middle = crossing[hit, None]
    offsets = torch.linspace(-config.truncation_m, config.truncation_m, _FINE, device=middle.device)
    depths = (middle + offsets).clamp(min=0)
    points = origins[hit, None] + depths[..., None] * directions[hit, None]
    distance, raw = field(to_unit(points.reshape(-1, 3)))
    colors = torch.sigmoid(raw).reshape(*depths.shape, 3)
    seen = composite_sdf(distance.reshape(depths.shape), colors, depths, config.truncation_m)
    rgb[hit], depth[hit], opacity[hit] = seen.rgb, seen.depth, seen.opacity
    return rgb, depth, opacity


def first_crossing(
    distance: Callable[[Tensor], Tensor],
    origins: Float[Tensor, "n 3"],
    directions: Float[Tensor, "n 3"],
    far: Float[Tensor, " n"],
    step_m: float,
) -> Float[Tensor, " n"]:
    """Return the depth at which rays first come from free space to the surface, linearly between steps; 0: never."""
    found = torch.zeros_like(far)
    active = (far > 0).nonzero()[:, 0]
    before = torch.full_like(far, -1.0)
    start = 0
    while len(active):
        steps = torch.arange(start, start + _SEGMENT, device=far.device, dtype=far.dtype) * step_m
        points = origins[active, None] + steps[:, None] * directions[active, None]
        values = distance(points.reshape(-1, 3)).reshape(len(active), _SEGMENT)
        chain = torch.cat((before[active, None], values), 1)
        crosses = (chain[:, :-1] > 0) & (chain[:, 1:] <= 0)
        has = crosses.any(1)
        at = crosses.int().argmax(1)[has]
        a, b = chain[has].gather(1, at[:, None])[:, 0], chain[has].gather(1, at[:, None] + 1)[:, 0]
        found[active[has]] = (start + at - 1 + a / (a - b)) * step_m
        before[active] = values[:, -1]
        start += _SEGMENT
        active = active[~has & (far[active] > start * step_m)]
    return torch.where(found <= far, found, 0.0)
