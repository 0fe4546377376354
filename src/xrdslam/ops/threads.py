"""One number of threads for torch and numba: what `torch.set_num_threads` says."""

from collections.abc import Iterator
from contextlib import contextmanager

import numba
import torch

from xrdslam.ops.simd import kernel

__all__ = ["kernel_threads", "warm_up"]


@contextmanager
def kernel_threads() -> Iterator[int]:
    """Run numba's parallel kernels on as many threads as torch may use, and say how many that is.

    Numba's OpenMP layer, when it starts, sets the thread count of the OpenMP library that it may share with torch, and
    so undoes an earlier `torch.set_num_threads`: that is put right here.
    """
    wanted = torch.get_num_threads()
    before = numba.get_num_threads()  # starts the layer
    if torch.get_num_threads() != wanted:
        torch.set_num_threads(wanted)
    workers = min(wanted, numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]  # set at run time
    numba.set_num_threads(workers)
    try:
        yield workers
    finally:
        numba.set_num_threads(before)


def warm_up() -> None:
    """Have done now what numba does before its first kernel in a process: 0.2 s of filling in its tables."""
    with kernel_threads():
        _nothing()


@kernel
def _nothing() -> None:
    pass
