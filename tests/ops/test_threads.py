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
