"""The shapes in signatures are checked in this very test run: a wrong one is refused."""

import pytest
import torch
from jaxtyping import TypeCheckError

from xrdslam.core.geometry import se3


def test_a_wrong_shape_is_refused() -> None:
    se3.transform(torch.eye(4), torch.zeros(5, 3))
    with pytest.raises(TypeCheckError, match="points_b"):
        se3.transform(torch.eye(4), torch.zeros(5, 2))


def test_a_wrong_dtype_is_refused() -> None:
    with pytest.raises(TypeCheckError, match="T_a_b"):
        se3.inverse(torch.eye(4, dtype=torch.int64))
