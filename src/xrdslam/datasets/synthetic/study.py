"""The study: two desks, bookcases, a reading chair, a filing cabinet, a window to the east."""

import numpy as np

from xrdslam.datasets.synthetic import fittings, home
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic import workplace as w
from xrdslam.datasets.synthetic.office_walls import LAMP, posters, windows
from xrdslam.datasets.synthetic.scene import Material, Pace, Pattern, Scene
from xrdslam.datasets.synthetic.site import Site

__all__ = ["study"]

P = Pattern
POSTERS = (
    ("north", -0.7, 0.9, 0.6, 4),
    ("north", 1.15, 0.6, 0.8, 0),
    ("west", -0.75, 0.55, 0.75, 2),
    ("west", 0.9, 0.6, 0.84, 4),
    ("south", 0.5, 0.7, 0.5, 1),
    ("east", -1.35, 0.45, 0.62, 3),
    ("west", 0.1, 0.7, 0.5, 3),
)


def study(rng: np.random.Generator) -> Scene:
    """Build a study of 4.2 x 3.8 x 2.6 m: a corner desk, bookcases, a reading chair, a pin board."""
    site = Site("office1", (4.2, 3.8, 2.6), rng)
    oak = site.material(P.WOOD, ("#a5774a", "#6f4a28", "#40281a"))
    white = site.material(P.WOOD, ("#e2ddd2", "#c8c0b0", "#a8a090"))
    green = site.material(P.FABRIC, ("#3f6a54", "#2c4e3c", "#b0c8a8"), 0.5)
    brown = site.material(P.FABRIC, ("#8a5a3a", "#643c24", "#d8b890"), 0.8)
    site.put(w.workplace(rng, oak, 1.6, 2), -0.7, 1.48)
    site.put_about(w.swivel_chair(green), -0.7, 0.82, 170)
    site.put(w.workplace(rng, oak, 1.3, 0), -1.7, 0.2, 90)
    site.put(f.shelf(rng, oak, 1.5, 2.05), -0.85, -1.73, 180)
    site.put(f.shelf(rng, white, 0.9, 1.35), 0.5, -1.73, 180)
    site.put(w.filing(site.material(P.PLAIN, ("#7a8a8c", "#667678", "#7a8a8c"), 0.4, 0.2), 3), 1.8, -0.45, -90)
    site.put(
        f.plant(rng, site.material(P.STONE, ("#b8693f", "#8f4a2b", "#d99a70"), 0.6), 0.62, 16), 1.8, -0.45, 0, 0.99
    )
    site.put_about(f.armchair(brown, oak), 1.5, 1.2, -40)
    site.put_about(home.stool(oak, green), 0.75, 1.55)
    site.put(w.bin_basket(site.material(P.FABRIC, ("#4a4c52", "#33353a", "#7a7c82"), 0.15)), 0.28, 1.62)
    site.put(w.coat_stand(oak, site.material(P.FABRIC, ("#2f3f5a", "#223048", "#5a6a8a"), 0.4)), 1.82, -1.58)
    site.put(w.boxes(rng, 3), -1.75, -1.0, 70)
    rug = site.material(P.RUG, ("#7a2f36", "#26405f", "#d8c4a0"))
    site.put([f.block(rug, (2.1, 1.4, 0.014), (0, 0, 0.007), 0.003)], 0.25, -0.1, -6)
    glow = Material(P.PLAIN, ("#ffe6b8", "#ffdca0", "#ffe6b8"), 1.0, 0.02, emission=0.9)
    site.put(f.floor_lamp(glow), 1.85, 1.72 - 0.12)
    site.bulb(1.85, 1.6, 1.315, 1.605, (20.0, 15.0, 8.0))
    site.ceiling_panel(0.0, 0.0, (0.6, 0.3), LAMP)
    site.on_wall(fittings.clock(0.15), "north", 0.45, 1.95)
    posters(site, POSTERS, 1.72)
    windows(site, white, "east", (0.75,), 1.5, 1.2)
    site.on_wall(fittings.door(white), "south", 1.4)
    site.skirting(white)
    return site.scene(shell(site), Pace(0.0058, 0.43))


def shell(site: Site) -> tuple[Material, ...]:
    """Return the materials of the walls x+, x-, y+, y-, of ceiling and floor."""
    return (
        site.material(P.PLASTER, ("#cfc4a8", "#b5a888", "#e2d9c4"), 0.7),
        site.material(P.WALLPAPER, ("#cdd2c4", "#8a9a86", "#a86a4a"), 0.7),
        site.material(P.PLASTER, ("#8a9a8c", "#728274", "#a8b4a8"), 0.7),
        site.material(P.PLASTER, ("#c4b49a", "#a89878", "#dccfb8"), 0.7),
        site.material(P.PLASTER, ("#e8e4da", "#d2ccbe", "#bcb4a2"), 0.9),
        site.material(P.PLANKS, ("#8f6238", "#5f3c20", "#22140c"), 0.8),
    )
