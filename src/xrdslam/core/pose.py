"""A pose that an optimiser can move."""

from collections.abc import Sequence
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from xrdslam.core.errors import DataError
from xrdslam.core.geometry import se3, so3

__all__ = ["OptimizablePose", "PivotedPose", "RotationKind", "move_", "stacked"]

RotationKind = Literal["axis_angle", "quaternion"]


class OptimizablePose(nn.Module):
    """T_world_camera as two parameters: rotation (axis-angle [rad] or quaternion w, x, y, z) and camera centre [m].

    Value and gradient of `matrix` are exact at the identity and near half a turn, in float32 and float64: an optimiser
    that starts at the identity moves (a constant returned there would be a dead point).
    """

    def __init__(
        self,
        rotation: Float[Tensor, " r"],
        translation: Float[Tensor, "3"],
        kind: RotationKind = "axis_angle",
    ) -> None:
        super().__init__()
        expected = 3 if kind == "axis_angle" else 4
        if rotation.shape != (expected,):
            raise ValueError(f"a rotation as {kind} has {expected} numbers, got shape {tuple(rotation.shape)}")
        self.kind = kind
        self.rotation = nn.Parameter(rotation.detach().clone())
        self.translation = nn.Parameter(translation.detach().clone())

    @classmethod
    def from_matrix(cls, T_world_camera: Float[Tensor, "4 4"], kind: RotationKind = "axis_angle") -> "OptimizablePose":
        """Build the pose of a rigid matrix; DataError where the matrix is not finite or not rigid within 1e-3."""
        pose = cls(torch.zeros(3 if kind == "axis_angle" else 4).to(T_world_camera), T_world_camera[:3, 3], kind)
        pose.set_(T_world_camera)
        return pose

    @torch.no_grad()
    def set_(self, T_world_camera: Float[Tensor, "4 4"]) -> None:
        """Move to a rigid matrix in place (the parameters stay the same objects, for an optimiser that holds them)."""
        if not se3.is_rigid(T_world_camera):
            raise DataError(
                f"not a rigid motion: {T_world_camera.tolist()}; "
                "a pose needs finite numbers, an orthonormal right-handed rotation and the bottom row 0 0 0 1"
            )
        exact = T_world_camera[:3, :3].double()  # the conversion divides by small numbers near half a turn
        rotation = so3.log(exact) if self.kind == "axis_angle" else so3.to_quat_wxyz(exact)
        self.rotation.copy_(rotation)
        self.translation.copy_(T_world_camera[:3, 3])

    def rotation_matrix(self) -> Float[Tensor, "3 3"]:
        """Return R_world_camera, differentiable."""
        return so3.exp(self.rotation) if self.kind == "axis_angle" else so3.from_quat_wxyz(self.rotation)

    def matrix(self) -> Float[Tensor, "4 4"]:
        """Return T_world_camera, differentiable in both parameters."""
        return se3.compose(self.rotation_matrix(), self.translation)

    def forward(self) -> Float[Tensor, "4 4"]:
        return self.matrix()

    def parameter_groups(self, lr_rotation: float, lr_translation: float | None = None) -> list[dict[str, Any]]:
        """Return optimiser groups: rotation first; one learning rate for both, or a second one for the translation."""
        lr_second = lr_rotation if lr_translation is None else lr_translation
        return [
            {"name": "pose_rotation", "params": [self.rotation], "lr": lr_rotation},
            {"name": "pose_translation", "params": [self.translation], "lr": lr_second},
        ]


class PivotedPose(OptimizablePose):
    """The same pose, turned about a point of the scene instead of the camera's centre.

    The parameters are those of T_camera_pivot, the world moved so that `pivot_world` is its origin: world-to-camera,
    as SplaTAM optimises, but about the middle of what is seen. A small turn of the camera looks like a small shift:
    about the camera's centre an optimiser has to trade one for the other along a narrow valley, about a point of the
    scene the two are nearly independent.
    """

    pivot_world: Float[Tensor, "3"]

    def __init__(
        self,
        rotation: Float[Tensor, " r"],
        translation: Float[Tensor, "3"],
        kind: RotationKind = "axis_angle",
    ) -> None:
        super().__init__(rotation, translation, kind)
        self.register_buffer("pivot_world", torch.zeros_like(translation))

    @classmethod
    def about(
        cls, T_world_camera: Float[Tensor, "4 4"], pivot_world: Float[Tensor, "3"], kind: RotationKind = "axis_angle"
    ) -> "PivotedPose":
        """Build the pose of a rigid matrix, turned about `pivot_world` [m]."""
        pose = cls(torch.zeros(3 if kind == "axis_angle" else 4).to(T_world_camera), T_world_camera[:3, 3], kind)
        pose.pivot_world.copy_(pivot_world)
        pose.set_(T_world_camera)
        return pose

    @torch.no_grad()
    def set_(self, T_world_camera: Float[Tensor, "4 4"]) -> None:
        """Move to a rigid matrix in place; the pivot stays."""
        T_pivot_camera = T_world_camera.clone()
        T_pivot_camera[:3, 3] -= self.pivot_world
        super().set_(se3.inverse(T_pivot_camera))

    def matrix(self) -> Float[Tensor, "4 4"]:
        """Return T_world_camera, differentiable in both parameters."""
        rotation_world_camera = self.rotation_matrix().mT
        return se3.compose(rotation_world_camera, self.pivot_world - rotation_world_camera @ self.translation)


def stacked(poses: Sequence[OptimizablePose]) -> Float[Tensor, "n 4 4"]:
    """Return T_world_camera of several poses, worked out at once where they have the same parameters."""
    if not _are_alike(poses):
        return torch.stack([pose.matrix() for pose in poses])
    rotations = torch.stack([pose.rotation for pose in poses])
    exponential = so3.exp if poses[0].kind == "axis_angle" else so3.from_quat_wxyz
    return se3.compose(exponential(rotations), torch.stack([pose.translation for pose in poses]))


@torch.no_grad()
def move_(poses: Sequence[OptimizablePose], T_world_cameras: Float[Tensor, "n 4 4"]) -> None:
    """Move poses to rigid matrices in place, as `set_` does, worked out at once where they have the same parameters."""
    if not _are_alike(poses) or not se3.is_rigid(T_world_cameras):
        for pose, matrix in zip(poses, T_world_cameras, strict=True):
            pose.set_(matrix)
        return
    logarithm = so3.log if poses[0].kind == "axis_angle" else so3.to_quat_wxyz
    rotations = logarithm(T_world_cameras[:, :3, :3].double())
    for pose, rotation, center in zip(poses, rotations, T_world_cameras[:, :3, 3], strict=True):
        pose.rotation.copy_(rotation)
        pose.translation.copy_(center)


def _are_alike(poses: Sequence[OptimizablePose]) -> bool:
    """Say whether there are poses, and all are plain ones of one kind."""
    kinds = {(type(pose), pose.kind) for pose in poses}
    return kinds in ({(OptimizablePose, "axis_angle")}, {(OptimizablePose, "quaternion")})
