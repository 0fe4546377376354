"""Dense grids: the kernel against its twin, affine fields, axes, borders, chosen vertices, growing."""

import pytest
import torch
from torch import Tensor

from xrdslam.core.errors import ConfigError
from xrdslam.ops.dense_grid import Chosen, DenseGridLayout, dense_grid, dense_grid_torch
from xrdslam.testing import KernelContract

LAYOUT = DenseGridLayout(0.25, (-4, 2, -7), (9, 6, 5))


def _points(generator: torch.Generator, count: int, margin: float) -> Tensor:
    low, high = LAYOUT.box
    return low - margin + torch.rand(count, 3, generator=generator) * (high - low + 2 * margin)


class TestDenseGrid(KernelContract):
    """All vertices may move; some points lie outside, some cotangents are zero."""

    is_smooth = False  # kinks at the cells' faces: finite differences are taken below, away from them

    def kernel(self, points: Tensor, table: Tensor) -> Tensor:
        return dense_grid(points, table, LAYOUT)

    def twin(self, points: Tensor, table: Tensor) -> Tensor:
        return dense_grid_torch(points, table, LAYOUT)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        points = _points(generator, 1500, 0.2).to(dtype)
        table = torch.randn(LAYOUT.num_rows, 32, generator=generator).to(dtype)
        return points.requires_grad_(), table.requires_grad_()

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return torch.zeros(0, 3), torch.zeros(LAYOUT.num_rows, 32)


class TestChosen(KernelContract):
    """Some vertices may move, the others are only read."""

    is_smooth = False

    def kernel(self, points: Tensor, table: Tensor, values: Tensor, rows: Tensor, slots: Tensor) -> Tensor:
        return dense_grid(points, table, LAYOUT, Chosen(values, rows, slots))

    def twin(self, points: Tensor, table: Tensor, values: Tensor, rows: Tensor, slots: Tensor) -> Tensor:
        return dense_grid_torch(points, table, LAYOUT, Chosen(values, rows, slots))

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        points = _points(generator, 1500, 0.2).to(dtype)
        table = torch.randn(LAYOUT.num_rows, 16, generator=generator).to(dtype)
        rows = torch.randperm(LAYOUT.num_rows, generator=generator)[:100].sort().values
        chosen = Chosen.of(table, rows)
        values = (chosen.values.detach() + torch.randn(100, 16, generator=generator).to(dtype)).requires_grad_()
        return points.requires_grad_(), table, values, rows, chosen.slots


def test_an_affine_field_is_interpolated_exactly_inside_and_constant_outside() -> None:
    slope = torch.randn(3, 16, generator=torch.Generator().manual_seed(1))
    table = LAYOUT.vertices() @ slope + 0.5
    points = _points(torch.Generator().manual_seed(0), 500, 0.3)
    low, high = LAYOUT.box
    expected = torch.maximum(torch.minimum(points, high), low) @ slope + 0.5
    torch.testing.assert_close(dense_grid(points, table, LAYOUT), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_field_along_one_axis_ignores_the_others(axis: int) -> None:
    table = LAYOUT.vertices()[:, axis, None].expand(-1, 16).contiguous()
    points = _points(torch.Generator().manual_seed(0), 200, 0.0)
    torch.testing.assert_close(dense_grid(points, table, LAYOUT)[:, 0], points[:, axis], rtol=0, atol=1e-5)


def test_gradients_agree_with_finite_differences_within_cells() -> None:
    generator = torch.Generator().manual_seed(0)
    low, _ = LAYOUT.box.double()
    cells = torch.stack([torch.randint(n - 1, (6,), generator=generator) for n in LAYOUT.size], 1)
    points = low + 0.25 * (cells + 0.1 + 0.8 * torch.rand(6, 3, generator=generator, dtype=torch.float64))
    table = torch.randn(LAYOUT.num_rows, 2, generator=generator, dtype=torch.float64)
    inputs = (points.requires_grad_(), table.requires_grad_())
    assert torch.autograd.gradcheck(lambda p, t: dense_grid_torch(p, t, LAYOUT), inputs)


def test_points_that_are_no_numbers_read_the_border_and_pull_nothing() -> None:
    points = torch.full((3, 3), torch.nan).requires_grad_()
    table = torch.ones(LAYOUT.num_rows, 16)
    features = dense_grid(points, table, LAYOUT)
    features.sum().backward()
    assert torch.equal(features, torch.ones(3, 16))
    assert torch.equal(points.grad, torch.zeros(3, 3))


def test_chosen_vertices_that_no_point_touches_get_no_gradient() -> None:
    table = torch.randn(LAYOUT.num_rows, 32, generator=torch.Generator().manual_seed(0))
    chosen = Chosen.of(table, torch.arange(LAYOUT.num_rows))
    point = LAYOUT.vertices()[:1] + 0.1
    dense_grid(point, table, LAYOUT, chosen).sum().backward()
    assert int((chosen.values.grad != 0).any(1).sum()) == 8


def test_a_larger_grid_of_the_lattice_has_the_same_vertices() -> None:
    larger = DenseGridLayout.covering(torch.tensor([[-2.0, 0.1, -2.2], [1.9, 2.6, 0.4]]), 0.25)
    rows = LAYOUT.rows_in(larger)
    torch.testing.assert_close(larger.vertices()[rows], LAYOUT.vertices())
    assert len(rows.unique()) == LAYOUT.num_rows


def test_a_box_is_covered_by_whole_voxels() -> None:
    bounds = torch.tensor([[-0.3, 0.0, 1.0], [0.5, 0.32, 1.05]])
    layout = DenseGridLayout.covering(bounds, 0.16)
    assert bool((layout.box[0] <= bounds[0] + 1e-4).all())
    assert bool((layout.box[1] >= bounds[1] - 1e-4).all())
    assert layout.size == (7, 3, 2), "-0.32 to 0.64, 0 to 0.32 on its vertices, 0.96 to 1.12"


def test_a_grid_without_cells_is_refused() -> None:
    with pytest.raises(ConfigError, match="at least 2"):
        DenseGridLayout(0.1, (0, 0, 0), (4, 1, 4))
