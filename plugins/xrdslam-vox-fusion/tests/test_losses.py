"""What rays are held to: exact fields cost nothing, a ray's part depends on no other ray, outliers are left out."""

import torch
from torch import Tensor

from xrdslam.algorithms.vox_fusion.losses import RayLosses, kept_rays, ray_losses

TRUNCATION_M = 0.05


def _losses(sdf: Tensor, depths: Tensor, depth: Tensor, counts: Tensor | None = None) -> RayLosses:
    """Hold a table of samples, a row a ray, to `depth`; rendered depth and colour are exact."""
    gray = torch.full((len(depth), 3), 0.5)
    rays = torch.arange(len(depth)).repeat_interleave(depths.shape[1])
    every = torch.ones(len(depth), dtype=torch.bool) if counts is None else counts
    flat = sdf.reshape(-1), depths.reshape(-1), rays
    return ray_losses(*flat, gray, depth, gray, depth, every, TRUNCATION_M, 100.0)


def _samples(depth: Tensor) -> Tensor:
    return depth[:, None] - 0.1 + 0.01 * torch.arange(15)


def test_an_exact_field_costs_nothing() -> None:
    depth = 1 + torch.rand(50, generator=torch.Generator().manual_seed(0))
    depths = _samples(depth)
    losses = _losses(((depth[:, None] - depths) / TRUNCATION_M).clamp(max=1), depths, depth)
    assert all(float(loss) < 1e-9 for loss in losses)


def test_losses_are_means_over_a_metre_of_every_ray() -> None:
    """5 of 15 samples lie before the truncation, 10 (to -4 cm) within; s = 0 misses by 1 there and by D - z here."""
    depth = torch.full((7,), 2.0)
    depths = 2.0 - 0.1 + 0.005 + 0.01 * torch.arange(15).expand(7, 15)
    losses = _losses(torch.zeros(7, 15), depths, depth)
    errors = (2.0 - depths[0])[5:]
    torch.testing.assert_close(losses.free_space, torch.tensor(5 / 100 * 10 / 15), rtol=1e-5, atol=0)
    torch.testing.assert_close(losses.sdf, errors.square().sum() / 100 * 5 / 15, rtol=1e-4, atol=0)


def test_a_sample_counts_for_those_that_were_left_out() -> None:
    """A field that is constant before the truncation has the losses of all samples from every fourth."""
    depth = torch.full((3,), 2.0)
    depths = (2.0 - 0.21 + 0.01 * torch.arange(25)).expand(3, 25)
    ahead = depth[:, None] - depths
    far = ahead > 2 * TRUNCATION_M
    sdf = torch.where(far, 0.7, (ahead / TRUNCATION_M).clamp(max=1) - 0.1)
    assert int(far.sum()) == 3 * 12
    thinned = ~far | (torch.arange(25) % 4 == 1)
    rays = torch.arange(3).repeat_interleave(25)
    gray, every = torch.full((3, 3), 0.5), torch.ones(3, dtype=torch.bool)
    held = gray, depth, gray, depth, every, TRUNCATION_M, 100.0
    whole = ray_losses(sdf.reshape(-1), depths.reshape(-1), rays, *held)
    few = (t[thinned.reshape(-1)] for t in (sdf.reshape(-1), depths.reshape(-1), rays))
    found = ray_losses(*few, *held, torch.where(far, 4.0, 1.0)[thinned])
    for loss, expected in zip(found, whole, strict=True):
        torch.testing.assert_close(loss, expected)


def test_a_longer_ray_beside_them_leaves_the_others_losses() -> None:
    """Published, padding to the longest ray would divide them."""
    generator = torch.Generator().manual_seed(0)
    depth = torch.full((6,), 2.0)
    depths, sdf = _samples(depth), torch.randn(6, 15, generator=generator)
    alone = _losses(sdf, depths, depth)
    more = torch.linspace(2.2, 9.0, 900)  # behind the truncation: neither loss
    rays = torch.cat((torch.arange(6).repeat_interleave(15), torch.full((900,), 5)))
    gray = torch.full((6, 3), 0.5)
    counts = torch.ones(6, dtype=torch.bool)
    long = torch.cat((sdf.reshape(-1), torch.zeros(900))), torch.cat((depths.reshape(-1), more)), rays
    together = ray_losses(*long, gray, depth, gray, depth, counts, TRUNCATION_M, 100.0)
    torch.testing.assert_close(together.sdf, alone.sdf)
    torch.testing.assert_close(together.free_space, alone.free_space)


def test_without_rays_that_count_everything_is_zero_and_has_a_gradient() -> None:
    sdf = torch.randn(4, 15, generator=torch.Generator().manual_seed(0)).requires_grad_()
    losses = _losses(sdf, _samples(torch.ones(4)), torch.ones(4), torch.zeros(4, dtype=torch.bool))
    torch.stack(list(losses)).sum().backward()
    assert all(float(loss.detach()) == 0 for loss in losses)
    assert bool((sdf.grad == 0).all())


def test_rays_far_beyond_the_median_are_left_out() -> None:
    error, variance = torch.full((11,), 0.01), torch.full((11,), 1e-4)
    error[3], error[4] = 0.2, -0.2
    counts = torch.ones(11, dtype=torch.bool)
    counts[0] = False
    kept = kept_rays(error, variance, counts, 10.0)
    assert kept.tolist() == [False, True, True, False, False, *[True] * 6]
    nobody = torch.zeros(11, dtype=torch.bool)
    assert not kept_rays(error, variance, nobody, 10.0).any()
