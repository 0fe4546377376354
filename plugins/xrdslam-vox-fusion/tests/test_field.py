"""The field of Vox-Fusion: the fused pass against its twin, sizes, initial values, what a frozen map is spared."""

import pytest
import torch
from torch import Tensor

from xrdslam.algorithms.vox_fusion.config import VoxFusionMapConfig
from xrdslam.algorithms.vox_fusion.decoder import Decoder, DecoderWeights
from xrdslam.algorithms.vox_fusion.field import voxel_field, voxel_field_torch
from xrdslam.algorithms.vox_fusion.model import VoxelMap
from xrdslam.ops.voxel_hash import SparseVoxels
from xrdslam.testing import KernelContract


def _grid() -> SparseVoxels:
    grid = SparseVoxels(0.2)
    grid.insert(torch.randn(200, 3, generator=torch.Generator().manual_seed(0)) * 0.4)
    return grid


def _every_third(sdf: Tensor) -> Tensor:
    return torch.arange(len(sdf)) % 3 == 1


class TestVoxelField(KernelContract):
    is_smooth = False  # ReLUs: finite differences are taken of the interpolation by its own test

    def kernel(self, points: Tensor, voxels: Tensor, table: Tensor, *weights: Tensor) -> tuple[Tensor, ...]:
        return voxel_field(points, voxels, table, DecoderWeights(*weights), _grid(), _every_third)

    def twin(self, points: Tensor, voxels: Tensor, table: Tensor, *weights: Tensor) -> tuple[Tensor, ...]:
        return voxel_field_torch(points, voxels, table, DecoderWeights(*weights), _grid(), _every_third)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        grid = _grid()
        voxels = torch.randint(len(grid), (9000,), generator=generator)  # more than two chunks
        points = ((grid.coords[voxels] + torch.rand(9000, 3, generator=generator)) * 0.2).to(dtype)
        table = torch.randn(grid.num_vertices, 16, generator=generator).to(dtype)
        weights = [w.detach().to(dtype).requires_grad_() for w in Decoder(16, 32, generator).weights]
        return points.requires_grad_(), voxels, table.requires_grad_(), *weights

    def empty_inputs(self) -> tuple[Tensor, ...]:
        weights = Decoder(16, 32, torch.Generator()).weights
        table = torch.zeros(_grid().num_vertices, 16, requires_grad=True)
        return torch.zeros(0, 3, requires_grad=True), torch.zeros(0, dtype=torch.int64), table, *weights


@pytest.mark.parametrize(("width", "count"), [(128, 54276), (256, 141188)])
def test_the_decoder_has_the_published_number_of_parameters(width: int, count: int) -> None:
    assert sum(p.numel() for p in Decoder(16, width, torch.Generator()).parameters()) == count


def test_features_begin_as_published() -> None:
    table = VoxelMap(VoxFusionMapConfig()).table.detach()
    assert table.shape == (20000, 16)
    assert abs(float(table.std()) / 0.01 - 1) < 0.02
    assert abs(float(table.mean())) < 1e-4


def test_a_frozen_map_gets_no_gradient_and_points_do() -> None:
    inputs = TestVoxelField().inputs(torch.Generator().manual_seed(0), torch.float32)
    points, voxels, table, *weights = (t.detach() for t in inputs)
    points.requires_grad_()
    sdf, rgb, _ = voxel_field(points, voxels, table, DecoderWeights(*weights), _grid(), _every_third)
    (sdf.sum() + rgb.sum()).backward()
    full = TestVoxelField()._gradients(TestVoxelField().twin, inputs, 0)
    assert points.grad is not None
    assert float(points.grad.abs().max()) > 0
    assert all(w.grad is None for w in (table, *weights))
    assert len(full) == 12


def test_the_field_goes_on_across_voxels() -> None:
    grid = SparseVoxels(0.2)
    grid.insert_cells(torch.tensor([[-1, 0, 0], [0, 0, 0]], dtype=torch.int32))
    weights, table = Decoder(16, 32, torch.Generator().manual_seed(0)).weights, torch.randn(grid.num_vertices, 16)
    points = torch.cat((torch.zeros(50, 1), torch.rand(50, 2, generator=torch.Generator().manual_seed(1)) * 0.2), 1)
    sides = [voxel_field(points, torch.full((50,), v), table, weights, grid, torch.ones_like) for v in (0, 1)]
    torch.testing.assert_close(sides[0].sdf, sides[1].sdf, rtol=0, atol=1e-5)
    torch.testing.assert_close(sides[0].rgb, sides[1].rgb, rtol=0, atol=1e-5)


def test_in_bfloat16_values_and_gradients_are_close() -> None:
    """Eight bits of mantissa a product: a per cent of the largest value, and gradients that point the same way."""
    inputs = TestVoxelField().inputs(torch.Generator().manual_seed(0), torch.float32)
    points, voxels, table, *weights = inputs
    found = []
    for precision in (torch.float32, torch.bfloat16):
        given = points, voxels, table, DecoderWeights(*weights), _grid(), _every_third, precision
        sdf, rgb, _ = voxel_field(*given)
        movable = (points, table, *weights)
        found.append((sdf.detach(), rgb.detach(), *torch.autograd.grad(sdf.square().sum() + rgb.sum(), movable)))
    assert float((found[0][0] - found[1][0]).abs().max()) < 0.01 * float(found[0][0].abs().max())
    assert float((found[0][1] - found[1][1]).abs().max()) < 0.01
    for exact, rounded in zip(*found, strict=True):
        assert exact.dtype == rounded.dtype == torch.float32
        assert float(torch.cosine_similarity(exact.flatten(), rounded.flatten(), 0)) > 0.999
