"""Motion models: exact on the motion that they assume."""

import pytest
import torch

from xrdslam.core.geometry import se3, so3
from xrdslam.core.motion import MOTION_MODELS, constant_velocity, stay
from xrdslam.core.trajectory import Trajectory

STEP = se3.compose(so3.exp(torch.tensor([0.02, -0.5, 0.1]).double()), torch.tensor([0.1, 0.02, -0.3]).double())


def moving(count: int) -> Trajectory:
    trajectory = Trajectory()
    pose = se3.compose(so3.exp(torch.tensor([1.0, 2.0, -0.5]).double()), torch.tensor([3.0, 0.0, 1.0]).double())
    for index in range(count):
        trajectory.append(index, index, pose)
        pose = pose @ STEP
    return trajectory


def test_a_uniform_motion_is_predicted_exactly() -> None:
    """A constant step in the camera's own frame, turning included."""
    trajectory = moving(3)
    expected = trajectory.pose(2) @ STEP
    torch.testing.assert_close(constant_velocity(trajectory), expected, rtol=0, atol=2e-15)  # ten eps of metres


@pytest.mark.parametrize("model", sorted(MOTION_MODELS))
def test_with_one_pose_the_camera_stays(model: str) -> None:
    trajectory = moving(1)
    assert torch.equal(MOTION_MODELS[model](trajectory), trajectory.pose(0))


def test_staying_is_the_last_pose() -> None:
    trajectory = moving(3)
    assert torch.equal(stay(trajectory), trajectory.pose(2))


def test_what_bundle_adjustment_moved_is_followed() -> None:
    trajectory = moving(2)
    trajectory.make_keyframe(1)
    trajectory.update(1, trajectory.pose(0))
    torch.testing.assert_close(constant_velocity(trajectory), trajectory.pose(0), rtol=0, atol=2e-15)


def test_a_thousand_predictions_stay_rigid() -> None:
    """A camera that is lost coasts on its own predictions: the rotation must not drift from orthonormal."""
    trajectory = moving(2)
    for index in range(2, 1000):
        trajectory.append(index, index, constant_velocity(trajectory))
    assert se3.is_rigid(trajectory.pose(999), tolerance=1e-14)
