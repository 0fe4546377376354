"""SSIM: the kernel against the torch twin, the twin against scikit-image and finite differences."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity
from torch import Tensor

from xrdslam.core.errors import ConfigError
from xrdslam.ops.ssim import l1_dssim_loss, ssim_map


def _images(height: int, width: int, channels: int = 3, seed: int = 0) -> tuple[Tensor, Tensor]:
    g = torch.Generator().manual_seed(seed)
    x = torch.rand(height, width, channels, generator=g)
    return x, (x + 0.2 * torch.randn(height, width, channels, generator=g)).clamp(0, 1)


@pytest.mark.parametrize("backend", ["numba", "torch"])
def test_whole_windows_agree_with_scikit_image(backend: str) -> None:
    x, y = _images(40, 50)
    _, expected = structural_similarity(
        x.double().numpy(), y.double().numpy(), channel_axis=2, gaussian_weights=True, sigma=1.5, data_range=1.0,
        use_sample_covariance=False, full=True,
    )  # fmt: skip
    found = ssim_map(x, y, padding="valid", backend=backend)
    assert found.shape == (30, 40, 3)
    np.testing.assert_allclose(found.numpy(), expected[5:-5, 5:-5], atol=2e-5)


@pytest.mark.parametrize("shape", [(40, 50, 3), (7, 6, 3), (3, 16, 1), (33, 17, 2), (1, 100, 3)])
@pytest.mark.parametrize(("window", "sigma"), [(11, 1.5), (5, 0.7), (1, 1.0)])
def test_kernel_and_twin_agree_in_value_and_gradient(shape: tuple[int, int, int], window: int, sigma: float) -> None:
    x, y = _images(*shape)
    g = torch.randn(shape, generator=torch.Generator().manual_seed(1))
    results = []
    for dtype, backend in ((torch.float32, "numba"), (torch.float64, "torch")):
        leaf = x.to(dtype).clone().requires_grad_()
        image = ssim_map(leaf, y.to(dtype), window=window, sigma=sigma, backend=backend)
        image.backward(g.to(dtype))
        results.append((image.detach().double(), leaf.grad.double()))
    (image, gradient), (expected, expected_gradient) = results
    # Worst measured 5e-6 and 2e-6. A window of one pixel has no variance: the rounding of E[x^2] - E[x]^2, 1e-7, is
    # held against c2 = 9e-4 alone; measured 1e-4 both.
    image_limit, gradient_limit = (2e-4, 3e-4) if window == 1 else (1e-5, 1e-5)
    torch.testing.assert_close(image, expected, rtol=0, atol=image_limit)
    assert (gradient - expected_gradient).abs().max() < gradient_limit * expected_gradient.abs().max()


def test_the_twins_gradient_is_finite_differences() -> None:
    x, y = (t.double() for t in _images(6, 7, 2))
    assert torch.autograd.gradcheck(lambda x: ssim_map(x, y), x.requires_grad_())


@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
def test_the_fused_loss_is_the_sum_of_its_parts(weight: float) -> None:
    x, y = _images(40, 50)
    y[3:6, 4:9] = x[3:6, 4:9]  # equal pixels: |x - y| has the gradient 0 there
    found, expected = x.clone().requires_grad_(), x.double().requires_grad_()
    loss = l1_dssim_loss(found, y, weight, backend="numba")
    (3 * loss).backward()
    parts = (1 - weight) * (expected - y.double()).abs().mean() + weight * (1 - ssim_map(expected, y.double()).mean())
    (3 * parts).backward()
    assert abs(loss.item() - parts.item()) < 1e-6
    assert (found.grad - expected.grad).abs().max() < 1e-4 * expected.grad.abs().max()


@pytest.mark.parametrize("backend", ["numba", "torch"])
def test_an_image_is_similar_to_itself(backend: str) -> None:
    x, _ = _images(20, 30)
    torch.testing.assert_close(ssim_map(x, x, backend=backend), torch.ones(20, 30, 3), rtol=0, atol=1e-6)
    assert abs(l1_dssim_loss(x, x, backend=backend)) < 1e-6


def test_one_and_two_threads_give_the_same_bits() -> None:
    x, y = _images(100, 64)
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            leaf = x.clone().requires_grad_()
            loss = l1_dssim_loss(leaf, y)
            loss.backward()
            results.append((loss.detach(), leaf.grad))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))


def test_what_the_kernel_cannot_do_goes_to_the_twin_or_is_refused() -> None:
    x, y = _images(12, 4, 1)
    assert ssim_map(x, y).shape == (12, 4, 1)
    y.requires_grad_()
    ssim_map(x, y).sum().backward()
    assert y.grad.abs().max() > 0
    with pytest.raises(ConfigError, match="rows of 16 values"):
        ssim_map(x, y, backend="numba")
    with pytest.raises(ConfigError, match="window must be odd"):
        ssim_map(x, y, window=10)
    with pytest.raises(ConfigError, match="smaller than the 11 px window"):
        ssim_map(x, y, padding="valid")
    with pytest.raises((ConfigError, TypeError)):  # the shape checks of a test run come first
        ssim_map(x, y[:5])
