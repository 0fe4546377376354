"""Rooms, each built from a seed: `ROOMS` maps a name to its builder."""

from collections.abc import Callable

import numpy as np

from xrdslam.core.errors import UnknownNameError
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic.scene import Light, Material, Pattern, Scene, Solid

__all__ = ["ROOMS", "build_room"]

P = Pattern


def build_room(name: str, seed: int) -> Scene:
    """Return the room of that name; the seed changes its books, ornaments, pictures and patterns."""
    if name not in ROOMS:
        raise UnknownNameError(f"no synthetic room {name!r}; there is {', '.join(sorted(ROOMS))}")
    return ROOMS[name](np.random.default_rng(seed))


def living_room(rng: np.random.Generator) -> Scene:
    """A living room of 5.8 x 4.8 x 2.6 m: sofa, armchair, shelf, desk, television, window to the east."""

    def s() -> int:
        return int(rng.integers(1 << 16))

    oak = Material(P.WOOD, ("#9a6b3f", "#5f3d22", "#3a2514"), seed=s())
    walnut = Material(P.WOOD, ("#6b4630", "#3a2418", "#20140d"), seed=s())
    white = Material(P.WOOD, ("#e6e1d6", "#cfc8b8", "#b0a894"), seed=s())
    blue = Material(P.FABRIC, ("#3d5a80", "#2c4566", "#7f9cc0"), 1.0, seed=s())
    rust = Material(P.FABRIC, ("#b5552e", "#8c3d20", "#e0a070"), 0.7, seed=s())
    cream = Material(P.FABRIC, ("#ddd2b8", "#c2b391", "#a08d66"), 0.6, seed=s())
    mustard = Material(P.FABRIC, ("#cf9b2b", "#a87618", "#f0dca0"), 0.45, seed=s())
    teal = Material(P.FABRIC, ("#2a7f7a", "#e2dcc8", "#124a4a"), 0.5, seed=s())
    clay = Material(P.STONE, ("#b8693f", "#8f4a2b", "#d99a70"), 0.6, seed=s())
    glow = Material(P.PLAIN, ("#ffe6b8", "#ffdca0", "#ffe6b8"), 1.0, 0.02, emission=0.9)
    solids: list[Solid] = [
        *f.place(f.sofa(blue, walnut), -0.3, 1.88),
        *f.place([f.cushion(mustard, (0.42, 0.15, 0.42), (0, 0, 0), (14, 0, -22))], -0.95, 1.78, 0, 0.69),
        *f.place([f.cushion(teal, (0.4, 0.14, 0.4), (0, 0, 0), (-10, 0, -24))], 0.3, 1.77, 0, 0.69),
        *f.place([f.cushion(cream, (0.36, 0.14, 0.36), (0, 0, 0), (8, 10, -28))], -0.55, 1.66, 0, 0.66),
        *f.place(f.armchair(rust, oak), 1.75, 0.85, -62),
        *f.place(f.coffee_table(oak), -0.2, 0.35, 4),
        *table_top(rng, clay),
        *f.place(f.shelf(rng, walnut, 1.6, 2.0), 0.9, -2.23, 180),
        *f.place(f.shelf(rng, white, 0.8, 1.25), 2.1, -2.23, 180),
        *f.place(f.television(Material(P.SCREEN, ("#e8a060", "#5a3a70", "#6b4a3a"), seed=s()), oak), -2.65, 0.35, 90),
        *f.place(f.desk(oak, white), -1.65, -2.05, 180),
        *f.place(f.chair(oak, teal), -1.6, -1.45, 200),
        *desk_top(rng),
        *f.place(f.floor_lamp(glow), 1.25, 2.05),
        *f.place(f.plant(rng, clay), 2.4, 1.95),
        *f.place(f.plant(rng, clay, 0.75, 16), -2.5, 1.95),
        *f.place([f.frustum(cream, 0.27, 0.27, (0, 0, 0), 0.38, 0.08)], 0.95, -0.75),
        f.block(
            Material(P.RUG, ("#8c2f39", "#1f3a5f", "#e0c9a0"), seed=s()), (2.6, 1.8, 0.014), (-0.2, 0.35, 0.007), 0.003
        ),
        *walls(rng, white, walnut),
        *window_side(rng, white, mustard),
        f.block(Material(P.PLAIN, ("#ffffff", "#fff8ee", "#ffffff"), emission=1.6), (0.9, 0.9, 0.04), (0.0, 0.1, 2.58)),
    ]
    shell = (
        Material(P.PLAIN, ("#a9bda6", "#93ab92", "#a9bda6"), 0.8, seed=s()),
        Material(P.BRICK, ("#a8543a", "#7d3a2a", "#b9ada0"), seed=s()),
        Material(P.WALLPAPER, ("#e6dcc4", "#a8b89a", "#b5654a"), seed=s()),
        Material(P.PLAIN, ("#d9c9ae", "#cbb894", "#d9c9ae"), 0.8, seed=s()),
        Material(P.PLAIN, ("#efece4", "#e2ddd2", "#efece4"), 1.2, seed=s()),
        Material(P.PLANKS, ("#b07d4c", "#7d5230", "#2a1a0f"), seed=s()),
    )
    lights = (
        Light((0.0, 0.1, 2.555), (0.45, 0.0, 0.0), (0.0, -0.45, 0.0), (7.0, 6.6, 6.0)),
        Light((2.80, -0.35, 1.45), (0.0, -0.72, 0.0), (0.0, 0.0, 0.58), (5.0, 5.9, 7.2)),
        Light((1.25, 2.05, 1.605), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (40.0, 30.0, 17.0)),
        Light((1.25, 2.05, 1.315), (0.15, 0.0, 0.0), (0.0, -0.15, 0.0), (14.0, 10.5, 6.0)),
    )
    return Scene("room0", (5.8, 4.8, 2.6), shell, tuple(solids), lights)


