"""The dining room: a round table laid for six, a dresser with crockery, a sideboard, two windows to the south."""

import math

import numpy as np

from xrdslam.datasets.synthetic import fittings, home
from xrdslam.datasets.synthetic import furniture as f
from xrdslam.datasets.synthetic.scene import Material, Pace, Pattern, Scene
from xrdslam.datasets.synthetic.site import Site

__all__ = ["dining_room"]

P = Pattern


def dining_room(rng: np.random.Generator) -> Scene:
    """Build a dining room of 5.4 x 5.0 x 2.9 m."""
    site = Site("room2", (5.4, 5.0, 2.9), rng)
    cherry = site.material(P.WOOD, ("#8c4a2a", "#5a2a16", "#33160c"))
    cream = site.material(P.WOOD, ("#d9cfb4", "#bcae8c", "#9a8c6a"))
    table(site, cherry)
    site.put(dresser(site, cream, cherry), -0.9, 2.25)
    site.put(home.drawers(cherry, cream, 1.7, 0.88, 2, 4), -2.44, -0.3, 90)
    glaze = site.material(P.STONE, ("#efe8d8", "#3f6f8c", "#27455a"), 0.5)
    site.put(home.bowl(glaze), -2.44, -0.75, 0, 0.88)
    site.put(home.candles(5), -2.46, -0.15, 90, 0.88)
    site.put(home.book_pile(rng, 4), -2.42, 0.3, 15, 0.88)
    glow = Material(P.PLAIN, ("#ffe2b0", "#ffd898", "#ffe2b0"), 1.0, 0.02, emission=0.8)
    site.put(home.table_lamp(glaze, glow), 2.42, 0.62, 0, 0.78)
    site.bulb(2.42, 0.62, 1.03, 1.25, (20.0, 14.5, 8.0), 0.08)
    site.put(f.place(f.coffee_table(cherry, (1.1, 0.42, 0.78)), 0, 0), 2.42, 0.35, -90)
    site.put(f.books(rng, 0.42, (-0.5, 0, 0), 0.25), 2.44, 0.3, -90, 0.78)
    site.put(home.floor_vase(site.material(P.STONE, ("#2f5d6a", "#163a44", "#d8b070"), 0.7), 0.85), 2.2, -2.05)
    clay = site.material(P.STONE, ("#a85a38", "#7a3c24", "#d89a70"), 0.6)
    site.put(f.plant(rng, clay, 1.5, 28), -2.25, -2.05)
    site.put(f.plant(rng, clay, 0.8, 18), 2.3, 2.1)
    mustard = site.material(P.FABRIC, ("#6a7a3a", "#4a5a24", "#d8cf9a"), 0.5)
    site.put_about(f.armchair(mustard, cherry), -2.0, 1.55, 62)
    walls(site, cream, cherry)
    faces = (
        site.material(P.WALLPAPER, ("#d2b8a0", "#a87860", "#7a2f2a"), 0.9),
        site.material(P.PLASTER, ("#a85f48", "#8a4634", "#c08a70"), 0.8),
        site.material(P.WALLPAPER, ("#d8cdb0", "#8a9a70", "#b0603a"), 0.7),
        site.material(P.PLASTER, ("#c8b48c", "#ac966a", "#e0d2b0"), 0.8),
        site.material(P.PLASTER, ("#e8e0d0", "#d2c8b2", "#b8ac94"), 1.2),
        site.material(P.CHECKER, ("#d8cfbc", "#5a3f32", "#2a2420"), 1.6),
    )
    return site.scene(faces, Pace(0.0115, 0.57))


