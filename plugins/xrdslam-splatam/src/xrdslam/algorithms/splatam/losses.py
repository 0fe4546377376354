"""SplaTAM's losses, on whole images."""

import torch
from torch import Tensor

from xrdslam.algorithms.splatam.config import SplatamMapConfig
from xrdslam.core.frame import Frame
from xrdslam.ops.splats import SplatRender
from xrdslam.ops.ssim import l1_dssim_loss

__all__ = ["mapping_losses", "tracking_losses"]


def tracking_losses(image: SplatRender, frame: Frame, config: SplatamMapConfig) -> dict[str, Tensor]:
    """Sum the depth [m] and colour L1 errors over the measured pixels that the map explains (the paper's equation 8).

    M = (D_gt > 0) and (S > 0.99); the mask carries no gradient.
    """
    assert frame.depth is not None, "an algorithm checks that its frames have depth"
    mask = (frame.depth > 0) & (image.opacity.detach() > config.tracking_silhouette)
    depth = torch.where(mask, (frame.depth - image.depth).abs(), 0).sum()
    color = torch.where(mask[..., None], (frame.rgb - image.rgb).abs(), 0).sum()
    return {"depth": config.weight_depth * depth, "color": config.weight_color * color}


def mapping_losses(image: SplatRender, frame: Frame, config: SplatamMapConfig) -> dict[str, Tensor]:
    """Mean depth L1 [m] over measured pixels, and mean colour L1 mixed with 1 - SSIM over all (section 3.4)."""
    assert frame.depth is not None, "an algorithm checks that its frames have depth"
    measured = frame.depth > 0
    num_measured = measured.sum().clamp(min=1)
    depth = torch.where(measured, (frame.depth - image.depth).abs(), 0).sum() / num_measured
    color = l1_dssim_loss(image.rgb, frame.rgb, config.weight_ssim)
    return {"depth": config.weight_depth * depth, "color": config.weight_color * color}
