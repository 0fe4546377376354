"""The small networks of the field on the CPU: 32 points at a time in lanes, all layers while the tile is in the cache.

Weights come in two flat packs, one for each direction, so that eight outputs lie side by side for every input. The
distance is the last of the 16 geometry outputs here, so that the colour's input is [one-blob | features] as it lies.

- forward: hidden transposed (80, 32) | geometry transposed (32, 16) | colour's hidden transposed (63, 32) | colour
  transposed, filled up (32, 8)
- backward: hidden (32, 80) | geometry (16, 32) | colour's hidden, filled up (32, 64) | colour (3, 32)
- gradients: hidden transposed (80, 32) | geometry (16, 32) | colour's hidden transposed, filled up (64, 32) | colour,
  filled up (8, 32)
"""

# Intrinsics are called without their typing context:
# mypy: disable-error-code="call-arg"

import numba
import numpy as np

from xrdslam.ops.one_blob_kernels import add_bins, bins_slope
from xrdslam.ops.simd import inline_kernel, load, parallel_kernel, store
from xrdslam.ops.simd_tiles import add_outer, add_product, clear_rows, keep_positive, pass_positive, turn_rows

__all__ = ["CHUNK", "GRADIENTS", "decode", "decode_backward"]

CHUNK = 512
"""Points that a thread takes at once; a sum over points is a sum over chunks, whatever the number of threads."""
_T, _BINS = 32, 16
_IN, _BLOB, _GEO = 80, 32, 80
"""Inputs of the first layer; the first rows of one-blob and geometry in the tile: [hash | one-blob | geometry]."""
_HIDDEN, _GEOMETRY, _COLOR_HIDDEN, _COLOR = 0, 2560, 3072, 5088
_BACK_GEOMETRY, _BACK_COLOR_HIDDEN, _BACK_COLOR = 2560, 3072, 5120
_GROWN_GEOMETRY, _GROWN_COLOR_HIDDEN, _GROWN_COLOR = 2560, 3072, 5120
GRADIENTS = 5376
"""Numbers of a pack of gradients."""
# The scratch of a tile, in floats: rows of 32.
_E = 0
_H = _E + 96 * _T
_C = _H + 32 * _T
_O = _C + 32 * _T
_D = _O + 8 * _T
_DE = _D + 32 * _T
_G = _DE + 96 * _T
_SCRATCH = _G + 32 * _T


@inline_kernel
def _read_tile(points: np.ndarray, encoded: np.ndarray, start: int, count: int, s: np.ndarray) -> None:
    """Bring up to 32 points' encodings into lanes; the lanes beyond `count` repeat the last point."""
    for lane in range(_T):
        at = min(start + lane, count - 1)
        store(s, _G + lane * 32, load(encoded, at * 32))
        store(s, _G + lane * 32 + 16, load(encoded, at * 32 + 16))
    turn_rows(s, _G, _E)
    clear_rows(3 * _BINS, s, _E + _BLOB * _T)
    for lane in range(_T):
        at = min(start + lane, count - 1)
        for axis in range(3):
            add_bins(points[at, axis], _BINS, s, _E + (_BLOB + axis * _BINS) * _T + lane, _T)


@inline_kernel
def _forward_tile(pack: np.ndarray, s: np.ndarray, wants_color: bool) -> None:
    """Run all layers; what each puts out stays in the scratch."""
    clear_rows(32, s, _H)
    add_product(pack, _HIDDEN, 32, _IN, _E, 32, s, _H)
    keep_positive(32, s, _H)
    clear_rows(16, s, _E + _GEO * _T)
    add_product(pack, _GEOMETRY, 16, 32, _H, 16, s, _E + _GEO * _T)
    if wants_color:
        clear_rows(32, s, _C)
        add_product(pack, _COLOR_HIDDEN, 32, 63, _E + _BLOB * _T, 32, s, _C)
        keep_positive(32, s, _C)
        clear_rows(8, s, _O)
        add_product(pack, _COLOR, 8, 32, _C, 8, s, _O)


