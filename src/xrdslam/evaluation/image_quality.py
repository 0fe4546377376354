"""How much a rendered image looks like the photograph: PSNR, SSIM, MS-SSIM; and depth against depth.

Images are in [0, 1], so the peak is 1. SSIM and MS-SSIM are two different numbers and never stand in for one another.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn import functional

from xrdslam.evaluation.errors import EvaluationError

__all__ = ["MS_SSIM_MIN_SIDE", "SSIM_MIN_SIDE", "depth_l1_cm", "ms_ssim", "psnr", "ssim"]

WINDOW, SIGMA = 11, 1.5  # Wang et al. 2004, section III.B
C1, C2 = 0.01**2, 0.03**2  # (K1 L)^2, (K2 L)^2 with L = 1
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)  # Wang et al. 2003, section 3.2
SSIM_MIN_SIDE = WINDOW
MS_SSIM_MIN_SIDE = (WINDOW - 1) * 2 ** (len(SCALE_WEIGHTS) - 1) + 1  # the window still fits the image halved four times

Image = Float[Tensor, "h w 3"]


def psnr(x: Image, y: Image, mask: Bool[Tensor, "h w"] | None = None) -> Float[Tensor, ""]:
    """Return -10 log10(MSE) [dB], the squared error pooled over pixels and channels; infinite for equal images.

    With `mask` only the pixels where it is True enter.
    """
    if mask is not None:
        if not mask.any():
            raise EvaluationError("PSNR over an empty mask: no pixel to compare")
        x, y = x[mask], y[mask]
    return -10.0 * ((x - y) ** 2).mean().log10()


def ssim(x: Image, y: Image) -> Float[Tensor, ""]:
    """Return the structural similarity of Wang et al., TIP 2004, equation 13: mean over windows and channels.

    11x11 Gaussian window, sigma 1.5 px, population covariance, only windows that lie inside the image.
    """
    if min(x.shape[:2]) < SSIM_MIN_SIDE:
        raise EvaluationError(f"SSIM needs images of at least {SSIM_MIN_SIDE} px, found {tuple(x.shape[:2])}")
    similarity, _ = _similarities(_channels_first(x), _channels_first(y))
    return similarity.mean()


def ms_ssim(x: Image, y: Image) -> Float[Tensor, ""]:
    """Return the multi-scale structural similarity of Wang et al., Asilomar 2003, equation 7.

    Contrast and structure at four scales, the full index at the fifth, each to the power of its weight. As in the
    `pytorch_msssim` package that the published figures come from: halving is a 2x2 mean with a zero row or column
    around odd sizes, negative terms count as 0, the channels' products are averaged.
    """
    if min(x.shape[:2]) < MS_SSIM_MIN_SIDE:
        raise EvaluationError(
            f"MS-SSIM has 5 scales and needs images of at least {MS_SSIM_MIN_SIDE} px, found {tuple(x.shape[:2])}"
        )
    a, b = _channels_first(x), _channels_first(y)
    result = torch.ones(a.shape[1], dtype=x.dtype, device=x.device)
    for scale, weight in enumerate(SCALE_WEIGHTS):
        similarity, structure = _similarities(a, b)
        is_last = scale == len(SCALE_WEIGHTS) - 1
        result = result * (similarity if is_last else structure).relu() ** weight
        if not is_last:
            padding = [side % 2 for side in a.shape[2:]]
            a, b = (functional.avg_pool2d(image, 2, padding=padding) for image in (a, b))
    return result.mean()


def depth_l1_cm(depth: Float[Tensor, "h w"], depth_gt: Float[Tensor, "h w"]) -> Float[Tensor, ""]:
    """Return the mean |depth - depth_gt| [cm] over pixels with a measurement; what is not rendered counts in full."""
    is_measured = depth_gt > 0
    if not is_measured.any():
        raise EvaluationError("depth L1 without a single measured depth: no pixel to compare")
    return 100.0 * (depth - depth_gt)[is_measured].abs().mean()


def _channels_first(image: Image) -> Float[Tensor, "1 3 h w"]:
    return image.permute(2, 0, 1)[None]


def _similarities(
    a: Float[Tensor, "1 c h w"], b: Float[Tensor, "1 c h w"]
) -> tuple[Float[Tensor, " c"], Float[Tensor, " c"]]:
    """Return each channel's mean of l·cs and of cs, the index with and without its luminance term."""
    mean_a, mean_b, mean_aa, mean_bb, mean_ab = _smooth(torch.cat([a, b, a * a, b * b, a * b])).unbind()
    var_a, var_b, cov = mean_aa - mean_a**2, mean_bb - mean_b**2, mean_ab - mean_a * mean_b
    structure = (2 * cov + C2) / (var_a + var_b + C2)
    luminance = (2 * mean_a * mean_b + C1) / (mean_a**2 + mean_b**2 + C1)
    return (luminance * structure).mean((1, 2)), structure.mean((1, 2))


def _smooth(images: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h2 w2"]:
    """Return Gaussian means of the windows that lie inside: 11 shifted sums an axis outrun conv2d."""
    offsets = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    weights = (-(offsets**2) / (2 * SIGMA**2)).exp()
    for axis in (2, 3):
        images = _weighted_sum(images, (weights / weights.sum()).tolist(), axis)
    return images


def _weighted_sum(images: Float[Tensor, "n c h w"], weights: list[float], axis: int) -> Float[Tensor, "n c h2 w2"]:
    length = images.shape[axis] - len(weights) + 1
    total = images.narrow(axis, 0, length) * weights[0]
    for start, weight in enumerate(weights[1:], 1):
        total.add_(images.narrow(axis, start, length), alpha=weight)
    return total
