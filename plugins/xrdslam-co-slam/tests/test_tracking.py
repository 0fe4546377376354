"""What ten iterations of tracking do and do not do, and how well the first frame is fitted (toy room, closed form)."""

import math

import pytest
import torch
from torch import Tensor

from xrdslam.algorithms.co_slam.algorithm import bounds_about
from xrdslam.algorithms.co_slam.config import CoSlamMapConfig, CoSlamMappingConfig, CoSlamTrackingConfig
from xrdslam.algorithms.co_slam.mapping import CoSlamMapping
from xrdslam.algorithms.co_slam.model import CoSlamMap
from xrdslam.algorithms.co_slam.tracking import CoSlamTracking
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.trajectory import Trajectory
from xrdslam.testing import toy_sequence


@pytest.fixture(scope="module")
def fitted() -> CoSlamMap:
    """Return the map of one frame after 120 iterations."""
    torch.manual_seed(0)
    frame = _first_frame()
    frame.pose.set_(frame.T_world_camera_gt)
    model = CoSlamMap(CoSlamMapConfig(log2_rows=13, voxel_m=0.05, weight_smoothness=0.0), bounds_about(frame))
    CoSlamMapping(CoSlamMappingConfig(first_iterations=120, num_pixels=600)).map(frame, model, [])
    return model


def _first_frame() -> Frame:
    return toy_sequence(num_frames=1, width=96, height=72)[0]


def _errors(pose: Tensor, truth: Tensor) -> tuple[float, float]:
    """Return centimetres and degrees between two poses."""
    moved = se3.inverse(truth) @ pose
    return 100 * float(moved[:3, 3].norm()), math.degrees(float(so3.log(moved[:3, :3].double()).norm()))


def test_the_first_frame_is_fitted(fitted: CoSlamMap) -> None:
    """The card of the method asks for 1 cm and 30 dB after 200 iterations of 2048 rays of a larger image."""
    frame = _first_frame()
    seen = fitted.render(frame.camera, frame.T_world_camera_gt)
    assert 100 * float((seen.depth - frame.depth).abs().mean()) < 1.5
    assert -10 * math.log10(float((seen.rgb - frame.rgb).square().mean())) > 27


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_ten_iterations_turn_a_centimetre_and_half_a_degree_back(fitted: CoSlamMap, axis: int) -> None:
    """Adam moves a parameter by its rate a step: ten steps of 1e-3 have a budget of 1 cm and 0.57 degrees, no more.

    Turned about the camera's centre, as published: rotation comes back, centimetres do not (the card's measurement).
    """
    frame = _first_frame()
    truth, shift, turn = frame.T_world_camera_gt, torch.zeros(3), torch.zeros(3)
    shift[axis], turn[(axis + 1) % 3] = 0.01, math.radians(0.5)
    start = truth @ se3.compose(so3.exp(turn), shift)
    frame.pose.set_(start)
    result = CoSlamTracking(CoSlamTrackingConfig(border_px=2, pivot="camera")).track(frame, fitted, _trajectory(truth))
    centimetres, degrees = _errors(result.T_world_camera, truth)
    assert result.iterations == 10
    assert degrees < 0.6 * 0.5
    assert centimetres < 1.5


def _trajectory(pose: Tensor) -> Trajectory:
    trajectory = Trajectory()
    for index in range(2):
        trajectory.append(index, index, pose)
    return trajectory


def test_the_third_frame_has_the_published_iterations_and_the_second_more(fitted: CoSlamMap) -> None:
    frame = _first_frame()
    frame.pose.set_(frame.T_world_camera_gt)
    tracking, lonely = CoSlamTracking(CoSlamTrackingConfig(border_px=2, num_pixels=64)), Trajectory()
    lonely.append(0, 0, frame.T_world_camera_gt)
    assert tracking.track(frame, fitted, lonely).iterations == 60
    assert tracking.track(frame, fitted, _trajectory(frame.T_world_camera_gt)).iterations == 10
