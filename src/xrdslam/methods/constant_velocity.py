"""Tracking that keeps the prediction: the floor that any tracker must beat."""

from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.core.tracking import TrackingMethod, TrackingResult
from xrdslam.core.trajectory import Trajectory

__all__ = ["ConstantVelocityTracking"]


class ConstantVelocityTracking(TrackingMethod):
    """Keeps what the motion model of the algorithm (`algo.motion`) predicts, and ignores the image.

    A frame is never lost, since the prediction is what was asked for, and never converged, since nothing was measured.
    Velocity comes from poses that mapping corrects; where nothing corrects them, the camera stays where it started, and
    the trajectory error is the extent of the motion: the figure of a tracker that does nothing.
    """

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        """Return the prediction."""
        return TrackingResult(frame.pose.matrix().detach(), converged=False)
