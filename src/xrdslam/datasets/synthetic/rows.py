"""Spreading rows over threads.

The kernels take scenes as named tuples, which numba's own parallel loops refuse; they release the GIL instead, and
plain threads give them disjoint rows. No row depends on another: the same bits for any number of threads.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba

__all__ = ["over_rows"]

CHUNKS_PER_THREAD = 8


def over_rows(kernel: Callable[..., None], count: int, *arguments: object) -> None:
    """Call kernel(begin, end, *arguments) for ranges that cover [0, count), on as many threads as numba may use."""
    threads = numba.get_num_threads()
    if threads == 1 or count < 2:
        kernel(0, count, *arguments)
        return
    step = max(1, -(-count // (threads * CHUNKS_PER_THREAD)))
    with ThreadPoolExecutor(threads) as pool:
        jobs = [pool.submit(kernel, k, min(k + step, count), *arguments) for k in range(0, count, step)]
        for job in jobs:
            job.result()
