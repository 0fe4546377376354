"""Motion models: exact on the motion that they assume."""

import pytest
import torch

from xrdslam.core.geometry import se3, so3
from xrdslam.core.motion import MOTION_MODELS, constant_velocity, has_velocity, stay
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


def test_found_again_the_camera_stays_until_its_velocity_is_known() -> None:
    """The way from where it was lost to where it is found is no velocity."""
    trajectory = moving(3)
    there = trajectory.pose(2) @ STEP @ STEP
    trajectory.append(3, 3, trajectory.pose(2), is_lost=True)
    assert has_velocity(trajectory)
    trajectory.append(4, 4, there)
    assert not has_velocity(trajectory)
    assert torch.equal(constant_velocity(trajectory), trajectory.pose(4))
    trajectory.append(5, 5, there @ STEP)
    assert has_velocity(trajectory)
    torch.testing.assert_close(constant_velocity(trajectory), there @ STEP @ STEP, rtol=0, atol=4e-15)


def test_recognised_at_once_the_jump_is_no_velocity_either() -> None:
    trajectory = moving(3)
    trajectory.append(3, 3, trajectory.pose(2) @ STEP @ STEP @ STEP, is_recognised=True)
    assert not has_velocity(trajectory)
    assert torch.equal(constant_velocity(trajectory), trajectory.pose(3))


def test_lost_the_camera_comes_to_rest() -> None:
    """1/2 + 1/4 + ... of a step beyond the first lost frame's prediction, along the axes of the motion itself."""
    trajectory = moving(2)
    straight = se3.compose(torch.eye(3).double(), STEP[:3, 3])
    trajectory.update(1, trajectory.pose(0) @ straight)
    start = trajectory.pose(1)
    for index in range(2, 60):
        trajectory.append(index, index, constant_velocity(trajectory), is_lost=True)
    expected = start @ straight @ straight
    torch.testing.assert_close(trajectory.pose(59), expected, rtol=0, atol=1e-13)
    torch.testing.assert_close(constant_velocity(trajectory), trajectory.pose(59), rtol=0, atol=1e-13)


def test_a_thousand_predictions_stay_rigid() -> None:
    """The rotation must not drift from orthonormal."""
    trajectory = moving(2)
    for index in range(2, 1000):
        trajectory.append(index, index, constant_velocity(trajectory))
    assert se3.is_rigid(trajectory.pose(999), tolerance=1e-14)
