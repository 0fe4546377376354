"""Rays through the field without measured depth: search for the first surface, then sample about it."""

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.algorithms.nice_slam.field import NiceField
from xrdslam.algorithms.nice_slam.rays import exit_depths
from xrdslam.ops.volume_rendering import composite, occupancy_weights

__all__ = ["first_surface", "render_rays"]

_RAYS = 8192
_SEGMENT = 16
"""Steps of the search before rays that have found their surface leave it."""
_FINE = 16
"""Samples about a surface."""


def render_rays(
    field: NiceField,
    bounds: Float[Tensor, "2 3"],
    origins_world: Float[Tensor, "n 3"],
    directions_world: Float[Tensor, "n 3"],
    step_m: float,
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Return colour, depth [m] (0 where no surface is met) and opacity.

    The search goes in steps of `step_m` along the ray to where it leaves the box, beyond which everything is solid.
    From one step before the surface that it finds to two behind, samples are composited as in training.
    """
    parts = [
        _chunk(field, bounds, o, d, step_m)
        for o, d in zip(torch.split(origins_world, _RAYS), torch.split(directions_world, _RAYS), strict=True)
    ]
    rgb, depth, opacity = (torch.cat(column) for column in zip(*parts, strict=True))
    return rgb, depth, opacity


def _chunk(
    field: NiceField, bounds: Tensor, origins: Tensor, directions: Tensor, step_m: float
) -> tuple[Tensor, Tensor, Tensor]:
    far = exit_depths(origins, directions, bounds)
    surface = first_surface(field, origins, directions, far, step_m)
    rgb = torch.zeros_like(origins)
    depth, opacity = torch.zeros_like(surface), torch.zeros_like(surface)
    hit = (surface > 0).nonzero()[:, 0]
    if len(hit) == 0:
        return rgb, depth, opacity
    offsets = torch.linspace(-step_m, 2 * step_m, _FINE, device=far.device)
    depths = (surface[hit, None] + offsets).clamp(min=0)
    points = (origins[hit, None] + depths[..., None] * directions[hit, None]).reshape(-1, 3)
    weights = occupancy_weights(field.logits(points).reshape(depths.shape))
    # What passes through thin things ends at the last sample: nothing behind is known to be nearer.
    weights[:, -1] += (1 - weights.sum(1)).clamp(min=0)
    shown = (weights.reshape(-1) > 1e-3).nonzero()[:, 0]
    colors = torch.zeros_like(points)
    colors[shown] = field.rgb(points[shown])
    seen = composite(weights, colors.reshape(*depths.shape, 3), depths)
    rgb[hit], depth[hit], opacity[hit] = seen.rgb, seen.depth, seen.opacity
    return rgb, depth, opacity


def first_surface(
    field: NiceField,
    origins: Float[Tensor, "n 3"],
    directions: Float[Tensor, "n 3"],
    far: Float[Tensor, " n"],
    step_m: float,
) -> Float[Tensor, " n"]:
    """Return the depth at which rays first come to occupancy 1/2, linearly between steps; `far` where they do not.

    0 where the ray does not enter the box, or begins in something solid.
    """
    found = torch.where(far > 0, far, 0.0)
    active = (far > 0).nonzero()[:, 0]
    lengths = directions.norm(dim=1)
    before = torch.full_like(far, torch.nan)
    start = 0
    while len(active):
        step = step_m / lengths[active, None]
        depths = torch.arange(start, start + _SEGMENT, device=far.device, dtype=far.dtype) * step
        points = (origins[active, None] + depths[..., None] * directions[active, None]).reshape(-1, 3)
        values = field.logits(points).reshape(depths.shape)
        chain = torch.cat((before[active, None], values), 1)
        crosses = (chain[:, :-1] < 0) & (chain[:, 1:] >= 0)
        has = crosses.any(1)
        at = crosses.int().argmax(1)[has]
        a, b = chain[has].gather(1, at[:, None])[:, 0], chain[has].gather(1, at[:, None] + 1)[:, 0]
        crossing = (start + at - 1 + a / (a - b)) * step[has, 0]
        found[active[has]] = torch.minimum(crossing, far[active[has]])
        before[active] = values[:, -1]
        start += _SEGMENT
        active = active[~has & (far[active] > depths[:, -1])]
    return found
