"""Tile lists: for every tile, the Gaussians that touch it, nearest first."""

# Kernels take numpy arrays and scalars that numba types by itself:
# mypy: disable-error-code="no-untyped-def, no-untyped-call"
# ruff: noqa: ANN001, ANN201, ANN202

import numpy as np
from numba import prange

from xrdslam.ops.simd import kernel, parallel_kernel
from xrdslam.ops.splats import layout

_DIGIT = 8
RADIX = 1 << _DIGIT


@kernel
def place(tile_counts, slot_counts, offsets):
    """Turn counts into places: where tiles begin (`offsets`), where chunks write (`tile_counts`), their first slots.

    Returns the length of the list.
    """
    chunks, tiles = tile_counts.shape
    total = 0
    for t in range(tiles):
        offsets[t] = total
        for c in range(chunks):
            count = tile_counts[c, t]
            tile_counts[c, t] = total
            total += count
    offsets[tiles] = total
    slot = 0
    for c in range(chunks):
        count = slot_counts[c]
        slot_counts[c] = slot
        slot += count
    return total


@parallel_kernel
def scatter(records, chunk, counts, slots, tiles_x, places, slot_places, keys):
    """Write each Gaussian into the lists of its tiles as depth bits << 32 | index; completes `slots` and the records.

    Within a tile the keys come in the order of the Gaussians, whatever the number of threads.
    """
    bits = records.view(np.int32)
    depths = records.view(np.uint32)
    for c in prange(counts.shape[0]):
        for j in range(c * chunk, c * chunk + counts[c]):
            slots[j, 0] += slot_places[c]
            bits[j, layout.SLOT], bits[j, layout.TILES] = slots[j, 0], slots[j, 1]
            box = slots[j, 1]
            key = np.uint64(depths[j, layout.DEPTH]) << np.uint64(32) | np.uint64(j)
            for ty in range(box >> 16 & 255, (box >> 24 & 255) + 1):
                for tx in range(box & 255, (box >> 8 & 255) + 1):
                    place = places[c, ty * tiles_x + tx]
                    keys[place] = key
                    places[c, ty * tiles_x + tx] = place + 1


@kernel
def sort_tile(start, stop, keys, spare, entries, histogram):
    """Sort one tile's keys by depth, ties by index, and write the indices to `entries`.

    Radix sort of the bits that differ within the tile; positive floats order as their bits do.
    """
    if stop - start < 24:
        _insertion_sort(start, stop, keys)
    else:
        low, high = keys[start], keys[start]
        for e in range(start, stop):
            low, high = min(low, keys[e]), max(high, keys[e])
        base, span = low >> np.uint64(32), (high >> np.uint64(32)) - (low >> np.uint64(32))
        shift = 0
        while span >> np.uint64(shift) > np.uint64(0):
            _radix_pass(start, stop, keys, spare, base, np.uint64(shift), histogram)
            keys, spare = spare, keys
            shift += _DIGIT
    for e in range(start, stop):
        entries[e] = np.int32(keys[e] & np.uint64(0xFFFFFFFF))


@kernel
def _radix_pass(start, stop, keys, spare, base, shift, histogram):
    digits = np.uint64(RADIX - 1)
    histogram[:] = 0
    for e in range(start, stop):
        histogram[((keys[e] >> np.uint64(32)) - base) >> shift & digits] += 1
    place = start
    for d in range(RADIX):
        count = histogram[d]
        histogram[d] = place
        place += count
    for e in range(start, stop):
        d = ((keys[e] >> np.uint64(32)) - base) >> shift & digits
        spare[histogram[d]] = keys[e]
        histogram[d] += 1


@kernel
def _insertion_sort(start, stop, keys):
    for e in range(start + 1, stop):
        key, hole = keys[e], e
        while hole > start and keys[hole - 1] > key:
            keys[hole] = keys[hole - 1]
            hole -= 1
        keys[hole] = key
