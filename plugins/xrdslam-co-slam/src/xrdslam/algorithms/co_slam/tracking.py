"""Co-SLAM's tracker: the pose descends the losses of rays drawn from the frame."""

from typing import ClassVar

from xrdslam.algorithms.co_slam.config import CoSlamTrackingConfig
from xrdslam.core.batch import BatchKind
from xrdslam.core.tracking import GradientTracking

__all__ = ["CoSlamTracking"]


class CoSlamTracking(GradientTracking):
    """Gradient-based tracking on rays, for any map that takes them."""

    batch_kinds: ClassVar[frozenset[BatchKind]] = frozenset({"rays"})
    config: CoSlamTrackingConfig
