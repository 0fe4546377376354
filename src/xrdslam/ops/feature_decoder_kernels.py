"""A feature decoder on the CPU: 32 points at a time in lanes, all layers while the tile is in the cache.

Weights come in two flat packs, one for each direction, so that eight outputs lie side by side for every input:

- forward: B (3, 96) | layers 0..4 transposed (96 | 32 | 32 | 96 + 32 | 32, 32) | biases (5, 32)
  | feature biases (5, 32) | feature matrices transposed 5 x (C, 32) | output transposed (32, 32) | output bias (32)
- backward: layers 0..4 (32, 96 | 32 | 32 | 96 | 32 | 32) | feature matrices 5 x (32, C) | output (8, 32)

where 93 columns of the embedding are filled up to 96 and the outputs to 8 or 32 with zeros.
"""

# Intrinsics are called without their typing context, and forward and backward share the tile, its scratch and the
# places in the packs, which makes this one long file:
# mypy: disable-error-code="call-arg"

import numba
import numpy as np

from xrdslam.ops.simd import inline_kernel, load, parallel_kernel, splat, store, zeros
from xrdslam.ops.simd_layers import cosine, mask_rows, multiply_add, relu_rows, sine
from xrdslam.ops.simd_tiles import add_outer, add_product, clear_rows, turn_block, turn_rows

__all__ = ["CHUNK", "decode", "decode_backward", "weight_gradient_size"]

CHUNK = 512
"""Points that a thread takes at once; a sum over points is a sum over chunks, whatever the number of threads."""
_T = 32
_EMBED = 96
# The forward pack.
_L0 = 3 * _EMBED
_L1 = _L0 + _EMBED * 32
_L2 = _L1 + 1024
_L3E = _L2 + 1024
_L3H = _L3E + _EMBED * 32
_L4 = _L3H + 1024
_BIAS = _L4 + 1024
_FEATURE_BIAS = _BIAS + 160
_FEATURE = _FEATURE_BIAS + 160
# The backward pack.
_R0 = 0
_R1 = _R0 + 32 * _EMBED
_R2 = _R1 + 1024
_R3E = _R2 + 1024
_R3H = _R3E + 32 * _EMBED
_R4 = _R3H + 1024
_RF = _R4 + 1024
# The scratch of a tile, in floats: rows of 32.
_P = 0
_E = _P + 8 * _T
_C = _E + _EMBED * _T
_H = _C + 64 * _T
"""Inputs of layers 1 to 4 and of the output, 32 rows each."""
_Y = _H + 5 * 32 * _T
_O = _Y + 32 * _T
_G = _O + 32 * _T
_D = _G + 32 * _T
_DE = _D + 32 * _T
_DC = _DE + _EMBED * _T
_ROWS = _DC + 64 * _T
"""Features as they lie in memory, 32 points of up to 64."""
_POINTS = _ROWS + 64 * _T
_SCRATCH = _POINTS + 16 * _T


@inline_kernel
def _fill(pack: np.ndarray, at: int, rows: int, s: np.ndarray, target: int) -> None:
    """Set every lane of rows to the biases."""
    for r in range(rows):
        value = splat(pack[at + r])
        store(s, target + r * _T, value)
        store(s, target + r * _T + 16, value)


@inline_kernel
def _read_tile(
    points: np.ndarray,
    features: np.ndarray,
    column: int,
    channels: int,
    order: np.ndarray,
    start: int,
    count: int,
    s: np.ndarray,
) -> None:
    """Bring up to 32 points and their features into lanes; the lanes beyond `count` repeat the last point."""
    for lane in range(_T):
        at = order[min(start + lane, count - 1)] if order.size > 0 else min(start + lane, count - 1)
        for axis in range(3):
            s[_P + axis * _T + lane] = points[at, axis]
        for c in range(0, channels, 16):
            store(s, _ROWS + lane * 64 + c, load(features, at * features.shape[1] + column + c))
    for half in range(0, _T, 16):
        for c in range(0, channels, 16):
            turn_block(s, _ROWS + half * 64 + c, 64, s, _C + c * _T + half, _T)


@inline_kernel
def _embed(pack: np.ndarray, s: np.ndarray, slope: bool) -> None:
    """Write sin(p B) (or multiply d by cos(p B), in place) for all 96 columns."""
    for half in range(0, _T, 16):
        x, y, z = load(s, _P + half), load(s, _P + _T + half), load(s, _P + 2 * _T + half)
        for j in range(_EMBED):
            angle = x * pack[j] + y * pack[_EMBED + j] + z * pack[2 * _EMBED + j]
            if slope:
                at = _DE + j * _T + half
                store(s, at, load(s, at) * cosine(angle))
            else:
                store(s, _E + j * _T + half, sine(angle))


