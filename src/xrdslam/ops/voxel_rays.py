"""Samples of rays within sparse voxels, ray after ray without gaps."""

from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor
from torch.autograd.function import once_differentiable

from xrdslam.ops.voxel_hash import RayHits

__all__ = ["RaySamples", "cut_torch", "points_along", "points_along_torch", "sample_hits"]

_SHORTEST = 1e-6  # as the kernel's


class RaySamples(NamedTuple):
    """Samples in order along each ray: ray r has `offsets[r]` to `offsets[r + 1]`."""

    offsets: Int64[Tensor, " n1"]
    depths: Float[Tensor, " m"]
    """Ray parameter."""
    lengths: Float[Tensor, " m"]
    """Of the piece that a sample stands for [of the ray parameter]."""
    voxels: Int64[Tensor, " m"]

    @property
    def counts(self) -> Int64[Tensor, " n"]:
        """How many samples each ray has."""
        return self.offsets.diff()

    @property
    def rays(self) -> Int64[Tensor, " m"]:
        """The ray of each sample."""
        return torch.repeat_interleave(self.counts, output_size=len(self.depths))

    def where(self, kept: Bool[Tensor, " m"]) -> "RaySamples":
        """Return those samples alone, in their order; their lengths stay as they are."""
        before = torch.cat((self.offsets.new_zeros(1), kept.cumsum(0)))
        return RaySamples(before[self.offsets], self.depths[kept], self.lengths[kept], self.voxels[kept])


def sample_hits(
    hits: RayHits, step: float, generator: torch.Generator | None = None, max_samples: int = 1 << 30
) -> RaySamples:
    """Cut the part of each ray that lies within voxels, and take the middle of each piece (Vox-Fusion).

    Laid end to end, a ray's hits are cut at (k + xi_k) step, k = 0, 1, ... with xi uniform in (0.001, 0.999), or 1/2
    without a generator; voxels' exits cut as well. A ray has at most `max_samples`: the nearest.
    """
    if not step > 0 or max_samples < 1:
        raise ValueError(f"step={step}, max_samples={max_samples}: must both be positive")
    num_cuts = _num_cuts(hits, step, max_samples)
    cut_offsets = torch.cat((num_cuts.new_zeros(1), num_cuts.cumsum(0)))
    total = int(cut_offsets[-1])
    noise = torch.full((total,), 0.5) if generator is None else torch.rand(total, generator=generator) * 0.998 + 0.001
    noise = noise.to(hits.entries)
    if not _on_cpu(hits.entries, hits.exits):
        return cut_torch(hits, step, cut_offsets, noise, max_samples)
    from xrdslam.ops.threads import kernel_threads
    from xrdslam.ops.voxel_rays_kernels import count_samples, fill_samples

    given = (*_arrays(*hits), step, max_samples, *_arrays(cut_offsets, noise))
    counts = torch.empty(len(num_cuts), dtype=torch.int64)
    with kernel_threads():
        count_samples(*given, counts.numpy())
        offsets = torch.cat((counts.new_zeros(1), counts.cumsum(0)))
        total = int(offsets[-1])
        samples = RaySamples(offsets, torch.empty(total), torch.empty(total), torch.empty(total, dtype=torch.int64))
        fill_samples(*given, *(t.numpy() for t in samples))
    return samples


