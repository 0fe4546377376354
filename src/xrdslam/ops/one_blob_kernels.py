"""One-blob encoding on the CPU, parallel over points; only the bins that a coordinate reaches are computed.

`out` and `upstream` may have columns of other encodings before those of the bins, which begin at `column`.
"""

import numba
import numpy as np

from xrdslam.ops.simd import inline_kernel, parallel_kernel

__all__ = ["spread", "spread_gradient"]

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


@parallel_kernel
def spread(points: np.ndarray, bins: int, column: int, out: np.ndarray) -> None:
    """Write the bins of each coordinate."""
    width = np.float32(bins)
    for n in numba.prange(points.shape[0]):
        for axis in range(3):
            first = column + axis * bins
            for k in range(bins):
                out[n, first + k] = 0
            u = points[n, axis] * width
            if not (-width < u < np.float32(2) * width):  # further off than a period no kernel reaches, nor for NaN
                continue
            center = int(np.floor(u))
            for k in range(center - 1, center + 2):
                value = _cumulative(np.float32(k + 1) - u) - _cumulative(np.float32(k) - u)
                if -bins <= k < 2 * bins:
                    out[n, first + k % bins] += value


@parallel_kernel
def spread_gradient(points: np.ndarray, bins: int, column: int, upstream: np.ndarray, d_points: np.ndarray) -> None:
    """Add to each point's gradient: de_k / du = bins (f(k - bins u) - f(k + 1 - bins u))."""
    width = np.float32(bins)
    for n in numba.prange(points.shape[0]):
        for axis in range(3):
            u = points[n, axis] * width
            if not (-width < u < np.float32(2) * width):
                continue
            center = int(np.floor(u))
            slope = np.float32(0)
            for k in range(center - 1, center + 2):
                if -bins <= k < 2 * bins:
                    change = _density(np.float32(k) - u) - _density(np.float32(k + 1) - u)
                    slope += upstream[n, column + axis * bins + k % bins] * change
            d_points[n, axis] += slope * width
