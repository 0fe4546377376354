"""Rigid motions: the group's axioms, and what is refused as not rigid."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from xrdslam.core.geometry import se3, so3

coordinates = st.floats(-2, 2, width=32)
motions = st.tuples(*[coordinates] * 6).map(
    lambda v: se3.compose(so3.exp(torch.tensor(v[:3]).double()), torch.tensor(v[3:]).double())
)
ATOL = 4e-14  # products of three matrices with entries below 2 * sqrt(3) + 2: about 30 eps


@settings(deadline=None, max_examples=60)
@given(motions, motions, motions)
def test_motions_are_a_group(T_a_b: Tensor, T_b_c: Tensor, T_c_d: Tensor) -> None:
    identity = torch.eye(4, dtype=torch.float64)
    torch.testing.assert_close(T_a_b @ se3.inverse(T_a_b), identity, rtol=0, atol=ATOL)
    torch.testing.assert_close(se3.inverse(T_a_b), torch.linalg.inv(T_a_b), rtol=0, atol=ATOL)
    product = se3.inverse(T_a_b @ T_b_c)
    torch.testing.assert_close(product, se3.inverse(T_b_c) @ se3.inverse(T_a_b), rtol=0, atol=ATOL)
    assert se3.is_rigid(T_a_b @ T_b_c @ T_c_d, tolerance=1e-13)


@settings(deadline=None, max_examples=60)
@given(motions, motions)
def test_points_go_through_frames_one_after_the_other(T_a_b: Tensor, T_b_c: Tensor) -> None:
    points_c = torch.tensor([[0.0, 0.0, 0.0], [1.0, -2.0, 0.5]], dtype=torch.float64)
    points_a = se3.transform(T_a_b, se3.transform(T_b_c, points_c))
    torch.testing.assert_close(points_a, se3.transform(T_a_b @ T_b_c, points_c), rtol=0, atol=ATOL)
    torch.testing.assert_close(
        (points_a[0] - points_a[1]).norm(), (points_c[0] - points_c[1]).norm(), rtol=0, atol=ATOL
    )


def test_the_origin_of_b_in_a_is_the_translation() -> None:
    T_a_b = se3.compose(so3.exp(torch.tensor([0.1, 0.2, 0.3])), torch.tensor([1.0, 2.0, 3.0]))
    assert torch.equal(se3.transform(T_a_b, torch.zeros(1, 3))[0], torch.tensor([1.0, 2.0, 3.0]))
    assert torch.equal(T_a_b[3], torch.tensor([0.0, 0.0, 0.0, 1.0]))


def test_batches_are_their_elements_and_may_be_empty() -> None:
    batch = se3.compose(so3.exp(torch.randn(4, 3)), torch.randn(4, 3))
    for one, inverted in zip(batch, se3.inverse(batch), strict=True):
        torch.testing.assert_close(se3.inverse(one), inverted)
    assert se3.inverse(torch.zeros(0, 4, 4)).shape == (0, 4, 4)
    assert se3.transform(batch[0], torch.zeros(0, 3)).shape == (0, 3)
    assert se3.transform(batch[0], torch.zeros(2, 5, 3)).shape == (2, 5, 3)


def test_inverse_and_transform_have_gradients() -> None:
    T = se3.compose(so3.exp(torch.tensor([0.1, 0.2, 0.3]).double()), torch.ones(3).double()).requires_grad_()
    assert torch.autograd.gradcheck(se3.inverse, T)
    assert torch.autograd.gradcheck(se3.transform, (T, torch.ones(2, 3).double().requires_grad_()))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_rigid_motion_is_rigid(dtype: torch.dtype) -> None:
    T = se3.compose(so3.exp(torch.tensor([0.5, -2.0, 1.0], dtype=dtype)), torch.tensor([100.0, 0, -3], dtype=dtype))
    assert se3.is_rigid(T)
    assert se3.is_rigid(T, tolerance=1e-6)


def mirrored(T: Tensor) -> Tensor:
    return T @ torch.diag(torch.tensor([1.0, 1.0, -1.0, 1.0]))


def scaled(T: Tensor) -> Tensor:
    return T @ torch.diag(torch.tensor([1.002, 1.002, 1.002, 1.0]))


def sheared(T: Tensor) -> Tensor:
    T = T.clone()
    T[:3, 0] += 0.01 * T[:3, 1]
    return T


def with_nan(T: Tensor) -> Tensor:
    T = T.clone()
    T[0, 3] = torch.nan
    return T


def at_infinity(T: Tensor) -> Tensor:
    T = T.clone()
    T[2, 3] = torch.inf
    return T


def transposed(T: Tensor) -> Tensor:
    return T.mT


def collapsed(T: Tensor) -> Tensor:
    return torch.zeros_like(T)


@pytest.mark.parametrize("spoil", [mirrored, scaled, sheared, with_nan, at_infinity, transposed, collapsed])
def test_what_is_not_rigid_is_refused(spoil: object) -> None:
    T = se3.compose(so3.exp(torch.tensor([0.5, -2.0, 1.0])), torch.tensor([1.0, 2.0, -3.0]))
    assert callable(spoil)
    assert not se3.is_rigid(spoil(T))
