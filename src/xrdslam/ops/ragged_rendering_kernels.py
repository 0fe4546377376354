"""Volume rendering of rays of different lengths on the CPU: rays in parallel, each by one thread."""

import numba
import numpy as np

from xrdslam.ops.simd import parallel_kernel

__all__ = ["bell_weights", "bell_weights_backward"]


@parallel_kernel
def bell_weights(
    sdf: np.ndarray, depths: np.ndarray, offsets: np.ndarray, truncation_m: float, weights: np.ndarray
) -> None:
    """Weigh by the bell about the first crossing (see `volume_rendering.sdf_weights`)."""
    inverse = np.float32(1 / truncation_m)
    for ray in numba.prange(len(offsets) - 1):
        first, end = offsets[ray], offsets[ray + 1]
        at = first
        for i in range(first, end - 1):
            if sdf[i] * sdf[i + 1] <= 0:
                at = i
                break
        limit = depths[at] + np.float32(truncation_m) if end > first else np.float32(0)
        total = np.float32(0)
        for i in range(first, end):
            bell = np.float32(0)
            if depths[i] < limit:
                power = np.exp(-abs(sdf[i] * inverse))
                bell = power / ((1 + power) * (1 + power))
            weights[i] = bell
            total += bell
        scale = np.float32(1) / (total + np.float32(1e-8))
        for i in range(first, end):
            weights[i] *= scale


@parallel_kernel
def bell_weights_backward(
    sdf: np.ndarray,
    weights: np.ndarray,
    d_weights: np.ndarray,
    offsets: np.ndarray,
    truncation_m: float,
    d_sdf: np.ndarray,
) -> None:
    """Pull back: with w = b / (sum b + e), dL/db ~ g - sum w g, and db/ds = b (1 - 2 sigmoid(s / t)) / t."""
    inverse = np.float32(1 / truncation_m)
    for ray in numba.prange(len(offsets) - 1):
        mean = np.float32(0)
        for i in range(offsets[ray], offsets[ray + 1]):
            mean += weights[i] * d_weights[i]
        for i in range(offsets[ray], offsets[ray + 1]):
            w = weights[i]
            if w == 0:
                d_sdf[i] = 0
                continue
            d_sdf[i] = -w * (d_weights[i] - mean) * np.tanh(sdf[i] * inverse * np.float32(0.5)) * inverse
