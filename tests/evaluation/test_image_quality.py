"""Image metrics against closed forms, scikit-image and a slow twin written with scipy."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter1d
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from xrdslam.evaluation import EvaluationError, depth_l1_cm, ms_ssim, psnr, ssim


def pair(height: int = 40, width: int = 53, noise: float = 0.1, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """A smooth image with an edge, and the same with noise; float64."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[0:height, 0:width]
    image = np.stack([np.sin(u / 7) * 0.4 + 0.5, np.cos(v / 5) * 0.4 + 0.5, (u > width / 2) * 0.8], -1)
    noisy = np.clip(image + rng.normal(size=image.shape) * noise, 0, 1)
    return torch.from_numpy(image), torch.from_numpy(noisy)


def constant(value: float, height: int = 176, width: int = 176, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.full((height, width, 3), value, dtype=dtype)


@pytest.mark.parametrize(("difference", "expected"), [(0.1, 20.0), (0.01, 40.0), (1.0, 0.0)])
@pytest.mark.parametrize(("dtype", "rel"), [(torch.float32, 1e-5), (torch.float64, 1e-13)])
def test_psnr_of_a_constant_difference(difference: float, expected: float, dtype: torch.dtype, rel: float) -> None:
    # float32: 0.01 itself is off by 2e-8 relative, 8.7 dB per unit of log; 1e-5 of 20 dB is a hundred times that
    value = psnr(constant(0.0, 5, 7, dtype), constant(difference, 5, 7, dtype))
    assert value.item() == pytest.approx(expected, rel=rel, abs=1e-6)


def test_psnr_is_what_scikit_image_says_and_pools_channels() -> None:
    x, y = pair()
    assert psnr(x, y).item() == pytest.approx(peak_signal_noise_ratio(x.numpy(), y.numpy(), data_range=1.0), rel=1e-13)
    one_channel = torch.zeros(4, 4, 3)
    one_channel[..., 0] = 0.3
    assert psnr(one_channel, torch.zeros(4, 4, 3)).item() == pytest.approx(-10 * math.log10(0.09 / 3), rel=1e-6)


def test_psnr_of_equal_images_is_infinite() -> None:
    assert psnr(constant(0.5), constant(0.5)).item() == math.inf


def test_the_mask_of_psnr_says_what_is_kept() -> None:
    x, y = constant(0.0, 4, 6), constant(0.0, 4, 6)
    y[:, :3] = 0.1
    y[:, 3:] = 0.01
    left = torch.zeros(4, 6, dtype=torch.bool)
    left[:, :3] = True
    assert psnr(x, y, left).item() == pytest.approx(20.0)
    assert psnr(x, y, ~left).item() == pytest.approx(40.0)
    with pytest.raises(EvaluationError, match="empty mask"):
        psnr(x, y, torch.zeros(4, 6, dtype=torch.bool))


def test_a_broken_pixel_breaks_the_number() -> None:
    x, y = pair(170, 180)
    x[3, 4, 1] = math.nan
    assert all(math.isnan(measure(x, y).item()) for measure in (psnr, ssim, ms_ssim))


@pytest.mark.parametrize("size", [(11, 11), (11, 30), (40, 53), (64, 64)])
@pytest.mark.parametrize("seed", range(3))
def test_ssim_is_what_scikit_image_says(size: tuple[int, int], seed: int) -> None:
    x, y = pair(*size, seed=seed)
    expected = structural_similarity(
        x.numpy(),
        y.numpy(),
        data_range=1.0,
        channel_axis=-1,
        gaussian_weights=True,
        use_sample_covariance=False,
        sigma=1.5,
    )
    # A variance is a difference of two sums of 22 products below 1, each off by up to 22 eps = 5e-15; over C2 = 9e-4
    # that is 5e-12, for each of three such terms.
    assert ssim(x, y).item() == pytest.approx(expected, abs=2e-11)


def test_ssim_in_float32_stays_close() -> None:
    x, y = pair(60, 80)
    # 22 eps32 / 9e-4 = 3e-3 is the bound for one flat window; errors are independent over 3500 windows: 1e-4 is ample
    assert ssim(x.float(), y.float()).item() == pytest.approx(ssim(x, y).item(), abs=1e-4)


@pytest.mark.parametrize(("a", "b"), [(0.2, 0.8), (0.0, 1.0), (0.5, 0.5)])
def test_constants_have_only_a_luminance_term(a: float, b: float) -> None:
    luminance = (2 * a * b + 1e-4) / (a * a + b * b + 1e-4)
    assert ssim(constant(a), constant(b)).item() == pytest.approx(luminance, rel=1e-11)
    # 176 halves four times without a remainder; only the last scale has luminance
    assert ms_ssim(constant(a), constant(b)).item() == pytest.approx(luminance**0.1333, rel=1e-11)


@pytest.mark.parametrize("measure", [ssim, ms_ssim])
def test_similarity_is_one_for_equal_images_and_symmetric(
    measure: Callable[[torch.Tensor, torch.Tensor], torch.Tensor],
) -> None:
    x, y = pair(170, 190)
    assert measure(x, x).item() == pytest.approx(1.0, abs=1e-12)
    assert measure(x, y).item() == pytest.approx(measure(y, x).item(), abs=1e-12)
    assert measure(x, y).item() < 0.95


def smooth_inside(image: np.ndarray) -> np.ndarray:
    for axis in (0, 1):
        image = gaussian_filter1d(image, 1.5, axis=axis, truncate=3.5)
    return image[5:-5, 5:-5]


def twin_terms(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """SSIM and contrast-structure of one channel, equation 13 of Wang 2004 written out."""
    mx, my = smooth_inside(x), smooth_inside(y)
    vx, vy, cov = smooth_inside(x * x) - mx**2, smooth_inside(y * y) - my**2, smooth_inside(x * y) - mx * my
    structure = (2 * cov + 9e-4) / (vx + vy + 9e-4)
    return float(((2 * mx * my + 1e-4) / (mx**2 + my**2 + 1e-4) * structure).mean()), float(structure.mean())


def twin_halved(x: np.ndarray) -> np.ndarray:
    x = np.pad(x, [(side % 2, side % 2) for side in x.shape])
    x = x[: x.shape[0] // 2 * 2, : x.shape[1] // 2 * 2]
    return (x[::2, ::2] + x[1::2, ::2] + x[::2, 1::2] + x[1::2, 1::2]) / 4


def twin_ms_ssim(x: np.ndarray, y: np.ndarray) -> float:
    values = []
    for a, b in zip(np.moveaxis(x, -1, 0), np.moveaxis(y, -1, 0), strict=True):
        value = 1.0
        for scale, weight in enumerate([0.0448, 0.2856, 0.3001, 0.2363, 0.1333]):
            whole, structure = twin_terms(a, b)
            value *= max(whole if scale == 4 else structure, 0.0) ** weight
            a, b = twin_halved(a), twin_halved(b)
        values.append(value)
    return float(np.mean(values))


@pytest.mark.parametrize("size", [(161, 161), (176, 192), (163, 205), (340, 180)])
@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_ms_ssim_is_what_the_slow_twin_says(size: tuple[int, int], noise: float) -> None:
    x, y = pair(*size, noise=noise)
    assert ms_ssim(x, y).item() == pytest.approx(twin_ms_ssim(x.numpy(), y.numpy()), abs=1e-10)


def test_ms_ssim_of_an_inverted_image_is_zero_not_complex() -> None:
    x, _ = pair(170, 170)
    assert ms_ssim(x, 1.0 - x).item() == 0.0
    assert ssim(x, 1.0 - x).item() < 0.0  # no clamping there


def test_ms_ssim_is_not_ssim() -> None:
    x, y = pair(200, 200)
    assert ms_ssim(x, y).item() - ssim(x, y).item() > 0.1


@pytest.mark.parametrize("size", [(160, 400), (400, 160), (8, 8)])
def test_images_too_small_for_five_scales_have_no_ms_ssim(size: tuple[int, int]) -> None:
    with pytest.raises(EvaluationError, match="at least 161 px"):
        ms_ssim(*pair(*size))


def test_images_smaller_than_the_window_have_no_ssim() -> None:
    with pytest.raises(EvaluationError, match="at least 11 px"):
        ssim(*pair(10, 40))


def test_depth_l1_counts_where_something_was_measured() -> None:
    measured = torch.tensor([[1.0, 2.0, 0.0], [4.0, 0.0, math.nan]])
    rendered = torch.tensor([[1.01, 1.97, 9.0], [4.02, math.nan, 5.0]])
    assert depth_l1_cm(rendered, measured).item() == pytest.approx((1 + 3 + 2) / 3, rel=1e-5)


def test_a_hole_in_the_rendering_counts_in_full() -> None:
    assert depth_l1_cm(torch.zeros(2, 2), torch.full((2, 2), 3.0)).item() == pytest.approx(300.0)


def test_depth_l1_needs_a_measurement_and_keeps_nan() -> None:
    with pytest.raises(EvaluationError, match="without a single measured depth"):
        depth_l1_cm(torch.ones(2, 2), torch.zeros(2, 2))
    assert math.isnan(depth_l1_cm(torch.tensor([[math.nan, 1.0]]), torch.ones(1, 2)).item())
