"""Rays of different lengths: the weights' kernel against its twin, sums, rays without samples."""

import torch
from torch import Tensor

from xrdslam.ops.ragged_rendering import ragged_sdf_weights, ragged_sdf_weights_torch, ragged_sums
from xrdslam.ops.volume_rendering import sdf_weights
from xrdslam.testing import KernelContract

TRUNCATION_M = 0.1


def _rays(generator: torch.Generator, count: int = 500) -> tuple[Tensor, Tensor]:
    """Return depths and offsets; every fifth ray has no sample, and the first and the last have one."""
    counts = torch.randint(2, 40, (count,), generator=generator)
    counts[::5], counts[0], counts[-1] = 0, 1, 1
    offsets = torch.cat((counts.new_zeros(1), counts.cumsum(0)))
    steps = torch.rand(int(offsets[-1]), generator=generator) * 0.02
    return steps.cumsum(0) - steps.cumsum(0)[offsets[:-1].clamp(max=len(steps) - 1)].repeat_interleave(counts), offsets


class TestRaggedWeights(KernelContract):
    is_smooth = False  # the first crossing jumps

    def kernel(self, sdf: Tensor, depths: Tensor, offsets: Tensor) -> Tensor:
        return ragged_sdf_weights(sdf, depths, offsets, TRUNCATION_M)

    def twin(self, sdf: Tensor, depths: Tensor, offsets: Tensor) -> Tensor:
        return ragged_sdf_weights_torch(sdf, depths, offsets, TRUNCATION_M)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        depths, offsets = _rays(generator)
        sdf = 0.2 + 0.3 * torch.randn(len(depths), generator=generator)
        return sdf.to(dtype).requires_grad_(), depths.to(dtype), offsets

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return torch.zeros(0, requires_grad=True), torch.zeros(0), torch.zeros(4, dtype=torch.int64)


def test_rays_of_one_length_weigh_as_in_a_table() -> None:
    generator = torch.Generator().manual_seed(0)
    sdf, depths = torch.randn(30, 12, generator=generator), torch.rand(30, 12, generator=generator).cumsum(1)
    ragged = ragged_sdf_weights(sdf.reshape(-1), depths.reshape(-1), torch.arange(31) * 12, TRUNCATION_M)
    torch.testing.assert_close(ragged.reshape(30, 12), sdf_weights(sdf, depths, TRUNCATION_M))


def test_weights_of_a_ray_add_up_to_one_and_end_behind_the_crossing() -> None:
    """A plane at 1 m, sampled every centimetre over 0.6 m: the first crossing is there, the weight about it."""
    depths = 0.7 + 0.01 * torch.arange(60)
    sdf = ((1.0 - depths) / TRUNCATION_M).clamp(-1, 1)
    weights = ragged_sdf_weights(sdf, depths, torch.tensor([0, 60]), TRUNCATION_M)
    assert abs(float(weights.sum()) - 1) < 1e-5
    assert abs(float((weights * depths).sum()) - 1.0) < 1e-3
    assert float(weights[depths > 1.0 + TRUNCATION_M].sum()) == 0


def test_sums_are_over_each_rays_samples() -> None:
    values = torch.arange(6.0).reshape(6, 1).repeat(1, 2).requires_grad_()
    sums = ragged_sums(values, torch.tensor([0, 2, 2, 6]))
    torch.testing.assert_close(sums.detach(), torch.tensor([1.0, 0.0, 14.0])[:, None].repeat(1, 2))
    (sums * torch.tensor([[1.0], [2.0], [3.0]])).sum().backward()
    assert values.grad[:, 0].tolist() == [1, 1, 3, 3, 3, 3]
