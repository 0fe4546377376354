"""Samples along rays' hits on the CPU: rays in parallel, each by one thread."""

import numba
import numpy as np

from xrdslam.ops.simd import inline_kernel, parallel_kernel

__all__ = ["count_cuts", "count_samples", "fill_samples", "place", "place_backward"]

SHORTEST = 1e-6
"""Pieces below this length are no samples."""


@parallel_kernel
def count_cuts(
    offsets: np.ndarray, entries: np.ndarray, exits: np.ndarray, step: float, most: int, counts: np.ndarray
) -> None:
    """Count the cuts of each ray: its length within voxels in steps, rounded up, and no more than `most`."""
    for ray in numba.prange(len(offsets) - 1):
        length = 0.0
        for hit in range(offsets[ray], offsets[ray + 1]):
            length += np.float64(exits[hit]) - np.float64(entries[hit])
        counts[ray] = min(np.int64(np.ceil(length / step)), most)


@inline_kernel
def _cut(
    ray: int,
    offsets: np.ndarray,
    hit_voxels: np.ndarray,
    entries: np.ndarray,
    exits: np.ndarray,
    step: float,
    most: int,
    cut_offsets: np.ndarray,
    noise: np.ndarray,
    write: bool,
    at: int,
    depths: np.ndarray,
    lengths: np.ndarray,
    voxels: np.ndarray,
) -> int:
    """Cut the hits of a ray where (k + noise_k) steps of it have passed within voxels; return the number of pieces."""
    first, num_cuts = cut_offsets[ray], cut_offsets[ray + 1] - cut_offsets[ray]
    passed, k, count = 0.0, 0, 0
    for hit in range(offsets[ray], offsets[ray + 1]):
        entry, leave = np.float64(entries[hit]), np.float64(exits[hit])
        end, place = passed + (leave - entry), entry
        while True:
            cut = (k + np.float64(noise[first + k])) * step if k < num_cuts else np.inf
            until = entry + (cut - passed) if cut < end else leave
            if until - place > SHORTEST:
                if count == most:
                    return count
                if write:
                    depths[at + count] = 0.5 * (place + until)
                    lengths[at + count] = until - place
                    voxels[at + count] = hit_voxels[hit]
                count += 1
                place = until
            if not cut < end:
                break
            k += 1
        passed = end
    return count


@parallel_kernel
def count_samples(
    offsets: np.ndarray,
    hit_voxels: np.ndarray,
    entries: np.ndarray,
    exits: np.ndarray,
    step: float,
    most: int,
    cut_offsets: np.ndarray,
    noise: np.ndarray,
    counts: np.ndarray,
) -> None:
    """Count each ray's samples."""
    none = np.empty(0, np.float32)
    for ray in numba.prange(len(offsets) - 1):
        counts[ray] = _cut(
            ray, offsets, hit_voxels, entries, exits, step, most, cut_offsets, noise, False, 0, none, none, hit_voxels
        )


@parallel_kernel
def fill_samples(
    offsets: np.ndarray,
    hit_voxels: np.ndarray,
    entries: np.ndarray,
    exits: np.ndarray,
    step: float,
    most: int,
    cut_offsets: np.ndarray,
    noise: np.ndarray,
    sample_offsets: np.ndarray,
    depths: np.ndarray,
    lengths: np.ndarray,
    voxels: np.ndarray,
) -> None:
    """Write each ray's samples from its offset on."""
    for ray in numba.prange(len(offsets) - 1):
        at = sample_offsets[ray]
        _cut(
            ray,
            offsets,
            hit_voxels,
            entries,
            exits,
            step,
            most,
            cut_offsets,
            noise,
            True,
            at,
            depths,
            lengths,
            voxels,
        )


@parallel_kernel
def place(
    origins: np.ndarray, directions: np.ndarray, offsets: np.ndarray, depths: np.ndarray, points: np.ndarray
) -> None:
    """Write the point of each sample."""
    for ray in numba.prange(len(offsets) - 1):
        for n in range(offsets[ray], offsets[ray + 1]):
            for a in range(3):
                points[n, a] = origins[ray, a] + depths[n] * directions[ray, a]


@parallel_kernel
def place_backward(
    offsets: np.ndarray, depths: np.ndarray, d_points: np.ndarray, d_origins: np.ndarray, d_directions: np.ndarray
) -> None:
    """Sum the samples' gradients for each ray."""
    for ray in numba.prange(len(offsets) - 1):
        for a in range(3):
            to_origin, to_direction = 0.0, 0.0
            for n in range(offsets[ray], offsets[ray + 1]):
                to_origin += d_points[n, a]
                to_direction += depths[n] * d_points[n, a]
            d_origins[ray, a], d_directions[ray, a] = to_origin, to_direction
