"""The contract of a kernel with a plain-torch twin: subclass, name both, draw inputs, and pytest runs the rest."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor

__all__ = ["KernelContract"]

Inputs = tuple[Any, ...]
Outputs = Tensor | tuple[Tensor, ...]


class KernelContract:
    """What every fast kernel must keep to: it is its twin, only faster.

    ```python
    class TestTrilinear(KernelContract):
        def kernel(self, grid: Tensor, points: Tensor) -> Tensor:
            return dense_grid.sample(grid, points)

        def twin(self, grid: Tensor, points: Tensor) -> Tensor:
            return dense_grid.sample_torch(grid, points)

        def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> tuple[Tensor, ...]: ...
    ```

    Inputs whose gradient is to be checked have `requires_grad`. Outputs are a tensor or a tuple of tensors; those of
    integers or booleans must be equal.
    """

    rtol: ClassVar[float] = 1e-4
    """Largest difference from the twin, relative to the largest magnitude of that output or gradient."""
    seeds: ClassVar[tuple[int, ...]] = (0, 1)
    is_smooth: ClassVar[bool] = True
    """False where finite differences make no sense (the function jumps, or float32 is built in)."""
    finite_difference_rtol: ClassVar[float] = 1e-5

    def kernel(self, *inputs: Any, **_: Any) -> Outputs:  # noqa: ANN401  # a subclass names its own
        """Call the fast path."""
        raise NotImplementedError

    def twin(self, *inputs: Any, **_: Any) -> Outputs:  # noqa: ANN401  # a subclass names its own
        """Call the plain torch path."""
        raise NotImplementedError

    def inputs(self, generator: torch.Generator, dtype: torch.dtype) -> Inputs:
        """Draw inputs of a size that takes milliseconds, degenerate elements among them."""
        raise NotImplementedError

    def empty_inputs(self) -> Inputs | None:
        """Return inputs without elements, where that is a case."""
        return None

    def test_forward_equals_the_twin(self) -> None:
        for seed in self.seeds:
            inputs = self._inputs(seed)
            for position, (fast, slow) in enumerate(_pairs(self.kernel(*inputs), self.twin(*inputs))):
                _assert_close(fast, slow, self.rtol, f"output {position} (seed {seed})")

    def test_backward_equals_the_twin(self) -> None:
        for seed in self.seeds:
            inputs = self._inputs(seed)
            if not _movable(inputs):
                pytest.skip("no input requires a gradient")
            fast, slow = (self._gradients(call, inputs, seed) for call in (self.kernel, self.twin))
            assert any(bool((g != 0).any()) for g in slow), "all of the twin's gradients are zero: the inputs miss it"
            for position, pair in enumerate(zip(fast, slow, strict=True)):
                _assert_close(*pair, self.rtol, f"gradient {position} (seed {seed})")

    def test_the_twin_agrees_with_finite_differences(self) -> None:
        """Along one random direction of all inputs: (f(x + h d) - f(x - h d)) / 2h = gradient d, in float64."""
        inputs = self._inputs(self.seeds[0], torch.float64)
        if not self.is_smooth or not _movable(inputs):
            pytest.skip("not smooth, or nothing to differentiate")
        generator = torch.Generator().manual_seed(3)
        directions = [torch.randn(t.shape, dtype=t.dtype, generator=generator) for t in _movable(inputs)]
        gradients = self._gradients(self.twin, inputs, 0)
        expected = sum(float((g * d).sum()) for g, d in zip(gradients, directions, strict=True))
        scale = sum(float((g * d).abs().sum()) for g, d in zip(gradients, directions, strict=True))
        step = 1e-6
        values = [self._weighted(_moved(inputs, directions, sign * step)) for sign in (1, -1)]
        found = (values[0] - values[1]) / (2 * step)
        assert abs(found - expected) <= self.finite_difference_rtol * scale, (
            f"finite differences give {found}, the twin's gradient {expected}"
        )

    def test_one_and_two_threads_give_the_same_bits(self) -> None:
        inputs = self._inputs(self.seeds[0])
        results = []
        for count in (1, 2, 2):
            with _threads(count):
                outputs = _tuple(self.kernel(*inputs))
                gradients = self._gradients(self.kernel, inputs, 0) if _movable(inputs) else []
            results.append([t.detach().clone() for t in (*outputs, *gradients)])
        for position, (one, two, again) in enumerate(zip(*results, strict=True)):
            assert _same_bits(one, two), f"result {position} differs between 1 and 2 threads"
            assert _same_bits(two, again), f"result {position} differs between two calls"

    def test_inputs_are_not_written_to(self) -> None:
        inputs = self._inputs(self.seeds[0])
        copies = [t.detach().clone() for t in inputs if isinstance(t, Tensor)]
        self.kernel(*inputs)
        tensors = [t for t in inputs if isinstance(t, Tensor)]
        changed = [i for i, (t, copy) in enumerate(zip(tensors, copies, strict=True)) if not _same_bits(t, copy)]
        assert not changed, f"the kernel wrote to its tensor inputs {changed}"

    def test_no_elements_are_fine(self) -> None:
        inputs = self.empty_inputs()
        if inputs is None:
            pytest.skip("empty_inputs() brings nothing")
        for position, (fast, slow) in enumerate(_pairs(self.kernel(*inputs), self.twin(*inputs))):
            _assert_close(fast, slow, self.rtol, f"output {position} of empty inputs")
        if any(t.requires_grad for t in _tuple(self.kernel(*inputs))):
            assert all(bool((g == 0).all()) for g in self._gradients(self.kernel, inputs, 0))

    def _inputs(self, seed: int, dtype: torch.dtype = torch.float32) -> Inputs:
        return self.inputs(torch.Generator().manual_seed(seed), dtype)

    def _gradients(self, call: Callable[..., Outputs], inputs: Inputs, seed: int) -> list[Tensor]:
        """Return the gradients of <output, random cotangent>, dense, zero for inputs that are not reached."""
        outputs = [t for t in _tuple(call(*inputs)) if t.requires_grad]
        cotangents = _cotangents(outputs, seed)
        movable = _movable(inputs)
        found = torch.autograd.grad(outputs, movable, cotangents, allow_unused=True)
        return [torch.zeros_like(t) if g is None else _dense(g) for t, g in zip(movable, found, strict=True)]

    def _weighted(self, inputs: Inputs) -> float:
        outputs = [t for t in _tuple(self.twin(*inputs)) if t.requires_grad]
        return sum(float((t.detach() * c).sum()) for t, c in zip(outputs, _cotangents(outputs, 0), strict=True))


def _tuple(outputs: Outputs) -> tuple[Tensor, ...]:
    return (outputs,) if isinstance(outputs, Tensor) else outputs


def _pairs(fast: Outputs, slow: Outputs) -> list[tuple[Tensor, Tensor]]:
    left, right = _tuple(fast), _tuple(slow)
    assert len(left) == len(right), f"the kernel returns {len(left)} tensors, its twin {len(right)}"
    return list(zip(left, right, strict=True))


def _movable(inputs: Inputs) -> list[Tensor]:
    return [t for t in inputs if isinstance(t, Tensor) and t.requires_grad]


def _moved(inputs: Inputs, directions: list[Tensor], step: float) -> Inputs:
    ways = iter(directions)
    return tuple(
        (t.detach() + step * next(ways)).requires_grad_() if isinstance(t, Tensor) and t.requires_grad else t
        for t in inputs
    )


def _cotangents(outputs: list[Tensor], seed: int) -> list[Tensor]:
    generator = torch.Generator().manual_seed(1000 + seed)
    return [torch.randn(t.shape, dtype=torch.float64, generator=generator).to(t.dtype) for t in outputs]


def _dense(gradient: Tensor) -> Tensor:
    return gradient.to_dense() if gradient.is_sparse else gradient


def _same_bits(a: Tensor, b: Tensor) -> bool:
    if a.dtype != b.dtype or a.shape != b.shape:
        return False
    left, right = (t.detach().contiguous().reshape(-1).view(torch.uint8) for t in (a, b))
    return torch.equal(left, right)


def _assert_close(fast: Tensor, slow: Tensor, rtol: float, what: str) -> None:
    fast, slow = fast.detach(), slow.detach()
    assert fast.shape == slow.shape, f"{what}: shape {tuple(fast.shape)}, the twin's {tuple(slow.shape)}"
    assert fast.dtype == slow.dtype, f"{what}: {fast.dtype}, the twin's {slow.dtype}"
    if not slow.is_floating_point():
        assert torch.equal(fast, slow), f"{what}: differs from the twin"
    elif slow.numel():
        assert bool(torch.isfinite(slow).all()), f"{what}: the twin's is not finite"
        worst, scale = float((fast - slow).abs().max()), float(slow.abs().max())
        assert worst <= rtol * scale, f"{what}: differs from the twin by {worst:.3g} of {scale:.3g}"


@contextmanager
def _threads(count: int) -> Iterator[None]:
    """Run torch and numba on `count` threads (numba has no more than it started with)."""
    import numba

    before = torch.get_num_threads(), numba.get_num_threads()
    torch.set_num_threads(count)
    most: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]  # set when numba is imported
    numba.set_num_threads(min(count, most))
    try:
        yield
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])
