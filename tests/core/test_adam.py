"""Adam: torch's, without its compiler."""

import subprocess
import sys

import pytest
import torch
from torch import nn

from xrdslam.core.adam import Adam


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("weight_decay", [0.0, 0.01])
def test_every_step_has_the_bits_of_torchs_own(dtype: torch.dtype, weight_decay: float) -> None:
    draw = torch.Generator().manual_seed(0)
    start = [torch.randn(shape, generator=draw, dtype=dtype) for shape in ((5, 3), (7,))]
    ours, theirs = ([nn.Parameter(t.clone()) for t in start] for _ in range(2))
    adam = Adam(ours, (0.8, 0.99), 1e-6, weight_decay)
    torchs = torch.optim.Adam(theirs, 0.0, (0.8, 0.99), 1e-6, weight_decay, fused=True)
    for step in range(6):
        rate = 0.1 / (step + 1)
        torchs.param_groups[0]["lr"] = rate
        for position, (mine, other) in enumerate(zip(ours, theirs, strict=True)):
            gradient = torch.randn(mine.shape, generator=draw, dtype=dtype)
            has_none = position == 1 and step % 2 == 0  # it keeps its own count of steps
            mine.grad, other.grad = (None, None) if has_none else (gradient.clone(), gradient.clone())
        adam.step(rate)
        torchs.step()
        for mine, other in zip(ours, theirs, strict=True):
            assert torch.equal(mine, other)
            assert adam.state.get(mine, {}).keys() == torchs.state.get(other, {}).keys()
            for name, tensor in torchs.state.get(other, {}).items():
                assert torch.equal(adam.state[mine][name], tensor)


def test_gradients_are_forgotten() -> None:
    parameter = nn.Parameter(torch.zeros(2))
    parameter.grad = torch.ones(2)
    Adam([parameter], (0.9, 0.999), 1e-8, 0.0).zero_grad()
    assert parameter.grad is None


def test_optimising_does_not_import_torchs_compiler() -> None:
    program = (
        "import sys, torch\n"
        "from xrdslam.core.optimisation import GroupedOptimiser, ParameterGroup\n"
        "x = torch.nn.Parameter(torch.ones(3))\n"
        "optimiser = GroupedOptimiser([ParameterGroup('x', [x], 0.1)])\n"
        "x.sum().backward()\n"
        "optimiser.step(0)\n"
        "assert bool((x < 1).all())\n"
        "assert 'torch._dynamo' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
