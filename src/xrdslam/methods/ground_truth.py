"""Tracking that takes the data's own poses: for mapping alone, and for reconstruction."""

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.model import Model
from xrdslam.core.tracking import TrackingMethod, TrackingResult
from xrdslam.core.trajectory import Trajectory
from xrdslam.methods.config import GroundTruthTrackingConfig

__all__ = ["GroundTruthTracking"]


class GroundTruthTracking(TrackingMethod):
    """Gives every frame its ground-truth pose, moved into the run's world.

    T_world_camera = T_world_data T_data_camera, where T_world_data is fixed by the first frame whose ground truth is
    finite, so that the run may start at the data's first pose or at the identity. A frame without one is lost.
    """

    needs = frozenset({"rgb", "pose"})

    def __init__(self, config: GroundTruthTrackingConfig, seed: int = 0) -> None:
        super().__init__(config, seed)
        self.T_world_data: Tensor | None = None

    def start(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> None:
        """Fix the run's world to the data's."""
        given = _finite_pose(frame)
        if given is not None:
            self.T_world_data = T_world_camera.detach().cpu().double() @ se3.inverse(given)

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        """Look the pose up."""
        predicted = frame.pose.matrix().detach()
        given = _finite_pose(frame)
        if given is None:
            reason = f"frame {frame.index} has no finite ground-truth pose"
            return TrackingResult(predicted, is_lost=True, converged=False, reason=reason)
        if self.T_world_data is None:
            self.start(frame, predicted)
            return TrackingResult(predicted)
        return TrackingResult((self.T_world_data @ given).to(predicted))

    def state_dict(self) -> dict[str, Tensor]:
        """Return what a resumed run needs; T_world_data is NaN as long as it is unknown."""
        unknown = torch.full((4, 4), torch.nan, dtype=torch.float64)
        return super().state_dict() | {"T_world_data": unknown if self.T_world_data is None else self.T_world_data}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        super().load_state_dict(state)
        known = bool(torch.isfinite(state["T_world_data"]).all())
        self.T_world_data = state["T_world_data"] if known else None


def _finite_pose(frame: Frame) -> Float[Tensor, "4 4"] | None:
    """Return T_data_camera in float64, or None where it is absent or not finite."""
    given = frame.T_world_camera_gt
    if given is None or not bool(torch.isfinite(given).all()):
        return None
    return given.detach().cpu().double()
