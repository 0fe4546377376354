"""Textures drawn to the size of their face: paintings, books, rugs, a window's view, a screen, a clock's dial."""

import math

from xrdslam.datasets.synthetic.compiled import compiled
from xrdslam.datasets.synthetic.noise import cell_random, edge, fbm, gradient_noise, mix, smooth_step, visible
from xrdslam.datasets.synthetic.stripes import line

__all__ = ["book", "clock", "painting", "rug", "screen", "window"]

Three = tuple[float, float, float]


@compiled
def hue(t: float, lightness: float) -> Three:
    """Return a saturated colour; t in [0, 1) goes once around the circle."""
    a = 2.0 * math.pi * t
    return (
        lightness * (0.5 + 0.45 * math.cos(a)),
        lightness * (0.5 + 0.45 * math.cos(a - 2.1)),
        lightness * (0.5 + 0.45 * math.cos(a + 2.1)),
    )


@compiled
def landscape(c0: Three, c1: Three, c2: Three, p: float, q: float, w: float, seed: int) -> Three:
    """Three ridges under a sky with a sun; (p, q) in [-1, 1]."""
    colour = mix(c1, c0, smooth_step(-0.4, 1.0, q + 0.15 * fbm(p, 3.0 * q, 0.0, 2.0, 4, w, seed)))
    colour = mix(colour, (0.9, 0.7, 0.3), edge(0.16 - math.hypot(p - 0.35, q - 0.5), w))
    for ridge in range(3):
        top = 0.25 - 0.4 * ridge + (0.3 - 0.06 * ridge) * fbm(p, float(ridge), 0.5, 1.6, 4, w, seed + ridge)
        k = 1.1 - 0.3 * ridge + 0.35 * fbm(p, q, 0.2, 9.0, 3, w, seed + 7)
        colour = mix(colour, (c2[0] * k, c2[1] * k, c2[2] * k), edge(top - q, w))
    return colour


@compiled
def blocks(c0: Three, p: float, q: float, w: float, seed: int) -> Three:
    """A grid of coloured fields of unequal width with dark bars."""
    i, j = math.floor(2.0 * p + 0.4 * math.sin(2.0 * p)), math.floor(2.5 * q + 0.5 * math.sin(1.7 * q + 1.0))
    fp, fq = 2.0 * p + 0.4 * math.sin(2.0 * p) - i, 2.5 * q + 0.5 * math.sin(1.7 * q + 1.0) - j
    t = cell_random(i, j, seed)
    colour = hue(2.0 * t, 0.9) if t < 0.5 else mix(c0, (0.85, 0.83, 0.78), 0.85)
    bar = max(line(min(fp, 1.0 - fp), 0.12, 2.0 * w), line(min(fq, 1.0 - fq), 0.14, 2.5 * w))
    return mix(colour, (0.03, 0.03, 0.03), bar)


@compiled
def circles(c0: Three, c1: Three, p: float, q: float, w: float, seed: int) -> Three:
    """A dozen overlapping discs and rings."""
    colour = mix(c0, c1, 0.5 + 0.5 * q)
    for i in range(12):
        x, y = 1.8 * cell_random(i, 0, seed) - 0.9, 1.8 * cell_random(i, 1, seed) - 0.9
        r = 0.12 + 0.35 * cell_random(i, 2, seed)
        d = math.hypot(p - x, q - y)
        colour = mix(colour, hue(cell_random(i, 3, seed), 0.8), 0.8 * edge(r - d, w))
        colour = mix(colour, c1, line(d - 0.7 * r, 0.05, w))
    return colour


@compiled
def swirl(c0: Three, c1: Three, c2: Three, p: float, q: float, w: float, seed: int) -> Three:
    """Marbled paint: stripes bent by noise."""
    bend = fbm(p, q, 0.7, 1.1, 4, w, seed)
    wave = math.sin(9.0 * (p + 0.6 * q + 1.5 * bend)) * visible(3.0, w)
    return mix(mix(c0, c1, 0.5 + 0.5 * wave), c2, smooth_step(0.1, 0.5, fbm(p, q, 1.7, 2.3, 4, w, seed + 5)))


@compiled
def painting(c0: Three, c1: Three, c2: Three, u: float, v: float, hu: float, hv: float, w: float, seed: int) -> Three:
    """A picture in one of four manners (by seed) inside a white mat."""
    short = min(hu, hv)
    mat = 0.16 * short
    p, q, wn = u / (short - mat), v / (short - mat), w / (short - mat)
    manner = seed & 3
    if manner == 0:
        colour = landscape(c0, c1, c2, p, q, wn, seed)
    elif manner == 1:
        colour = blocks(c0, p, q, wn, seed)
    elif manner == 2:
        colour = circles(c0, c1, p, q, wn, seed)
    else:
        colour = swirl(c0, c1, c2, p, q, wn, seed)
    inside = min(hu - mat - abs(u), hv - mat - abs(v))
    return mix((0.78, 0.76, 0.7), colour, edge(inside, w))


