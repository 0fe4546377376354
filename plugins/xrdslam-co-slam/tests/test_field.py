"""The field of Co-SLAM: the fused path against its twin, sizes, initial values."""

import torch
from torch import Tensor

from xrdslam.algorithms.co_slam.field import FieldWeights, JointField, joint_field, joint_field_torch
from xrdslam.ops.hash_grid import HashGridLayout
from xrdslam.testing import KernelContract

LAYOUT = HashGridLayout.build(40, 9, levels=16)


class TestJointField(KernelContract):
    is_smooth = False  # ReLUs and cells: finite differences are taken by the parts' own tests

    def kernel(self, points: Tensor, *weights: Tensor) -> tuple[Tensor, ...]:
        return joint_field(points, FieldWeights(*weights), LAYOUT)

    def twin(self, points: Tensor, *weights: Tensor) -> tuple[Tensor, ...]:
        return joint_field_torch(points, FieldWeights(*weights), LAYOUT)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        field = JointField(LAYOUT, seed=3)
        weights = [w.detach().to(dtype) for w in field.weights]
        weights[0] = torch.randn(weights[0].shape, generator=generator).to(dtype)
        points = torch.rand(9000, 3, generator=generator).to(dtype) * 1.2 - 0.1  # more than a chunk, some outside
        return tuple(t.requires_grad_() for t in (points, *weights))

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return (torch.zeros(0, 3), *(w.detach() for w in JointField(LAYOUT).weights))


def test_the_decoder_has_the_published_number_of_weights_and_no_bias() -> None:
    decoder = JointField(HashGridLayout.build(325, 13)).decoder()
    assert sum(w.numel() for w in decoder) == 5184
    assert all(w.ndim == 2 for w in decoder)


def test_the_field_begins_near_zero() -> None:
    field = JointField(HashGridLayout.build(325, 13))
    points = torch.rand(2000, 3, generator=torch.Generator().manual_seed(0))
    distance, _ = field(points)
    assert distance.abs().mean() < 0.5
    torch.testing.assert_close(field.distance(points), distance.detach(), rtol=1e-4, atol=1e-6)


def test_frozen_parameters_get_no_gradient_and_points_do() -> None:
    field = JointField(LAYOUT)
    for parameter in field.parameters():
        parameter.requires_grad_(False)
    points = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    distance, rgb = field(points)
    (distance.sum() + rgb.sum()).backward()
    assert all(p.grad is None for p in field.parameters())
    assert points.grad is not None
    assert float(points.grad.abs().max()) > 0
