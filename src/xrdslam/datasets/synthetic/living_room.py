"""The living room: sofa, armchair, bookshelves, desk, television, a window to the east."""

import numpy as np

from xrdslam.datasets.synthetic import fittings, home
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic.scene import Material, Pace, Pattern, Scene, Solid
from xrdslam.datasets.synthetic.site import Site

__all__ = ["living_room"]

P = Pattern


def living_room(rng: np.random.Generator) -> Scene:
    """Build a living room of 5.8 x 4.8 x 2.6 m."""
    site = Site("room0", (5.8, 4.8, 2.6), rng)
    oak = site.material(P.WOOD, ("#9a6b3f", "#5f3d22", "#3a2514"))
    walnut = site.material(P.WOOD, ("#6b4630", "#3a2418", "#20140d"))
    white = site.material(P.WOOD, ("#e6e1d6", "#cfc8b8", "#b0a894"))
    clay = site.material(P.STONE, ("#b8693f", "#8f4a2b", "#d99a70"), 0.6)
    mustard = site.material(P.FABRIC, ("#cf9b2b", "#a87618", "#f0dca0"), 0.45)
    seats(site, oak, walnut, mustard)
    site.put(table_top(site, clay), -0.2, 0.35, 4)
    site.put(f.shelf(rng, walnut, 1.6, 2.0), 0.9, -2.23, 180)
    site.put(f.shelf(rng, white, 0.8, 1.25), 2.1, -2.23, 180)
    screen = site.material(P.SCREEN, ("#e8a060", "#5a3a70", "#6b4a3a"))
    site.put(f.television(screen, oak), -2.65, 0.35, 90)
    site.put([*f.desk(oak, white), *desk_top(site)], -1.65, -2.05, 180)
    glow = Material(P.PLAIN, ("#ffe6b8", "#ffdca0", "#ffe6b8"), 1.0, 0.02, emission=0.9)
    site.put(f.floor_lamp(glow), 1.25, 2.05)
    site.bulb(1.25, 2.05, 1.315, 1.605, (32.0, 24.0, 13.5))
    site.put(f.plant(rng, clay), 2.4, 1.95)
    site.put(f.plant(rng, clay, 0.75, 16), -2.5, 1.95)
    site.ceiling_panel(0.0, 0.1, (0.45, 0.45), (7.0, 6.6, 6.0))
    walls(site, white, walnut, mustard)
    faces = (
        site.material(P.PLASTER, ("#a9bda6", "#8fa88e", "#bccab4"), 0.8),
        site.material(P.BRICK, ("#a8543a", "#7d3a2a", "#b9ada0")),
        site.material(P.WALLPAPER, ("#e6dcc4", "#a8b89a", "#b5654a")),
        site.material(P.PLASTER, ("#d9c9ae", "#c2ae8a", "#e6dcc8"), 0.8),
        site.material(P.PLASTER, ("#efece4", "#dcd6c9", "#c9c0ae"), 1.1),
        site.material(P.PLANKS, ("#b07d4c", "#7d5230", "#2a1a0f")),
    )
    return site.scene(faces, Pace(0.0124, 0.39))


def seats(site: Site, oak: Material, walnut: Material, mustard: Material) -> None:
    """Put the sofa with its cushions, the armchair, the desk's chair, the pouffe, the rug and the coffee table."""
    blue = site.material(P.FABRIC, ("#3d5a80", "#2c4566", "#7f9cc0"))
    rust = site.material(P.FABRIC, ("#b5552e", "#8c3d20", "#e0a070"), 0.7)
    cream = site.material(P.FABRIC, ("#ddd2b8", "#c2b391", "#a08d66"), 0.6)
    teal = site.material(P.FABRIC, ("#2a7f7a", "#e2dcc8", "#124a4a"), 0.5)
    rug = site.material(P.RUG, ("#8c2f39", "#1f3a5f", "#e0c9a0"))
    site.put(f.sofa(blue, walnut), -0.3, 1.88)
    site.put([f.cushion(mustard, (0.42, 0.15, 0.42), (0, 0, 0), (14, 0, -22))], -0.95, 1.78, 0, 0.69)
    site.put([f.cushion(teal, (0.4, 0.14, 0.4), (0, 0, 0), (-10, 0, -24))], 0.3, 1.77, 0, 0.69)
    site.put([f.cushion(cream, (0.36, 0.14, 0.36), (0, 0, 0), (8, 10, -28))], -0.55, 1.66, 0, 0.66)
    site.put_about(f.armchair(rust, oak), 1.75, 0.85, -62)
    site.put_about(f.chair(oak, teal), -1.6, -1.42, 200)
    site.put_about([f.frustum(cream, 0.27, 0.27, (0, 0, 0), 0.38, 0.08)], 0.95, -0.75)
    site.put([f.block(rug, (2.6, 1.8, 0.014), (0, 0, 0.007), 0.003)], -0.2, 0.35)
    site.put(f.coffee_table(oak), -0.2, 0.35, 4)


