"""A pose that turns about a point of the scene is the same pose, in better parameters."""

import pytest
import torch

from xrdslam.core.geometry import se3, so3
from xrdslam.core.pose import OptimizablePose, PivotedPose, RotationKind

PIVOT = torch.tensor([0.5, -1.0, 4.0], dtype=torch.float64)
T_WORLD_CAMERA = se3.compose(
    so3.exp(torch.tensor([0.3, -0.2, 0.9], dtype=torch.float64)), torch.tensor([1.0, 2.0, -0.5], dtype=torch.float64)
)
POINTS_CAMERA = torch.tensor([[-1.0, -1, 3], [1, -1, 4], [1, 1, 5], [-1, 1, 4], [0, 0, 3]], dtype=torch.float64)


@pytest.mark.parametrize("kind", ["axis_angle", "quaternion"])
@pytest.mark.parametrize("T_world_camera", [torch.eye(4, dtype=torch.float64), T_WORLD_CAMERA])
def test_a_matrix_goes_in_and_comes_out(kind: RotationKind, T_world_camera: torch.Tensor) -> None:
    pose = PivotedPose.about(T_world_camera, PIVOT, kind)
    torch.testing.assert_close(pose.matrix(), T_world_camera, rtol=0, atol=1e-14)
    pose.set_(T_WORLD_CAMERA)
    torch.testing.assert_close(pose.matrix(), T_WORLD_CAMERA, rtol=0, atol=1e-14)


@pytest.mark.parametrize("kind", ["axis_angle", "quaternion"])
def test_turning_leaves_the_pivot_where_the_camera_saw_it(kind: RotationKind) -> None:
    pose = PivotedPose.about(T_WORLD_CAMERA, PIVOT, kind)
    before = se3.transform(se3.inverse(pose.matrix()), PIVOT)
    with torch.no_grad():
        pose.rotation += 0.1 * torch.randn(pose.rotation.shape, dtype=torch.float64, generator=torch.manual_seed(0))
    assert not torch.allclose(pose.matrix(), T_WORLD_CAMERA, atol=1e-3)
    torch.testing.assert_close(se3.transform(se3.inverse(pose.matrix()), PIVOT), before)


@pytest.mark.parametrize("kind", ["axis_angle", "quaternion"])
def test_gradients_agree_with_finite_differences(kind: RotationKind) -> None:
    pose = PivotedPose.about(T_WORLD_CAMERA, PIVOT, kind)

    def moved(rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
        return torch.func.functional_call(pose, {"rotation": rotation, "translation": translation}, ())

    inputs = [p.detach().clone().requires_grad_() for p in (pose.rotation, pose.translation)]
    assert torch.autograd.gradcheck(moved, inputs)


def coupling(pose: OptimizablePose) -> float:
    """Return the largest correlation between a turn and a shift, in how they move points in the camera's frame."""
    points_world = se3.transform(T_WORLD_CAMERA, POINTS_CAMERA)

    def seen(rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
        T = torch.func.functional_call(pose, {"rotation": rotation, "translation": translation}, ())
        return se3.transform(se3.inverse(T), points_world)

    at_rest = (pose.rotation.detach(), pose.translation.detach())
    turns, shifts = (J.reshape(15, -1) for J in torch.func.jacrev(seen, (0, 1))(*at_rest))
    turns, shifts = turns / turns.norm(dim=0), shifts / shifts.norm(dim=0)
    return float((turns.mT @ shifts).abs().max())


def test_about_the_middle_of_the_scene_turns_and_shifts_are_independent() -> None:
    """The reason for the pivot: about the camera's centre a turn is nearly a shift (correlation over 0.9)."""
    middle = se3.transform(T_WORLD_CAMERA, POINTS_CAMERA.mean(0))
    assert coupling(PivotedPose.about(T_WORLD_CAMERA, middle)) < 1e-9
    assert coupling(OptimizablePose.from_matrix(T_WORLD_CAMERA)) > 0.8
