"""SplaTAM's tracker finds a small motion, and says when it is lost."""

import math
from typing import Any

import pytest
import torch

from xrdslam.algorithms.splatam.config import SplatamMapConfig, SplatamTrackingConfig
from xrdslam.algorithms.splatam.model import GaussianMap
from xrdslam.algorithms.splatam.tracking import SplatamTracking
from xrdslam.core.batch import ImageBatch
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import so3
from xrdslam.core.optimisation import GroupedOptimiser
from xrdslam.core.trajectory import Trajectory


def fitted_map(frame: Frame, iterations: int = 40) -> GaussianMap:
    model = GaussianMap(SplatamMapConfig(), scene_radius_m=1.0)
    model.extend(frame, torch.eye(4))
    optimiser = GroupedOptimiser(model.parameter_groups())
    for iteration in range(iterations):
        sum(model.losses(ImageBatch(frame, torch.eye(4)), "mapping").values()).backward()  # type: ignore[union-attr]
        optimiser.step(iteration)
    return model


def test_a_centimetre_is_found_to_a_millimetre(world: Any) -> None:
    """Replica's rates and iterations, from 1 cm away, 320 x 240 px (a pixel of the wall is 10 mm wide).

    Measured 0.85 to 1.02 mm by the number of threads: half a step of Adam, which is 2 mm.
    """
    sharp = type(world)(scale=4)
    model = fitted_map(sharp.look(torch.eye(4)), 200)
    truth = world.moved(x=0.006, y=-0.005, z=0.006)
    result = SplatamTracking(SplatamTrackingConfig()).track(sharp.look(truth, 1), model, Trajectory())
    error = torch.linalg.inv(truth.double()) @ result.T_world_camera.double()
    assert not result.is_lost
    assert error[:3, 3].norm() < 0.0015
    assert so3.log(error[:3, :3]).norm() < math.radians(0.05)


def test_tracking_leaves_the_map_untouched_and_without_gradients(world: Any, first_frame: Frame) -> None:
    model = fitted_map(first_frame, 2)
    for parameter in model.parameters():
        parameter.grad = None
    before = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    SplatamTracking(SplatamTrackingConfig(iterations=3)).track(world.look(world.moved(x=0.01), 1), model, Trajectory())
    assert all(torch.equal(before[name], tensor) for name, tensor in model.state_dict().items())
    assert all(parameter.grad is None for parameter in model.parameters())


def test_a_view_that_the_map_does_not_explain_is_lost_and_says_so(world: Any, first_frame: Frame) -> None:
    model = fitted_map(first_frame, 1)
    frame = world.look(torch.eye(4), 1)
    frame.pose.set_(world.moved(turn=1.2))  # predicted to look away from everything mapped
    result = SplatamTracking(SplatamTrackingConfig(iterations=2)).track(frame, model, Trajectory())
    assert result.is_lost
    assert "explains" in result.reason


def test_without_a_map_every_frame_is_lost(first_frame: Frame) -> None:
    model = GaussianMap(SplatamMapConfig(), 1.0)
    assert SplatamTracking(SplatamTrackingConfig()).track(first_frame, model, Trajectory()).is_lost


@pytest.mark.parametrize("depth", [0.0, float("nan")])
def test_a_frame_without_usable_depth_does_not_crash(world: Any, first_frame: Frame, depth: float) -> None:
    model = fitted_map(first_frame, 1)
    frame = world.look(torch.eye(4), 1)
    frame.depth.fill_(depth)
    result = SplatamTracking(SplatamTrackingConfig(iterations=2)).track(frame, model, Trajectory())
    assert torch.isfinite(result.T_world_camera).all()


def test_the_camera_of_the_little_world_is_what_the_tests_assume(world: Any) -> None:
    assert world.look(torch.eye(4)).depth.unique().tolist() == [1.5, 2.5]
    assert (world.camera.width, world.camera.height) == (80, 60)
