"""Rotations: against the matrix exponential, by round trips, by their axioms; at every switch, in both precisions."""

import math

import pytest
import scipy.linalg
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from torch import Tensor

from xrdslam.core.geometry import so3

PRECISIONS = [(torch.float32, 6e-7), (torch.float64, 1.2e-15)]  # 5 eps: each entry is a sum of five rounded terms <= 1
ANGLES = [0.0, 1e-8, 1e-3, 1.0, math.pi - 1e-3, math.pi - 1e-6, math.pi]
AXES = [[1.0, 2.0, -2.0], [0.0, 0.0, 3.0], [-3.0, 0.0, 0.0], [0.0, -3.0, 0.0]]  # of length 3
DTYPES = [torch.float32, torch.float64]

vectors = st.tuples(*[st.floats(-2, 2, width=32)] * 3).map(lambda v: torch.tensor(v, dtype=torch.float64))


def switch(dtype: torch.dtype) -> float:
    """Return the angle [rad] below which the series takes over."""
    return math.sqrt(torch.finfo(dtype).eps ** (1 / 3))


def expm(omega: Tensor) -> Tensor:
    """The independent twin: scipy's Pade approximation (torch's own is 7e-12 off at an angle of 0.0246 in float64)."""
    return torch.from_numpy(scipy.linalg.expm(so3.skew(omega.double()).numpy()))


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("side", [1e-4, 0.5, 0.999, 1.001, 2.0, 10.0])
@pytest.mark.parametrize(("dtype", "atol"), PRECISIONS)
def test_exp_agrees_with_the_matrix_exponential_across_the_series_switch(
    dtype: torch.dtype, atol: float, side: float, axis: list[float]
) -> None:
    omega = (side * switch(dtype) / 3 * torch.tensor(axis, dtype=torch.float64)).to(dtype)
    torch.testing.assert_close(so3.exp(omega).double(), expm(omega), rtol=0, atol=atol)


@pytest.mark.parametrize("angle", [1.0, 3.0, math.pi, 4.0, 2 * math.pi, 20.0])
@pytest.mark.parametrize(("dtype", "atol"), PRECISIONS)
def test_exp_agrees_with_quaternions_at_large_angles(dtype: torch.dtype, atol: float, angle: float) -> None:
    omega = (angle / 3 * torch.tensor(AXES[0], dtype=torch.float64)).to(dtype)
    worst = atol * max(1.0, angle)  # |omega| is rounded: eps * angle in the argument of sine and cosine
    twin = torch.from_numpy(Rotation.from_rotvec(omega.double().numpy()).as_matrix())  # by way of the quaternion
    torch.testing.assert_close(so3.exp(omega).double(), twin, rtol=0, atol=worst)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("dtype", DTYPES)
def test_log_undoes_exp(dtype: torch.dtype, angle: float, axis: list[float]) -> None:
    """At half a turn omega and -omega are one rotation: there the rotations are compared, not the vectors."""
    omega = (angle / 3 * torch.tensor(axis, dtype=torch.float64)).to(dtype)
    rotation = so3.exp(omega)
    found = so3.log(rotation)
    eps = torch.finfo(dtype).eps
    torch.testing.assert_close(so3.exp(found), rotation, rtol=0, atol=16 * eps)  # two conversions of about 5 eps each
    assert float(found.norm()) <= math.pi + 4 * eps
    if angle < math.pi - 1e-5:
        torch.testing.assert_close(found, omega, rtol=0, atol=16 * eps)


@pytest.mark.parametrize("dtype", DTYPES)
def test_small_rotations_keep_their_relative_accuracy(dtype: torch.dtype) -> None:
    """The logarithm of a small rotation comes from R - R^T, not from the trace, which has forgotten it."""
    omega = torch.tensor([1e-6, -2e-6, 3e-6], dtype=dtype)
    torch.testing.assert_close(so3.log(so3.exp(omega)), omega, rtol=8 * torch.finfo(dtype).eps, atol=0)


