"""Colours of surfaces, band-limited to the width of a pixel: the dispatcher and the plain building materials.

Every texture is a function of the surface point alone: (u, v) [m] from the middle of its chart, or (x, y, z) [m] in the
solid's frame. `w` [m] is the width that a pixel covers there; features narrower than it fade to their mean, as the
sensor's area would make them. Colours are linear rgb; c0, c1, c2 are the material's own three.
"""

import math

import numpy as np

from xrdslam.datasets.synthetic.compiled import compiled
from xrdslam.datasets.synthetic.noise import cell_random, edge, fbm, mix, smooth_step, visible
from xrdslam.datasets.synthetic.pictures import book, clock, painting, rug, screen, window
from xrdslam.datasets.synthetic.prints import carpet, ceiling, plaster, poster, whiteboard
from xrdslam.datasets.synthetic.stripes import line

__all__ = ["albedo"]

Three = tuple[float, float, float]


@compiled
def plain(c0: Three, c1: Three, x: float, y: float, z: float, w: float, scale: float, seed: int) -> Three:
    """Paint or plaster: slow drifts between two near colours."""
    return mix(c0, c1, 0.5 + 0.9 * fbm(x, y, z, 1.7 / scale, 3, w, seed))


@compiled
def grain(c0: Three, c1: Three, along: float, across: float, z: float, w: float, scale: float, seed: int) -> Three:
    """Wood: rings bent by slow noise, and fibres a dozen times longer than wide."""
    bend = fbm(along * 0.35, across, z, 3.0 / scale, 2, w, seed)
    rings = math.sin(across * 90.0 / scale + 7.0 * bend) * visible(20.0 / scale, w)
    fibres = fbm(along * 0.08, across, z, 45.0 / scale, 3, w, seed + 9)
    return mix(c0, c1, 0.45 + 0.45 * bend + 0.16 * rings + 0.4 * fibres)


@compiled
def wood(
    c0: Three, c1: Three, u: float, v: float, hu: float, hv: float, z: float, w: float, scale: float, seed: int
) -> Three:
    """Wood with its grain along the longer side."""
    return grain(c0, c1, u, v, z, w, scale, seed) if hu >= hv else grain(c0, c1, v, u, z, w, scale, seed)


@compiled
def planks(c0: Three, c1: Three, c2: Three, u: float, v: float, w: float, scale: float, seed: int) -> Three:
    """Floor boards of 13 cm by 1.1 m, staggered at random, each with its own tone; c2 between them."""
    wide, long = 0.13 * scale, 1.1 * scale
    row = math.floor(v / wide)
    shifted = u + long * cell_random(row, 1, seed)
    board = math.floor(shifted / long)
    tone = cell_random(row, board, seed + 2)
    colour = grain(c0, c1, u, v, 3.0 * tone, w, 0.8, seed + (row * 31 + board) % 57)
    k = 0.72 + 0.5 * tone
    to_side = wide * (0.5 - abs(v / wide - row - 0.5))
    to_end = long * (0.5 - abs(shifted / long - board - 0.5))
    gap = max(line(to_side, 0.007, w), line(to_end, 0.007, w))
    return mix((colour[0] * k, colour[1] * k, colour[2] * k), c2, 0.85 * gap)


@compiled
def fabric(
    c0: Three, c1: Three, c2: Three, u: float, v: float, x: float, y: float, z: float, w: float, scale: float, seed: int
) -> Three:
    """Woven cloth: a plaid of c1 with thin lines of c2, over yarn-sized irregularities."""
    period = 0.12 * scale
    du, dv = (
        abs(u / period - math.floor(u / period) - 0.5) * period,
        abs(v / period - math.floor(v / period) - 0.5) * period,
    )
    plaid = 0.5 * (line(du, 0.4 * period, w) + line(dv, 0.4 * period, w))
    thin = max(line(0.5 * period - du, 0.08 * period, w), line(0.5 * period - dv, 0.08 * period, w))
    yarn = fbm(x, y, z, 55.0, 3, w, seed) * 0.22 + fbm(x, y, z, 6.0, 2, w, seed + 4) * 0.18
    colour = mix(mix(c0, c1, 0.75 * plaid), c2, 0.6 * thin)
    return colour[0] * (1.0 + yarn), colour[1] * (1.0 + yarn), colour[2] * (1.0 + yarn)


