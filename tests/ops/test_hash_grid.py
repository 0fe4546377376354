"""Hash grid: published level sizes and indices, the kernel against its twin, closed forms."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from xrdslam.core.errors import ConfigError
from xrdslam.ops.hash_grid import HashGridLayout, hash_grid, hash_grid_torch
from xrdslam.testing import KernelContract

SMALL = HashGridLayout.build(60, 9, levels=6, base=4)


class TestHashGrid(KernelContract):
    """Levels with and without hashing; points outside of the unit cube."""

    is_smooth = False  # kinks at the cells' faces: finite differences are taken below, away from them

    def kernel(self, points: Tensor, table: Tensor) -> Tensor:
        return hash_grid(points, table, SMALL)

    def twin(self, points: Tensor, table: Tensor) -> Tensor:
        return hash_grid_torch(points, table, SMALL)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        points = torch.rand(3000, 3, generator=generator).to(dtype) * 1.4 - 0.2
        table = torch.randn(SMALL.num_rows, 2, generator=generator).to(dtype)
        return points.requires_grad_(), table.requires_grad_()

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return torch.zeros(0, 3), torch.zeros(SMALL.num_rows, 2)


@pytest.mark.parametrize(("log2_rows", "numbers"), [(16, 1_640_944), (13, 253_568)])
def test_a_published_scene_has_the_published_number_of_parameters(log2_rows: int, numbers: int) -> None:
    layout = HashGridLayout.build(325, log2_rows)
    assert layout.num_rows * layout.features == numbers
    expected = [16, 20, 24, 30, 36, 44, 54, 66, 80, 98, 120, 146, 178, 218, 266, 325]
    np.testing.assert_array_equal(layout.resolutions, expected)
    assert layout.num_dense == {16: 5, 13: 2}[log2_rows]


@pytest.mark.parametrize(
    ("vertex", "at_16", "at_13"),
    [
        ((1, 2, 3), 62940, 5596),
        ((43, 17, 29), 65291, 7947),
        ((324, 200, 111), 60055, 2711),
        ((0, 1, 0), 31153, 6577),
        ((0, 0, 1), 22421, 6037),
    ],
)
def test_vertices_hash_as_published(vertex: tuple[int, int, int], at_16: int, at_13: int) -> None:
    for log2_rows, row in ((16, at_16), (13, at_13)):
        layout = HashGridLayout.build(325, log2_rows)
        assert int(layout.rows_of(15, torch.tensor(vertex))) - layout.offsets[15] == row


def test_a_table_of_ones_is_one_everywhere() -> None:
    layout = HashGridLayout.build(325, 13)
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(0))
    table = torch.ones(layout.num_rows, 2, requires_grad=True)
    features = hash_grid(points, table, layout)
    torch.testing.assert_close(features, torch.ones(500, 32), rtol=0, atol=1e-6)
    upstream = torch.randn(500, 32, generator=torch.Generator().manual_seed(1))
    features.backward(upstream)
    per_level = [table.grad[layout.offsets[level] : layout.offsets[level + 1]].sum(0) for level in range(layout.levels)]
    torch.testing.assert_close(torch.cat(per_level), upstream.sum(0), rtol=1e-4, atol=1e-4)


def test_the_points_gradient_is_finite_differences_within_cells() -> None:
    g = torch.Generator().manual_seed(0)
    points = torch.rand(200, 3, generator=g, dtype=torch.float64)
    position = points[:, None] * torch.tensor(SMALL.scales)[None, :, None] + 0.5
    points = points[((position - position.round()).abs() > 1e-3).all(2).all(1)].requires_grad_()
    assert len(points) > 100
    table = torch.randn(SMALL.num_rows, 2, generator=g, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda p: hash_grid_torch(p, table, SMALL), points, eps=1e-7, atol=1e-5)


def test_what_is_no_number_does_not_reach_beyond_the_table() -> None:
    points = torch.tensor([[torch.nan, 0.5, 0.5], [torch.inf, 0, 0], [1e30, -1e30, 0.1]], requires_grad=True)
    table = torch.ones(SMALL.num_rows, 2, requires_grad=True)
    hash_grid(points, table, SMALL).sum().backward()
    assert bool(torch.isfinite(table.grad).all())


@pytest.mark.parametrize("settings", [{"finest": 8, "log2_rows": 13}, {"finest": 64, "log2_rows": 2}])
def test_a_layout_that_cannot_be_is_refused(settings: dict[str, int]) -> None:
    with pytest.raises(ConfigError, match="hash grid of"):
        HashGridLayout.build(**settings)


HASHED = """
import hashlib
import torch
from xrdslam.ops.hash_grid import HashGridLayout, hash_grid
layout, g = HashGridLayout.build(60, 9, levels=6, base=4), torch.Generator().manual_seed(0)
points = torch.rand(2000, 3, generator=g).requires_grad_()
table = torch.randn(layout.num_rows, 2, generator=g).requires_grad_()
out = hash_grid(points, table, layout)
out.square().sum().backward()
print(*(hashlib.sha256(t.detach().numpy().tobytes()).hexdigest() for t in (out, points.grad, table.grad)))
"""


def test_kernels_compiled_just_now_and_found_on_disk_give_the_same_bits(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    compiled, found = (
        subprocess.run([sys.executable, "-c", HASHED], env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    )
    assert list(tmp_path.rglob("*.nbc")), "the second process found kernels"
    assert compiled.stdout == found.stdout
