"""Volume rendering on the CPU: rays in parallel, each by one thread, so that bits do not depend on their number."""

import math

import numba
import numpy as np

from xrdslam.ops.simd import inline_kernel, parallel_kernel

__all__ = [
    "bell_weights",
    "bell_weights_backward",
    "stop_weights",
    "stop_weights_backward",
    "sums",
    "sums_backward",
]


@parallel_kernel
def sums(
    weights: np.ndarray,
    rgb: np.ndarray,
    depths: np.ndarray,
    color: np.ndarray,
    depth: np.ndarray,
    variance: np.ndarray,
    opacity: np.ndarray,
) -> None:
    """Sum colour, depth, its variance and the weights of each ray."""
    for ray in numba.prange(weights.shape[0]):
        red, green, blue, mean, total = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(weights.shape[1]):
            w = weights[ray, i]
            if w != 0:
                red += w * rgb[ray, i, 0]
                green += w * rgb[ray, i, 1]
                blue += w * rgb[ray, i, 2]
                mean += w * depths[ray, i]
                total += w
        spread = 0.0
        for i in range(weights.shape[1]):
            spread += weights[ray, i] * (depths[ray, i] - mean) ** 2
        color[ray, 0], color[ray, 1], color[ray, 2] = red, green, blue
        depth[ray], variance[ray], opacity[ray] = mean, spread, total


@parallel_kernel
def sums_backward(
    weights: np.ndarray,
    rgb: np.ndarray,
    depths: np.ndarray,
    depth: np.ndarray,
    opacity: np.ndarray,
    d_color: np.ndarray,
    d_depth: np.ndarray,
    d_variance: np.ndarray,
    d_opacity: np.ndarray,
    d_weights: np.ndarray,
    d_rgb: np.ndarray,
) -> None:
    """Pull back through `sums`; dV/dD = -2 sum w (z - D) = -2 D (1 - sum w)."""
    for ray in numba.prange(weights.shape[0]):
        through_depth = d_depth[ray] - 2 * d_variance[ray] * depth[ray] * (1 - opacity[ray])
        for i in range(weights.shape[1]):
            w, z = weights[ray, i], depths[ray, i]
            slope = through_depth * z + d_variance[ray] * (z - depth[ray]) ** 2 + d_opacity[ray]
            for c in range(3):
                slope += d_color[ray, c] * rgb[ray, i, c]
                d_rgb[ray, i, c] = d_color[ray, c] * w
            d_weights[ray, i] = slope


@parallel_kernel
def bell_weights(
    sdf: np.ndarray,
    depths: np.ndarray,
    valid: np.ndarray,
    truncation_m: float,
    weights: np.ndarray,
    totals: np.ndarray,
) -> None:
    """Weigh by the bell about the first crossing; `valid` is empty where every sample counts."""
    count = sdf.shape[1]
    everything = valid.size == 0
    inverse = np.float32(1 / truncation_m)
    for ray in numba.prange(sdf.shape[0]):
        first, crossing = -1, -1
        for i in range(count):
            if everything or valid[ray, i]:
                if first < 0:
                    first = i
                if i + 1 < count and (everything or valid[ray, i + 1]) and sdf[ray, i] * sdf[ray, i + 1] <= 0:
                    crossing = i
                    break
        at = crossing if crossing >= 0 else max(first, 0)
        limit = depths[ray, at] + np.float32(truncation_m) if count else np.float32(0)
        total = np.float32(0)
        for i in range(count):
            bell = np.float32(0)
            if (everything or valid[ray, i]) and depths[ray, i] < limit:
                power = np.exp(-abs(sdf[ray, i] * inverse))
                bell = power / ((1 + power) * (1 + power))
            weights[ray, i] = bell
            total += bell
        totals[ray] = total
        scale = np.float32(1) / (total + np.float32(1e-8))
        for i in range(count):
            weights[ray, i] *= scale


@parallel_kernel
def bell_weights_backward(
    sdf: np.ndarray, weights: np.ndarray, d_weights: np.ndarray, truncation_m: float, d_sdf: np.ndarray
) -> None:
    """Pull back: with w = b / (sum b + e), dL/db ~ g - sum w g, and db/ds = b (1 - 2 sigmoid(s / t)) / t."""
    inverse = np.float32(1 / truncation_m)
    for ray in numba.prange(sdf.shape[0]):
        mean = np.float32(0)
        for i in range(sdf.shape[1]):
            mean += weights[ray, i] * d_weights[ray, i]
        for i in range(sdf.shape[1]):
            w = weights[ray, i]
            if w == 0:
                d_sdf[ray, i] = 0
                continue
            d_sdf[ray, i] = -w * (d_weights[ray, i] - mean) * np.tanh(sdf[ray, i] * inverse * np.float32(0.5)) * inverse


@parallel_kernel
def stop_weights(logits: np.ndarray, scale: float, weights: np.ndarray) -> None:
    """Weigh by where the ray ends."""
    for ray in numba.prange(logits.shape[0]):
        passed = np.float32(1)
        for i in range(logits.shape[1]):
            occupancy = _sigmoid(np.float32(scale) * logits[ray, i])
            weights[ray, i] = occupancy * passed
            passed *= 1 - occupancy + np.float32(1e-10)


@parallel_kernel
def stop_weights_backward(
    logits: np.ndarray, weights: np.ndarray, d_weights: np.ndarray, scale: float, d_logits: np.ndarray
) -> None:
    """Pull back: dL/do_i = T_i g_i - sum_{k>i} w_k g_k / (1 - o_i + 1e-10), from the far end."""
    for ray in numba.prange(logits.shape[0]):
        behind = np.float32(0)
        for i in range(logits.shape[1] - 1, -1, -1):
            scaled = np.float32(scale) * logits[ray, i]
            occupancy, free = _sigmoid(scaled), _sigmoid(-scaled)
            w, g = weights[ray, i], d_weights[ray, i]
            # do/dl = scale o (1 - o): the o of the first term makes T_i o_i = w_i, the (1 - o) of the second cancels.
            second = behind * occupancy * free / (free + np.float32(1e-10))
            d_logits[ray, i] = np.float32(scale) * (w * g * free - second)
            behind += w * g


@inline_kernel
def _sigmoid(x: np.float32) -> np.float32:
    """Return 1 / (1 + exp(-x)) without overflow."""
    power = math.exp(-abs(x))
    return np.float32(1 / (1 + power)) if x >= 0 else np.float32(power / (1 + power))
