"""The methods that do nothing: constant velocity and no map."""

from collections.abc import Callable

import torch

from xrdslam.core.frame import Frame
from xrdslam.core.model import Model
from xrdslam.core.trajectory import Trajectory
from xrdslam.methods.config import ConstantVelocityTrackingConfig, NoMappingConfig
from xrdslam.methods.constant_velocity import ConstantVelocityTracking
from xrdslam.methods.no_mapping import NoMapping

Make = Callable[..., Frame]


def test_constant_velocity_keeps_the_prediction_and_says_that_nothing_was_measured(
    walk: Make, no_map: Model, trajectory: Trajectory
) -> None:
    frame = walk(4)
    result = ConstantVelocityTracking(ConstantVelocityTrackingConfig()).track(frame, no_map, trajectory)
    assert torch.equal(result.T_world_camera, frame.pose.matrix())
    assert not result.T_world_camera.requires_grad
    assert not result.is_lost
    assert not result.converged
    assert result.iterations == 0


def test_no_mapping_changes_neither_map_nor_poses(walk: Make, no_map: Model) -> None:
    result = NoMapping(NoMappingConfig()).map(walk(0), no_map, [])
    assert not NoMapping.changes_map
    assert result.num_added == 0
    assert result.poses == {}