def table(site: Site, wood: Material) -> None:
    """Lay the table for six under a lamp, six chairs about it, on a round rug."""
    cloth = site.material(P.FABRIC, ("#9a3a34", "#6f2420", "#e8d0a0"), 0.6)
    mat = site.material(P.FABRIC, ("#d8c9a0", "#a08a5a", "#6a7a4a"), 0.2)
    plate = site.material(P.STONE, ("#ece6d8", "#3f6f8c", "#a8b8bc"), 0.3)
    glass = site.material(P.PLAIN, ("#5f8a7a", "#4a7466", "#5f8a7a"), 0.2)
    rug = site.material(P.RUG, ("#33506a", "#8c2f32", "#dcc8a0"))
    round_rug = f.frustum((rug, rug, rug), 1.55, 1.55, (0, 0, 0), 0.014, 0.003)
    site.put([round_rug, *home.round_table(wood, 0.8)], 0.35, -0.25)
    for k in range(6):
        yaw = 60.0 * k + 20
        a = math.radians(yaw - 90)
        x, y = 0.35 + math.cos(a), -0.25 + math.sin(a)
        site.put_about(f.chair(wood, cloth), x, y, yaw + 180)
        site.put(
            home.place_setting(plate, mat, glass), 0.35 + 0.55 * math.cos(a), -0.25 + 0.55 * math.sin(a), yaw, 0.75
        )
    site.put(home.bowl(plate), 0.35, -0.25, 0, 0.75)
    shade = site.material(P.STONE, ("#c08a3a", "#8a5a1c", "#e8c070"), 0.4)
    site.put(home.pendant(shade, 2.9, 2.2, 0.3), 0.35, -0.25)
    site.bulb(0.35, -0.25, 2.15, 2.45, (16.0, 13.0, 9.0), 0.2)


def dresser(site: Site, paint: Material, top: Material) -> f.Piece:
    """Return a dresser: drawers below, two shelves of crockery above."""
    parts = home.drawers(paint, top, 1.8, 0.86, 2, 3)
    parts += [
        f.block(paint, (1.8, 0.02, 1.2), (0, 0.21, 1.46)),
        *(f.block(paint, (0.03, 0.28, 1.2), (s * 0.885, 0.08, 1.46), 0.006) for s in (-1, 1)),
        *(f.block(top, (1.76, 0.26, 0.025), (0, 0.08, z)) for z in (1.24, 1.62)),
        f.block(top, (1.9, 0.36, 0.05), (0, 0.06, 2.08), 0.015),
    ]
    for z in (0.865, 1.255, 1.635):
        parts += home.crockery(site.rng, 1.68, (-0.84, 0.05, z))
    return parts


def walls(site: Site, paint: Material, frame: Material) -> None:
    """Hang pictures and a clock; put the door and two windows with curtains in place."""
    pictures = (
        (("#a8c0c8", "#f0d0a0", "#50683f"), 0, (1.2, 0.8), frame, "west", -0.3, 1.7),
        (("#f2ead8", "#a84a3a", "#2f5d6a"), 2, (0.5, 0.66), f.BLACK, "west", 1.35, 1.65),
        (("#e8d8c0", "#906a40", "#403838"), 1, (0.7, 0.9), f.BRASS, "east", -0.9, 1.65),
        (("#203848", "#c87848", "#e8d8a0"), 3, (0.8, 0.6), frame, "east", 0.35, 1.75),
        (("#d0e0e0", "#e8b888", "#4a6040"), 0, (0.8, 0.55), frame, "north", 0.75, 1.75),
        (("#f0e4d0", "#5a7a9a", "#c06a3a"), 2, (0.5, 0.65), f.BRASS, "north", 1.6, 1.65),
        (("#f0e4d0", "#3a5a4a", "#b0503a"), 1, (0.5, 0.4), frame, "south", 0.02, 1.9),
    )
    for colours, manner, size, edge, wall, along, z in pictures:
        site.on_wall(f.picture(site.art(colours, manner), *size, edge), wall, along, z)
    cloth = site.material(P.FABRIC, ("#c8b890", "#a08a5a", "#7a2f2a"), 0.7)
    for along in (-1.35, 1.3):
        view = site.view(("#7aa8dc", "#dce6ec", "#4f6a34"))
        fitted = [*fittings.window(view, paint, 1.15, 1.4), *fittings.curtains(cloth, 1.15, 2.2, -1.45)]
        site.on_wall(fitted, "south", along, 1.6)
        site.shine(fittings.daylight((5.5, 6.0, 6.8), 1.15, 1.4), "south", along, 1.6)
        site.on_wall(fittings.radiator(paint, 0.9), "south", along)
    site.skirting(frame, 0.14)
    site.on_wall(fittings.clock(0.18), "south", 0.02, 1.45)
    site.on_wall(fittings.door(paint), "east", 1.75)
    # a rail half way up the walls
    x, y, _ = site.size
    site.solids += [f.block(frame, (x, 0.025, 0.06), (0, s * (y / 2 - 0.0125), 1.0), 0.01) for s in (1,)]
    site.solids += [f.block(frame, (0.025, y, 0.06), (s * (x / 2 - 0.0125), 0, 1.0), 0.01) for s in (-1, 1)]
