"""Textures of offices: ceiling tiles, carpet tiles, written whiteboards, printed posters; and brushed plaster.

Arguments as in `textures`.
"""

import math

from xrdslam.datasets.synthetic.compiled import compiled
from xrdslam.datasets.synthetic.noise import cell_random, edge, fbm, mix, smooth_step, visible
from xrdslam.datasets.synthetic.stripes import line

__all__ = ["carpet", "ceiling", "plaster", "poster", "whiteboard"]

Three = tuple[float, float, float]


@compiled
def ceiling(c0: Three, c1: Three, c2: Three, u: float, v: float, w: float, scale: float, seed: int) -> Three:
    """Mineral tiles of 60 cm in a grid of c2, each with its own tone and drilled with worm holes of c1."""
    side = 0.6 * scale
    i, j = math.floor(u / side), math.floor(v / side)
    p, q = u / side - i - 0.5, v / side - j - 0.5
    bar = max(line(side * (0.5 - abs(p)), 0.022, w), line(side * (0.5 - abs(q)), 0.022, w))
    tone = cell_random(i, j, seed)
    holes = smooth_step(0.28, 0.5, fbm(u, v, 3.0 * tone, 28.0, 2, w, seed))
    stain = smooth_step(0.3, 0.8, fbm(u, v, 0.4, 1.3, 3, w, seed + 6))
    k = 0.88 + 0.16 * tone + 0.06 * fbm(u, v, tone, 5.0, 2, w, seed + 2)
    colour = mix((c0[0] * k, c0[1] * k, c0[2] * k), c1, min(0.75 * holes + 0.35 * stain, 1.0))
    return mix(colour, c2, 0.9 * bar)


@compiled
def carpet(c0: Three, c1: Three, c2: Three, u: float, v: float, w: float, scale: float, seed: int) -> Three:
    """Carpet tiles of 50 cm, laid crosswise: ribs of c0 and c1, every sixth or so in c2, flecks of yarn."""
    side = 0.5 * scale
    i, j = math.floor(u / side), math.floor(v / side)
    p, q = u / side - i, v / side - j
    along = q if (int(i) + int(j)) & 1 == 0 else p
    rib = math.floor(along * 12.0)
    share = 0.5 + 0.5 * math.sin(2.0 * math.pi * along * 12.0) * visible(12.0 / side, w)
    flecks = fbm(u, v, 0.3, 34.0, 3, w, seed)
    colour = mix(c0, c1, min(max(0.65 * share + 0.5 * flecks + 0.25 * (cell_random(i, j, seed) - 0.5), 0.0), 1.0))
    if cell_random(int(i) * 57 + rib, j, seed + 3) < 0.16:
        colour = mix(colour, c2, 0.75 * visible(6.0 / side, w) + 0.12)
    seam = max(line(side * min(p, 1.0 - p), 0.006, w), line(side * min(q, 1.0 - q), 0.006, w))
    k = 1.0 + 0.18 * fbm(u, v, 0.9, 2.0, 2, w, seed + 5)
    return mix((colour[0] * k, colour[1] * k, colour[2] * k), (0.03, 0.03, 0.03), 0.6 * seam)


@compiled
def handwriting(u: float, v: float, w: float, seed: int) -> float:
    """Return how much ink lies at (u, v) of a line of script 6 cm high: words of joined loops."""
    row = math.floor(v / 0.085)
    y = v - (row + 0.5) * 0.085
    word = math.floor(u / 0.19 + 0.6 * cell_random(row, 11, seed))
    if cell_random(word, row, seed) < 0.3:
        return 0.0
    a, b = 60.0 + 40.0 * cell_random(word, row, seed + 1), 131.0 + 40.0 * cell_random(row, word, seed + 2)
    pen = 0.013 * math.sin(a * u) + 0.011 * math.sin(b * u + 1.3) * (0.5 + cell_random(word, row, seed + 3))
    slope = 0.013 * a * math.cos(a * u) + 0.011 * b * math.cos(b * u + 1.3)
    away = abs(y - pen) / math.sqrt(1.0 + slope * slope)
    return line(away, 0.008, w) * visible(9.0, w) + 0.2 * (1.0 - visible(9.0, w))


