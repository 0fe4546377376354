"""Features of voxels' corners: the kernel against its twin, continuity, linear functions, far from the origin."""

import torch
from torch import Tensor

from xrdslam.ops.voxel_features import voxel_features
from xrdslam.ops.voxel_features import voxel_features_torch as twin_of
from xrdslam.ops.voxel_hash import SparseVoxels
from xrdslam.testing import KernelContract


def _grid() -> SparseVoxels:
    grid = SparseVoxels(0.2)
    grid.insert(torch.randn(400, 3, generator=torch.Generator().manual_seed(0)) * 0.4)
    return grid


def _points(grid: SparseVoxels, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    voxels = torch.randint(len(grid), (count,), generator=generator)
    return (grid.coords[voxels] + torch.rand(count, 3, generator=generator)) * 0.2, voxels


class TestVoxelFeatures(KernelContract):
    def kernel(self, points: Tensor, voxels: Tensor, table: Tensor) -> Tensor:
        return voxel_features(points, voxels, table, _grid())

    def twin(self, points: Tensor, voxels: Tensor, table: Tensor) -> Tensor:
        return twin_of(points, voxels, table, _grid())

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        grid = _grid()
        points, voxels = _points(grid, 2000, generator)
        table = torch.randn(grid.num_vertices + 5, 32, generator=generator)
        return points.to(dtype).requires_grad_(), voxels, table.to(dtype).requires_grad_()

    def empty_inputs(self) -> tuple[Tensor, ...]:
        table = torch.zeros(_grid().num_vertices, 16, requires_grad=True)
        return torch.zeros(0, 3, requires_grad=True), torch.zeros(0, dtype=torch.int64), table


def test_a_linear_function_is_reproduced() -> None:
    grid = _grid()
    slopes = torch.randn(3, 16, generator=torch.Generator().manual_seed(1))
    points, voxels = _points(grid, 500, torch.Generator().manual_seed(2))
    found = voxel_features(points, voxels, grid.vertices * 0.2 @ slopes, grid)
    torch.testing.assert_close(found, points @ slopes, rtol=0, atol=1e-5)


def test_voxels_agree_on_the_face_between_them() -> None:
    grid = SparseVoxels(0.2)
    grid.insert_cells(torch.tensor([[-1, 0, 0], [0, 0, 0]], dtype=torch.int32))
    table = torch.randn(grid.num_vertices, 16, generator=torch.Generator().manual_seed(0)).requires_grad_()
    points = torch.cat((torch.zeros(50, 1), torch.rand(50, 2, generator=torch.Generator().manual_seed(1)) * 0.2), 1)
    values, slopes = [], []
    for voxel in (0, 1):
        value = voxel_features(points, torch.full((50,), voxel), table, grid)
        values.append(value.detach())
        slopes.append(torch.autograd.grad(value.square().sum(), table)[0])
    torch.testing.assert_close(values[0], values[1], rtol=0, atol=1e-6)
    torch.testing.assert_close(slopes[0], slopes[1], rtol=0, atol=1e-5)


def test_far_from_the_origin_a_point_is_as_well_placed_as_its_coordinates() -> None:
    """float32 at 100 m tells 8 micrometres apart: 4e-5 voxels; a table of unit slopes shows the error."""
    grid = SparseVoxels(0.2)
    grid.insert_cells(torch.tensor([[500, -500, 500]], dtype=torch.int32))
    table = torch.zeros(8, 16)
    table[4:] = 1.0
    points = torch.tensor([[100.05, -99.9, 100.1]])
    expected = float(points[0, 0].double() / 0.2 - 500)
    assert abs(float(voxel_features(points, torch.zeros(1, dtype=torch.int64), table, grid)[0, 0]) - expected) < 1e-6


def test_widths_that_are_no_sixteens_go_the_way_of_the_twin() -> None:
    grid = _grid()
    points, voxels = _points(grid, 100, torch.Generator().manual_seed(0))
    table = torch.randn(grid.num_vertices, 5, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(voxel_features(points, voxels, table, grid), twin_of(points, voxels, table, grid))
