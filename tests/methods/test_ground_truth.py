"""Ground-truth tracking: the data's motion in the run's world, whatever that is; a gap is a lost frame."""

from collections.abc import Callable

import pytest
import torch

from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.model import Model
from xrdslam.core.trajectory import Trajectory
from xrdslam.methods.config import GroundTruthTrackingConfig
from xrdslam.methods.ground_truth import GroundTruthTracking

Make = Callable[..., Frame]


@pytest.mark.parametrize("starts_at_identity", [False, True])
def test_poses_are_the_datas_motion_from_wherever_the_run_starts(
    walk: Make, no_map: Model, trajectory: Trajectory, starts_at_identity: bool
) -> None:
    tracking = GroundTruthTracking(GroundTruthTrackingConfig())
    first = walk(3)
    start = torch.eye(4) if starts_at_identity else first.T_world_camera_gt
    tracking.start(first, start)
    frame = walk(7)
    found = tracking.track(frame, no_map, trajectory)
    expected = start @ se3.inverse(first.T_world_camera_gt) @ frame.T_world_camera_gt
    assert not found.is_lost
    torch.testing.assert_close(found.T_world_camera, expected, rtol=0, atol=1e-6)


def test_started_at_the_datas_pose_the_poses_are_the_datas(walk: Make, no_map: Model, trajectory: Trajectory) -> None:
    tracking = GroundTruthTracking(GroundTruthTrackingConfig())
    first, frame = walk(0), walk(9)
    tracking.start(first, first.T_world_camera_gt)
    found = tracking.track(frame, no_map, trajectory).T_world_camera
    torch.testing.assert_close(found, frame.T_world_camera_gt, rtol=0, atol=1e-6)


@pytest.mark.parametrize("gap", ["absent", "infinite", "nan"])
def test_a_frame_without_finite_ground_truth_is_lost_and_keeps_the_prediction(
    walk: Make, no_map: Model, trajectory: Trajectory, gap: str
) -> None:
    tracking = GroundTruthTracking(GroundTruthTrackingConfig())
    tracking.start(walk(0), torch.eye(4))
    frame = walk(4)
    frame.T_world_camera_gt = {
        "absent": None,
        "infinite": torch.full((4, 4), -torch.inf),  # how ScanNet marks it
        "nan": torch.full((4, 4), torch.nan),
    }[gap]
    result = tracking.track(frame, no_map, trajectory)
    assert result.is_lost
    assert not result.converged
    assert "frame 4 has no finite ground-truth pose" in result.reason
    torch.testing.assert_close(result.T_world_camera, frame.pose.matrix())


def test_a_gap_at_the_start_lets_the_first_good_frame_fix_the_world(
    walk: Make, no_map: Model, trajectory: Trajectory
) -> None:
    tracking = GroundTruthTracking(GroundTruthTrackingConfig())
    first, second, third = walk(0), walk(1), walk(2)
    first.T_world_camera_gt = None
    second.pose.set_(torch.eye(4))  # predicted to stay
    tracking.start(first, torch.eye(4))
    torch.testing.assert_close(tracking.track(second, no_map, trajectory).T_world_camera, torch.eye(4))
    motion = se3.inverse(second.T_world_camera_gt) @ third.T_world_camera_gt
    found = tracking.track(third, no_map, trajectory).T_world_camera
    torch.testing.assert_close(found, motion, rtol=0, atol=1e-6)


@pytest.mark.parametrize("is_started", [False, True])
def test_a_resumed_run_goes_on_in_the_same_world(
    walk: Make, no_map: Model, trajectory: Trajectory, is_started: bool
) -> None:
    tracking, resumed = (GroundTruthTracking(GroundTruthTrackingConfig()) for _ in range(2))
    if is_started:
        tracking.start(walk(2), torch.eye(4))
    resumed.load_state_dict(tracking.state_dict())
    poses = [method.track(walk(5), no_map, trajectory).T_world_camera for method in (tracking, resumed)]
    assert torch.equal(*poses)