def table_top(site: Site, clay: Material) -> list[Solid]:
    """What lies on the coffee table: a pile of books, a vase, fruit in a bowl, a mug."""
    glaze = site.material(P.STONE, ("#e9e4d6", "#3f6f8c", "#2a4a60"), 0.5)
    mug = site.material(P.PLAIN, ("#27496d", "#2f5580", "#27496d"))
    return [
        *f.place(home.book_pile(site.rng, 3), 0.3, 0.08, 0, 0.42),
        *f.place(home.bowl(glaze, 5), -0.22, -0.1, 0, 0.42),
        f.frustum(clay, 0.05, 0.075, (-0.42, 0.15, 0.42), 0.14, 0.01),
        f.frustum(clay, 0.07, 0.035, (-0.42, 0.15, 0.56), 0.09, 0.01),
        f.cylinder(mug, 0.04, (0.08, -0.18, 0.42), 0.095),
    ]


def desk_top(site: Site) -> list[Solid]:
    """What stands on the desk: a monitor, a keyboard, a lamp, books."""
    screen = site.material(P.SCREEN, ("#9fd0e8", "#3f78a8", "#2f6040"))
    face = (f.BLACK, f.BLACK, f.BLACK, screen, f.BLACK, f.BLACK)
    keys = Material(P.CHECKER, ("#3a3a40", "#4a4a52", "#17171a"), 0.1)
    return [
        f.block(face, (0.56, 0.03, 0.35), (-0.1, 0.12, 1.06)),
        f.block(f.BLACK, (0.05, 0.03, 0.2), (-0.1, 0.15, 0.87)),
        f.block(f.BLACK, (0.24, 0.17, 0.015), (-0.1, 0.13, 0.77), 0.005),
        f.block(keys, (0.42, 0.14, 0.02), (-0.1, -0.16, 0.773), 0.004),
        f.frustum(f.BRASS, 0.08, 0.07, (0.5, 0.1, 0.7625), 0.02),
        f.cylinder(f.BRASS, 0.01, (0.5, 0.1, 0.78), 0.32),
        f.frustum(Material(P.PLAIN, ("#3f7f5c", "#2f6a4a", "#3f7f5c")), 0.12, 0.05, (0.5, 0.1, 1.08), 0.14),
        *f.books(site.rng, 0.2, (-0.62, 0.1, 0.7625), 0.26),
    ]


def walls(site: Site, white: Material, frame: Material, cloth: Material) -> None:
    """Hang pictures and a clock; put the door, the window with its curtains and the radiator in place."""
    pictures = (
        (("#8fb8d8", "#f0c890", "#4a6a4a"), 0, (1.1, 0.7), frame, "north", -0.5, 1.55),
        (("#e8e0d0", "#d0c0a0", "#404040"), 1, (0.5, 0.65), f.BLACK, "north", 0.75, 1.6),
        (("#f0e0c0", "#506080", "#a04030"), 2, (0.45, 0.6), frame, "north", -1.75, 1.55),
        (("#203050", "#c06040", "#e8d090"), 3, (0.7, 0.5), f.BRASS, "west", -1.15, 1.6),
        (("#f4ead8", "#2a6a70", "#a04030"), 2, (0.62, 0.8), f.BLACK, "west", 1.65, 1.6),
        (("#e0d4c0", "#903020", "#304860"), 1, (0.7, 0.5), frame, "south", 2.05, 1.75),
        (("#c0d8e0", "#e8c0a0", "#506848"), 0, (0.6, 0.42), frame, "south", -2.05, 1.65),
    )
    for colours, manner, size, edge, wall, along, z in pictures:
        site.on_wall(f.picture(site.art(colours, manner), *size, edge), wall, along, z)
    view = site.view(("#7fb2e8", "#d8e8f4", "#4a6a38"))
    site.skirting(white)
    site.on_wall(fittings.clock(), "south", -0.72, 1.72)
    site.on_wall(fittings.door(white), "east", 1.35)
    site.on_wall([*fittings.window(view, white), *fittings.curtains(cloth)], "east", -0.35, 1.45)
    site.shine(fittings.daylight((5.0, 5.9, 7.2)), "east", -0.35, 1.45)
    site.on_wall(fittings.radiator(white), "east", -0.35)
