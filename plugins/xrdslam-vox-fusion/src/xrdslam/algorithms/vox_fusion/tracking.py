"""Vox-Fusion's tracker: the pose descends the losses of rays drawn from the frame."""

from typing import ClassVar

import torch

from xrdslam.algorithms.vox_fusion.config import VoxFusionTrackingConfig
from xrdslam.algorithms.vox_fusion.model import VoxelMap
from xrdslam.core.batch import BatchKind
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.model import Model
from xrdslam.core.tracking import GradientTracking, TrackingResult
from xrdslam.core.trajectory import Trajectory

__all__ = ["VoxFusionTracking"]

_EVERY = 7
"""Of how many measured points one is looked up."""


class VoxFusionTracking(GradientTracking):
    """Gradient-based tracking on rays, for any map that takes them."""

    batch_kinds: ClassVar[frozenset[BatchKind]] = frozenset({"rays"})
    config: VoxFusionTrackingConfig

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        """Track, unless the frame looks where the map has no voxels: nothing could be compared there."""
        predicted = frame.pose.matrix().detach()
        if isinstance(model, VoxelMap) and model.size:
            points_world = se3.transform(predicted, frame.points_camera()[::_EVERY])
            seen = float((model.grid.locate(points_world) >= 0).to(torch.float32).mean())
            if seen < self.config.min_seen:
                reason = f"only {100 * seen:.0f} % of what was measured falls into the map's voxels"
                return TrackingResult(predicted, is_lost=True, converged=False, reason=reason)
        return super().track(frame, model, trajectory)
