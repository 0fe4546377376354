"""Sparse voxels: insertion and sharing against their twins, look-up, traversal against a brute-force slab test."""

import pytest
import torch
from torch import Tensor

from xrdslam.ops.voxel_hash import (
    SparseVoxels,
    corner_rows_torch,
    locate_torch,
    traverse,
    traverse_torch,
    voxels_torch,
)
from xrdslam.testing import KernelContract


def _random_grid(share: float = 0.05, side: int = 24, seed: int = 0) -> SparseVoxels:
    """Fill a share of a box about the origin, so that half of all coordinates are negative."""
    generator = torch.Generator().manual_seed(seed)
    cells = (torch.rand(side, side, side, generator=generator) < share).nonzero() - side // 2
    grid = SparseVoxels(0.2, capacity=16)
    grid.insert_cells(cells.int())
    return grid


def _rays(count: int, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    origins = torch.rand(count, 3, generator=generator) * 8 - 4  # some outside of the voxels' box
    directions = torch.randn(count, 3, generator=generator)
    return origins, directions, torch.rand(count, generator=generator) * 4


class TestTraverse(KernelContract):
    """Hits, entries and exits are those of a slab test with every voxel."""

    is_smooth = False

    def kernel(self, origins: Tensor, directions: Tensor, far: Tensor) -> tuple[Tensor, ...]:
        return traverse(self._grid(), origins, directions, far)

    def twin(self, origins: Tensor, directions: Tensor, far: Tensor) -> tuple[Tensor, ...]:
        return traverse_torch(self._grid(), origins, directions, far)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        origins, directions, far = _rays(3000, seed=int(torch.randint(99, (), generator=generator)))
        directions[:50, 0], directions[50:90, 1:] = 0.0, 0.0  # along planes and along an axis
        directions[90] = 0.0
        far[91], far[92] = 0.0, 1e6
        return origins.to(dtype), directions.to(dtype), far.to(dtype)

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0)

    def _grid(self) -> SparseVoxels:
        return _random_grid()


def test_every_hit_is_kept_in_order_along_the_ray() -> None:
    grid = SparseVoxels(0.2)
    grid.insert_cells(torch.tensor([[k, 0, 0] for k in range(-100, 100)], dtype=torch.int32)[torch.randperm(200)])
    hits = traverse(grid, torch.tensor([[-30.0, 0.1, 0.1]]), torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([100.0]))
    assert len(hits.voxels) == 200
    torch.testing.assert_close(hits.entries, 10 + 0.2 * torch.arange(200), rtol=0, atol=1e-5)
    torch.testing.assert_close(hits.exits[:-1], hits.entries[1:], rtol=0, atol=1e-6)


def test_a_camera_inside_of_a_voxel_enters_at_zero() -> None:
    grid = SparseVoxels(0.2)
    grid.insert_cells(torch.tensor([[-1, -1, -1], [-1, -1, 0]], dtype=torch.int32))
    hits = traverse(grid, torch.tensor([[-0.05, -0.1, -0.15]]), torch.tensor([[0.0, 0.0, 1.0]]), torch.tensor([9.0]))
    torch.testing.assert_close(hits.entries, torch.tensor([0.0, 0.15]))
    torch.testing.assert_close(hits.exits, torch.tensor([0.15, 0.35]))
    assert hits.voxels.tolist() == [0, 1]


def test_a_ray_along_an_edge_ends_and_hits_what_it_touches_at_most() -> None:
    grid = SparseVoxels(1.0)
    grid.insert_cells(torch.tensor([[0, 0, 0], [0, -1, 0], [5, -1, -1]], dtype=torch.int32))
    origins = torch.tensor([[-1.0, 0.0, 0.0], [-1.0, -1.0, -1.0], [-1.0, 5.0, 0.5]])
    directions = torch.tensor([[1.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 0.0, 0.0]])
    hits = traverse(grid, origins, directions, torch.full((3,), 50.0))
    counts = hits.offsets.diff().tolist()
    assert counts[0] <= 2
    assert counts[1] == 1, "through the corner at the origin into voxel (0, 0, 0)"
    assert counts[2] == 0, "beside everything"


def test_rays_that_are_no_numbers_hit_nothing() -> None:
    origins, directions, far = _rays(4)
    origins[0, 0], directions[1, 2], far[2] = torch.nan, torch.nan, torch.nan
    directions[3] = torch.inf
    hits = traverse(_random_grid(0.5), origins, directions, far)
    assert hits.offsets.tolist() == [0] * 5