def test_identity_is_not_a_dead_point_for_an_optimiser() -> None:
    """dR/d omega_k = generator k at the identity."""
    jacobian = torch.autograd.functional.jacobian(so3.exp, torch.zeros(3))
    generators = so3.skew(torch.eye(3)).permute(1, 2, 0)
    assert torch.equal(jacobian, generators)


@pytest.mark.parametrize(
    "angle", [0.0, 1e-9, *(side * switch(torch.float64) for side in (0.5, 0.999, 1.001)), 1.0, math.pi, 4.0]
)
def test_exp_has_the_gradient_of_finite_differences(angle: float) -> None:
    omega = (angle / 3 * torch.tensor(AXES[0], dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(so3.exp, omega, eps=1e-6, atol=1e-8)  # h^2/6 + eps/h = 2e-10


@pytest.mark.parametrize("side", [0.5, 0.999, 1.001, 2.0])
def test_the_float32_gradient_is_right_on_both_sides_of_the_switch(side: float) -> None:
    """d/dt2 of sin(t)/t loses eps/t^2 relative; times 2 omega W, of size t^2/3, that is a few eps."""
    omega = side * switch(torch.float32) / 3 * torch.tensor(AXES[0])
    found = torch.autograd.functional.jacobian(so3.exp, omega)
    exact = torch.autograd.functional.jacobian(so3.exp, omega.double())
    torch.testing.assert_close(found.double(), exact, rtol=0, atol=2e-6)  # measured 3e-7 at worst


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 2.4e-3, 2.5e-3, 5e-3, 1.0, 3.0, math.pi - 1e-3])
def test_log_has_the_gradient_of_finite_differences(angle: float) -> None:
    """Along rotations: d log(R exp(w)) / dw at w = 0."""
    start = so3.exp(angle / 3 * torch.tensor(AXES[0], dtype=torch.float64))
    step = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda w: so3.log(start @ so3.exp(w)), step, eps=1e-6, atol=1e-7)


@pytest.mark.parametrize("dtype", DTYPES)
def test_there_and_back_has_the_identity_for_a_jacobian_at_the_identity(dtype: torch.dtype) -> None:
    jacobian = torch.autograd.functional.jacobian(lambda w: so3.log(so3.exp(w)), torch.zeros(3, dtype=dtype))
    torch.testing.assert_close(jacobian, torch.eye(3, dtype=dtype))


@pytest.mark.parametrize("largest", [0, 1, 2, 3])
@pytest.mark.parametrize("dtype", DTYPES)
def test_each_of_shepperds_branches_gives_the_quaternion_back(dtype: torch.dtype, largest: int) -> None:
    quat_wxyz = torch.tensor([0.2, -0.25, 0.3, 0.15], dtype=dtype)
    quat_wxyz[largest] = 0.9
    quat_wxyz = quat_wxyz / quat_wxyz.norm()
    rotation = so3.from_quat_wxyz(quat_wxyz)
    atol = 8 * torch.finfo(dtype).eps
    torch.testing.assert_close(so3.to_quat_wxyz(rotation), quat_wxyz, rtol=0, atol=atol)
    torch.testing.assert_close(
        so3.to_quat_wxyz(rotation.expand(2, 3, 3, 3)), quat_wxyz.expand(2, 3, 4), rtol=0, atol=atol
    )


@pytest.mark.parametrize("axis", [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.6, -0.8, 0.0]])
@pytest.mark.parametrize("dtype", DTYPES)
def test_half_turns_are_rotations_about_their_axis(dtype: torch.dtype, axis: list[float]) -> None:
    """R = 2 a a^T - I: w is 0, the trace formula divides by it."""
    a = torch.tensor(axis, dtype=dtype)
    rotation = 2 * torch.outer(a, a) - torch.eye(3, dtype=dtype)
    omega = so3.log(rotation)
    torch.testing.assert_close(omega.norm(), torch.tensor(math.pi, dtype=dtype))
    torch.testing.assert_close(so3.exp(omega), rotation, rtol=0, atol=16 * torch.finfo(dtype).eps)


