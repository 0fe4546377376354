"""Where the numba kernels keep what: the record of a projected Gaussian, the blocks of a tile, the view vector.

A tile is `TILE` x `TILE` pixels, worked on by one thread with its state in the first-level cache. Inside, pixels are
stored as 4x4 blocks of 16 lanes, so that every access is one aligned vector whatever the footprint's place: a 7x7
footprint touches about six blocks, where it would touch seven unaligned rows of 8 lanes.
"""

import numpy as np

TILE = 32
BLOCK = 4
BLOCKS = TILE // BLOCK
LANES = BLOCK * BLOCK
TILES_MAX = 255
"""Tiles along one side: a tile box is four bytes."""

# The record of a visible Gaussian: 16 float32, one cache line, some of them integers' bits.
U, V = 0, 1  # centre [px]
POWER_XX, POWER_XY, POWER_YY = 2, 3, 4  # log2 alpha = LOG2_OPACITY + XX dx^2 + XY dx dy + YY dy^2
LOG2_OPACITY = 5
RED, GREEN, BLUE, DEPTH = 6, 7, 8, 9
PIXELS_X, PIXELS_Y = 10, 11  # int: first | last << 16, the footprint cut to the image; first > last if there is none
TILES = 12  # int: left | right << 8 | top << 16 | bottom << 24, the tiles whose lists hold the Gaussian
SLOT = 13  # int: where its gradient slots begin, one for each of these tiles, row by row
WIDE_X, WIDE_Y = 14, 15  # int: as PIXELS_*, grown by the margin
RECORD = 16

# The gradient slot of one Gaussian in one tile: sums over its pixels, with g = dL/d(ln alpha).
M_1, M_X, M_Y, M_XX, M_XY, M_YY = range(6)  # g times 1, dx, dy, dx^2, dx dy, dy^2
M_RED, M_GREEN, M_BLUE, M_DEPTH = range(6, 10)  # dL/dcolour, and dL/dz through the depth image

# The view: pose, intrinsics and limits in one float32 vector.
ROTATION, TRANSLATION = 0, 9
FX, FY, CX, CY, LIMIT_X, LIMIT_Y, LOWPASS, NEAR, MARGIN_PX, SLACK_TRANSLATION, SLACK_ROTATION = range(12, 23)
VIEW = 23

f32 = np.float32

# Coordinates of the pixels of each block column and of each block row of a tile, 16 lanes each.
COLUMNS = (np.arange(LANES, dtype=f32) % BLOCK + BLOCK * np.arange(BLOCKS, dtype=f32)[:, None]).astype(f32)
ROWS = (np.arange(LANES, dtype=f32) // BLOCK + BLOCK * np.arange(BLOCKS, dtype=f32)[:, None]).astype(f32)
MANY_BLOCKS = 12
"""A footprint over more blocks than this looks before it works: it may be a streak, or lie behind pixels that are full.
Below, the misprediction of that branch costs more than the work it saves."""

EMPTY_TILES = 1 | 1 << 16  # left 1, right 0, top 1, bottom 0


def chunk_size(num_gaussians: int) -> int:
    """Return how many Gaussians one unit of work takes, a multiple of 16.

    It depends on nothing but their number, and so, hence, do the sums, whatever the threads.
    """
    return max(1024, -(-num_gaussians // 1024) * 16)