def test_without_voxels_nothing_is_hit_and_nothing_found() -> None:
    grid = SparseVoxels(0.1)
    assert traverse(grid, *_rays(5)).offsets.tolist() == [0] * 6
    assert traverse_torch(grid, *_rays(5)).offsets.tolist() == [0] * 6
    assert grid.locate(torch.zeros(2, 3)).tolist() == [-1, -1]
    assert locate_torch(torch.zeros(2, 3), grid.coords, 0.1).tolist() == [-1, -1]


def test_insertion_equals_its_twin_whatever_the_capacity() -> None:
    generator = torch.Generator().manual_seed(0)
    points = torch.randn(20000, 3, generator=generator) * 2
    points[::7] = points[3]
    points[100] = torch.nan
    points[101, 1] = torch.inf
    points[102, 2] = 1e9
    expected = voxels_torch(points, 0.2)
    corners, vertices = corner_rows_torch(expected)
    for capacity in (1, 100000):
        grid = SparseVoxels(0.2, capacity)
        assert grid.insert(points) == len(expected)
        assert torch.equal(grid.coords, expected)
        assert torch.equal(grid.corners, corners)
        assert torch.equal(grid.vertices, vertices)
        assert grid.insert(points.flip(0)) == 0, "everything is there already"


def test_rows_of_corners_stay_when_voxels_come() -> None:
    generator = torch.Generator().manual_seed(1)
    grid = SparseVoxels(0.2, 8)
    grid.insert(torch.randn(300, 3, generator=generator))
    corners, vertices = grid.corners.clone(), grid.vertices.clone()
    grid.insert(torch.randn(3000, 3, generator=generator) * 2)
    assert torch.equal(grid.corners[: len(corners)], corners)
    assert torch.equal(grid.vertices[: len(vertices)], vertices)
    assert grid.num_vertices > len(vertices)


@pytest.mark.parametrize(("other", "shared"), [((1, 0, 0), 4), ((1, 1, 0), 2), ((1, 1, 1), 1), ((2, 0, 0), 0)])
def test_neighbours_share_their_corners(other: tuple[int, int, int], shared: int) -> None:
    grid = SparseVoxels(0.2)
    grid.insert_cells(torch.tensor([[-1, -1, -1]], dtype=torch.int32))
    grid.insert_cells(torch.tensor([other], dtype=torch.int32) - 1)
    assert grid.num_vertices == 16 - shared
    assert len(set(grid.corners[0].tolist()) & set(grid.corners[1].tolist())) == shared


def test_a_slab_has_as_many_corners_as_its_lattice() -> None:
    x, y = torch.meshgrid(torch.arange(30), torch.arange(25), indexing="ij")
    cells = torch.stack((x, y, torch.full_like(x, -50)), -1).reshape(-1, 3).int()
    grid = SparseVoxels(0.2)
    assert grid.insert_cells(cells) == 750
    assert grid.num_vertices == 31 * 26 * 2


def test_points_are_found_where_they_were_put() -> None:
    grid = _random_grid(0.3)
    generator = torch.Generator().manual_seed(2)
    points = torch.rand(5000, 3, generator=generator) * 6 - 3
    points[0] = torch.nan
    found = grid.locate(points)
    assert torch.equal(found, locate_torch(points, grid.coords, 0.2))
    cells = torch.floor(points.double() / 0.2)
    has = found >= 0
    assert has.any()
    assert not has.all()
    assert torch.equal(grid.coords[found[has]].double(), cells[has])


def test_points_on_an_outer_face_are_found_with_some_slack() -> None:
    grid = SparseVoxels(0.2)
    grid.insert_cells(torch.tensor([[0, 0, 0]], dtype=torch.int32))
    points = torch.tensor([[0.2, 0.1, 0.1], [0.2, 0.2, 0.2], [-1e-9, 0.1, 0.1], [0.21, 0.1, 0.1]])
    assert grid.locate(points).tolist() == [-1] * 4
    assert grid.locate(points, 1e-3).tolist() == [0, 0, 0, -1]
    assert locate_torch(points, grid.coords, 0.2, 1e-3).tolist() == [0, 0, 0, -1]


def test_sizes_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="voxel_m=0"):
        SparseVoxels(0.0)
    with pytest.raises(ValueError, match="must lie within"):
        SparseVoxels(0.1).insert_cells(torch.tensor([[1 << 20, 0, 0]], dtype=torch.int32))