def test_quaternions_of_any_length_and_sign_are_one_rotation() -> None:
    quat_wxyz = torch.tensor([0.3, -0.5, 0.1, 0.7], dtype=torch.float64)
    rotation = so3.from_quat_wxyz(quat_wxyz)
    for factor in (-1.0, 2.0, 1e-3, -1e3):
        torch.testing.assert_close(so3.from_quat_wxyz(factor * quat_wxyz), rotation, rtol=0, atol=1e-15)


def test_the_quaternion_of_a_rotation_vector_is_the_half_angle() -> None:
    found = so3.quat_wxyz_from_rotation_vector(torch.tensor([0.0, 0.0, math.pi / 2], dtype=torch.float64))
    half = math.sqrt(0.5)
    torch.testing.assert_close(found, torch.tensor([half, 0.0, 0.0, half], dtype=torch.float64), rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1.0, math.pi - 1e-3, math.pi])
def test_conversions_have_the_gradient_of_finite_differences(angle: float) -> None:
    start = so3.exp(angle / 3 * torch.tensor(AXES[0], dtype=torch.float64))
    quat_wxyz = so3.to_quat_wxyz(start).requires_grad_()
    assert torch.autograd.gradcheck(so3.from_quat_wxyz, quat_wxyz, eps=1e-6, atol=1e-8)
    sign = 1.0 if angle < math.pi else 0.0  # where w = 0, q and -q meet: only the outer product is smooth
    step = torch.zeros(3, dtype=torch.float64, requires_grad=True)

    def smooth(w: Tensor) -> Tensor:
        q = so3.to_quat_wxyz(start @ so3.exp(w))
        return q if sign else torch.outer(q, q)

    assert torch.autograd.gradcheck(smooth, step, eps=1e-6, atol=1e-7)


def test_nan_stays_nan() -> None:
    nan = torch.tensor([0.1, torch.nan, 0.0])
    assert so3.exp(nan).isnan().any()
    assert so3.log(torch.full((3, 3), torch.nan)).isnan().all()


@settings(deadline=None, max_examples=60)
@given(vectors, vectors)
def test_skew_is_the_cross_product(a: Tensor, b: Tensor) -> None:
    torch.testing.assert_close(so3.skew(a) @ b, torch.linalg.cross(a, b), rtol=0, atol=1e-14)


@settings(deadline=None, max_examples=60)
@given(vectors, vectors, vectors)
def test_rotations_are_a_group_that_keeps_lengths_and_hands(a: Tensor, b: Tensor, v: Tensor) -> None:
    R, S = so3.exp(a), so3.exp(b)
    identity = torch.eye(3, dtype=torch.float64)
    torch.testing.assert_close(R @ R.mT, identity, rtol=0, atol=4e-15)
    torch.testing.assert_close(so3.exp(-a), R.mT, rtol=0, atol=4e-15)
    torch.testing.assert_close(torch.linalg.det(R @ S), torch.ones((), dtype=torch.float64), rtol=0, atol=1e-14)
    torch.testing.assert_close((R @ v).norm(), v.norm(), rtol=0, atol=1e-14)
    torch.testing.assert_close(R @ a, a, rtol=0, atol=1e-14)  # the axis stays
    torch.testing.assert_close(R @ so3.skew(v) @ R.mT, so3.skew(R @ v), rtol=0, atol=4e-14)


@settings(deadline=None, max_examples=60)
@given(vectors, st.floats(-1, 1), st.floats(-1, 1))
def test_turns_about_one_axis_add_up(a: Tensor, s: float, t: float) -> None:
    torch.testing.assert_close(so3.exp(s * a) @ so3.exp(t * a), so3.exp((s + t) * a), rtol=0, atol=1e-14)


def test_batches_are_their_elements() -> None:
    omega = torch.randn(2, 5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    omega[0, 0] = 0
    rotation = so3.exp(omega)
    for i in range(2):
        for j in range(5):
            torch.testing.assert_close(rotation[i, j], so3.exp(omega[i, j]), rtol=0, atol=2e-15)
            torch.testing.assert_close(so3.log(rotation)[i, j], so3.log(rotation[i, j]), rtol=0, atol=2e-15)
    assert so3.exp(torch.zeros(0, 3)).shape == (0, 3, 3)
    assert so3.log(torch.zeros(0, 3, 3)).shape == (0, 3)
