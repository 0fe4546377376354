"""The bedroom: a double bed, wardrobe, chest of drawers, armchair, trunk, a window to the north."""

import numpy as np

from xrdslam.datasets.synthetic import fittings, home
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic.scene import Material, Pace, Pattern, Scene
from xrdslam.datasets.synthetic.site import Site

__all__ = ["bedroom"]

P = Pattern


def bedroom(rng: np.random.Generator) -> Scene:
    """Build a bedroom of 4.8 x 4.4 x 2.7 m."""
    site = Site("room1", (4.8, 4.4, 2.7), rng)
    pine = site.material(P.WOOD, ("#c89a62", "#9a6a38", "#6f4a26"))
    white = site.material(P.WOOD, ("#e4ded2", "#c9c0ae", "#a89e8a"))
    sage = site.material(P.WOOD, ("#8fa58c", "#6f8a70", "#526a55"))
    site.put(sleeping(site, pine), -1.25, 0.1, 90)
    for y in (-1.25, 1.45):
        site.put(home.nightstand(pine, white), -2.12, y, 90)
        lamp(site, -2.14, y, 0.555)
    site.put(home.book_pile(rng, 3), -2.0, -1.1, 20, 0.555)
    site.put(home.wardrobe(pine, sage, 1.9), 0.9, -1.88, 180)
    site.put(home.drawers(white, sage, 1.2, 0.85, 3, 2), 2.12, -0.2, -90)
    dresser_top(site)
    rust = site.material(P.FABRIC, ("#b0704a", "#8a4f30", "#e6c9a0"), 0.6)
    site.put_about(f.armchair(rust, pine), 1.55, 1.35, -32)
    site.put_about(home.trunk(site.material(P.WOOD, ("#7a4f30", "#4a2c1a", "#2a1a10")), f.BRASS, 1.1), 0.22, 0.1, 90)
    clay = site.material(P.STONE, ("#3f6f8c", "#2a4a60", "#e0e6e8"), 0.6)
    site.put(f.plant(rng, clay, 1.3, 24), 2.02, -1.72)
    site.put(f.floor_lamp(Material(P.FABRIC, ("#ffe0b0", "#f4cf90", "#fff0d0"), 0.3, 0.02, emission=0.8)), 2.1, 1.95)
    site.bulb(2.1, 1.95, 1.315, 1.605, (26.0, 19.0, 10.5))
    rug = site.material(P.RUG, ("#d8cdb4", "#5a6f8a", "#b5654a"))
    site.put([f.block(rug, (2.2, 1.6, 0.014), (0, 0, 0.007), 0.003)], 1.0, 0.15, 8)
    pouf = site.material(P.FABRIC, ("#c9a24a", "#9a7426", "#f0e0b0"), 0.35)
    site.put_about([f.frustum(pouf, 0.24, 0.24, (0, 0, 0), 0.4, 0.1)], 1.15, -0.75)
    walls(site, white, pine)
    faces = (
        site.material(P.PLASTER, ("#c9b6a0", "#b09a80", "#ded0bc"), 0.7),
        site.material(P.WALLPAPER, ("#c4cfd2", "#7f98a6", "#d8a070"), 0.8),
        site.material(P.PLASTER, ("#b8c4c2", "#9aaaa8", "#d2dad6"), 0.7),
        site.material(P.WALLPAPER, ("#ddd4c4", "#b8a488", "#8f5a4a"), 1.3),
        site.material(P.PLASTER, ("#ece8de", "#d8d0c2", "#c2b8a4"), 1.0),
        site.material(P.CARPET, ("#a8987e", "#8a7a62", "#c9bca4"), 1.6),
    )
    return site.scene(faces, Pace(0.0081, 0.65))


