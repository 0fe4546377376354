"""Matrix products of small networks over many rows, by whichever library is quicker.

On CPUs torch's `addmm` is MKL's, whose float32 runs at a half to a third of oneDNN's speed on AMD's processors since
Zen 5 (before, they are even); oneDNN, which torch carries along as well, also applies a ReLU for nothing. Both round
differently in the last places, nothing else. The gradient of a weight, left^T right, is MKL's: oneDNN copies left.
"""

import functools
from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["linear", "linear_torch"]


def linear(
    rows: Float[Tensor, "n i"],
    weight: Float[Tensor, "o i"],
    bias: Float[Tensor, " o"] | None = None,
    relu: bool = False,
) -> Float[Tensor, "n o"]:
    """Return rows weight^T + bias, negative ones as 0 where asked. Carries no gradient: for hand-written passes."""
    fast = _onednn()
    if fast is None or rows.device.type != "cpu" or rows.dtype not in (torch.float32, torch.bfloat16) or not len(rows):
        return linear_torch(rows, weight, bias, relu)
    with torch.no_grad():
        return fast(_dense(rows), _dense(weight), bias, "relu" if relu else "none", [], "")  # type: ignore[no-any-return]


def linear_torch(rows: Tensor, weight: Tensor, bias: Tensor | None = None, relu: bool = False) -> Tensor:
    """Multiply: the twin."""
    with torch.no_grad():
        out = rows @ weight.mT
        out = out if bias is None else out + bias
        return out.relu() if relu else out


def _dense(matrix: Tensor) -> Tensor:
    """Return the matrix without gaps in memory: for a view of some columns oneDNN has but a reference loop."""
    return matrix if matrix.is_contiguous() or matrix.mT.is_contiguous() else matrix.contiguous()


@functools.cache
def _onednn() -> Callable[..., Any] | None:
    """Return torch's binding of oneDNN's linear layer, or None where this torch has none."""
    if not torch.backends.mkldnn.is_available():  # type: ignore[no-untyped-call]  # torch leaves it untyped
        return None
    found: Callable[..., Any] | None = getattr(torch.ops.mkldnn, "_linear_pointwise", None)
    return found
