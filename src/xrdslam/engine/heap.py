"""When freed memory goes back to the system, and when it does not."""

import ctypes
import functools
from collections.abc import Callable

__all__ = ["EVERY", "give_back", "keep"]

EVERY = 50
"""Frames between two times that it is done; it takes some milliseconds."""
TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Names of glibc's mallopt."""


def give_back() -> None:
    """Let the allocator return the pages that it holds free; nothing happens where it cannot be asked to.

    Keyframes' images stay for the whole run among buffers of a moment, in one heap: what lies free between them grows
    with every keyframe, and glibc returns by itself only what lies free at the heap's end.
    """
    trim = _malloc_trim()
    if trim is not None:
        trim(0)


def keep() -> None:
    """Let the allocator keep what is freed until `give_back`; nothing happens where it cannot be asked to.

    glibc gives blocks back at once until a process has freed larger ones. One that maps does so early; one that only
    tracks would fault in the same pages for every iteration.
    """
    mallopt = _of_libc("mallopt")
    if mallopt is not None:
        mallopt(MMAP_THRESHOLD, 2**25)  # glibc's own limits, to which it goes where it sees large blocks
        mallopt(TRIM_THRESHOLD, 2**26)


def _malloc_trim() -> Callable[[int], int] | None:
    return _of_libc("malloc_trim")


@functools.cache
def _of_libc(name: str) -> Callable[..., int] | None:
    try:
        found: Callable[..., int] = getattr(ctypes.CDLL(None), name)
    except (AttributeError, OSError, TypeError):  # another C library than glibc
        return None
    return found
