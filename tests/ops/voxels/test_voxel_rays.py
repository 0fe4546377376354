"""Samples of rays within voxels: the kernels against their twins, and what must hold of every sample."""

import pytest
import torch
from torch import Tensor

from xrdslam.ops.voxel_hash import RayHits, SparseVoxels, traverse
from xrdslam.ops.voxel_rays import RaySamples, cut_torch, points_along, points_along_torch, sample_hits
from xrdslam.testing import KernelContract

STEP_M = 0.01


def _hits(count: int = 300, seed: int = 0) -> tuple[SparseVoxels, Tensor, Tensor, RayHits]:
    generator = torch.Generator().manual_seed(seed)
    grid = SparseVoxels(0.2)
    grid.insert(torch.randn(800, 3, generator=generator))
    origins, directions = torch.randn(2, count, 3, generator=generator)
    directions /= directions.norm(dim=1, keepdim=True)
    return grid, origins, directions, traverse(grid, origins, directions, torch.full((count,), 5.0))


class TestCut(KernelContract):
    """Both are given the same noise."""

    is_smooth = False
    rtol = 1e-6

    def kernel(self, *hits: Tensor) -> tuple[Tensor, ...]:
        return sample_hits(RayHits(*hits), STEP_M, torch.Generator().manual_seed(5), 150)

    def twin(self, *hits: Tensor) -> tuple[Tensor, ...]:
        offsets, _, entries, exits = hits
        length = torch.zeros(len(offsets) - 1, dtype=torch.float64)
        length.index_add_(0, torch.repeat_interleave(offsets.diff()), exits.double() - entries.double())
        cuts = (length / STEP_M).ceil().long().clamp(max=150)
        cut_offsets = torch.cat((cuts.new_zeros(1), cuts.cumsum(0)))
        noise = torch.rand(int(cuts.sum()), generator=torch.Generator().manual_seed(5)) * 0.998 + 0.001
        return cut_torch(RayHits(*hits), STEP_M, cut_offsets, noise, 150)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        return _hits(seed=int(torch.randint(99, (), generator=generator)))[3]

    def empty_inputs(self) -> tuple[Tensor, ...]:
        nothing = torch.zeros(0)
        return torch.zeros(1, dtype=torch.int64), torch.zeros(0, dtype=torch.int64), nothing, nothing


class TestPointsAlong(KernelContract):
    def kernel(self, origins: Tensor, directions: Tensor, samples: RaySamples) -> Tensor:
        return points_along(origins, directions, samples)

    def twin(self, origins: Tensor, directions: Tensor, samples: RaySamples) -> Tensor:
        return points_along_torch(origins, directions, samples)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, Tensor, RaySamples]:
        _, origins, directions, hits = _hits()
        samples = sample_hits(hits, STEP_M)
        samples = samples._replace(depths=samples.depths.to(dtype))
        return origins.to(dtype).requires_grad_(), directions.to(dtype).requires_grad_(), samples


@pytest.mark.parametrize("seed", [None, 3])
def test_samples_lie_in_their_voxels_in_order_and_add_up(seed: int | None) -> None:
    grid, origins, directions, hits = _hits()
    generator = None if seed is None else torch.Generator().manual_seed(seed)
    samples = sample_hits(hits, STEP_M, generator)
    points = points_along(origins, directions, samples)
    local = points / 0.2 - grid.coords[samples.voxels]
    assert local.min() > -1e-4
    assert local.max() < 1 + 1e-4
    same = samples.rays[1:] == samples.rays[:-1]
    assert (samples.depths.diff()[same] > 0).all()
    for ray in range(len(origins)):
        mine = slice(hits.offsets[ray], hits.offsets[ray + 1])
        length, number = float((hits.exits[mine] - hits.entries[mine]).sum()), int(hits.offsets[ray + 1]) - mine.start
        part = slice(samples.offsets[ray], samples.offsets[ray + 1])
        assert abs(float(samples.lengths[part].sum()) - length) < 1e-4
        assert part.stop - part.start <= length / STEP_M + 1 + number
    assert samples.lengths.max() <= 2 * STEP_M


def test_without_noise_cuts_are_at_the_middle_of_each_step() -> None:
    hits = RayHits(torch.tensor([0, 1]), torch.tensor([7]), torch.tensor([1.0]), torch.tensor([1.04]))
    samples = sample_hits(hits, 0.01)
    expected = torch.tensor([1.0025, 1.01, 1.02, 1.03, 1.0375])
    torch.testing.assert_close(samples.depths, expected, rtol=0, atol=1e-6)
    assert samples.voxels.tolist() == [7] * 5


def test_the_nearest_samples_are_kept_where_there_are_too_many() -> None:
    hits = RayHits(torch.tensor([0, 1]), torch.tensor([0]), torch.tensor([0.0]), torch.tensor([1e7]))
    samples = sample_hits(hits, 0.01, torch.Generator().manual_seed(0), max_samples=64)
    assert len(samples.depths) == 64
    assert samples.depths.max() < 0.66


def test_rays_without_hits_have_no_samples() -> None:
    hits = RayHits(torch.zeros(6, dtype=torch.int64), torch.zeros(0, dtype=torch.int64), torch.zeros(0), torch.zeros(0))
    samples = sample_hits(hits, 0.01)
    assert samples.counts.tolist() == [0] * 5
    assert points_along(torch.zeros(5, 3), torch.zeros(5, 3), samples).shape == (0, 3)
