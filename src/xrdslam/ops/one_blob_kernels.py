"""One-blob encoding on the CPU, parallel over points; only the bins that a coordinate reaches are computed."""

import numba
import numpy as np

from xrdslam.ops.simd import inline_kernel, parallel_kernel

__all__ = ["add_bins", "bins_slope", "spread", "spread_gradient"]

_ONE = np.float32(1)
_C0, _C1, _C2, _HALF = np.float32(15 / 16), np.float32(2 / 3), np.float32(1 / 5), np.float32(0.5)


@inline_kernel
def _cumulative(v: np.float32) -> np.float32:
    v = min(max(v, -_ONE), _ONE)
    q = v * v
    return _C0 * v * (_ONE - _C1 * q + _C2 * q * q) + _HALF


@inline_kernel
def _density(v: np.float32) -> np.float32:
    q = max(_ONE - v * v, np.float32(0))
    return _C0 * q * q


@inline_kernel
def _reaches(u: np.float32, width: np.float32) -> bool:
    """Say whether a kernel reaches from here: further off than a period none does, nor for what is no number."""
    return bool(-width < u < np.float32(2) * width)


@inline_kernel
def add_bins(coordinate: np.float32, bins: int, out: np.ndarray, at: int, stride: int) -> None:
    """Add a coordinate's bins to the flat `out`, `stride` apart."""
    u = coordinate * np.float32(bins)
    if _reaches(u, np.float32(bins)):
        center = int(np.floor(u))
        for k in range(center - 1, center + 2):
            if -bins <= k < 2 * bins:
                value = _cumulative(np.float32(k + 1) - u) - _cumulative(np.float32(k) - u)
                out[at + k % bins * stride] += value


@inline_kernel
def bins_slope(coordinate: np.float32, bins: int, upstream: np.ndarray, at: int, stride: int) -> np.float32:
    """Return a coordinate's gradient, from that of its bins in the flat `upstream`, `stride` apart."""
    u = coordinate * np.float32(bins)
    slope = np.float32(0)
    if _reaches(u, np.float32(bins)):
        center = int(np.floor(u))
        for k in range(center - 1, center + 2):
            if -bins <= k < 2 * bins:
                change = _density(np.float32(k) - u) - _density(np.float32(k + 1) - u)
                slope += upstream[at + k % bins * stride] * change
    return slope * np.float32(bins)


@parallel_kernel
def spread(points: np.ndarray, bins: int, out: np.ndarray) -> None:
    """Write the bins of each coordinate."""
    flat = out.reshape(-1)
    for n in numba.prange(points.shape[0]):
        for axis in range(3):
            first = (3 * n + axis) * bins
            flat[first : first + bins] = 0
            add_bins(points[n, axis], bins, flat, first, 1)


@parallel_kernel
def spread_gradient(points: np.ndarray, bins: int, upstream: np.ndarray, d_points: np.ndarray) -> None:
    """Add to each point's gradient: de_k / du = bins (f(k - bins u) - f(k + 1 - bins u))."""
    flat = upstream.reshape(-1)
    for n in numba.prange(points.shape[0]):
        for axis in range(3):
            d_points[n, axis] += bins_slope(points[n, axis], bins, flat, (3 * n + axis) * bins, 1)