def cut_torch(hits: RayHits, step: float, cut_offsets: Tensor, noise: Tensor, max_samples: int) -> RaySamples:
    """Cut ray by ray: the twin of the kernel."""
    parts, counts = [], []
    for ray in range(len(hits.offsets) - 1):
        mine = slice(int(hits.offsets[ray]), int(hits.offsets[ray + 1]))
        entries, exits = hits.entries[mine].double(), hits.exits[mine].double()
        ends = (exits - entries).cumsum(0)
        xi = noise[int(cut_offsets[ray]) : int(cut_offsets[ray + 1])].double()
        cuts = (torch.arange(len(xi), device=xi.device) + xi) * step
        cuts = cuts[cuts < (ends[-1] if len(ends) else 0.0)]
        bounds = torch.cat((ends.new_zeros(1), cuts, ends)).sort().values
        low, high = bounds[:-1], bounds[1:]
        kept = high - low > _SHORTEST
        low, high = low[kept][:max_samples], high[kept][:max_samples]
        hit = torch.searchsorted(ends, (low + high) / 2)
        shift = (entries - (ends - (exits - entries)))[hit]
        parts.append(((low + high) / 2 + shift, high - low, hits.voxels[mine][hit]))
        counts.append(len(low))
    number = torch.tensor(counts, dtype=torch.int64, device=noise.device)
    offsets = torch.cat((number.new_zeros(1), number.cumsum(0)))
    if not parts:
        return RaySamples(offsets, noise[:0], noise[:0], hits.voxels[:0])
    depths, lengths, voxels = (torch.cat(column) for column in zip(*parts, strict=True))
    return RaySamples(offsets, depths.to(noise.dtype), lengths.to(noise.dtype), voxels)


def points_along(
    origins_world: Float[Tensor, "n 3"], directions_world: Float[Tensor, "n 3"], samples: RaySamples
) -> Float[Tensor, "m 3"]:
    """Return the samples' points; differentiable in the rays, not in the depths."""
    if _on_cpu(origins_world, directions_world, samples.depths):
        return _PointsAlong.apply(  # type: ignore[no-any-return, no-untyped-call]  # torch leaves it untyped
            origins_world, directions_world, samples
        )
    return points_along_torch(origins_world, directions_world, samples)


def points_along_torch(origins_world: Tensor, directions_world: Tensor, samples: RaySamples) -> Tensor:
    """Return the samples' points: the twin of the kernel."""
    rays = samples.rays
    return origins_world[rays] + samples.depths[:, None] * directions_world[rays]


class _PointsAlong(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, origins: Tensor, directions: Tensor, samples: RaySamples) -> Tensor:  # noqa: ANN401
        from xrdslam.ops.threads import kernel_threads
        from xrdslam.ops.voxel_rays_kernels import place

        points = torch.empty(len(samples.depths), 3)
        with kernel_threads():
            place(*_arrays(origins, directions, samples.offsets, samples.depths, points))
        ctx.save_for_backward(samples.offsets, samples.depths)
        return points

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_points: Tensor) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        from xrdslam.ops.threads import kernel_threads
        from xrdslam.ops.voxel_rays_kernels import place_backward

        offsets, depths = ctx.saved_tensors
        d_origins, d_directions = torch.empty(len(offsets) - 1, 3), torch.empty(len(offsets) - 1, 3)
        with kernel_threads():
            place_backward(*_arrays(offsets, depths, d_points, d_origins, d_directions))
        return d_origins, d_directions, None


def _num_cuts(hits: RayHits, step: float, most: int) -> Int64[Tensor, " n"]:
    if _on_cpu(hits.entries, hits.exits):
        from xrdslam.ops.threads import kernel_threads
        from xrdslam.ops.voxel_rays_kernels import count_cuts

        counts = torch.empty(len(hits.offsets) - 1, dtype=torch.int64)
        with kernel_threads():
            count_cuts(*_arrays(hits.offsets, hits.entries, hits.exits), step, most, counts.numpy())
        return counts
    lengths = torch.zeros(len(hits.offsets) - 1, dtype=torch.float64, device=hits.entries.device)
    rays = torch.repeat_interleave(hits.offsets.diff())
    lengths.index_add_(0, rays, hits.exits.double() - hits.entries.double())
    return (lengths / step).ceil().long().clamp(max=most)


def _on_cpu(*tensors: Tensor) -> bool:
    return all(t.device.type == "cpu" and t.dtype == torch.float32 for t in tensors)


def _arrays(*tensors: Tensor) -> list[np.ndarray]:
    return [t.detach().contiguous().numpy() for t in tensors]
