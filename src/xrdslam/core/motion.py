"""Predicting where the camera will be."""

from collections.abc import Callable

from jaxtyping import Float64
from torch import Tensor

from xrdslam.core.geometry import se3, so3
from xrdslam.core.trajectory import Trajectory

__all__ = ["MOTION_MODELS", "constant_velocity", "has_velocity", "stay"]

DAMPING = 0.5
"""What each lost frame leaves of the velocity: a camera that is lost comes to rest one more step away."""


def stay(trajectory: Trajectory) -> Float64[Tensor, "4 4"]:
    """Predict that the camera stays where it was."""
    return trajectory.pose(trajectory.indices[-1])


def constant_velocity(trajectory: Trajectory) -> Float64[Tensor, "4 4"]:
    """Predict T_1 (T_2^-1 T_1): the last motion once more, in the camera's frame; with one pose only, stay.

    Uses current beliefs, so that what bundle adjustment found is followed; the rotation is made orthonormal again.
    After a lost frame, whose pose is a prediction itself, the motion is halved: the camera slows down instead of
    leaving the room. The first frame that is tracked after lost ones says where the camera is, not how fast it moves:
    from there it stays.
    """
    if not has_velocity(trajectory):
        return stay(trajectory)
    indices = trajectory.indices[-2:]
    before, last = (trajectory.pose(index) for index in indices)
    step = se3.inverse(before) @ last
    if trajectory.lost(indices[-1]):
        step = se3.compose(so3.exp(DAMPING * so3.log(step[:3, :3])), DAMPING * step[:3, 3])
        predicted = last @ step
    else:
        predicted = last @ se3.inverse(before) @ last
    rotation = so3.from_quat_wxyz(so3.to_quat_wxyz(predicted[:3, :3]))
    return se3.compose(rotation, predicted[:3, 3])


def has_velocity(trajectory: Trajectory) -> bool:
    """Say whether the last two poses tell a velocity: not with one pose, nor where the last one was found again."""
    if len(trajectory) < 2:
        return False
    before, last = trajectory.indices[-2:]
    return trajectory.lost(last) or not (trajectory.lost(before) or trajectory.recognised(last))


MOTION_MODELS: dict[str, Callable[[Trajectory], Tensor]] = {"none": stay, "constant_velocity": constant_velocity}
