"""SplaTAM's tracker: the pose that makes the map look like the frame."""

from xrdslam.algorithms.splatam.config import SplatamTrackingConfig
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.core.tracking import GradientTracking, TrackingResult
from xrdslam.core.trajectory import Trajectory

__all__ = ["SplatamTracking"]


class SplatamTracking(GradientTracking):
    """Gradient-based tracking on whole images, lost where the map explains too little of the frame to say anything.

    Deviations from the released code: the pose turns about the middle of what the frame measured (there: the first
    camera's centre), which takes half the iterations; the motion model is the product of motions instead of a
    difference of parameters; the pose kept is the one whose loss was measured (there: the one after the step).
    """

    config: SplatamTrackingConfig

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        result = super().track(frame, model, trajectory)
        if result.is_lost or not model.supports("render"):
            return result
        share = self._explained_share(frame, model, result)
        if share >= self.config.min_tracked_share:
            return result
        return result._replace(is_lost=True, reason=f"the map explains {share:.1%} of the measured pixels")

    def _explained_share(self, frame: Frame, model: Model, result: TrackingResult) -> float:
        assert frame.depth is not None, "an algorithm checks that its frames have depth"
        measured = frame.depth > 0
        opacity = model.render(frame.camera, result.T_world_camera).opacity
        explained = (opacity > 0.5) & measured
        return float(explained.sum()) / max(1, int(measured.sum()))
