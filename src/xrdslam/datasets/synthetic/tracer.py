"""Frames by ray casting: exact z-depth from the pixel's centre, colour with edges sampled more finely.

One ray through each pixel's centre gives depth and what is seen there. Textures are band-limited, so one sample is
enough inside a surface; where a neighbour sees another surface, four rays share the pixel. Rows are
independent: the same bits for any number of threads.
"""

import math

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from xrdslam.datasets.synthetic.bvh import STACK, first_hit
from xrdslam.datasets.synthetic.compiled import compiled, inlined
from xrdslam.datasets.synthetic.rows import over_rows
from xrdslam.datasets.synthetic.shading import World, display_linear, radiance, srgb_codes, surface_frame

__all__ = ["render"]

ROTATED = ((-0.375, -0.125), (0.125, -0.375), (0.375, 0.125), (-0.125, 0.375))
"""Four samples [px from the centre] with four different rows and columns: upright edges get four steps too."""
FAINT, FAINT_SHARE = 0.002, 0.06
"""Steps of display-linear colour that need no smoothing: about three codes of 255."""
CODES = srgb_codes()


def render(
    world: World,
    intrinsics: tuple[float, float, float, float],
    width: int,
    height: int,
    T_world_camera: Float64[np.ndarray, "4 4"],
) -> tuple[UInt8[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
    """Return sRGB codes and depth along z [m] of the pinhole camera (fx, fy, cx, cy) at a pose in OpenCV axes."""
    pose = np.ascontiguousarray(T_world_camera, dtype=np.float64)
    lens = np.array(intrinsics, dtype=np.float64)
    depth = np.empty((height, width), np.float32)
    seen = np.empty((height, width), np.int64)
    colour = np.empty((height, width, 3), np.float64)
    rgb = np.empty((height, width, 3), np.uint8)
    over_rows(_pass, height, world, lens, pose, False, depth, seen, colour, rgb, CODES)
    over_rows(_pass, height, world, lens, pose, True, depth, seen, colour, rgb, CODES)
    return rgb, depth


@inlined
def _sample(
    world: World, lens: np.ndarray, pose: np.ndarray, u: float, v: float, pixels: float, guess: int, stack: np.ndarray
) -> tuple[float, int, float, float, float]:
    """Return depth, surface and display-linear colour through image point (u, v), for a sample `pixels` wide."""
    x, y = (u - lens[2]) / lens[0], (v - lens[3]) / lens[1]
    dx = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2]
    dy = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2]
    dz = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2]
    ox, oy, oz = pose[0, 3], pose[1, 3], pose[2, 3]
    t, i = first_hit(world.scene, world.bvh, ox, oy, oz, dx, dy, dz, guess, stack)
    hit = surface_frame(world.scene, i, ox + t * dx, oy + t * dy, oz + t * dz)
    length = math.sqrt(1.0 + x * x + y * y)
    facing = abs(dx * hit[4] + dy * hit[5] + dz * hit[6]) / length
    w = pixels * t / lens[0] / math.sqrt(max(facing, 0.1))  # between the pixel's short and long side on the surface
    r, g, b = radiance(world, i, hit[0], hit[1], hit[2], hit[3], w, True)
    k = world.light.exposure
    return t, i * 6 + hit[0], display_linear(r, k), display_linear(g, k), display_linear(b, k)


@inlined
def _differs(seen: np.ndarray, colour: np.ndarray, row: int, column: int, j: int, i: int) -> bool:
    """Return whether pixel (j, i) shows another surface than (row, column), and a colour that is seen to be another."""
    if seen[j, i] == seen[row, column]:
        return False
    for c in range(3):
        a, b = colour[row, column, c], colour[j, i, c]
        if abs(a - b) > FAINT + FAINT_SHARE * max(a, b):
            return True
    return False


@inlined
def _is_edge(seen: np.ndarray, colour: np.ndarray, row: int, column: int) -> bool:
    height, width = seen.shape
    return (
        (row > 0 and _differs(seen, colour, row, column, row - 1, column))
        or (column > 0 and _differs(seen, colour, row, column, row, column - 1))
        or (row + 1 < height and _differs(seen, colour, row, column, row + 1, column))
        or (column + 1 < width and _differs(seen, colour, row, column, row, column + 1))
    )


@compiled
def _pass(
    begin: int, end: int, world: World, lens: np.ndarray, pose: np.ndarray, is_refining: bool,
    depth: np.ndarray, seen: np.ndarray, centre: np.ndarray, rgb: np.ndarray,
    codes: np.ndarray,
) -> None:  # fmt: skip
    """Look through every pixel's centre; or, refining, look again at the pixels on edges and write the picture.

    Both in one kernel because compiling the ray caster twice would double the wait of the first run.
    """
    stack = np.empty(STACK, np.int64)
    for row in range(begin, end):
        guess = 0
        for column in range(seen.shape[1]):
            count, share = (4, 0.25) if is_refining else (1, 1.0)
            if is_refining and not _is_edge(seen, centre, row, column):
                count = 0
            c = centre[row, column]
            r, g, b = (0.0, 0.0, 0.0) if count > 0 else (c[0], c[1], c[2])
            for k in range(count):
                du, dv = ROTATED[k] if is_refining else (0.0, 0.0)
                s = _sample(world, lens, pose, column + du, row + dv, math.sqrt(share), guess, stack)
                guess = s[1] // 6
                r, g, b = r + share * s[2], g + share * s[3], b + share * s[4]
                if not is_refining:
                    depth[row, column], seen[row, column] = s[0], s[1]
            if is_refining:  # centres stay as they are: other rows' edges are found by them
                n = len(codes)
                rgb[row, column, 0], rgb[row, column, 1] = codes[min(int(r * n), n - 1)], codes[min(int(g * n), n - 1)]
                rgb[row, column, 2] = codes[min(int(b * n), n - 1)]
            else:
                c[0], c[1], c[2] = r, g, b
