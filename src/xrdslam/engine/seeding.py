"""What a process sets before it computes: threads, and every source of random numbers."""

import os

import torch

from xrdslam.engine.random_numbers import seed_streams

__all__ = ["num_threads", "prepare"]


def num_threads(threads: int) -> int:
    """Return a run's threads, where 0 is as many as there are cores for this process."""
    return threads or len(os.sched_getaffinity(0))


def prepare(seed: int, threads: int) -> None:
    """Set the threads of torch and numba, and every global stream of random numbers."""
    import numba

    numba.set_num_threads(min(threads, int(numba.config.NUMBA_NUM_THREADS)))  # type: ignore[attr-defined]  # set late
    torch.set_num_threads(threads)  # after numba, whose start sets the OpenMP pool that both share to all cores
    seed_streams(seed)
