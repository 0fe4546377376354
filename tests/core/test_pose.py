"""A pose that an optimiser can move: from the identity too."""

import math

import pytest
import torch
from torch import Tensor

from xrdslam.core.errors import DataError
from xrdslam.core.geometry import se3, so3
from xrdslam.core.pose import OptimizablePose, PivotedPose, RotationKind, move_, stacked

KINDS: list[RotationKind] = ["axis_angle", "quaternion"]
PRECISIONS = [(torch.float32, 1e-6), (torch.float64, 2e-15)]  # about 8 eps


def motion(angle: float, dtype: torch.dtype = torch.float64) -> Tensor:
    omega = angle / 3 * torch.tensor([1.0, 2.0, -2.0], dtype=torch.float64)
    return se3.compose(so3.exp(omega), torch.tensor([0.3, -0.2, 0.5], dtype=torch.float64)).to(dtype)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-3, 1.0, math.pi - 1e-6, math.pi])
@pytest.mark.parametrize(("dtype", "atol"), PRECISIONS)
def test_a_matrix_comes_back(dtype: torch.dtype, atol: float, angle: float, kind: RotationKind) -> None:
    T = motion(angle, dtype)
    pose = OptimizablePose.from_matrix(T, kind)
    assert pose.matrix().dtype == dtype
    torch.testing.assert_close(pose.matrix().detach(), T, rtol=0, atol=atol)
    assert torch.equal(pose().detach(), pose.matrix().detach())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_gradient_at_the_identity_is_not_zero(dtype: torch.dtype, kind: RotationKind) -> None:
    """A turn by w about z moves R[1, 0] by w; half a quaternion component is a quarter of that turn, twice."""
    pose = OptimizablePose.from_matrix(torch.eye(4, dtype=dtype), kind)
    pose.matrix()[1, 0].backward()
    assert pose.rotation.grad is not None
    expected = [0.0, 0.0, 1.0] if kind == "axis_angle" else [0.0, 0.0, 0.0, 2.0]
    assert pose.rotation.grad.tolist() == expected


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("angle", [0.0, 1e-3, 1.0, math.pi - 1e-3, math.pi])
def test_the_gradient_is_that_of_finite_differences(angle: float, kind: RotationKind) -> None:
    pose = OptimizablePose.from_matrix(motion(angle), kind)

    def matrix(rotation: Tensor, translation: Tensor) -> Tensor:
        values = {"rotation": rotation, "translation": translation}
        found = torch.func.functional_call(pose, values)
        assert isinstance(found, Tensor)
        return found

    assert torch.autograd.gradcheck(matrix, (pose.rotation, pose.translation), eps=1e-6, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("angle", [0.3, 2.0])
def test_adam_finds_a_target_from_the_identity(angle: float, kind: RotationKind) -> None:
    """Points seen from the pose are to lie where they lie from the target."""
    points = torch.randn(20, 3, generator=torch.Generator().manual_seed(0))
    target = motion(angle, torch.float32)
    wanted = se3.transform(target, points)
    pose = OptimizablePose.from_matrix(torch.eye(4), kind)
    optimiser = torch.optim.Adam(pose.parameter_groups(4e-2), lr=0.0)
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimiser, 0.985)
    for _ in range(400):
        optimiser.zero_grad()
        (se3.transform(pose.matrix(), points) - wanted).square().mean().backward()
        optimiser.step()
        schedule.step()
    torch.testing.assert_close(pose.matrix().detach(), target, rtol=0, atol=2e-3)  # the last steps are 1e-4 each
    assert se3.is_rigid(pose.matrix().detach(), tolerance=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_setting_a_pose_keeps_the_parameters_that_an_optimiser_holds(kind: RotationKind) -> None:
    pose = OptimizablePose.from_matrix(torch.eye(4), kind)
    held = [id(p) for p in pose.parameters()]
    pose.set_(motion(1.0))
    assert [id(p) for p in pose.parameters()] == held
    torch.testing.assert_close(pose.matrix().detach(), motion(1.0, torch.float32), rtol=0, atol=1e-6)
    assert all(p.requires_grad for p in pose.parameters())


def test_a_pose_does_not_share_memory_with_what_it_was_made_of() -> None:
    T = torch.eye(4)
    pose = OptimizablePose.from_matrix(T)
    T[0, 3] = 5.0
    assert pose.translation.tolist() == [0.0, 0.0, 0.0]


def test_one_learning_rate_for_both_or_two() -> None:
    pose = OptimizablePose.from_matrix(torch.eye(4))
    joint, separate = pose.parameter_groups(1e-3), pose.parameter_groups(1e-3, 1e-2)
    assert [g["lr"] for g in joint] == [1e-3, 1e-3]
    assert [g["lr"] for g in separate] == [1e-3, 1e-2]
    assert [g["params"][0] is p for g, p in zip(separate, (pose.rotation, pose.translation), strict=True)] == [True] * 2
    assert pose.parameter_groups(1e-3, 0.0)[1]["lr"] == 0.0  # no rate is not the same as none given


@pytest.mark.parametrize("spoil", [torch.nan, torch.inf, 1.1, -1.0])
def test_what_is_not_rigid_is_refused_and_the_pose_kept(spoil: float) -> None:
    T = torch.eye(4)
    T[0, 0] = spoil
    with pytest.raises(DataError, match="not a rigid motion"):
        OptimizablePose.from_matrix(T)
    pose = OptimizablePose.from_matrix(motion(1.0))
    before = pose.matrix().detach()
    with pytest.raises(DataError, match="not a rigid motion"):
        pose.set_(T)
    assert torch.equal(pose.matrix().detach(), before)


def test_a_rotation_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ValueError, match="quaternion has 4 numbers"):
        OptimizablePose(torch.zeros(3), torch.zeros(3), "quaternion")


@pytest.mark.parametrize("kinds", [["axis_angle"] * 3, ["quaternion"] * 3, ["axis_angle", "quaternion", "axis_angle"]])
def test_stacked_poses_are_the_poses(kinds: list[RotationKind]) -> None:
    poses = [
        OptimizablePose.from_matrix(motion(angle), kind) for angle, kind in zip((0.0, 0.3, 3.1), kinds, strict=True)
    ]
    expected = torch.stack([pose.matrix() for pose in poses])
    torch.testing.assert_close(stacked(poses), expected, rtol=0, atol=1e-15)
    pivoted = [PivotedPose.about(motion(0.3), torch.tensor([1.0, 2.0, 3.0]).double()) for _ in range(2)]
    torch.testing.assert_close(stacked(pivoted), torch.stack([pose.matrix() for pose in pivoted]), rtol=0, atol=0)


@pytest.mark.parametrize(
    "kinds", [("axis_angle", "axis_angle"), ("quaternion", "quaternion"), ("axis_angle", "quaternion")]
)
def test_poses_moved_together_are_where_each_would_be_moved_to(kinds: tuple[RotationKind, RotationKind]) -> None:
    g = torch.Generator().manual_seed(0)
    targets = se3.compose(so3.exp(torch.randn(2, 3, generator=g)), torch.randn(2, 3, generator=g))
    poses = [OptimizablePose.from_matrix(torch.eye(4), kind) for kind in kinds]
    parameters = [pose.rotation for pose in poses]
    move_(poses, targets)
    torch.testing.assert_close(stacked(poses).detach(), targets)
    assert all(pose.rotation is parameter for pose, parameter in zip(poses, parameters, strict=True))
    targets[1, 0, 0] = torch.nan
    with pytest.raises(DataError, match="not a rigid motion"):
        move_(poses, targets)