@compiled
def whiteboard(c0: Three, c1: Three, c2: Three, u: float, v: float, hu: float, hv: float, w: float, seed: int) -> Three:
    """Handwriting in c1, boxes joined by lines and a curve over axes in c2, wiped smears."""
    smear = fbm(0.3 * u, v, 0.2, 5.0, 4, w, seed)
    k = 0.93 + 0.1 * smear
    colour = (c0[0] * k, c0[1] * k, c0[2] * k)
    p, q = u / hu, v / hv
    if -0.92 < p < -0.12 and abs(q) < 0.84:
        colour = mix(colour, c1, 0.9 * handwriting(u, v, w, seed))
    elif 0.0 < p < 0.9 and -0.85 < q < -0.02:
        x, y = (u - 0.08 * hu) / hu, (v + 0.8 * hv) / hv
        curve = 0.12 + 0.5 * x + 0.12 * math.sin(9.0 * x + 6.0 * cell_random(3, 4, seed))
        ink = max(line((y - curve) * 0.7 * hv, 0.012, w), max(line(x * hu, 0.009, w), line(y * hv, 0.009, w)))
        colour = mix(colour, c2, 0.95 * ink)
    elif 0.0 < p < 0.95 and 0.08 < q < 0.9:
        cell = 0.32 * hu
        i = math.floor((u - 0.02 * hu) / cell)
        x, y = (u - 0.02 * hu) / cell - i - 0.5, (v - (0.32 + 0.3 * cell_random(i, 1, seed)) * hv) / cell
        frame = max(abs(x) - 0.3, abs(y) - 0.2) * cell
        ink = max(line(frame, 0.009, w), line(y * cell, 0.009, w) * edge(abs(x) - 0.3, w / cell))
        colour = mix(colour, c1 if cell_random(i, 2, seed) < 0.5 else c2, 0.95 * ink)
        if frame < -0.012:
            colour = mix(colour, c1, 0.7 * handwriting(u, v, w, seed + 7))
    return colour


@compiled
def poster(c0: Three, c1: Three, c2: Three, u: float, v: float, hu: float, hv: float, w: float, seed: int) -> Three:
    """A printed sheet: a title on a band of c1, columns of text, bars and a disc in c1 and c2."""
    short = min(hu, hv)
    p, q, wn = u / short, v / short, w / short
    a, b = hu / short, hv / short
    colour = mix(c0, c1, 0.9 * edge(q - (b - 0.5), wn))
    letter = math.floor(p / 0.14)
    if q > b - 0.42 and q < b - 0.14 and abs(p) < a - 0.2 and cell_random(letter, 5, seed) > 0.2:
        colour = mix(colour, c0, line(p / 0.14 - letter - 0.5, 0.62, wn / 0.14) * visible(4.0, wn))
    if q < b - 0.6 and abs(p) < a - 0.14 and q > -b + 0.14:
        if (p < 0.0) == (cell_random(1, 1, seed) < 0.5):
            row, mark = math.floor(q / 0.09), math.floor(p / 0.035)
            ink = 0.0 if cell_random(mark, row, seed) < 0.3 else line(q / 0.09 - row - 0.5, 0.5, wn / 0.09)
            colour = mix(colour, (0.06, 0.06, 0.07), ink * (0.85 * visible(12.0, wn) + 0.5 * (1.0 - visible(12.0, wn))))
        else:
            x, y = abs(p), q + b - 0.14
            bar = math.floor(x / 0.16)
            top = (0.25 + 0.6 * cell_random(bar, 9, seed)) * (b - 0.1)
            inside = edge(top - y, wn) * line(x / 0.16 - bar - 0.5, 0.7, wn / 0.16)
            colour = mix(
                colour, c1 if int(bar) & 1 == 0 else c2, inside * visible(5.0, wn) + 0.3 * (1.0 - visible(5.0, wn))
            )
            disc = math.hypot(x - 0.5 * a, q - (b - 0.95)) - 0.22
            colour = mix(colour, c2, edge(-disc, wn))
            colour = mix(colour, c0, line(disc + 0.08, 0.03, wn))
    rim = min(hu - abs(u), hv - abs(v)) / short
    return mix(colour, c1, line(rim - 0.06, 0.025, wn))


@compiled
def plaster(c0: Three, c1: Three, c2: Three, x: float, y: float, z: float, w: float, scale: float, seed: int) -> Three:
    """Brushed plaster: clouds between c0 and c1, crossing strokes of the trowel, specks of c2."""
    cloud = fbm(x, y, z, 1.6 / scale, 3, w, seed)
    bend = 0.15 * cloud
    stroke = fbm(3.0 * (x + y + bend), 3.0 * (x - y), 0.5 * z, 4.0 / scale, 3, w, seed + 11)
    speck = smooth_step(0.42, 0.6, fbm(x, y, z, 17.0 / scale, 2, w, seed + 21))
    return mix(mix(c0, c1, min(max(0.5 + 0.75 * cloud + 0.5 * stroke, 0.0), 1.0)), c2, 0.55 * speck)
