"""One-blob encoding: the published values, bins that sum to one, the kernel against its twin."""

import torch
from torch import Tensor

from xrdslam.ops.one_blob import one_blob, one_blob_torch
from xrdslam.testing import KernelContract


class TestOneBlob(KernelContract):
    def kernel(self, points: Tensor) -> Tensor:
        return one_blob(points, 16)

    def twin(self, points: Tensor) -> Tensor:
        return one_blob_torch(points, 16)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        points = torch.rand(2000, 3, generator=generator).to(dtype) * 2.4 - 0.7  # outside of the unit interval too
        points[:3] = torch.tensor([[0.0, 1.0, 0.5], [-5.0, 7.0, 0.25], [1 / 16, 15 / 16, 1e-9]]).to(dtype)
        return (points.requires_grad_(),)

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return (torch.zeros(0, 3),)


def test_values_of_the_quartic_kernel() -> None:
    """At the middle of bin 0: F(1/2) - F(-1/2) = 0.792969, the rest falls to both neighbours, one of them around."""
    x = one_blob(torch.tensor([[0.5 / 16, 0.5, 0.5]]))[0, :16]
    torch.testing.assert_close(x[[0, 1, 15]], torch.tensor([0.792969, 0.103516, 0.103516]), rtol=0, atol=1e-6)
    torch.testing.assert_close(one_blob(torch.tensor([[0.5] * 3]))[0, [7, 8]], torch.tensor([0.5, 0.5]))


def test_the_bins_of_a_coordinate_sum_to_one_and_three_at_most_are_reached() -> None:
    points = torch.rand(1000, 3, generator=torch.Generator().manual_seed(0))
    bins = one_blob(points).reshape(-1, 3, 16)
    torch.testing.assert_close(bins.sum(2), torch.ones(1000, 3), rtol=0, atol=1e-6)
    assert int((bins > 0).sum(2).max()) <= 3
