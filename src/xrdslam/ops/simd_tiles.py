"""What a network does with a tile: 32 points in lanes, each row of a flat scratch 32 floats of one quantity.

Places are positions in the scratch. Weights lie as (inputs, outputs), so that eight outputs are side by side.
"""

# Intrinsics are called without their typing context:
# mypy: disable-error-code="call-arg"

import numpy as np

from xrdslam.ops.simd import LANES, inline_kernel, load, maximum, select, store, transpose, zeros
from xrdslam.ops.simd_layers import BLOCK, TILE, multiply_add

__all__ = ["add_outer", "add_product", "clear_rows", "keep_positive", "pass_positive", "turn_block", "turn_rows"]

_ZERO = np.float32(0)


@inline_kernel
def turn_block(
    source: np.ndarray, at: int, stride: int, target: np.ndarray, target_at: int, target_stride: int
) -> None:
    """Transpose a block of 16 x 16."""
    t = transpose(
        (
            load(source, at),
            load(source, at + stride),
            load(source, at + 2 * stride),
            load(source, at + 3 * stride),
            load(source, at + 4 * stride),
            load(source, at + 5 * stride),
            load(source, at + 6 * stride),
            load(source, at + 7 * stride),
            load(source, at + 8 * stride),
            load(source, at + 9 * stride),
            load(source, at + 10 * stride),
            load(source, at + 11 * stride),
            load(source, at + 12 * stride),
            load(source, at + 13 * stride),
            load(source, at + 14 * stride),
            load(source, at + 15 * stride),
        )
    )
    store(target, target_at, t[0])
    store(target, target_at + target_stride, t[1])
    store(target, target_at + 2 * target_stride, t[2])
    store(target, target_at + 3 * target_stride, t[3])
    store(target, target_at + 4 * target_stride, t[4])
    store(target, target_at + 5 * target_stride, t[5])
    store(target, target_at + 6 * target_stride, t[6])
    store(target, target_at + 7 * target_stride, t[7])
    store(target, target_at + 8 * target_stride, t[8])
    store(target, target_at + 9 * target_stride, t[9])
    store(target, target_at + 10 * target_stride, t[10])
    store(target, target_at + 11 * target_stride, t[11])
    store(target, target_at + 12 * target_stride, t[12])
    store(target, target_at + 13 * target_stride, t[13])
    store(target, target_at + 14 * target_stride, t[14])
    store(target, target_at + 15 * target_stride, t[15])


@inline_kernel
def turn_rows(s: np.ndarray, source: int, target: int) -> None:
    """Write 32 rows of 32 points as 32 points of 32 rows."""
    for half in range(0, TILE, LANES):
        for row in range(0, 32, LANES):
            turn_block(s, source + row * TILE + half, TILE, s, target + half * 32 + row, 32)


@inline_kernel
def clear_rows(rows: int, s: np.ndarray, target: int) -> None:
    """Set rows to zero."""
    for r in range(2 * rows):
        store(s, target + r * LANES, zeros())


@inline_kernel
def add_product(
    weights: np.ndarray, at: int, width: int, inputs: int, source: int, outputs: int, s: np.ndarray, target: int
) -> None:
    """Add a matrix product: `width` weights for each of `inputs` rows, the first `outputs` of them used."""
    for o in range(0, outputs, BLOCK):
        multiply_add(weights, at + o, 1, width, s, source, inputs, s, target + o * TILE)


@inline_kernel
def add_outer(s: np.ndarray, turned: int, rows: int, count: int, grown: np.ndarray, at: int) -> None:
    """Add, for each of `count` rows, its products with the 32 rows that lie turned, summed over the points."""
    for r in range(0, count, BLOCK):
        multiply_add(s, rows + r * TILE, TILE, 1, s, turned, TILE, grown, at + r * 32)


@inline_kernel
def keep_positive(count: int, s: np.ndarray, target: int) -> None:
    """Set what is negative in rows to zero."""
    for r in range(2 * count):
        at = target + r * LANES
        store(s, at, maximum(load(s, at), _ZERO))


@inline_kernel
def pass_positive(count: int, s: np.ndarray, activation: int, target: int) -> None:
    """Set rows to zero where an activation is."""
    for r in range(2 * count):
        at = target + r * LANES
        store(s, at, select(load(s, activation + r * LANES) > _ZERO, load(s, at), zeros()))
