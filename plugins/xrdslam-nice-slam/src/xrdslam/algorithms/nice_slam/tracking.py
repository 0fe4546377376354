"""NICE-SLAM's tracker: the pose descends the losses of rays drawn from the frame.

What makes it robust, residuals by their deviation and the mask of outliers, is in the map's tracking losses.
"""

from typing import ClassVar

from xrdslam.algorithms.nice_slam.config import NiceSlamTrackingConfig
from xrdslam.core.batch import BatchKind
from xrdslam.core.tracking import GradientTracking

__all__ = ["NiceSlamTracking"]


class NiceSlamTracking(GradientTracking):
    """Gradient-based tracking on rays, for any map that takes them."""

    batch_kinds: ClassVar[frozenset[BatchKind]] = frozenset({"rays"})
    config: NiceSlamTrackingConfig
