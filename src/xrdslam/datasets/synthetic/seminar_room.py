"""The seminar room: rows of chairs, a lectern, a wall of books, stacked boxes, windows to the east."""

import numpy as np

from xrdslam.datasets.synthetic import fittings, home
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic import workplace as w
from xrdslam.datasets.synthetic.office_walls import LAMP, posters, windows, written
from xrdslam.datasets.synthetic.scene import Material, Pace, Pattern, Scene
from xrdslam.datasets.synthetic.site import Site

__all__ = ["seminar_room"]

P = Pattern
POSTERS = (
    ("south", -0.35, 0.9, 1.2, 4),
    ("south", 0.75, 0.7, 0.95, 2),
    ("south", 1.9, 1.1, 0.8, 0),
    ("east", -2.75, 0.6, 0.84, 4),
    ("east", 2.45, 0.7, 0.95, 3),
    ("west", 2.85, 0.35, 0.5, 2),
)


def seminar_room(rng: np.random.Generator) -> Scene:
    """Build a seminar room of 6.8 x 6.2 x 3.0 m: rows of chairs, a lectern, a wall of books, stacked boxes."""
    site = Site("office4", (6.8, 6.2, 3.0), rng)
    beech = site.material(P.WOOD, ("#c4966a", "#9a6c42", "#6a4426"))
    dark = site.material(P.WOOD, ("#5a3a28", "#3a2418", "#20120c"))
    shells = [
        site.material(P.PLASTER, c, 0.3)
        for c in (
            ("#b83a2f", "#9a2c24", "#d0564a"),
            ("#2f6a8f", "#24567a", "#4a84a8"),
            ("#d0a030", "#b08420", "#e4bc58"),
        )
    ]
    for row in range(3):
        for k in range(4):
            if (row, k) != (0, 3):
                seat = shells[int(rng.integers(3))]
                site.put_about(w.row_chair(seat), -1.15 + 0.78 * k, 0.75 - 0.95 * row, 180)
    site.put(
        [
            *w.stand_desk(dark, 1.8, 0.8),
            *f.place(home.book_pile(rng, 5), -0.6, 0, 0, 0.75),
            *f.place(w.monitor(site.material(P.SCREEN, ("#d8dde2", "#5a7a9a", "#2a3a4a")), 0.5), 0.4, 0.1, 180, 0.75),
        ],
        -1.9,
        2.2,
    )
    lectern = [
        f.frustum(dark, 0.3, 0.2, (0, 0, 0), 0.06, 0.01),
        f.block(beech, (0.12, 0.12, 1.0), (0, 0, 0.55), 0.01),
        f.block(beech, (0.56, 0.42, 0.03), (0, 0, 1.08), 0.008, (0, 0, 22)),
    ]
    site.put_about(lectern, 1.3, 2.3, 0)
    site.on_wall(w.screen_wall(site.material(P.SCREEN, ("#e8c890", "#5a6a9a", "#3a5a4a")), 2.3), "north", 0.0, 1.75)
    written(site, "north", 2.2, 1.5, 1.2)
    for k in range(3):
        site.put(f.shelf(rng, beech if k % 2 else dark, 1.5, 2.35), -3.23, -1.65 + 1.55 * k, 90)
    site.put(f.shelf(rng, dark, 1.4, 1.3), -1.6, -2.93, 180)
    site.put(home.floor_vase(site.material(P.STONE, ("#a85a38", "#7a3c24", "#e0b080"), 0.5), 0.5), -1.3, -2.93, 0, 1.3)
    site.put(w.boxes(rng, 5), 3.0, -2.7, -30)
    site.put(w.boxes(rng, 3), 2.35, -2.75, 20)
    site.put(home.trunk(dark, f.BRASS, 1.0), 0.3, -2.8, 180)
    globe = site.material(P.STONE, ("#3f7fb0", "#5a8a4a", "#e8e0c8"), 2.2)
    site.put(
        [
            *home.stool(beech, dark, 0.5),
            f.frustum(f.BRASS, 0.1, 0.03, (0, 0, 0.52), 0.08),
            f.sphere(globe, 0.22, (0, 0, 0.8)),
        ],
        2.9,
        1.5,
    )
    site.put(f.plant(rng, site.material(P.STONE, ("#5a5f66", "#3f444a", "#8a9096"), 0.5), 1.7, 30), 2.95, 2.65)
    site.put_about(home.stool(beech, shells[1], 0.7), 2.35, 2.1)
    rug = site.material(P.RUG, ("#5f2f3a", "#2f4a5f", "#d8c8a0"))
    site.put([f.block(rug, (2.6, 1.0, 0.012), (0, 0, 0.006), 0.003)], 0.3, 1.85)
    for x in (-1.8, 0.4, 2.4):
        for y in (-1.4, 1.4):
            site.ceiling_panel(x, y, (0.3, 0.55), LAMP)
    posters(site, POSTERS, 1.85)
    windows(site, beech, "east", (-1.1, 1.05), 1.7, 1.5)
    site.on_wall(fittings.pipes(w.METAL, 6.0, 3), "south", 0.0, 2.7)
    site.on_wall(fittings.door(dark), "south", 2.85)
    site.skirting(dark)
    return site.scene(shell(site), Pace(0.0126, 0.53))


def shell(site: Site) -> tuple[Material, ...]:
    """Return the materials of the walls x+, x-, y+, y-, of ceiling and floor."""
    return (
        site.material(P.PLASTER, ("#d0c4a4", "#b4a684", "#e4dac0"), 0.9),
        site.material(P.PLASTER, ("#7a4a3a", "#5f3628", "#9a6a56"), 0.8),
        site.material(P.PLASTER, ("#8a9aa8", "#72828f", "#a8b4be"), 0.9),
        site.material(P.BRICK, ("#a87a5a", "#8a5f44", "#c0b4a4"), 1.1),
        site.material(P.CEILING, ("#e4e0d6", "#b8b2a4", "#9a948a"), 1.5),
        site.material(P.PLANKS, ("#a8794a", "#7a5230", "#2c1a0e"), 1.2),
    )
