"""Predicting where the camera will be."""

from collections.abc import Callable

from jaxtyping import Float64
from torch import Tensor

from xrdslam.core.geometry import se3, so3
from xrdslam.core.trajectory import Trajectory

__all__ = ["MOTION_MODELS", "constant_velocity", "stay"]


def stay(trajectory: Trajectory) -> Float64[Tensor, "4 4"]:
    """Predict that the camera stays where it was."""
    return trajectory.pose(trajectory.indices[-1])


def constant_velocity(trajectory: Trajectory) -> Float64[Tensor, "4 4"]:
    """Predict T_1 (T_2^-1 T_1): the last motion once more, in the camera's frame; with one pose only, stay.

    Uses current beliefs, so that what bundle adjustment found is followed; the rotation is made orthonormal again.
    """
    if len(trajectory) < 2:
        return stay(trajectory)
    before, last = (trajectory.pose(index) for index in trajectory.indices[-2:])
    predicted = last @ se3.inverse(before) @ last
    rotation = so3.from_quat_wxyz(so3.to_quat_wxyz(predicted[:3, :3]))
    return se3.compose(rotation, predicted[:3, 3])


MOTION_MODELS: dict[str, Callable[[Trajectory], Tensor]] = {"none": stay, "constant_velocity": constant_velocity}
