"""Rays through the voxels without measured depth: search for the first surface, then sample about it."""

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.algorithms.vox_fusion.config import VoxFusionMapConfig
from xrdslam.algorithms.vox_fusion.field import VoxelField
from xrdslam.ops.volume_rendering import composite_sdf
from xrdslam.ops.voxel_hash import traverse
from xrdslam.ops.voxel_rays import RaySamples, sample_hits

__all__ = ["first_crossing", "render_rays"]

_RAYS = 16384
_SEGMENT = 12
"""Steps of the search before rays that have found their surface leave it."""
_FINE = 24
"""Samples about a surface."""


def render_rays(
    field: VoxelField,
    origins_world: Float[Tensor, "n 3"],
    directions_world: Float[Tensor, "n 3"],
    config: VoxFusionMapConfig,
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"], Float[Tensor, " n"]]:
    """Return colour, depth [m] (0 where no surface is met) and opacity.

    The search steps by half a truncation within voxels; about the crossing, a truncation to either side is sampled
    evenly, where there are voxels, and composited as in training.
    """
    pairs = zip(torch.split(origins_world, _RAYS), torch.split(directions_world, _RAYS), strict=True)
    parts = [_chunk(field, origins, directions, config) for origins, directions in pairs]
    rgb, depth, opacity = (torch.cat(column) for column in zip(*parts, strict=True))
    return rgb, depth, opacity


def _chunk(
    field: VoxelField, origins: Tensor, directions: Tensor, config: VoxFusionMapConfig
) -> tuple[Tensor, Tensor, Tensor]:
    far = torch.full_like(origins[:, 0], config.max_depth_m)
    samples = sample_hits(traverse(field.grid, origins, directions, far), 0.5 * config.truncation_m)
    crossing = first_crossing(field, origins, directions, samples)
    rgb, depth, opacity = torch.zeros_like(origins), torch.zeros_like(crossing), torch.zeros_like(crossing)
    hit = (crossing > 0).nonzero()[:, 0]
    offsets = torch.linspace(-config.truncation_m, config.truncation_m, _FINE, device=origins.device)
    depths = (crossing[hit, None] + offsets).clamp(min=0)
    points = (origins[hit, None] + depths[..., None] * directions[hit, None]).reshape(-1, 3)
    voxels = field.grid.locate(points)
    inside = voxels >= 0
    found = field.at(points[inside], voxels[inside], torch.ones_like)
    valid = inside.reshape(depths.shape)
    sdf = torch.ones_like(depths).masked_scatter(valid, found.sdf)
    colors = torch.zeros(len(points), 3, device=points.device)
    colors[inside] = found.rgb
    seen = composite_sdf(sdf, colors.reshape(*depths.shape, 3), depths, config.truncation_m, valid)
    rgb[hit], depth[hit], opacity[hit] = seen.rgb, seen.depth, seen.opacity
    return rgb, depth, opacity


def first_crossing(
    field: VoxelField, origins: Float[Tensor, "n 3"], directions: Float[Tensor, "n 3"], samples: RaySamples
) -> Float[Tensor, " n"]:
    """Return the depth at which rays first come to the surface, linearly between samples; 0: never.

    Between voxels there is free space: a ray that enters one behind its surface meets it where it enters.
    """
    count = len(origins)
    found, before = torch.zeros(count, device=origins.device), torch.ones(count, device=origins.device)
    end_before = torch.full((count,), -1.0, device=origins.device)
    place_before = torch.zeros(count, device=origins.device)
    active, start = (samples.counts > 0).nonzero()[:, 0], 0
    while len(active):
        column = samples.offsets[active, None] + start + torch.arange(_SEGMENT, device=origins.device)
        valid = column < samples.offsets[active + 1, None]
        index = column[valid]
        rays = active[:, None].expand_as(column)[valid]
        points = origins[rays] + samples.depths[index, None] * directions[rays]
        values = torch.ones(column.shape, device=origins.device)
        values[valid] = field.distance(points, samples.voxels[index])
        index = column.clamp(max=len(samples.depths) - 1)
        middle, half = samples.depths[index], samples.lengths[index] / 2
        # What lies before each sample: the sample before, where the two touch, else free space at its entry.
        previous = torch.cat((before[active, None], values[:, :-1]), 1)
        place = torch.cat((place_before[active, None], middle[:, :-1]), 1)
        end = torch.cat((end_before[active, None], (middle + half)[:, :-1]), 1)
        touches = (middle - half - end).abs() < 1e-4
        crosses = (values <= 0) & (~touches | (previous > 0)) & valid
        share = previous / (previous - values).clamp(min=1e-12)
        depth = torch.where(touches, place + share * (middle - place), middle - half)
        has = crosses.any(1)
        first = crosses.int().argmax(1, keepdim=True)
        found[active[has]] = depth.gather(1, first)[has, 0].clamp(min=1e-6)
        before[active], place_before[active] = values[:, -1], middle[:, -1]
        end_before[active] = (middle + half)[:, -1]
        start += _SEGMENT
        active = active[~has & (samples.counts[active] > start)]
    return found
