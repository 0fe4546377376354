"""Furniture of bedrooms and dining rooms: beds, wardrobes, round tables, arc sofas, lamps, crockery."""

import math

import numpy as np

from xrdslam.datasets.synthetic.furniture import (
    BLACK,
    BRASS,
    PAPER,
    Piece,
    block,
    book_cover,
    cushion,
    cylinder,
    frustum,
    legs,
    place,
    sphere,
)  # fmt: skip
from xrdslam.datasets.synthetic.scene import Material, Pattern, Scalar, Vector

__all__ = [
    "arc_sofa", "bean_bag", "bed", "book_pile", "bowl", "candles", "crockery", "drawers", "floor_vase", "nightstand",
    "pendant", "place_setting", "round_table", "stool", "table_lamp", "trunk", "wardrobe",
]  # fmt: skip

FRUIT = tuple(
    Material(Pattern.PLAIN, (c, d, c), 0.1)
    for c, d in (("#c9402a", "#e0a030"), ("#e08a1e", "#d06a10"), ("#7a9a2e", "#a0b840"))
)


def bed(wood: Material, sheet: Material, quilt: Material, pillow: Material, width: Scalar = 1.6) -> Piece:
    """Return a bed 2.1 m long, its head at the back, the quilt turned down."""
    frame = [
        block(wood, (width + 0.12, 0.07, 1.05), (0, 1.0, 0.525), 0.03),
        block(wood, (width + 0.12, 0.05, 0.45), (0, -1.05, 0.225), 0.02),
        *(block(wood, (0.04, 2.05, 0.2), (s * (width / 2 + 0.03), -0.02, 0.26), 0.012) for s in (-1, 1)),
        *(sphere(wood, 0.05, (s * (width / 2 + 0.03), 1.0, 1.08)) for s in (-1, 1)),
    ]
    mattress = block(sheet, (width, 2.0, 0.24), (0, -0.03, 0.42), 0.06)
    cover = [
        block(quilt, (width + 0.06, 1.35, 0.2), (0, -0.34, 0.48), 0.085),
        block(quilt, (width + 0.04, 0.22, 0.1), (0, 0.34, 0.585), 0.048),
    ]
    heads = [cushion(pillow, (0.66, 0.42, 0.16), (s * width / 4, 0.66, 0.62), (4 * s, 0, -16)) for s in (-1, 1)]
    return [*frame, mattress, *cover, *heads, cushion(quilt, (0.4, 0.14, 0.36), (0.05, 0.47, 0.7), (8, 0, -25))]


def drawers(wood: Material, front: Material, width: Scalar, height: Scalar, rows: int, columns: int = 1) -> Piece:
    """Return a chest 0.45 m deep with round knobs."""
    tall, wide = (height - 0.1) / rows, (width - 0.04) / columns
    parts = [block(wood, (width, 0.45, height - 0.06), (0, 0, 0.06 + (height - 0.06) / 2), 0.012)]
    parts += legs(wood, width / 2 - 0.06, 0.17, 0.07, 0.025)
    for row in range(rows):
        for column in range(columns):
            x, z = (column - (columns - 1) / 2) * wide, 0.08 + tall * (row + 0.5)
            parts.append(block(front, (wide - 0.015, 0.02, tall - 0.015), (x, -0.232, z), 0.006))
            parts += [sphere(BRASS, 0.016, (x + s * wide / 4, -0.252, z)) for s in (-1, 1)]
    return parts


def nightstand(wood: Material, front: Material) -> Piece:
    """Return a chest of two drawers, 0.55 m tall."""
    return drawers(wood, front, 0.5, 0.55, 2)


def wardrobe(wood: Material, front: Material, width: Scalar = 1.7, height: Scalar = 2.15) -> Piece:
    """Return a wardrobe 0.6 m deep with panelled doors."""
    count = max(2, round(width / 0.55))
    wide = (width - 0.04) / count
    parts = [
        block(wood, (width, 0.58, height), (0, 0, height / 2)),
        block(wood, (width + 0.08, 0.64, 0.07), (0, -0.01, height + 0.02), 0.02),
    ]
    for k in range(count):
        x = (k - (count - 1) / 2) * wide
        parts.append(block(front, (wide - 0.012, 0.022, height - 0.16), (x, -0.3, height / 2 + 0.03), 0.006))
        parts += [
            block(wood, (wide - 0.16, 0.014, h), (x, -0.314, z), 0.005)
            for z, h in ((0.3 * height, 0.36 * height), (0.73 * height, 0.34 * height))
        ]
        parts.append(cylinder(BRASS, 0.011, (x + (0.5 - k % 2) * (wide - 0.12), -0.335, 0.48 * height), 0.16))
    return parts


