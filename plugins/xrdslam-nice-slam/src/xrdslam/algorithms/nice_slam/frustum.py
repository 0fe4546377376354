"""Which vertices a frame can say something about."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import grid_sample

from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3

__all__ = ["seen_by"]


def seen_by(points_world: Float[Tensor, "n 3"], frame: Frame, margin_m: float) -> Bool[Tensor, " n"]:
    """Say which points lie in the frame's image and at most `margin_m` behind its depth, or as near to the camera.

    Depth is interpolated between pixels; where none was measured, the largest of the looked-up depths counts.
    """
    pose = frame.pose.matrix().detach()
    near: Tensor = (points_world - pose[:3, 3]).norm(dim=1) < margin_m
    if frame.depth is None:
        return near
    pixels, z = frame.camera.project(se3.transform(se3.inverse(pose), points_world))
    inside = frame.camera.contains(pixels) & (z >= 0)
    scale = pixels.new_tensor([max(1, frame.camera.width - 1), max(1, frame.camera.height - 1)])
    places = (2 * pixels[inside] / scale - 1)[None, None]
    depth = grid_sample(frame.depth[None, None], places, align_corners=True, padding_mode="border")[0, 0, 0]
    if len(depth):
        depth = torch.where(depth > 0, depth, depth.max())
    near[inside] |= z[inside] <= depth + margin_m
    return near
