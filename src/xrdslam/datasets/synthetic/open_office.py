"""The open-plan office: four work places behind partitions, cabinets, a copier, windows to the north."""

import numpy as np

from xrdslam.datasets.synthetic import fittings, home
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic import workplace as w
from xrdslam.datasets.synthetic.office_walls import LAMP, posters, windows, written
from xrdslam.datasets.synthetic.scene import Material, Pace, Pattern, Scene
from xrdslam.datasets.synthetic.site import Site

__all__ = ["open_office"]

P = Pattern
POSTERS = (
    ("west", 1.3, 0.7, 1.0, 4),
    ("west", 2.02, 0.6, 0.8, 2),
    ("east", 0.6, 0.8, 1.1, 4),
    ("east", -0.7, 1.1, 0.75, 0),
    ("east", -2.1, 0.7, 0.95, 3),
    ("south", 1.6, 1.2, 0.8, 1),
    ("south", 2.85, 0.6, 0.84, 4),
    ("north", -2.4, 1.1, 0.7, 0),
)


def open_office(rng: np.random.Generator) -> Scene:
    """Build an open-plan office of 7.6 x 6.8 x 2.9 m: four work places behind partitions, cabinets, a copier."""
    site = Site("office3", (7.6, 6.8, 2.9), rng)
    birch = site.material(P.WOOD, ("#d0b083", "#a88458", "#7a5c38"))
    steel = site.material(P.PLAIN, ("#8a9094", "#767c80", "#8a9094"), 0.3, 0.2)
    paint = site.material(P.PLAIN, ("#c8ccca", "#b0b6b4", "#c8ccca"), 0.3, 0.2)
    chairs = [
        site.material(P.FABRIC, c, 0.45) for c in (("#2f5a7a", "#20425c", "#9ab8cc"), ("#8a3f4a", "#642a34", "#d8a8ac"))
    ]
    screen = site.material(P.FABRIC, ("#4f7a6a", "#3a5e50", "#a8c4b4"), 0.6)
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = 1.0 + 0.85 * sx, -0.35 + 0.46 * sy
            site.put(w.workplace(rng, birch, 1.6, 2 if sx * sy > 0 else 1), x, y, 180 if sy > 0 else 0)
            site.put_about(w.swivel_chair(chairs[(sx + sy) // 2 % 2]), x, y + 0.62 * sy, 180 if sy < 0 else 0)
        site.put(w.partition(screen, steel, 1.65, 1.2), 1.0 + 0.85 * sx, -0.35)
    site.put(
        w.partition(site.material(P.FABRIC, ("#c8803a", "#a06020", "#f0d0a0"), 0.6), steel, 1.7, 1.45), 2.85, -0.35, 90
    )
    for k in range(3):
        site.put(w.cabinet(rng, birch, 1.2, 5 if k else 3), -2.3 + 1.22 * k, -3.2, 180)
    site.put(w.filing(steel), 3.45, 2.0, -90)
    site.put(w.filing(steel), 3.45, 2.5, -90)
    site.put(w.copier(paint), -3.4, -2.1, 90)
    site.put(w.boxes(rng, 4), -3.35, -2.95, 60)
    sofa = site.material(P.FABRIC, ("#b0562f", "#8a3e1e", "#e8c0a0"), 0.8)
    site.put(f.sofa(sofa, birch, 1.9, 2), -2.4, 2.85)
    site.put([f.cushion(screen, (0.4, 0.14, 0.38), (0, 0, 0), (10, 0, -22))], -2.8, 2.75, 0, 0.69)
    site.put([*home.round_table(birch, 0.45, 0.48), *f.place(home.book_pile(rng, 4), 0.05, 0.05, 0, 0.48)], -2.35, 1.6)
    site.put_about(home.bean_bag(chairs[0]), -3.0, 0.9, 50)
    rug = site.material(P.RUG, ("#3a5a4a", "#c8803a", "#e0d8c0"))
    site.put([f.block(rug, (2.4, 1.7, 0.012), (0, 0, 0.006), 0.003)], -2.4, 1.75)
    site.put(w.coat_stand(birch, chairs[1]), -0.95, 3.1)
    pot = site.material(P.STONE, ("#d8d2c4", "#a89e8a", "#6a6458"), 0.5)
    for x, y, tall in ((3.35, -3.0, 1.6), (-3.4, 3.05, 1.4), (2.9, 1.15, 1.1)):
        site.put(f.plant(rng, pot, tall, 24), x, y)
    for x in (-2.4, 0.0, 2.4):
        for y in (-1.5, 1.5):
            site.ceiling_panel(x, y, (0.6, 0.3), LAMP)
    written(site, "west", -0.4, 1.9, 1.2)
    posters(site, POSTERS, 1.7)
    windows(site, paint, "north", (0.4, 2.6), 1.8, 1.4)
    site.on_wall(fittings.pipes(steel, 7.2), "south", 0.0, 2.6)
    site.on_wall(fittings.clock(0.2), "south", 2.2, 2.25)
    site.on_wall(fittings.door(birch), "west", 2.86)
    site.skirting(steel)
    return site.scene(shell(site), Pace(0.0146, 0.36))


def shell(site: Site) -> tuple[Material, ...]:
    """Return the materials of the walls x+, x-, y+, y-, of ceiling and floor."""
    return (
        site.material(P.BRICK, ("#d4ccc0", "#b8afa2", "#98928a"), 1.2),
        site.material(P.PLASTER, ("#c4b898", "#a89c7c", "#dcd2b8"), 0.9),
        site.material(P.PLASTER, ("#b8c0bc", "#9ca6a2", "#d2d8d4"), 0.9),
        site.material(P.PLASTER, ("#6a7f96", "#54687e", "#8c9eb2"), 0.9),
        site.material(P.CEILING, ("#e2e2de", "#b6b4ac", "#8e9296")),
        site.material(P.CARPET, ("#6a6458", "#4e4a40", "#4f7a6a")),
    )
