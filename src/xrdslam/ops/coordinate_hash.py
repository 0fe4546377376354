"""A hash table from signed integer coordinates to rows, with open addressing, for numba kernels.

Two arrays of a length that is a power of two: `keys` (int64, -1 where a slot is free) and `rows`. The owner keeps the
table at most half full.
"""

import numpy as np

from xrdslam.ops.simd import inline_kernel, kernel

__all__ = ["REACH", "find", "pack", "rehash", "slot_of"]

REACH = 1 << 20
"""Coordinates lie in [-REACH, REACH): 21 bits each."""


@inline_kernel
def pack(x: int, y: int, z: int) -> int:
    """Return the key of coordinates."""
    return ((x + REACH) << 42) | ((y + REACH) << 21) | (z + REACH)


@kernel
def slot_of(keys: np.ndarray, key: int) -> np.int64:
    """Return where a key is, or would be put."""
    mask = len(keys) - 1
    mixed = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)  # Fibonacci hashing: the high bits are well mixed
    slot = np.int64(mixed >> np.uint64(32)) & mask
    while keys[slot] != key and keys[slot] != -1:
        slot = (slot + 1) & mask
    return slot


@kernel
def find(keys: np.ndarray, rows: np.ndarray, x: int, y: int, z: int) -> int:
    """Return the row of coordinates, or -1."""
    slot = slot_of(keys, pack(x, y, z))
    return rows[slot] if keys[slot] != -1 else -1


@kernel
def rehash(keys: np.ndarray, rows: np.ndarray, coords: np.ndarray, count: int) -> None:
    """Enter the first `count` coordinates into an empty table."""
    for row in range(count):
        key = pack(coords[row, 0], coords[row, 1], coords[row, 2])
        slot = slot_of(keys, key)
        keys[slot] = key
        rows[slot] = row