def table_lamp(foot: Material, shade: Material, tall: Scalar = 0.46) -> Piece:
    """Return a lamp with a ball for a foot and a conical shade."""
    return [
        frustum(BRASS, 0.075, 0.06, (0, 0, 0), 0.02, 0.006),
        sphere(foot, 0.085, (0, 0, 0.1)),
        cylinder(BRASS, 0.01, (0, 0, 0.17), tall - 0.26),
        frustum(shade, 0.15, 0.085, (0, 0, tall - 0.2), 0.2),
    ]


def pendant(shade: Material, ceiling: Scalar, low: Scalar, radius: Scalar = 0.24) -> Piece:
    """Return a lamp on a cord: a cone over a glowing ball, its rim at `low`."""
    glow = Material(Pattern.PLAIN, ("#fff0d0", "#ffe6b8", "#fff0d0"), 1.0, 0.02, emission=1.4)
    return [
        frustum(shade, radius, 0.06, (0, 0, low), 0.2),
        sphere(glow, 0.06, (0, 0, low - 0.02)),
        cylinder(BLACK, 0.007, (0, 0, low + 0.2), ceiling - low - 0.2),
        frustum(BRASS, 0.03, 0.06, (0, 0, ceiling - 0.05), 0.05),
    ]


def round_table(wood: Material, radius: Scalar = 0.65, height: Scalar = 0.75) -> Piece:
    """Return a round table on one turned foot."""
    return [
        frustum(wood, radius, radius, (0, 0, height - 0.04), 0.04, 0.018),
        frustum(wood, 0.09, 0.05, (0, 0, 0.1), 0.3, 0.01),
        frustum(wood, 0.05, 0.11, (0, 0, 0.4), height - 0.44, 0.01),
        frustum(wood, 0.5 * radius, 0.1, (0, 0, 0), 0.1, 0.015),
    ]


def stool(wood: Material, cloth: Material, height: Scalar = 0.46) -> Piece:
    """Return a round stool with a padded seat."""
    return [
        *legs(wood, 0.13, 0.13, height - 0.06, 0.022),
        frustum(cloth, 0.19, 0.2, (0, 0, height - 0.07), 0.09, 0.035),
    ]


def arc_sofa(
    cloth: Material, wood: Material, radius: Scalar = 1.35, sweep_deg: Scalar = 150.0, parts: int = 7
) -> Piece:
    """Return a sofa bent around the origin: seats and backs side by side on an arc about -y, open towards -y."""
    solids: Piece = []
    each = math.radians(sweep_deg) / parts
    wide = 2 * radius * math.tan(each / 2)
    for k in range(parts):
        yaw = math.degrees((k - (parts - 1) / 2) * each)
        segment = [
            block(cloth, (0.92 * wide, 0.7, 0.22), (0, radius - 0.2, 0.23), 0.05),
            block(cloth, (0.84 * wide, 0.6, 0.15), (0, radius - 0.26, 0.39), 0.06),
            block(cloth, (1.06 * wide, 0.2, 0.72), (0, radius + 0.12, 0.42), 0.09, (0, 0, -8)),
            cylinder(wood, 0.025, (0, radius - 0.3, 0), 0.14),
        ]
        solids += place(segment, 0, 0, yaw)
    return solids


def bean_bag(cloth: Material) -> Piece:
    """Return a bean bag: a slumped cone with a loop to carry it by."""
    loop = frustum(BLACK, 0.05, 0.05, (0, 0, 0.56), 0.05, 0.02)
    return [frustum(cloth, 0.46, 0.22, (0, 0, 0), 0.58, 0.15), loop]


def trunk(wood: Material, metal: Material, width: Scalar = 0.9) -> Piece:
    """Return a chest with a barrel lid and two straps."""
    lid = frustum(wood, 0.22, 0.22, (0, 0, 0.33 - width / 2), width, 0.01, (0, 90, 0))
    straps = [frustum(metal, 0.228, 0.228, (s * width / 3, 0, 0.305), 0.05, 0.004, (0, 90, 0)) for s in (-1, 1)]
    return [block(wood, (width, 0.44, 0.33), (0, 0, 0.165), 0.01), lid, *straps]


def bowl(glaze: Material, fruit: int = 6) -> Piece:
    """Return a bowl 0.3 m wide, filled with fruit."""
    balls = [
        sphere(FRUIT[k % 3], 0.042, (0.075 * math.cos(1.3 * k), 0.075 * math.sin(1.3 * k), 0.095)) for k in range(fruit)
    ]
    return [frustum(glaze, 0.07, 0.16, (0, 0, 0), 0.08, 0.008), *balls]


