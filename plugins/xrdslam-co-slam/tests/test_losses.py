"""What rays are held to: exact fields cost nothing, shares balance, a batch without depth is finite."""

import torch

from xrdslam.algorithms.co_slam.losses import RayLosses, ray_losses
from xrdslam.ops.sampling import jittered, linear_depths, merged
from xrdslam.ops.volume_rendering import composite_sdf

TRUNCATION_M = 0.1


def _losses(sdf: torch.Tensor, depths: torch.Tensor, depth: torch.Tensor, counts: bool = True) -> RayLosses:
    gray = torch.full((len(depth), 3), 0.5)
    return ray_losses(sdf, depths, gray, depth, gray, depth, TRUNCATION_M, counts)


def _samples(depth: torch.Tensor) -> torch.Tensor:
    even = linear_depths(torch.zeros_like(depth), torch.full_like(depth, 5.0), 32)
    close = linear_depths(depth - 0.1, depth + 0.1, 11)
    return jittered(merged(even, close), torch.Generator().manual_seed(0))


def test_an_exact_field_costs_nothing() -> None:
    depth = torch.full((200,), 2.37)
    depths = _samples(depth)
    sdf = ((depth[:, None] - depths) / TRUNCATION_M).clamp(-1, 1)
    losses = _losses(sdf, depths, depth)
    assert losses.sdf <= 1e-10
    assert losses.free_space <= 1e-10


def test_an_exact_field_renders_its_depth() -> None:
    depth = torch.full((2000,), 2.37)
    depths = _samples(depth)
    sdf = ((depth[:, None] - depths) / TRUNCATION_M).clamp(-1, 1)
    seen = composite_sdf(sdf, torch.zeros(*sdf.shape, 3), depths, TRUNCATION_M)
    error = seen.depth - depth
    assert error.mean().abs() < 0.002
    assert error.std() < 0.004
    torch.testing.assert_close(seen.opacity, torch.ones(2000), rtol=0, atol=1e-5)


def test_a_batch_without_depth_is_finite() -> None:
    sdf = torch.randn(20, 7, generator=torch.Generator().manual_seed(0)).requires_grad_()
    losses = _losses(sdf, linear_depths(torch.zeros(20), torch.ones(20), 7), torch.zeros(20))
    total = torch.stack(list(losses)).sum()
    total.backward()
    assert torch.isfinite(total)
    assert torch.isfinite(sdf.grad).all()
    assert losses.sdf == 0
    assert losses.free_space == 0


def test_without_free_space_the_whole_weight_is_on_free_space_and_none_on_the_surface() -> None:
    """omega_free = 1 - 0 / n = 1 on a term that is empty, omega_sdf = 1 - n / n = 0."""
    depth = torch.full((5,), 1.0)
    depths = linear_depths(depth - 0.05, depth + 0.05, 4)
    losses = _losses(torch.zeros(5, 4), depths, depth)
    assert losses.sdf == 0
    assert losses.free_space == 0


def test_pixels_without_depth_count_in_colour_only_where_asked() -> None:
    rendered, rgb, depth = torch.zeros(2, 3), torch.ones(2, 3), torch.tensor([0.0, 1.0])
    depths = linear_depths(torch.zeros(2), torch.ones(2), 3)
    both, one = (
        ray_losses(torch.zeros(2, 3), depths, rendered, depth, rgb, depth, TRUNCATION_M, counts).rgb
        for counts in (True, False)
    )
    assert both == 1.0
    assert one == 0.5