def table_top(rng: np.random.Generator, clay: Material) -> list[Solid]:
    """What lies on the coffee table: a pile of books, a vase, fruit in a bowl, a mug."""
    pile, z = [], 0.42
    for k, (x, y, h) in enumerate(((0.3, 0.22, 0.035), (0.26, 0.2, 0.028), (0.22, 0.16, 0.04))):
        cover = f.book_cover(rng)
        pile.append(
            f.block(
                (f.PAPER, f.PAPER, f.PAPER, cover, cover, cover),
                (x, y, h),
                (0.3, 0.08, z + h / 2),
                0.0,
                (9.0 * k - 6, 0, 0),
            )
        )
        z += h
    glaze = Material(P.STONE, ("#e9e4d6", "#3f6f8c", "#2a4a60"), 0.5, seed=7)
    fruit = [
        Material(P.PLAIN, (c, d, c), 0.1)
        for c, d in (("#c9402a", "#e0a030"), ("#e08a1e", "#d06a10"), ("#7a9a2e", "#a0b840"))
    ]
    bowl = [f.frustum(glaze, 0.07, 0.16, (-0.22, -0.1, 0.42), 0.08, 0.008)]
    bowl += [
        f.sphere(fruit[k % 3], 0.042, (-0.22 + 0.075 * np.cos(1.3 * k), -0.1 + 0.075 * np.sin(1.3 * k), 0.515))
        for k in range(5)
    ]
    vase = [
        f.frustum(clay, 0.05, 0.075, (-0.42, 0.15, 0.42), 0.14, 0.01),
        f.frustum(clay, 0.07, 0.035, (-0.42, 0.15, 0.56), 0.09, 0.01),
    ]
    mug = [f.cylinder(Material(P.PLAIN, ("#27496d", "#2f5580", "#27496d")), 0.04, (0.08, -0.18, 0.42), 0.095)]
    return f.place([*pile, *bowl, *vase, *mug], -0.2, 0.35, 4)


def desk_top(rng: np.random.Generator) -> list[Solid]:
    """What stands on the desk: a monitor, a keyboard, a lamp, a mug of pencils, books."""
    screen = Material(P.SCREEN, ("#9fd0e8", "#3f78a8", "#2f6040"), seed=int(rng.integers(1 << 16)))
    face = (f.BLACK, f.BLACK, f.BLACK, screen, f.BLACK, f.BLACK)
    keys = Material(P.CHECKER, ("#3a3a40", "#4a4a52", "#17171a"), 0.1)
    parts = [
        f.block(face, (0.56, 0.03, 0.35), (-0.1, 0.12, 1.06)),
        f.block(f.BLACK, (0.05, 0.03, 0.2), (-0.1, 0.15, 0.87)),
        f.block(f.BLACK, (0.24, 0.17, 0.015), (-0.1, 0.13, 0.77), 0.005),
        f.block(keys, (0.42, 0.14, 0.02), (-0.1, -0.16, 0.773), 0.004),
        f.frustum(f.BRASS, 0.08, 0.07, (0.5, 0.1, 0.7625), 0.02),
        f.cylinder(f.BRASS, 0.01, (0.5, 0.1, 0.78), 0.32),
        f.frustum(Material(P.PLAIN, ("#3f7f5c", "#2f6a4a", "#3f7f5c")), 0.12, 0.05, (0.5, 0.1, 1.08), 0.14),
        *f.books(rng, 0.2, (-0.62, 0.1, 0.7625), 0.26),
    ]
    return f.place(parts, -1.65, -2.05, 180)