def sleeping(site: Site, pine: Material) -> f.Piece:
    """Return the bed in its linen, with a throw over its foot."""
    sheet = site.material(P.FABRIC, ("#e2dccf", "#cfc7b6", "#b8ae9a"), 0.5)
    quilt = site.material(P.FABRIC, ("#4a6a8c", "#e0d8c4", "#b5552e"), 1.5)
    pillow = site.material(P.FABRIC, ("#d8c9a8", "#8fa0a8", "#f0ead8"), 0.55)
    throw = site.material(P.FABRIC, ("#8c3d32", "#5f2620", "#e0b080"), 0.8)
    return [*home.bed(pine, sheet, quilt, pillow), f.block(throw, (1.7, 0.5, 0.23), (0, -0.78, 0.48), 0.09)]


def lamp(site: Site, x: float, y: float, z: float) -> None:
    """Stand a lit table lamp on a nightstand."""
    glow = Material(P.PLAIN, ("#ffe2b0", "#ffd898", "#ffe2b0"), 1.0, 0.02, emission=0.8)
    foot = site.material(P.STONE, ("#3f6f6c", "#24484a", "#d8e0d0"), 0.3)
    site.put(home.table_lamp(foot, glow), x, y, 0, z)
    site.bulb(x, y, z + 0.25, z + 0.47, (20.0, 14.5, 8.0), 0.08)


def dresser_top(site: Site) -> None:
    """Put vases, candles, books and a small clock on the chest of drawers."""
    glaze = site.material(P.STONE, ("#b8693f", "#8f4a2b", "#e8d8c0"), 0.4)
    site.put(home.floor_vase(glaze, 0.34), 2.15, -0.62, 0, 0.85)
    site.put(home.candles(), 2.12, -0.18, -90, 0.85)
    site.put(f.books(site.rng, 0.3, (-0.15, 0, 0), 0.24), 2.14, 0.22, -90, 0.85)


def walls(site: Site, white: Material, frame: Material) -> None:
    """Hang pictures; put the door, the window with its curtains and the radiator in place."""
    pictures = (
        (("#f0e6d2", "#6a8a9a", "#b5654a"), 2, (0.55, 0.75), frame, "west", -0.55, 1.65),
        (("#9ac0d8", "#f4d8a8", "#3f6a5a"), 0, (0.9, 0.6), white, "west", 0.3, 1.72),
        (("#e8dcc8", "#c0a880", "#4a4040"), 1, (0.5, 0.5), f.BLACK, "west", 1.12, 1.6),
        (("#2a3a5a", "#d07a50", "#f0dca0"), 3, (0.9, 1.2), f.BRASS, "east", -0.2, 1.65),
        (("#d8c8b0", "#7a9a70", "#a04a3a"), 2, (0.5, 0.4), frame, "east", 0.9, 1.6),
        (("#c8d8dc", "#e0b890", "#5a6a48"), 0, (0.45, 0.62), white, "south", -0.5, 1.7),
        (("#f2e8d8", "#384a6a", "#c05a3a"), 1, (0.6, 0.45), frame, "north", 1.72, 1.75),
        (("#f2e8d8", "#a84a3a", "#386a5a"), 2, (0.5, 0.5), frame, "north", -1.5, 1.6),
    )
    for colours, manner, size, edge, wall, along, z in pictures:
        site.on_wall(f.picture(site.art(colours, manner), *size, edge), wall, along, z)
    cloth = site.material(P.FABRIC, ("#b0583e", "#8a3e2a", "#e8c8a0"), 0.5)
    view = site.view(("#8fb8e0", "#e8dcc8", "#3f6238"))
    site.skirting(white)
    site.on_wall(fittings.door(white), "south", -1.7)
    site.on_wall(
        [*fittings.window(view, white, 1.3, 1.3), *fittings.curtains(cloth, 1.3, 2.15, -1.3)], "north", 0.15, 1.5
    )
    site.shine(fittings.daylight((6.0, 6.4, 7.0), 1.3, 1.3), "north", 0.15, 1.5)
    site.on_wall(fittings.radiator(white, 1.1), "north", 0.15)
    site.ceiling_panel(0.2, -0.2, (0.3, 0.3), (6.0, 5.4, 4.6))
