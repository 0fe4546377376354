"""A box-shaped room seen from inside, with exact depth; and a map that is not there."""

from collections.abc import Callable

import pytest
import torch

from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.model import Model
from xrdslam.core.trajectory import Trajectory

CAMERA = Camera(130.0, 130.0, 79.5, 59.5, 160, 120)
LOW, HIGH = torch.tensor([-0.9, -0.7, -1.0]), torch.tensor([0.8, 0.6, 2.2])
"""Corners of the room [m]: five walls are in view, at round coordinates, none symmetric to another."""


class NoMap(Model):
    """Nothing."""

    size = 0  # type: ignore[assignment]  # a constant in place of the property

    def extend(self, frame: Frame, T_world_camera: torch.Tensor) -> int:
        return 0


def depth_of_room(T_world_camera: torch.Tensor) -> torch.Tensor:
    """Return the depth of the walls: along a ray, the first of the three walls that its direction heads for."""
    directions = CAMERA.rays().double() @ T_world_camera[:3, :3].double().mT
    origin = T_world_camera[:3, 3].double()
    walls = torch.where(directions > 0, HIGH.double(), LOW.double())
    return ((walls - origin) / directions).amin(-1).float()


def pose(translation: list[float], rotation: list[float]) -> torch.Tensor:
    """Return T_world_camera of a camera centre [m] and a rotation vector [rad]."""
    return se3.compose(so3.exp(torch.tensor(rotation)), torch.tensor(translation))


def path(index: int) -> torch.Tensor:
    """Return the pose on a winding path, about 2.5 cm and 1.3 degrees a frame."""
    t = index / 10
    return pose([0.25 * t, 0.05 * t * t, 0.1 * t], [0.05 * t, 0.2 * t, -0.1 * t * t])


@pytest.fixture
def look() -> Callable[..., Frame]:
    """Return what makes the frame of the room from a pose, its ground truth known."""

    def frame(index: int, T_world_camera: torch.Tensor, predicted: torch.Tensor | None = None) -> Frame:
        made = Frame(index, index, CAMERA, torch.zeros(120, 160, 3), depth_of_room(T_world_camera), T_world_camera)
        made.pose.set_(T_world_camera if predicted is None else predicted)
        return made

    return frame


@pytest.fixture
def walk(look: Callable[..., Frame]) -> Callable[..., Frame]:
    """Return what makes frame `index` of the winding path, predicted where the frame before was."""
    return lambda index: look(index, path(index), path(index - 1))


@pytest.fixture
def no_map() -> Model:
    return NoMap()


@pytest.fixture
def trajectory() -> Trajectory:
    return Trajectory()
