"""A little world for SplaTAM's tests: a textured wall with a box in front of it, exact depth."""

import math

import pytest
import torch

from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3


class World:
    """A wall at z = 2.5 m and a box in front of it whose face is at z = 1.5 m, both painted with waves."""

    def __init__(self, scale: int = 1) -> None:
        self.camera = Camera(60.0, 60.0, 39.5, 29.5, 80, 60).resized(80 * scale, 60 * scale)

    def look(self, T_world_camera: torch.Tensor, index: int = 0) -> Frame:
        """Return the frame of a pose."""
        directions = self.camera.rays().double() @ T_world_camera[:3, :3].double().mT
        origin = T_world_camera[:3, 3].double()
        depth = torch.full(directions.shape[:2], math.inf, dtype=torch.float64)
        for z, half in ((2.5, math.inf), (1.5, 0.35)):
            t = (z - origin[2]) / directions[..., 2]
            hit = origin + t[..., None] * directions
            inside = (t > 0) & (hit[..., 0].abs() < half) & (hit[..., 1].abs() < half)
            depth = torch.where(inside & (t < depth), t, depth)
        points = origin + depth[..., None] * directions
        return Frame(index, index * 10**8, self.camera, texture(points).float(), depth.float(), T_world_camera)

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: float = 0.0) -> torch.Tensor:
        """Return T_world_camera shifted [m] and turned about y [rad]."""
        return se3.compose(so3.exp(torch.tensor([0.0, turn, 0.0])), torch.tensor([x, y, z]))


def texture(points: torch.Tensor) -> torch.Tensor:
    x, y, z = points.unbind(-1)
    waves = (5 * x + 2 * y, 4 * y + 3 * z + 1, 6 * x + 1.5 * y + 2), (17 * x + 9 * y, 19 * x, 13 * x + 11 * y)
    return torch.stack([0.5 + 0.3 * torch.sin(a) + 0.15 * torch.sin(b) for a, b in zip(*waves, strict=True)], -1)


@pytest.fixture
def world() -> World:
    return World()


@pytest.fixture
def first_frame(world: World) -> Frame:
    return world.look(torch.eye(4))
