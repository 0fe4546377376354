"""The meeting room: a long table for nine, boards, a screen, a coffee corner, windows to the south."""

import numpy as np

from xrdslam.datasets.synthetic import fittings, home
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic import workplace as w
from xrdslam.datasets.synthetic.office_walls import LAMP, posters, windows, written
from xrdslam.datasets.synthetic.scene import Material, Pace, Pattern, Scene
from xrdslam.datasets.synthetic.site import Site

__all__ = ["meeting_room"]

P = Pattern
POSTERS = (
    ("west", 1.75, 0.6, 0.84, 4),
    ("west", -1.75, 0.6, 0.84, 4),
    ("east", 1.3, 0.7, 0.9, 3),
    ("east", -0.1, 1.0, 0.7, 0),
    ("east", 2.15, 0.45, 0.6, 2),
)


def meeting_room(rng: np.random.Generator) -> Scene:
    """Build a meeting room of 6.6 x 5.2 x 2.8 m: a long table for ten, boards, a screen, a coffee corner."""
    site = Site("office2", (6.6, 5.2, 2.8), rng)
    walnut = site.material(P.WOOD, ("#7a5234", "#4a2e1a", "#2a180e"))
    grey = site.material(P.WOOD, ("#b8b4a8", "#98948a", "#76726a"))
    cloths = [
        site.material(P.FABRIC, c, 0.5) for c in (("#2f4a6a", "#20344e", "#8aa4c0"), ("#a8482f", "#7a301c", "#e0b090"))
    ]
    site.put(w.long_table(walnut, 3.3, 1.15), 0, 0.1)
    for k in range(4):
        for s in (-1, 1):
            site.put_about(
                w.swivel_chair(cloths[(k + (s > 0)) % 2]), -1.2 + 0.8 * k, 0.1 + 0.86 * s, 0 if s > 0 else 180
            )
    site.put_about(w.swivel_chair(cloths[0]), 2.05, 0.1, -90)
    paper = site.material(P.POSTER, ("#f2f0ea", "#2f5f8f", "#b5562d"))
    for k in range(6):
        x, y = -1.3 + 0.55 * k, 0.42 if k % 2 else -0.22
        sheet = f.block((f.PAPER,) * 4 + (paper, f.PAPER), (0.21, 0.297, 0.006), (0, 0, 0.003))
        site.put_about([sheet], x, y, 12.0 * k, 0.75)
        mug = site.material(P.STONE, (("#27496d", "#a8432f", "#3f6f4a")[k % 3], "#e8e2d4", "#1f1f24"), 0.15)
        site.put_about([f.frustum(mug, 0.032, 0.042, (0, 0, 0), 0.1)], x + 0.22, y, 0, 0.75)
    site.on_wall(w.screen_wall(site.material(P.POSTER, ("#e8eef0", "#2f6a8f", "#d08a30")), 2.0), "west", 0.1, 1.55)
    written(site, "north", -1.1, 2.4, 1.15)
    site.on_wall(
        [f.block(site.material(P.POSTER, ("#c09a6a", "#8a6436", "#e8dcc4")), (1.3, 0.03, 0.9), (0, -0.015, 0), 0.004)],
        "north",
        1.3,
        1.55,
    )
    site.put(home.drawers(grey, walnut, 1.9, 0.9, 2, 4), 2.2, 2.32)
    site.put(
        [
            *home.bowl(site.material(P.STONE, ("#e9e4d6", "#3f6f8c", "#2a4a60"), 0.4)),
            *f.place(home.crockery(rng, 0.9, (0, 0, 0)), 0.2, 0),
        ],
        1.75,
        2.32,
        0,
        0.9,
    )
    site.put(w.water_cooler(site.material(P.STONE, ("#8ab8d8", "#6a9cc0", "#b8d8e8"), 1.2)), 2.98, -2.3, -120)
    site.put(f.plant(rng, site.material(P.STONE, ("#5a5f66", "#3f444a", "#8a9096"), 0.5), 1.5, 28), -2.9, 2.2)
    site.put(f.plant(rng, site.material(P.STONE, ("#b8693f", "#8f4a2b", "#d99a70"), 0.5), 1.0, 20), -2.9, -2.2)
    site.put_about(w.bin_basket(grey), 0.85, 2.35)
    for x in (-1.6, 0.0, 1.6):
        site.ceiling_panel(x, 0.1, (0.3, 0.6), LAMP)
    posters(site, POSTERS)
    windows(site, grey, "south", (-1.7, 0.9), 2.0, 1.4)
    site.on_wall(fittings.door(walnut), "east", -1.3)
    site.skirting(grey)
    return site.scene(shell(site), Pace(0.0116, 0.54))


def shell(site: Site) -> tuple[Material, ...]:
    """Return the materials of the walls x+, x-, y+, y-, of ceiling and floor."""
    return (
        site.material(P.PLASTER, ("#c8c4b8", "#aaa698", "#dedace"), 0.8),
        site.material(P.BRICK, ("#8a4a3a", "#6a3428", "#a89c90"), 0.9),
        site.material(P.PLASTER, ("#5a7a72", "#46645c", "#7c9890"), 0.8),
        site.material(P.PLASTER, ("#d4c8b0", "#b8aa90", "#e6decc"), 0.8),
        site.material(P.CEILING, ("#e6e4dc", "#bab6aa", "#a0a2a6")),
        site.material(P.CARPET, ("#4a5a6a", "#35424e", "#8a9aa8")),
    )
