"""A differentiable operation beside its twin: forward, and backward to given leaves."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from benchmarks.interleaved import median_seconds
from benchmarks.metric import Metric

__all__ = ["speedups"]


def speedups(
    key: str, twin: Callable[[], Tensor], kernel: Callable[[], Tensor], leaves: Sequence[Tensor]
) -> list[Metric]:
    """Measure both ways of one call; the upstream gradient is random."""
    calls = {"twin": twin, "kernel": kernel}
    forward = median_seconds({name: (call, 1) for name, call in calls.items()})
    graphs = {name: call() for name, call in calls.items()}
    upstream = torch.randn(graphs["twin"].shape, generator=torch.Generator().manual_seed(0))
    backward = median_seconds(
        {n: (lambda o=o: torch.autograd.grad(o, leaves, upstream, retain_graph=True), 1) for n, o in graphs.items()}
    )
    return [
        Metric(f"{key}_{way}_speedup", seconds["twin"] / seconds["kernel"], "x twin", "higher", 0.4)
        for way, seconds in (("forward", forward), ("backward", backward))
    ]