@compiled
def book(c0: Three, c1: Three, c2: Three, u: float, v: float, hu: float, hv: float, w: float, seed: int) -> Three:
    """A cover with two bands and rows of letter-like marks in c2; works on spines and on boards."""
    along, across, ha, hc = (u, v, hu, hv) if hu > hv else (v, u, hv, hu)
    colour = c0
    colour = mix(colour, c1, line(abs(along) - 0.72 * ha, 0.14 * ha, w))
    rows = 1 + int(hc / 0.03)
    for row in range(rows):
        middle = (row - 0.5 * (rows - 1)) * 0.045
        letter = math.floor(along / 0.012)
        ink = cell_random(letter, row, seed) > 0.35 and abs(along) < 0.5 * ha
        if ink:
            share = line(along / 0.012 - letter - 0.5, 0.7, w / 0.012) * line(across - middle, min(0.02, hc), w)
            colour = mix(colour, c2, share * visible(25.0, w) + 0.3 * (1.0 - visible(25.0, w)) * share)
    return colour


@compiled
def rug(c0: Three, c1: Three, c2: Three, u: float, v: float, hu: float, hv: float, w: float, seed: int) -> Three:
    """A carpet: two borders, a lattice of diamonds, a many-lobed medallion."""
    inside = min(hu - abs(u), hv - abs(v))
    cell = 0.16
    p, q = abs(u / cell - math.floor(u / cell) - 0.5), abs(v / cell - math.floor(v / cell) - 0.5)
    diamond = p + q
    colour = mix(c0, c1, edge(0.3 - diamond, w / cell) * visible(1.0 / cell, w))
    colour = mix(colour, c2, line(diamond - 0.42, 0.07, w / cell))
    r, angle = math.hypot(u / hu, v / hv), math.atan2(v / hv, u / hu)
    lobes = 0.5 + 0.06 * math.cos(12.0 * angle)
    colour = mix(colour, c1, edge(lobes - r, w / hv))
    colour = mix(colour, c2, line(r - 0.9 * lobes, 0.04, w / hv))
    star = mix(c0, c2, 0.5 + 0.5 * math.cos(8.0 * angle) * math.cos(14.0 * r))
    colour = mix(colour, star, edge(0.36 - r, w / hv))
    step = (u if hv - abs(v) < hu - abs(u) else v) / 0.1
    tooth = abs(step - math.floor(step) - 0.5)
    border = mix(c2, c1, edge(0.3 - tooth, w / 0.1))
    colour = mix(colour, border, edge(0.17 - inside, w))
    colour = mix(colour, c0, max(line(inside - 0.17, 0.025, w), line(inside - 0.02, 0.04, w)))
    pile = 1.0 + 0.35 * fbm(u, v, 0.0, 40.0, 3, w, seed) + 0.2 * fbm(u, v, 0.5, 3.0, 2, w, seed)
    return colour[0] * pile, colour[1] * pile, colour[2] * pile


@compiled
def window(c0: Three, c1: Three, c2: Three, u: float, v: float, hv: float, w: float, seed: int) -> Three:
    """The view: sky c0 to c1 with clouds, trees of c2 below."""
    q = v / hv
    colour = mix(c1, c0, smooth_step(-0.6, 1.0, q))
    cloud = smooth_step(0.05, 0.5, fbm(u, 2.0 * v, 0.0, 2.0, 4, w, seed))
    colour = mix(colour, (0.9, 0.9, 0.9), 0.7 * cloud)
    tops = -0.35 + 0.35 * fbm(u, 0.3, 0.0, 2.2, 5, w, seed + 3)
    k = 0.55 + 0.5 * gradient_noise(u * 14.0, v * 14.0, 0.0, seed) * visible(14.0, w)
    return mix(colour, (c2[0] * k, c2[1] * k, c2[2] * k), edge(tops - q, w / hv))


@compiled
def screen(c0: Three, c1: Three, c2: Three, u: float, v: float, hu: float, hv: float, w: float, seed: int) -> Three:
    """A picture on a television: dunes at dusk inside a dark bezel."""
    colour = landscape(c0, c1, c2, u / hv, v / hv, w / hv, seed)
    return mix((0.02, 0.02, 0.02), colour, edge(min(hu - abs(u), hv - abs(v)) - 0.025, w))


@compiled
def clock(c0: Three, c1: Three, c2: Three, u: float, v: float, h: float, w: float) -> Three:
    """A dial: rim of c1, twelve marks, two hands at ten past ten."""
    r, angle = math.hypot(u, v) / h, math.atan2(v, u)
    turn = angle * 6.0 / math.pi
    tick = abs(turn - round(turn)) * math.pi / 6.0 * r * h
    colour = mix(c0, c1, edge(r - 0.9, w / h))
    if 0.68 < r < 0.85:
        colour = mix(colour, c1, line(tick, 0.012, w))
    hour = line(u * 0.5 - v * -0.866, 0.016, w) if u < 0.0 and r < 0.5 else 0.0
    minute = line(u * 0.5 - v * 0.866, 0.012, w) if u > 0.0 and r < 0.7 else 0.0
    return mix(colour, c2, max(hour, minute))