@inline_kernel
def _forward_tile(pack: np.ndarray, channels: int, s: np.ndarray, kept: np.ndarray, kept_at: int) -> None:
    """Run all layers; the inputs of the layers stay in the scratch."""
    _embed(pack, s, False)
    for layer in range(5):
        _fill(pack, _BIAS + 32 * layer, 32, s, _Y)
        before = _H + (layer - 1) * 32 * _T
        if layer == 0:
            add_product(pack, _L0, 32, _EMBED, _E, 32, s, _Y)
        elif layer == 3:
            add_product(pack, _L3E, 32, _EMBED, _E, 32, s, _Y)
            add_product(pack, _L3H, 32, 32, before, 32, s, _Y)
        else:
            add_product(pack, _L1 if layer == 1 else (_L2 if layer == 2 else _L4), 32, 32, before, 32, s, _Y)
        after = _H + layer * 32 * _T
        for half in range(0, _T, 16):
            relu_rows(
                s, _Y + half, pack, _FEATURE_BIAS + 32 * layer, kept, kept_at + layer * _T + half, s, after + half
            )
        add_product(pack, _FEATURE + layer * channels * 32, 32, channels, _C, 32, s, after)
    output = _FEATURE + 5 * channels * 32
    _fill(pack, output + 1024, 8, s, _O)
    add_product(pack, output, 32, 32, _H + 4 * 32 * _T, 8, s, _O)


@parallel_kernel
def decode(
    points: np.ndarray,
    features: np.ndarray,
    column: int,
    channels: int,
    pack: np.ndarray,
    outputs: int,
    kept: np.ndarray,
    out: np.ndarray,
) -> None:
    """Write `out` (n, outputs), and in `kept` (tiles, 5, 32) which hidden units of which points were positive."""
    count = points.shape[0]
    everything = np.empty(0, np.int64)
    for chunk in numba.prange((count + CHUNK - 1) // CHUNK):
        s = np.empty(_SCRATCH, np.float32)
        for start in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK), _T):
            _read_tile(points, features, column, channels, everything, start, count, s)
            _forward_tile(pack, channels, s, kept, start * 5)
            for lane in range(min(_T, count - start)):
                for o in range(outputs):
                    out[start + lane, o] = s[_O + o * _T + lane]


@inline_kernel
def _sum_points(s: np.ndarray, grown: np.ndarray, at: int) -> None:
    """Add the sums over the points of what is in `_G`."""
    for half in range(0, 32, 16):
        total = load(grown, at + half)
        for lane in range(_T):
            total += load(s, _G + lane * 32 + half)
        store(grown, at + half, total)


@inline_kernel
def _embedding_gradient(s: np.ndarray, grown: np.ndarray) -> None:
    """Add the gradient of B, sum over the points of p d^T."""
    for j in range(0, _EMBED, 32):
        turn_rows(s, _DE + j * _T, _G)
        clear_rows(8, s, _Y)
        multiply_add(s, _P, _T, 1, s, _G, _T, s, _Y)
        for axis in range(3):
            for half in range(0, 32, 16):
                at = axis * _EMBED + j + half
                store(grown, at, load(grown, at) + load(s, _Y + axis * 32 + half))