def walls(rng: np.random.Generator, white: Material, frame: Material) -> list[Solid]:
    """Skirting boards, a door, pictures, a clock."""

    def art(c0: str, c1: str, c2: str, manner: int) -> Material:
        return Material(P.PAINTING, (c0, c1, c2), 1.0, 0.03, 4 * int(rng.integers(1 << 12)) + manner)

    skirting = [f.block(white, (5.8, 0.018, 0.1), (0, sy * 2.391, 0.05)) for sy in (-1, 1)]
    skirting += [f.block(white, (0.018, 4.8, 0.1), (sx * 2.891, 0, 0.05)) for sx in (-1, 1)]
    dial = Material(P.CLOCK, ("#f0ece0", "#2a2420", "#1a1a1a"))
    return [
        *skirting,
        *f.place(f.picture(art("#8fb8d8", "#f0c890", "#4a6a4a", 0), 1.1, 0.7, frame), -0.5, 2.4, 0, 1.55),
        *f.place(f.picture(art("#e8e0d0", "#d0c0a0", "#404040", 1), 0.5, 0.65, f.BLACK), 0.75, 2.4, 0, 1.6),
        *f.place(f.picture(art("#f0e0c0", "#506080", "#a04030", 2), 0.45, 0.6, frame), -1.75, 2.4, 0, 1.55),
        *f.place(f.picture(art("#203050", "#c06040", "#e8d090", 3), 0.7, 0.5, f.BRASS), -2.9, -1.15, 90, 1.6),
        *f.place(f.picture(art("#f4ead8", "#2a6a70", "#a04030", 2), 0.62, 0.8, f.BLACK), -2.9, 1.65, 90, 1.6),
        *f.place(f.picture(art("#e0d4c0", "#903020", "#304860", 1), 0.7, 0.5, frame), 2.05, -2.4, 180, 1.75),
        *f.place(f.picture(art("#c0d8e0", "#e8c0a0", "#506848", 0), 0.6, 0.42, frame), -2.05, -2.4, 180, 1.65),
        f.frustum((f.BLACK, f.BLACK, dial), 0.16, 0.16, (-0.72, -2.375, 1.72), 0.04, 0.0, (0, 0, -90)),
        *f.place(door(white), 2.9, 1.35, -90),
    ]


def door(wood: Material) -> list[Solid]:
    """A door of 0.85 x 2.05 m with its frame, in the wall y = 0."""
    panels = [
        f.block(wood, (0.3, 0.012, h), (x, -0.03, z), 0.004)
        for x in (-0.19, 0.19)
        for z, h in ((0.55, 0.75), (1.45, 0.8))
    ]
    posts = [f.block(wood, (0.08, 0.05, 2.1), (sx * 0.465, -0.025, 1.05)) for sx in (-1, 1)]
    return [
        f.block(wood, (0.85, 0.03, 2.03), (0, -0.015, 1.015)),
        *panels,
        *posts,
        f.block(wood, (1.01, 0.05, 0.08), (0, -0.025, 2.09)),
        f.sphere(f.BRASS, 0.03, (0.35, -0.06, 1.0)),
    ]


def window_side(rng: np.random.Generator, white: Material, cloth: Material) -> list[Solid]:
    """The window in the wall x+, its sill, two curtains and a radiator."""
    view = Material(P.WINDOW, ("#7fb2e8", "#d8e8f4", "#4a6a38"), 1.0, 0.0, int(rng.integers(1 << 16)), emission=1.5)
    bars = [f.block(white, (w, 0.05, h), (x, -0.035, z), 0.006) for x, z, w, h in (
        (-0.76, 0, 0.07, 1.3), (0.76, 0, 0.07, 1.3), (0, 0, 0.05, 1.2), (0, 0.62, 1.56, 0.07), (0, -0.62, 1.56, 0.07),
        (0, 0.15, 1.46, 0.035),
    )]  # fmt: skip
    folds = [
        f.block(cloth, (0.09, 0.09, 1.9), (sx * (0.86 + 0.075 * k), -0.09 - 0.02 * (k % 2), -0.12), 0.044)
        for sx in (-1, 1)
        for k in range(4)
    ]
    rail = f.block(f.BRASS, (2.5, 0.03, 0.03), (0, -0.1, 0.86), 0.0145)
    ribs = [f.block(white, (0.06, 0.08, 0.55), (-0.5 + 0.1 * k, -0.09, -1.02), 0.02) for k in range(11)]
    sill = f.block(white, (1.75, 0.2, 0.035), (0, -0.1, -0.68), 0.008)
    return f.place(
        [f.block(view, (1.5, 0.02, 1.22), (0, -0.01, 0)), *bars, *folds, rail, *ribs, sill], 2.9, -0.35, -90, 1.45
    )


ROOMS: dict[str, Callable[[np.random.Generator], Scene]] = {"room0": living_room}