def place_setting(glaze: Material, cloth: Material, glass: Material) -> Piece:
    """Return a mat, a plate and a bowl on it, a beaker, knife and fork; one sits at -y."""
    metal = Material(Pattern.PLAIN, ("#9a9a9e", "#b8b8bc", "#9a9a9e"))
    return [
        block(cloth, (0.42, 0.3, 0.006), (0, 0, 0.003)),
        frustum(glaze, 0.09, 0.125, (0, 0, 0.006), 0.018, 0.006),
        frustum(glaze, 0.045, 0.08, (0, 0, 0.022), 0.045, 0.008),
        frustum(glass, 0.03, 0.038, (0.16, 0.1, 0.006), 0.11, 0.004),
        *(block(metal, (0.015, 0.17, 0.004), (s * 0.165, -0.01, 0.008)) for s in (-1, 1)),
    ]


def candles(count: int = 3) -> Piece:
    """Return candles of several heights on brass feet, in a row."""
    wax = Material(Pattern.PLAIN, ("#efe3c2", "#e2d2a4", "#efe3c2"), 0.2)
    parts: Piece = []
    for k in range(count):
        x = (k - (count - 1) / 2) * 0.13
        parts += [
            frustum(BRASS, 0.045, 0.018, (x, 0, 0), 0.09 + 0.04 * (k % 2), 0.006),
            cylinder(wax, 0.018, (x, 0, 0.09 + 0.04 * (k % 2)), 0.14 + 0.05 * ((k + 1) % 3)),
        ]
    return parts


def floor_vase(glaze: Material, tall: Scalar = 0.7) -> Piece:
    """Return a bellied vase with a neck, of stacked round sections."""
    return [
        frustum(glaze, 0.11, 0.19, (0, 0, 0), 0.42 * tall, 0.02),
        frustum(glaze, 0.19, 0.08, (0, 0, 0.42 * tall), 0.36 * tall, 0.02),
        frustum(glaze, 0.06, 0.1, (0, 0, 0.76 * tall), 0.24 * tall, 0.015),
    ]


def crockery(rng: np.random.Generator, width: Scalar, low: Vector) -> Piece:
    """Return cups, bowls, jugs and leaning plates side by side along `width` from `low`."""
    parts, x = Piece(), 0.0
    while True:
        tint = str(rng.choice(("#3f6f8c", "#c4643c", "#e3d5b8", "#54784a", "#d8a531", "#8c4a5a")))
        glaze = Material(Pattern.STONE, (tint, "#efe9dc", "#33302c"), 0.35, seed=int(rng.integers(1 << 16)))
        kind, wide = int(rng.integers(4)), float(rng.uniform(0.13, 0.2))
        if x + wide > width:
            return parts
        at = (low[0] + x + wide / 2, low[1], low[2])
        if kind == 0:
            parts += [frustum(glaze, 0.3 * wide, 0.38 * wide, (at[0], at[1], at[2] + 0.06 * k), 0.09) for k in range(2)]
        elif kind == 1:
            parts += [
                frustum(glaze, 0.2 * wide, 0.45 * wide, (at[0], at[1], at[2] + 0.03 * k), 0.07, 0.006) for k in range(3)
            ]
        elif kind == 2:
            parts.append(frustum(glaze, 0.36 * wide, 0.22 * wide, at, 0.2, 0.01))
            parts.append(frustum(glaze, 0.2 * wide, 0.27 * wide, (at[0], at[1], at[2] + 0.19), 0.05))
        else:
            plate = (at[0], at[1] + 0.06, at[2] + 0.45 * wide - 0.012)
            parts.append(frustum(glaze, 0.45 * wide, 0.45 * wide, plate, 0.024, 0.008, (0, 0, 76)))
        x += wide + 0.02


def book_pile(rng: np.random.Generator, count: int = 4) -> Piece:
    """Return books lying on one another, each a little turned."""
    parts, z = Piece(), 0.0
    for _ in range(count):
        cover, thick = book_cover(rng), float(rng.uniform(0.02, 0.045))
        size = (float(rng.uniform(0.2, 0.3)), float(rng.uniform(0.15, 0.22)), thick)
        faces = (PAPER, PAPER, PAPER, cover, cover, cover)
        parts.append(block(faces, size, (0, 0, z + thick / 2), 0.0, (float(rng.uniform(-15, 15)), 0, 0)))
        z += thick
    return parts
