"""Frames as a failing sensor delivers them."""

import torch
from torch import Tensor

from xrdslam.core.frame import Frame

__all__ = ["not_finite", "without_depth"]


def without_depth(frame: Frame) -> Frame:
    """Return the frame with no measured depth at any pixel."""
    return _replaced(frame, frame.rgb, None if frame.depth is None else torch.zeros_like(frame.depth))


def not_finite(frame: Frame) -> Frame:
    """Return the frame with NaN in every pixel."""
    depth = None if frame.depth is None else torch.full_like(frame.depth, torch.nan)
    return _replaced(frame, torch.full_like(frame.rgb, torch.nan), depth)


def _replaced(frame: Frame, rgb: Tensor, depth: Tensor | None) -> Frame:
    return Frame(frame.index, frame.timestamp_ns, frame.camera, rgb, depth, frame.T_world_camera_gt, frame.imu)
