"""Where new Gaussians go, and what they start as."""

import math
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from xrdslam.algorithms.splatam.config import SplatamMapConfig
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.model import Rendering

__all__ = ["Seeds", "pixels_to_seed", "seeds_of"]


class Seeds(NamedTuple):
    """New rows of a map."""

    means: Float[Tensor, "n 3"]
    log_scales: Float[Tensor, "n s"]
    opacity_logits: Float[Tensor, "n 1"]
    colors: Float[Tensor, "n 3"]
    quats_wxyz: Float[Tensor, "n 4"]


def pixels_to_seed(rendering: Rendering, frame: Frame, config: SplatamMapConfig) -> Bool[Tensor, "h w"]:
    """Return the measured pixels that the map does not explain, or that lie in front of it (the paper's equation 9).

    mask = D_gt > 0 and (S < 0.5 or (D > D_gt and |D - D_gt| > 50 median)).
    Deviation: the median error is taken over *measured* pixels; SplaTAM's counts the unmeasured ones as zero, so that a
    frame with half its depth missing has the median 0 and is seeded all over.
    """
    assert frame.depth is not None, "an algorithm checks that its frames have depth"
    measured = frame.depth > 0
    error = (rendering.depth - frame.depth).abs()
    median = error[measured].median() if bool(measured.any()) else error.new_zeros(())
    in_front = (rendering.depth > frame.depth) & (error > config.densify_depth_factor * median)
    return measured & ((rendering.opacity < config.densify_silhouette) | in_front)


def seeds_of(
    frame: Frame, T_world_camera: Float[Tensor, "4 4"], mask: Bool[Tensor, "h w"], config: SplatamMapConfig
) -> Seeds:
    """Return a Gaussian a masked pixel, in raster order: at its depth, in its colour, one pixel in radius, half opaque.

    radius = z / f, f the mean focal length; with `seed_stride` n every n-th pixel is seeded, n times as large.
    """
    assert frame.depth is not None, "an algorithm checks that its frames have depth"
    stride = config.seed_stride
    pixels = frame.camera.pixels(frame.rgb.dtype, frame.device)[stride // 2 :: stride, stride // 2 :: stride]
    chosen = mask[stride // 2 :: stride, stride // 2 :: stride]
    depth = frame.depth[stride // 2 :: stride, stride // 2 :: stride][chosen]
    means = se3.transform(T_world_camera, frame.camera.unproject(pixels[chosen], depth))
    colors = frame.rgb[stride // 2 :: stride, stride // 2 :: stride][chosen]
    focal = (frame.camera.fx + frame.camera.fy) / 2 / stride
    log_scales = (depth.log() - math.log(focal))[:, None].repeat(1, 3 if config.anisotropic else 1)
    quats_wxyz = torch.zeros(len(depth), 4).to(means)
    quats_wxyz[:, 0] = 1
    return Seeds(means, log_scales, torch.zeros_like(depth)[:, None], colors, quats_wxyz)