@compiled
def wallpaper(c0: Three, c1: Three, c2: Three, u: float, v: float, w: float, scale: float, seed: int) -> Three:
    """Staggered flowers on soft vertical stripes."""
    cell = 0.3 * scale
    stripe = 0.5 + 0.5 * math.sin(2.0 * math.pi * u / (0.5 * cell)) * visible(2.0 / cell, w)
    row = math.floor(v / cell)
    shifted = u / cell + 0.5 * (row - 2.0 * math.floor(0.5 * row))
    p, q = (shifted - math.floor(shifted) - 0.5) * cell, (v / cell - row - 0.5) * cell
    r, angle = math.hypot(p, q), math.atan2(q, p)
    petal = (0.30 + 0.12 * math.cos(5.0 * angle + 2.0 * row)) * cell - r
    colour = mix(c0, mix(c0, c1, 0.35), stripe)
    colour = mix(colour, c1, 0.9 * edge(petal, w) * visible(1.5 / cell, w))
    return mix(colour, c2, edge(0.11 * cell - r, w) * visible(2.5 / cell, w))


@compiled
def brick(c0: Three, c1: Three, c2: Three, u: float, v: float, w: float, scale: float, seed: int) -> Three:
    """Running bond of 23 x 7.5 cm bricks between c0 and c1, mortar c2."""
    long, high, joint = 0.23 * scale, 0.075 * scale, 0.014 * scale
    row = math.floor(v / high)
    shifted = u / long + 0.5 * (row & 1) + 0.03 * cell_random(row, 3, seed)
    column = math.floor(shifted)
    to_side = long * (0.5 - abs(shifted - column - 0.5))
    to_bed = high * (0.5 - abs(v / high - row - 0.5))
    tone = cell_random(column, row, seed)
    rough = 1.0 + 0.25 * fbm(u, v, tone, 22.0, 4, w, seed)
    k = (0.75 + 0.5 * cell_random(column, row, seed + 5)) * rough
    body = mix(c0, c1, tone)
    mortar = max(line(to_side, joint, w), line(to_bed, joint, w))
    return mix((body[0] * k, body[1] * k, body[2] * k), c2, mortar)


@compiled
def checker(c0: Three, c1: Three, c2: Three, u: float, v: float, w: float, scale: float, seed: int) -> Three:
    """Tiles of 20 cm, alternating, with joints of c2."""
    side = 0.2 * scale
    i, j = math.floor(u / side), math.floor(v / side)
    joint = max(
        line(side * (0.5 - abs(u / side - i - 0.5)), 0.008, w), line(side * (0.5 - abs(v / side - j - 0.5)), 0.008, w)
    )
    t = 0.85 * ((i + j) & 1) + 0.15 * cell_random(i, j, seed)
    return mix(mix(c0, c1, t * visible(0.5 / side, w) + 0.5 * (1.0 - visible(0.5 / side, w))), c2, 0.8 * joint)


@compiled
def stone(c0: Three, c1: Three, c2: Three, x: float, y: float, z: float, w: float, scale: float, seed: int) -> Three:
    """Marble: veins where a bent noise crosses zero, specks of c2."""
    bend = fbm(x, y, z, 4.0 / scale, 3, w, seed)
    vein = abs(fbm(x + 0.25 * bend, y + 0.25 * bend, z, 6.0 / scale, 4, w, seed + 3))
    colour = mix(c1, c0, smooth_step(0.0, 0.28, vein))
    return mix(colour, c2, smooth_step(0.35, 0.6, fbm(x, y, z, 30.0 / scale, 3, w, seed + 8)))


