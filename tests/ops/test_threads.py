"""Kernels take torch's number of threads, and leave it as it is."""

import subprocess
import sys

import numba
import pytest
import torch

from xrdslam.ops.threads import kernel_threads


@pytest.mark.parametrize("threads", [1, 2])
def test_numba_gets_as_many_threads_as_torch(threads: int) -> None:
    torch_before, numba_before = torch.get_num_threads(), numba.get_num_threads()
    torch.set_num_threads(threads)
    try:
        with kernel_threads() as workers:
            assert numba.get_num_threads() == workers == min(threads, numba.config.NUMBA_NUM_THREADS)
        assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(torch_before)
    assert numba.get_num_threads() == numba_before


def test_the_start_of_numbas_threads_does_not_change_torchs() -> None:
    """In a fresh process, since the threads start once."""
    code = (
        "import torch; from xrdslam.ops.threads import kernel_threads; torch.set_num_threads(1)\n"
        "with kernel_threads() as workers: assert workers == 1\n"
        "assert torch.get_num_threads() == 1"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_warming_up_leaves_the_first_kernel_nothing_to_fill_in() -> None:
    """Numba's table of the functions that it knows is empty at first, and all but filled before a kernel is called."""
    code = (
        "import torch\n"
        "from numba.core.registry import cpu_target\n"
        "from xrdslam.ops.ssim import ssim_map\n"
        "from xrdslam.ops.threads import warm_up\n"
        "def known(): return len(cpu_target.typing_context._functions)\n"
        "torch.set_num_threads(1); before = known(); warm_up(); warm = known()\n"
        "assert torch.get_num_threads() == 1\n"
        "ssim_map(torch.rand(20, 20, 3), torch.rand(20, 20, 3)); after = known()\n"
        "assert before < 0.01 * after < 0.99 * after < warm, (before, warm, after)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
