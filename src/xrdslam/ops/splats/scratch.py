"""Big buffers kept for the next render: a fresh 20 MB array costs a page fault every 4 KiB, a millisecond or more."""

import threading
from collections import deque

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["Scratch"]

_ALIGNMENT = 64
_free: list[NDArray[np.uint8]] = []
_returned: deque[NDArray[np.uint8]] = deque()
_lock = threading.Lock()
_KEPT = 24
"""Buffers kept at most; a render holds about a dozen."""


class Scratch:
    """Uninitialised arrays on cache-line boundaries; they go back to a process-wide pool with their scratch."""

    def __init__(self) -> None:
        self._buffers: list[NDArray[np.uint8]] = []

    def empty(self, shape: int | tuple[int, ...], dtype: DTypeLike) -> np.ndarray:
        """Return an uninitialised C-contiguous array; it must not be used once this object is gone."""
        count = int(np.prod(shape))
        num_bytes = max(count, 1) * np.dtype(dtype).itemsize
        buffer = _take(num_bytes)
        self._buffers.append(buffer)
        start = -buffer.ctypes.data % _ALIGNMENT
        flat = buffer[start : start + count * np.dtype(dtype).itemsize]
        return flat.view(dtype).reshape(shape)

    def __del__(self) -> None:
        """Give the buffers back without taking the lock: a destructor may run inside any line, `_take`'s included."""
        buffers, self._buffers = self._buffers, []
        _returned.extend(buffers)


def _take(num_bytes: int) -> NDArray[np.uint8]:
    """Return the smallest free buffer that holds so many bytes, at most 4 times as large, or a new one."""
    need = num_bytes + _ALIGNMENT
    with _lock:
        while _returned:
            _free.append(_returned.popleft())
        _free.sort(key=len)
        del _free[: max(0, len(_free) - _KEPT)]
        for k, buffer in enumerate(_free):
            if need <= len(buffer) <= 4 * need + 65536:
                return _free.pop(k)
    return np.empty(need + need // 4, np.uint8)
