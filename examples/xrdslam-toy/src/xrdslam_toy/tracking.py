"""The toy's tracker: each frame registered to the one before by projective point-to-plane ICP."""

from typing import NamedTuple

import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.config import TrackingConfig
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3, so3
from xrdslam.core.model import Model
from xrdslam.core.tracking import TrackingMethod, TrackingResult
from xrdslam.core.trajectory import Trajectory
from xrdslam_toy.config import ToyTrackingConfig

__all__ = ["ToyTracking"]

DAMPING = 1e-3
"""Part of the squared length of a normal, per pair."""


class Surface(NamedTuple):
    """A frame's depth as points with normals, in its camera's axes; a normal of 0 marks a pixel without one."""

    points: Float64[Tensor, "h w 3"]
    normals: Float64[Tensor, "h w 3"]
    T_world_camera: Float64[Tensor, "4 4"]


class ToyTracking(TrackingMethod):
    """ICP: pair by projection, minimise the distances to the partners' planes, repeat."""

    needs = frozenset({"rgb", "depth"})

    def __init__(self, config: TrackingConfig, seed: int = 0) -> None:
        super().__init__(config, seed)
        self.settings: ToyTrackingConfig = self.config
        self.last: Surface | None = None

    def integrate(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> None:
        """Keep the frame's surface: the next one is registered to it."""
        points, normals = surface_of(frame)
        self.last = Surface(points, normals, T_world_camera.double())

    def track(self, frame: Frame, model: Model, trajectory: Trajectory) -> TrackingResult:
        """Refine the predicted pose; lost where too few points find a partner."""
        predicted = frame.pose.matrix().detach()
        points, normals = surface_of(frame)
        points = points[normals.any(-1)]
        if self.last is None or not len(points):
            return TrackingResult(predicted, is_lost=True, reason="no depth to register")
        T_last_camera = se3.inverse(self.last.T_world_camera) @ predicted.double()
        for _ in range(self.settings.iterations):
            pairs = self._pair(se3.transform(T_last_camera, points), frame.camera)
            share = len(pairs.points) / len(points)
            if share < self.settings.min_share or len(pairs.points) < 6:
                return TrackingResult(predicted, is_lost=True, reason=f"{share:.0%} of the points have a partner")
            T_last_camera = pairs.step() @ T_last_camera
        found = _orthonormal(self.last.T_world_camera @ T_last_camera).to(predicted)
        return TrackingResult(found, iterations=self.settings.iterations, loss=float(pairs.residuals().abs().mean()))

    def _pair(self, points: Float64[Tensor, "n 3"], camera: Camera) -> "Pairs":
        """Pair each point with what the last frame saw in that direction."""
        assert self.last is not None, "there is a surface to register to"
        pixels, z = camera.project(points)
        is_inside = camera.contains(pixels) & (z > 0)
        column, row = pixels[is_inside].round().long().unbind(-1)
        points, partners, normals = points[is_inside], self.last.points[row, column], self.last.normals[row, column]
        is_near = (points - partners).norm(dim=-1) < self.settings.max_distance
        used = is_near & normals.any(-1)
        return Pairs(points[used], partners[used], normals[used])

    def state_dict(self) -> dict[str, Tensor]:
        """Return the surface too: a resumed run registers its next frame to it."""
        return super().state_dict() | (self.last._asdict() if self.last else {})

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        super().load_state_dict(state)
        self.last = Surface(*(state[name] for name in Surface._fields)) if "points" in state else None


class Pairs(NamedTuple):
    """Points, and the planes that they should lie in."""

    points: Float64[Tensor, "n 3"]
    partners: Float64[Tensor, "n 3"]
    normals: Float64[Tensor, "n 3"]

    def residuals(self) -> Float64[Tensor, " n"]:
        """Return the signed distances [m] to the partners' planes."""
        return ((self.points - self.partners) * self.normals).sum(-1)

    def step(self) -> Float64[Tensor, "4 4"]:
        """Return the motion that minimises the squared residuals to first order: r + (p x n) . omega + n . t = 0.

        Damped, so that what the planes leave open (sliding along a wall) stays as predicted.
        """
        jacobian = torch.cat((torch.linalg.cross(self.points, self.normals), self.normals), -1)
        damping = DAMPING * len(self.points) * torch.eye(6, dtype=jacobian.dtype, device=jacobian.device)
        hessian = jacobian.mT @ jacobian + damping
        motion = torch.linalg.solve(hessian, -(jacobian.mT @ self.residuals()))
        return se3.compose(so3.exp(motion[:3]), motion[3:])


def _orthonormal(pose: Float64[Tensor, "4 4"]) -> Float64[Tensor, "4 4"]:
    """Return the pose with its rotation made exact: what chaining frames adds to its error would double with each."""
    return se3.compose(so3.from_quat_wxyz(so3.to_quat_wxyz(pose[:3, :3])), pose[:3, 3])


def surface_of(frame: Frame) -> tuple[Float64[Tensor, "h w 3"], Float64[Tensor, "h w 3"]]:
    """Return camera-frame points [m] and normals; 0 where a neighbour is missing or lies across a jump in depth."""
    assert frame.depth is not None, "an algorithm checks that its frames have depth"
    points = (frame.camera.rays(device=frame.device) * frame.depth[..., None]).double()
    right, down = points[:-1, 1:] - points[:-1, :-1], points[1:, :-1] - points[:-1, :-1]
    normals = torch.zeros_like(points)
    is_smooth = _is_smooth(points)
    normals[:-1, :-1][is_smooth] = torch.nn.functional.normalize(torch.linalg.cross(right, down), dim=-1)[is_smooth]
    return points, normals


def _is_smooth(points: Float64[Tensor, "h w 3"]) -> Bool[Tensor, "h1 w1"]:
    """Say where a pixel and its right and lower neighbours are measured within 5 % of one depth."""
    z = points[..., 2]
    corners = torch.stack((z[:-1, :-1], z[:-1, 1:], z[1:, :-1]))
    low, high = corners.amin(0), corners.amax(0)
    return (low > 0) & (high - low < 0.05 * low)
