"""Volume rendering: closed forms of the three kinds of weights, kernels against their twins, rays that see nothing."""

import pytest
import torch
from torch import Tensor

from xrdslam.ops import volume_rendering as vr
from xrdslam.testing import KernelContract

TRUNCATION_M = 0.1


def _depths(rays: int, samples: int, generator: torch.Generator) -> Tensor:
    return torch.rand(rays, samples, generator=generator).sort(1).values * 4 + 0.1


class TestComposite(KernelContract):
    def kernel(self, weights: Tensor, rgb: Tensor, depths: Tensor) -> tuple[Tensor, ...]:
        return tuple(vr.composite(weights, rgb, depths))

    def twin(self, weights: Tensor, rgb: Tensor, depths: Tensor) -> tuple[Tensor, ...]:
        return tuple(vr.composite_torch(weights, rgb, depths))

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        weights = torch.rand(300, 11, generator=generator) * 0.1
        weights[:4] = 0
        rgb = torch.rand(300, 11, 3, generator=generator)
        depths = _depths(300, 11, generator)
        return weights.to(dtype).requires_grad_(), rgb.to(dtype).requires_grad_(), depths.to(dtype)

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return torch.zeros(0, 5), torch.zeros(0, 5, 3), torch.zeros(0, 5)


class TestSdfWeights(KernelContract):
    def kernel(self, sdf: Tensor, depths: Tensor, valid: Tensor) -> Tensor:
        return vr.sdf_weights(sdf, depths, TRUNCATION_M, valid)

    def twin(self, sdf: Tensor, depths: Tensor, valid: Tensor) -> Tensor:
        return vr.sdf_weights_torch(sdf, depths, TRUNCATION_M, valid)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        sdf = torch.randn(300, 13, generator=generator) * 0.3
        sdf[:5] = sdf[:5].abs() + 0.1  # rays without a crossing
        valid = torch.rand(300, 13, generator=generator) > 0.2
        valid[5] = False
        depths = _depths(300, 13, generator) * 0.2
        return sdf.to(dtype).requires_grad_(), depths.to(dtype), valid

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return torch.zeros(0, 5), torch.zeros(0, 5), torch.zeros(0, 5, dtype=torch.bool)


class TestOccupancyWeights(KernelContract):
    def kernel(self, logits: Tensor) -> Tensor:
        return vr.occupancy_weights(logits)

    def twin(self, logits: Tensor) -> Tensor:
        return vr.occupancy_weights_torch(logits)

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]:
        logits = torch.randn(300, 13, generator=generator) * 0.2
        logits[:3] = -30
        return (logits.to(dtype).requires_grad_(),)

    def empty_inputs(self) -> tuple[Tensor, ...]:
        return (torch.zeros(0, 5),)


def test_a_solid_sample_stops_the_ray() -> None:
    logits = torch.full((1, 6), -100.0)
    logits[0, 3] = 100.0
    depths = torch.linspace(1, 2, 6)[None]
    seen = vr.composite_occupancy(logits, torch.rand(1, 6, 3), depths)
    assert seen.depth == depths[0, 3]
    assert seen.variance == 0
    assert seen.opacity == 1


def test_free_space_has_no_depth() -> None:
    seen = vr.composite_occupancy(torch.full((2, 6), -100.0), torch.rand(2, 6, 3), torch.ones(2, 6))
    assert float(seen.depth.abs().max()) < 1e-12, "weights of occupancy are not normalised"


def test_occupancy_weights_lie_between_nothing_and_one() -> None:
    weights = vr.occupancy_weights(torch.randn(200, 20, generator=torch.Generator().manual_seed(0)))
    assert (weights >= 0).all()
    assert (weights.sum(1) <= 1 + 1e-5).all()


def test_a_constant_density_is_beers_law() -> None:
    depths = torch.linspace(0, 3, 301, dtype=torch.float64)[None]
    weights = vr.density_weights(torch.full_like(depths, 0.7), depths)
    torch.testing.assert_close(weights.sum(), 1 - torch.exp(torch.tensor(-0.7 * 3.01, dtype=torch.float64)))


def test_a_surface_ends_the_ray_a_truncation_behind_the_sample_before_it() -> None:
    depths = torch.linspace(1, 2, 101)[None]
    sdf = (1.5 - depths) / TRUNCATION_M
    weights = vr.sdf_weights(sdf, depths, TRUNCATION_M)
    torch.testing.assert_close(weights.sum(), torch.tensor(1.0), rtol=0, atol=1e-6)
    assert (weights[depths >= 1.5 + TRUNCATION_M] == 0).all()
    assert float(weights[0, 50]) == float(weights.max())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_sample_on_the_surface_counts_as_a_crossing(dtype: torch.dtype) -> None:
    """A strict test of the sign finds none, and the weights stay at the camera."""
    depths = torch.tensor([[0.5, 1.0, 1.5]], dtype=dtype)
    weights = vr.sdf_weights(torch.tensor([[1.0, 0.0, -1.0]], dtype=dtype), depths, 0.6)
    assert int(weights.argmax()) == 1


def test_without_a_crossing_only_the_first_truncation_has_weight() -> None:
    depths = torch.linspace(0, 1, 21)[None]
    weights = vr.sdf_weights(torch.ones(1, 21), depths, TRUNCATION_M)
    assert (weights[depths > TRUNCATION_M] == 0).all()
    assert float(weights[0, 0]) > 0


def test_a_ray_without_valid_samples_is_nothing_and_has_no_gradient() -> None:
    sdf = torch.zeros(2, 4, requires_grad=True)
    seen = vr.composite_sdf(sdf, torch.ones(2, 4, 3), torch.ones(2, 4), 0.1, torch.zeros(2, 4, dtype=torch.bool))
    torch.stack([t.sum() for t in seen]).sum().backward()
    assert all(bool((t == 0).all()) for t in seen)
    assert bool((sdf.grad == 0).all())