@inline_kernel
def _backward_tile(
    forward: np.ndarray,
    pack: np.ndarray,
    channels: int,
    s: np.ndarray,
    kept: np.ndarray,
    wants_points: bool,
    wants_weights: bool,
    grown: np.ndarray,
) -> None:
    """Go back from `_O`; `_DC` gets the features' gradient, `_DE` the embedding's argument's, `grown` the weights'."""
    output = _RF + 5 * channels * 32
    wants_embedding = wants_points or wants_weights
    clear_rows(channels, s, _DC)
    if wants_embedding:
        clear_rows(_EMBED, s, _DE)
    if wants_weights:
        grown_output = _FEATURE + 5 * channels * 32
        turn_rows(s, _O, _G)
        _sum_points(s, grown, grown_output + 1024)
        add_outer(s, _G, _H + 4 * 32 * _T, 32, grown, grown_output)
    clear_rows(32, s, _D)
    add_product(pack, output, 32, 8, _O, 32, s, _D)
    for back in range(5):
        layer = 4 - back
        add_product(pack, _RF + layer * channels * 32, channels, 32, _D, channels, s, _DC)
        if wants_weights:
            turn_rows(s, _D, _G)
            _sum_points(s, grown, _FEATURE_BIAS + 32 * layer)
            add_outer(s, _G, _C, channels, grown, _FEATURE + layer * channels * 32)
        for half in range(0, _T, 16):
            mask_rows(s, _D + half, kept, layer * _T + half, s, _Y + half)
        before = _H + (layer - 1) * 32 * _T
        if wants_weights:
            turn_rows(s, _Y, _G)
            _sum_points(s, grown, _BIAS + 32 * layer)
            if layer == 0:
                add_outer(s, _G, _E, _EMBED, grown, _L0)
            elif layer == 3:
                add_outer(s, _G, _E, _EMBED, grown, _L3E)
                add_outer(s, _G, before, 32, grown, _L3H)
            else:
                add_outer(s, _G, before, 32, grown, _L1 if layer == 1 else (_L2 if layer == 2 else _L4))
        if wants_embedding and (layer == 0 or layer == 3):
            add_product(pack, _R0 if layer == 0 else _R3E, _EMBED, 32, _Y, _EMBED, s, _DE)
        if layer > 0:
            clear_rows(32, s, _D)
            at = _R1 if layer == 1 else (_R2 if layer == 2 else (_R3H if layer == 3 else _R4))
            add_product(pack, at, 32, 32, _Y, 32, s, _D)
    if wants_embedding:
        _embed(forward, s, True)
    if wants_weights:
        _embedding_gradient(s, grown)


@inline_kernel
def _write_tile(
    forward: np.ndarray,
    channels: int,
    order: np.ndarray,
    start: int,
    count: int,
    s: np.ndarray,
    d_features: np.ndarray,
    column: int,
    d_points: np.ndarray,
    wants_points: bool,
) -> None:
    """Bring the gradients of features and points back from the lanes; what is in `d_features` is added to."""
    if d_features.size > 0:
        for half in range(0, _T, 16):
            for c in range(0, channels, 16):
                turn_block(s, _DC + c * _T + half, _T, s, _ROWS + half * 64 + c, 64)
        for lane in range(min(_T, count - start)):
            at = order[start + lane] * d_features.shape[1] + column
            for c in range(0, channels, 16):
                store(d_features, at + c, load(d_features, at + c) + load(s, _ROWS + lane * 64 + c))
    if wants_points:
        for axis in range(3):
            for half in range(0, _T, 16):
                total = zeros()
                for j in range(_EMBED):
                    total += load(s, _DE + j * _T + half) * forward[axis * _EMBED + j]
                store(s, _POINTS + axis * _T + half, total)
            for lane in range(min(_T, count - start)):
                d_points[order[start + lane], axis] += s[_POINTS + axis * _T + lane]


@parallel_kernel
def decode_backward(
    points: np.ndarray,
    features: np.ndarray,
    column: int,
    channels: int,
    forward: np.ndarray,
    pack: np.ndarray,
    kept: np.ndarray,
    order: np.ndarray,
    upstream: np.ndarray,
    d_points: np.ndarray,
    d_features: np.ndarray,
    grown: np.ndarray,
) -> None:
    """Add the gradients of the points in `order`, those whose upstream is not zero.

    `d_points` and `d_features` may be empty: not wanted. `grown` (chunks, forward pack) gets the weights' gradient, a
    part for each chunk, or is empty. With it the layers are computed again, else `kept` says all that is needed.
    """
    count = order.shape[0]
    wants_points, wants_weights = d_points.size > 0, grown.size > 0
    for chunk in numba.prange((count + CHUNK - 1) // CHUNK):
        s = np.zeros(_SCRATCH, np.float32)
        bits = np.empty(5 * _T, np.int32)
        mine = grown[chunk] if wants_weights else np.empty(0, np.float32)
        for start in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK), _T):
            if wants_weights:
                _read_tile(points, features, column, channels, order, start, count, s)
                _forward_tile(forward, channels, s, bits, 0)
            else:
                for lane in range(_T):
                    at = order[min(start + lane, count - 1)]
                    for axis in range(3):
                        s[_P + axis * _T + lane] = points[at, axis]
                    for layer in range(5):
                        bits[layer * _T + lane] = kept[at // _T, layer, at % _T]
            clear_rows(32, s, _O)
            for lane in range(min(_T, count - start)):
                for o in range(upstream.shape[1]):
                    s[_O + o * _T + lane] = upstream[order[start + lane], o]
            _backward_tile(forward, pack, channels, s, bits, wants_points, wants_weights, mine)
            _write_tile(forward, channels, order, start, count, s, d_features, column, d_points, wants_points)


def weight_gradient_size(channels: int) -> int:
    """Return the length of the forward pack."""
    return _FEATURE + 5 * channels * 32 + 1024 + 32