@compiled
def leaf(c0: Three, c1: Three, c2: Three, u: float, v: float, hu: float, hv: float, w: float, seed: int) -> Three:
    """A leaf: a pale rib along it, veins slanting off."""
    across = v if hu >= hv else u
    along = u if hu >= hv else v
    veins = math.sin((along + 1.3 * abs(across)) * 220.0) * visible(35.0, w)
    colour = mix(c0, c1, 0.5 + 0.25 * veins + 0.4 * fbm(u, v, 0.3, 14.0, 3, w, seed))
    return mix(colour, c2, line(abs(across), 0.006, w))


@compiled
def albedo(  # one dispatcher over every pattern
    patterns: np.ndarray, looks: np.ndarray, m: int, u: float, v: float, hu: float, hv: float,
    x: float, y: float, z: float, w: float,
) -> Three:  # fmt: skip
    """Return the linear albedo of material m at a surface point; arguments as in the module's docstring."""
    k = looks[m]
    pattern, seed = patterns[m, 0], patterns[m, 1]
    c0, c1, c2 = (k[0], k[1], k[2]), (k[3], k[4], k[5]), (k[6], k[7], k[8])
    scale, colour = k[9], c0
    if pattern == 0:
        colour = plain(c0, c1, x, y, z, w, scale, seed)
    elif pattern == 1:
        colour = wood(c0, c1, u, v, hu, hv, z, w, scale, seed)
    elif pattern == 2:
        colour = planks(c0, c1, c2, u, v, w, scale, seed)
    elif pattern == 3:
        colour = fabric(c0, c1, c2, u, v, x, y, z, w, scale, seed)
    elif pattern == 4:
        colour = wallpaper(c0, c1, c2, u, v, w, scale, seed)
    elif pattern == 5:
        colour = brick(c0, c1, c2, u, v, w, scale, seed)
    elif pattern == 6:
        colour = rug(c0, c1, c2, u, v, hu, hv, w, seed)
    elif pattern == 7:
        colour = painting(c0, c1, c2, u, v, hu, hv, w, seed)
    elif pattern == 8:
        colour = book(c0, c1, c2, u, v, hu, hv, w, seed)
    elif pattern == 9:
        colour = window(c0, c1, c2, u, v, hv, w, seed)
    elif pattern == 10:
        colour = checker(c0, c1, c2, u, v, w, scale, seed)
    elif pattern == 11:
        colour = leaf(c0, c1, c2, u, v, hu, hv, w, seed)
    elif pattern == 12:
        colour = screen(c0, c1, c2, u, v, hu, hv, w, seed)
    elif pattern == 13:
        colour = stone(c0, c1, c2, x, y, z, w, scale, seed)
    elif pattern == 14:
        colour = clock(c0, c1, c2, u, v, hu, w)
    elif pattern == 15:
        colour = ceiling(c0, c1, c2, u, v, w, scale, seed)
    elif pattern == 16:
        colour = carpet(c0, c1, c2, u, v, w, scale, seed)
    elif pattern == 17:
        colour = whiteboard(c0, c1, c2, u, v, hu, hv, w, seed)
    elif pattern == 18:
        colour = poster(c0, c1, c2, u, v, hu, hv, w, seed)
    elif pattern == 19:
        colour = plaster(c0, c1, c2, x, y, z, w, scale, seed)
    mottle = 1.0 + (k[10] * fbm(x, y, z, 16.0, 3, w, seed + 40) if k[10] > 0.0 else 0.0)
    return (
        min(max(colour[0] * mottle, 0.01), 0.95),
        min(max(colour[1] * mottle, 0.01), 0.95),
        min(max(colour[2] * mottle, 0.01), 0.95),
    )
