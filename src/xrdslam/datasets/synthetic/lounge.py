"""The lounge: a sofa bent round a table, a television, bean bags, a window to the east."""

import numpy as np

from xrdslam.datasets.synthetic import fittings, home
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic import workplace as w
from xrdslam.datasets.synthetic.office_walls import LAMP, posters, windows, written
from xrdslam.datasets.synthetic.scene import Material, Pace, Pattern, Scene
from xrdslam.datasets.synthetic.site import Site

__all__ = ["lounge"]

P = Pattern
POSTERS = (
    ("north", -1.15, 1.0, 0.7, 0),
    ("north", 0.35, 0.9, 0.9, 3),
    ("north", 1.65, 0.6, 0.8, 2),
    ("south", -1.6, 0.6, 0.85, 4),
    ("south", 1.75, 0.5, 0.7, 4),
    ("west", 1.75, 0.8, 0.6, 1),
    ("east", -1.9, 0.6, 0.84, 4),
)


def lounge(rng: np.random.Generator) -> Scene:
    """Build a lounge of 5.2 x 5.4 x 2.7 m: a sofa bent round a table, a television, bean bags."""
    site = Site("office0", (5.2, 5.4, 2.7), rng)
    ash = site.material(P.WOOD, ("#c8ab82", "#9c7c54", "#6f5436"))
    dark = site.material(P.WOOD, ("#4f3a2e", "#30221a", "#1d1410"))
    plum = site.material(P.FABRIC, ("#5a3f63", "#43304c", "#b09ac0"), 0.9)
    lime = site.material(P.FABRIC, ("#9ab03c", "#738a24", "#e4e8b0"), 0.6)
    orange = site.material(P.FABRIC, ("#d07030", "#a04c18", "#f0c890"), 0.5)
    site.put(home.arc_sofa(plum, dark, 1.45, 165.0, 8), 0.35, 0.65)
    for k, cloth in enumerate((lime, orange, lime)):
        turn = (30.0, 0.0, -30.0)[k]
        x, y = (-0.62, 0.0, 0.62)[k], (1.06, 1.26, 1.06)[k]
        site.put([f.cushion(cloth, (0.4, 0.14, 0.38), (0, 0, 0), (0, 0, -20))], 0.35 + x, 0.65 + y, turn, 0.64)
    site.put(
        [
            *home.round_table(ash, 0.5, 0.42),
            *f.place(home.bowl(site.material(P.STONE, ("#e0e4e0", "#3f8c86", "#205a58"), 0.4)), -0.1, 0.1, 0, 0.42),
            *f.place(home.book_pile(rng, 3), 0.22, -0.1, 30, 0.42),
        ],
        0.35,
        0.7,
    )
    rug = site.material(P.RUG, ("#2f4f6f", "#c8803a", "#e4dcc4"))
    site.put([f.frustum((rug, rug, rug), 1.3, 1.3, (0, 0, 0), 0.012, 0.003)], 0.35, 0.6)
    screen = site.material(P.SCREEN, ("#e0a868", "#4a3f70", "#3a5a4a"))
    site.put(f.television(screen, ash, 1.8), 0.2, -2.45, 180)
    site.put_about(home.bean_bag(orange), -1.75, -1.0, -130)
    site.put_about(home.bean_bag(lime), -1.95, 1.95, -60)
    site.put(w.cabinet(rng, ash, 1.2, 4), -2.38, 0.45, 90)
    site.put(f.plant(rng, site.material(P.STONE, ("#d8d2c4", "#a89e8a", "#6a6458"), 0.5), 1.4, 26), 2.2, -2.3)
    site.put(home.floor_vase(site.material(P.STONE, ("#3f8c86", "#205a58", "#e0c890"), 0.6), 0.9), -2.2, -2.25)
    glow = Material(P.FABRIC, ("#ffe6b8", "#ffdca0", "#ffe6b8"), 0.2, 0.02, emission=0.9)
    site.put(f.floor_lamp(glow), -2.25, 2.45)
    site.bulb(-2.25, 2.45, 1.315, 1.605, (24.0, 18.0, 10.0))
    site.ceiling_panel(-0.9, 0.0, (0.3, 0.6), LAMP)
    site.ceiling_panel(1.2, 0.0, (0.3, 0.6), LAMP)
    written(site, "west", -1.05, 1.4, 1.1)
    posters(site, POSTERS)
    windows(site, ash, "east", (0.35,), 2.2, 1.3)
    site.on_wall(fittings.door(dark), "south", 2.05)
    site.skirting(dark)
    return site.scene(shell(site), Pace(0.0091, 0.57))


def shell(site: Site) -> tuple[Material, ...]:
    """Return the materials of the walls x+, x-, y+, y-, of ceiling and floor."""
    return (
        site.material(P.PLASTER, ("#d8cdb8", "#bfb298", "#e8e0d0"), 0.8),
        site.material(P.PLASTER, ("#3f6a7a", "#2f5464", "#5f8a98"), 0.7),
        site.material(P.BRICK, ("#c8b8a4", "#a89682", "#8a8078"), 1.1),
        site.material(P.PLASTER, ("#c98a4a", "#aa6e32", "#e0b080"), 0.7),
        site.material(P.CEILING, ("#e4e2da", "#b8b4a8", "#9a9ca0")),
        site.material(P.CARPET, ("#5a6068", "#40464e", "#c8803a")),
    )
