"""Layers of small networks: both libraries give one result."""

import pytest
import torch

from xrdslam.ops import dense_layers
from xrdslam.ops.dense_layers import linear, linear_torch


@pytest.mark.parametrize("rows", [0, 1, 777])
@pytest.mark.parametrize("relu", [False, True])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_layers_equal_their_twin(rows: int, relu: bool, dtype: torch.dtype) -> None:
    generator = torch.Generator().manual_seed(0)
    inputs, weight = torch.randn(rows, 16, generator=generator), torch.randn(16, 128, generator=generator)
    bias = torch.randn(128, generator=generator)
    given = inputs.to(dtype), weight.to(dtype).mT, bias.to(dtype)  # a transposed view, as in a backward pass
    torch.testing.assert_close(linear(*given, relu), linear_torch(*given, relu), rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(linear(*given[:2]), linear_torch(*given[:2]), rtol=1e-5, atol=1e-5)


def test_bits_do_not_depend_on_the_number_of_threads() -> None:
    generator = torch.Generator().manual_seed(0)
    inputs, weight = torch.randn(4096, 128, generator=generator), torch.randn(128, 128, generator=generator)
    before, results = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            results.append(linear(inputs, weight, weight[0], relu=True))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(*results)


def test_layers_carry_no_gradient() -> None:
    inputs = torch.randn(5, 4, requires_grad=True)
    assert not linear(inputs, torch.randn(3, 4)).requires_grad


def test_what_onednn_is_given_has_no_gaps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A view of some columns sends it into a reference loop, a thousand times slower."""
    seen: list[torch.Tensor] = []

    def noting(rows: torch.Tensor, weight: torch.Tensor, *_: object) -> torch.Tensor:
        seen.extend((rows, weight))
        return linear_torch(rows, weight)

    monkeypatch.setattr(dense_layers, "_onednn", lambda: noting)
    wide, weight = torch.randn(9, 10), torch.randn(4, 10)
    torch.testing.assert_close(linear(wide[:, :6], weight[:, :6]), wide[:, :6] @ weight[:, :6].mT)
    assert linear(torch.randn(9, 4), weight[:, :6].mT).shape == (9, 6)
    assert len(seen) == 4
    assert all(tensor.is_contiguous() or tensor.mT.is_contiguous() for tensor in seen)
