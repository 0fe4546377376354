"""Timing two ways of doing one thing in one process, turn by turn, so that a busy machine slows both."""

import statistics
import time
from collections.abc import Callable

__all__ = ["median_seconds"]


def median_seconds(functions: dict[str, tuple[Callable[[], object], int]], rounds: int = 3) -> dict[str, float]:
    """Return the median wall time [s] of each function, called so many times in each of the rounds, after a warm-up."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for function, _ in functions.values():
        function()
    for _ in range(rounds):
        for name, (function, repeats) in functions.items():
            for _ in range(repeats):
                start = time.perf_counter()
                function()
                times[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}
