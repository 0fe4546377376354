"""Giving freed memory back to the system."""

import ctypes
import functools
from collections.abc import Callable

__all__ = ["EVERY", "give_back"]

EVERY = 50
"""Frames between two times that it is done; it takes some milliseconds."""


def give_back() -> None:
    """Let the allocator return the pages that it holds free; nothing happens where it cannot be asked to.

    Keyframes' images stay for the whole run among buffers of a moment, in one heap: what lies free between them grows
    with every keyframe, and glibc returns by itself only what lies free at the heap's end.
    """
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


@functools.cache
def _malloc_trim() -> Callable[[int], int] | None:
    try:
        found: Callable[[int], int] = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another C library than glibc
        return None
    return found