@parallel_kernel
def decode(points: np.ndarray, encoded: np.ndarray, pack: np.ndarray, distance: np.ndarray, color: np.ndarray) -> None:
    """Write the distance (n) and, unless it is empty, the colour (n, 3) of points with their hash features (n, 32)."""
    count = points.shape[0]
    for chunk in numba.prange((count + CHUNK - 1) // CHUNK):
        s = np.empty(_SCRATCH, np.float32)
        for start in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK), _T):
            _read_tile(points, encoded, start, count, s)
            _forward_tile(pack, s, color.size > 0)
            for lane in range(min(_T, count - start)):
                distance[start + lane] = s[_E + (_GEO + 15) * _T + lane]
                if color.size > 0:
                    for o in range(3):
                        color[start + lane, o] = s[_O + o * _T + lane]


@inline_kernel
def _backward_tile(pack: np.ndarray, s: np.ndarray, wants_points: bool, wants_weights: bool, grown: np.ndarray) -> None:
    """Go back from the colour in `_O` and the distance in the last row of `_DE`, which gets the inputs' gradient."""
    first = 0 if wants_points else 3 * _BINS
    d_geometry = _DE + _GEO * _T
    if wants_weights:
        turn_rows(s, _C, _G)
        add_outer(s, _G, _O, 8, grown, _GROWN_COLOR)
    clear_rows(32, s, _D)
    add_product(pack, _BACK_COLOR, 32, 3, _O, 32, s, _D)
    pass_positive(32, s, _C, _D)
    if wants_weights:
        turn_rows(s, _D, _G)
        add_outer(s, _G, _E + _BLOB * _T, 64, grown, _GROWN_COLOR_HIDDEN)
    # The pack's last column is zero: the distance's gradient stays.
    clear_rows(63 - first, s, _DE + (_BLOB + first) * _T)
    add_product(pack, _BACK_COLOR_HIDDEN + first, 64, 32, _D, 64 - first, s, _DE + (_BLOB + first) * _T)
    if wants_weights:
        turn_rows(s, _H, _G)
        add_outer(s, _G, d_geometry, 16, grown, _GROWN_GEOMETRY)
    clear_rows(32, s, _D)
    add_product(pack, _BACK_GEOMETRY, 32, 16, d_geometry, 32, s, _D)
    pass_positive(32, s, _H, _D)
    if wants_weights:
        turn_rows(s, _D, _G)
        add_outer(s, _G, _E, _IN, grown, _HIDDEN)
    clear_rows(32, s, _DE)
    add_product(pack, 0, _IN, 32, _D, _IN if wants_points else 32, s, _DE)


@parallel_kernel
def decode_backward(
    points: np.ndarray,
    encoded: np.ndarray,
    forward: np.ndarray,
    pack: np.ndarray,
    d_distance: np.ndarray,
    d_color: np.ndarray,
    d_encoded: np.ndarray,
    d_points: np.ndarray,
    grown: np.ndarray,
) -> None:
    """Write the gradient of the hash features, and add the one-blob's part of the points' unless it is empty.

    `grown` (chunks, gradients) gets the weights' gradient, a part for each chunk, or is empty. The layers are computed
    again: that is cheaper than their way through the memory.
    """
    count = points.shape[0]
    wants_points, wants_weights = d_points.size > 0, grown.size > 0
    for chunk in numba.prange((count + CHUNK - 1) // CHUNK):
        s = np.empty(_SCRATCH, np.float32)
        mine = grown[chunk] if wants_weights else np.empty(0, np.float32)
        for start in range(chunk * CHUNK, min(count, (chunk + 1) * CHUNK), _T):
            used = min(_T, count - start)
            _read_tile(points, encoded, start, count, s)
            _forward_tile(forward, s, True)
            clear_rows(8, s, _O)
            clear_rows(1, s, _DE + (_GEO + 15) * _T)
            for lane in range(used):
                s[_DE + (_GEO + 15) * _T + lane] = d_distance[start + lane]
                for o in range(3):
                    s[_O + o * _T + lane] = d_color[start + lane, o]
            _backward_tile(pack, s, wants_points, wants_weights, mine)
            turn_rows(s, _DE, _G)
            for lane in range(used):
                at = (start + lane) * 32
                store(d_encoded, at, load(s, _G + lane * 32))
                store(d_encoded, at + 16, load(s, _G + lane * 32 + 16))
                if wants_points:
                    for axis in range(3):
                        first = _DE + (_BLOB + axis * _BINS) * _T + lane
                        d_points[start + lane, axis] += bins_slope(points[start + lane, axis], _BINS, s, first, _T)
