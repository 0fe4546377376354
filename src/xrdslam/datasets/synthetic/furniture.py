"""Pieces of furniture, each a list of solids in its own frame: x to a side, y to its back, z up, origin on the floor.

A piece faces -y: the front of a sofa, a shelf or a picture looks along -y.
"""

from collections.abc import Iterable

import numpy as np

from xrdslam.datasets.synthetic.scene import Material, Pattern, Scalar, Shape, Solid, Vector, rotation

__all__ = [
    "armchair", "block", "books", "chair", "coffee_table", "cushion", "cylinder", "desk", "floor_lamp", "frustum",
    "picture", "place", "plant", "shelf", "sofa", "sphere", "television",
]  # fmt: skip

Piece = list[Solid]
BLACK = Material(Pattern.PLAIN, ("#26262a", "#333338", "#26262a"))
BRASS = Material(Pattern.PLAIN, ("#b08d4a", "#d0b070", "#b08d4a"), 0.3)
PAPER = Material(Pattern.PLAIN, ("#e8e2d0", "#d8cfb8", "#e8e2d0"), 0.1, 0.3)


def place(piece: Iterable[Solid], x: Scalar, y: Scalar, yaw_deg: Scalar = 0.0, z: Scalar = 0.0) -> Piece:
    """Turn a piece about the vertical and put its origin at (x, y, z)."""
    R = rotation(yaw_deg)
    return [solid.moved(R, (x, y, z)) for solid in piece]


def block(
    material: Material | tuple[Material, ...],
    size: Vector,
    centre: Vector,
    radius: Scalar = 0.0,
    turn: Vector = (0.0, 0.0, 0.0),
) -> Solid:
    """Return a box of outer extents `size`, edges rounded by `radius`, turned by (yaw, pitch, roll) in degrees."""
    assert radius <= min(size) / 2, "a rounding wider than the box would make it grow"
    a, b, c = (s / 2 - radius for s in size)
    materials = material if isinstance(material, tuple) else (material,)
    return Solid(Shape.BOX, (a, b, c), radius, materials, centre, rotation(*turn))


def sphere(material: Material, radius: Scalar, centre: Vector) -> Solid:
    """Return a sphere."""
    return Solid(Shape.BOX, (0.0, 0.0, 0.0), radius, (material,), centre)


def frustum(
    material: Material | tuple[Material, ...],
    bottom: Scalar,
    top: Scalar,
    low: Vector,
    height: Scalar,
    radius: Scalar = 0.0,
    turn: Vector = (0.0, 0.0, 0.0),
) -> Solid:
    """Return an upright frustum standing on `low`, of outer radii `bottom` and `top`, its edges rounded by `radius`."""
    half = height / 2 - radius
    materials = material if isinstance(material, tuple) else (material,)
    centre = (low[0], low[1], low[2] + height / 2)
    return Solid(Shape.FRUSTUM, (bottom - radius, top - radius, half), radius, materials, centre, rotation(*turn))


def cylinder(material: Material, radius: Scalar, low: Vector, height: Scalar) -> Solid:
    """Return an upright cylinder standing on `low`."""
    return frustum(material, radius, radius, low, height)


def cushion(material: Material, size: Vector, centre: Vector, turn: Vector = (0.0, 0.0, 0.0)) -> Solid:
    """Return a box rounded as far as its thinnest side allows."""
    return block(material, size, centre, 0.48 * min(size), turn)


def legs(material: Material, x: Scalar, y: Scalar, height: Scalar, thick: Scalar, low: Scalar = 0.0) -> Piece:
    """Return four tapering legs at (+-x, +-y)."""
    return [
        frustum(material, 0.7 * thick, thick, (sx * x, sy * y, low), height - low) for sx in (-1, 1) for sy in (-1, 1)
    ]


def sofa(cloth: Material, wood: Material, width: Scalar = 2.1, seats: int = 3) -> Piece:
    """Return a sofa 0.9 m deep."""
    inner = width - 0.44
    parts = [
        block(cloth, (width - 0.04, 0.84, 0.24), (0, 0, 0.22), 0.04),
        block(cloth, (width, 0.22, 0.78), (0, 0.34, 0.45), 0.09),
        block(cloth, (0.22, 0.88, 0.56), (-width / 2 + 0.11, 0, 0.34), 0.09),
        block(cloth, (0.22, 0.88, 0.56), (width / 2 - 0.11, 0, 0.34), 0.09),
        *legs(wood, width / 2 - 0.12, 0.34, 0.12, 0.03),
    ]
    each = inner / seats
    for k in range(seats):
        x = -inner / 2 + each * (k + 0.5)
        parts.append(block(cloth, (each - 0.01, 0.64, 0.16), (x, -0.1, 0.41), 0.06))
        parts.append(block(cloth, (each - 0.03, 0.18, 0.42), (x, 0.19, 0.66), 0.08, (0, 0, -12)))
    return parts


def armchair(cloth: Material, wood: Material) -> Piece:
    """Return an armchair 0.85 m wide with a round seat."""
    return [
        *legs(wood, 0.3, 0.3, 0.2, 0.028),
        frustum(cloth, 0.40, 0.42, (0, 0, 0.18), 0.14, 0.05),
        frustum(cloth, 0.33, 0.33, (0, -0.03, 0.3), 0.14, 0.06),
        block(cloth, (0.8, 0.16, 0.6), (0, 0.33, 0.58), 0.075, (0, 0, -14)),
        cushion(cloth, (0.15, 0.66, 0.2), (-0.38, 0.02, 0.5)),
        cushion(cloth, (0.15, 0.66, 0.2), (0.38, 0.02, 0.5)),
    ]


def coffee_table(wood: Material, size: Vector = (1.15, 0.62, 0.42)) -> Piece:
    """Return a low table with a shelf under its rounded top."""
    x, y, z = size
    return [
        block(wood, (x, y, 0.045), (0, 0, z - 0.0225), 0.018),
        block(wood, (x - 0.16, y - 0.14, 0.02), (0, 0, 0.15)),
        *legs(wood, x / 2 - 0.07, y / 2 - 0.06, z - 0.04, 0.026),
    ]


def chair(wood: Material, cloth: Material) -> Piece:
    """Return a dining chair; one sits on it looking along -y."""
    back = [block(wood, (0.04, 0.03, 0.62), (sx * 0.18, 0.21, 0.74), 0.01, (0, 0, -6)) for sx in (-1, 1)]
    rails = [
        block(wood, (0.34, 0.022, 0.07), (0, 0.2 + 0.1 * (z - 0.7), z), 0.01, (0, 0, -6)) for z in (0.66, 0.82, 0.98)
    ]
    seat = [
        block(wood, (0.44, 0.44, 0.03), (0, 0, 0.44), 0.012),
        block(cloth, (0.4, 0.4, 0.05), (0, -0.01, 0.475), 0.022),
    ]
    return [*seat, *back, *rails, *legs(wood, 0.18, 0.18, 0.43, 0.02)]


def desk(wood: Material, front: Material) -> Piece:
    """Return a desk 1.3 x 0.62 m with three drawers on its right."""
    drawers = [block(front, (0.36, 0.02, 0.19), (0.42, -0.29, z), 0.006) for z in (0.2, 0.41, 0.62)]
    knobs = [sphere(BRASS, 0.014, (0.42, -0.31, z)) for z in (0.2, 0.41, 0.62)]
    return [
        block(wood, (1.3, 0.62, 0.035), (0, 0, 0.745), 0.008),
        block(wood, (0.4, 0.56, 0.66), (0.42, 0, 0.39)),
        block(wood, (0.03, 0.56, 0.73), (-0.6, 0, 0.365)),
        *drawers,
        *knobs,
    ]


def books(rng: np.random.Generator, width: Scalar, low: Vector, max_height: Scalar = 0.27) -> Piece:
    """Return books standing in a row from `low` rightwards, some leaning, until `width` is used up."""
    x, row = 0.0, list[Solid]()
    while True:
        thick, tall, deep = rng.uniform(0.018, 0.05), max_height * rng.uniform(0.68, 1.0), rng.uniform(0.14, 0.2)
        lean = -9.0 if rng.random() < 0.12 and row else 0.0
        advance = thick + (0.16 * tall if lean else 0.001)
        if x + advance > width:
            return row
        centre = (low[0] + x + advance / 2, low[1] + rng.uniform(0, 0.02), low[2] + tall / 2)
        cover = book_cover(rng)
        row.append(block((PAPER, PAPER, cover, cover, PAPER, PAPER), (thick, deep, tall), centre, 0.0, (0, lean, 0)))
        x += advance


def book_cover(rng: np.random.Generator) -> Material:
    """Return a cover with a title, in one of a library's colours."""
    cloths = (
        "#8c2f2b",
        "#27496d",
        "#2f5d46",
        "#c9a227",
        "#4b3a5a",
        "#d9d2c0",
        "#b5562d",
        "#1f1f24",
        "#5a7d8c",
        "#a33b52",
    )
    inks = ("#e8d9a0", "#f2efe6", "#1d1d1d", "#c8b070")
    cloth, band = rng.choice(cloths, 2, replace=False)
    return Material(Pattern.BOOK, (str(cloth), str(band), str(rng.choice(inks))), seed=int(rng.integers(1 << 16)))


def shelf(rng: np.random.Generator, wood: Material, width: Scalar = 1.5, height: Scalar = 1.9) -> Piece:
    """Return a bookcase 0.3 m deep, filled with books and a few ornaments."""
    parts = [block(wood, (0.025, 0.3, height), (sx * (width / 2 - 0.0125), 0, height / 2)) for sx in (-1, 1)]
    parts.append(block(wood, (width, 0.015, height), (0, 0.145, height / 2)))
    levels = np.linspace(0.05, height - 0.0125, 6)
    parts += [block(wood, (width - 0.04, 0.29, 0.025), (0, 0, float(z))) for z in levels]
    for z in levels[:-1]:
        low, high = float(z) + 0.0125, float(levels[1] - levels[0]) - 0.05
        used = rng.uniform(0.5, 0.8) * (width - 0.08)
        left = -width / 2 + 0.03 + (width - 0.08 - used if rng.random() < 0.4 else 0.0)
        parts += books(rng, used, (left, 0.0, low), min(high, 0.29))
        free = left + used + 0.12 if left < -width / 2 + 0.04 else -width / 2 + 0.14
        parts += ornament(rng, (free, 0.0, low))
    return parts


def ornament(rng: np.random.Generator, low: Vector) -> Piece:
    """Return a vase, a ball or a pile of boxes standing on `low`."""
    tint = str(rng.choice(("#3f7f8c", "#c4643c", "#e3d5b8", "#7a4f6b", "#d8a531", "#54784a")))
    glaze = Material(Pattern.STONE, (tint, "#efe9dc", "#33302c"), 0.4, seed=int(rng.integers(1 << 16)))
    x, y, z = low
    kind = int(rng.integers(3))
    if kind == 0:
        return [frustum(glaze, 0.035, 0.07, low, 0.12, 0.01), frustum(glaze, 0.065, 0.03, (x, y, z + 0.12), 0.08, 0.01)]
    if kind == 1:
        return [frustum(BRASS, 0.05, 0.03, low, 0.03), sphere(glaze, 0.075, (x, y, z + 0.1))]
    return [
        block(glaze, (0.16, 0.14, 0.09), (x, y, z + 0.045), 0.008),
        block(BRASS, (0.1, 0.09, 0.06), (x, y, z + 0.12)),
    ]


def floor_lamp(shade: Material) -> Piece:
    """Return a standing lamp 1.6 m tall."""
    return [
        frustum(BLACK, 0.15, 0.13, (0, 0, 0), 0.03, 0.008),
        cylinder(BRASS, 0.013, (0, 0, 0.03), 1.32),
        frustum(shade, 0.21, 0.14, (0, 0, 1.32), 0.28),
    ]


def picture(material: Material, width: Scalar, height: Scalar, frame: Material) -> Piece:
    """Return a framed picture hanging around its origin, its back in the plane y = 0."""
    t = 0.035
    bars = [block(frame, (width + 2 * t, 0.035, t), (0, -0.0175, sz * (height + t) / 2), 0.006) for sz in (-1, 1)]
    bars += [block(frame, (t, 0.035, height + 2 * t), (sx * (width + t) / 2, -0.0175, 0), 0.006) for sx in (-1, 1)]
    return [block(material, (width, 0.016, height), (0, -0.008, 0)), *bars]


def television(screen: Material, wood: Material, width: Scalar = 1.6) -> Piece:
    """Return a sideboard with a television and two loudspeakers on it."""
    doors = [block(wood, (width / 3 - 0.012, 0.016, 0.3), (width / 3 * k, -0.205, 0.27), 0.005) for k in (-1, 0, 1)]
    knobs = [cylinder(BRASS, 0.015, (width / 3 * k + 0.2, -0.225, 0.26), 0.03) for k in (-1, 0, 1)]
    boxes = [block(BLACK, (0.17, 0.2, 0.3), (sx * (width / 2 - 0.12), 0, 0.6), 0.012) for sx in (-1, 1)]
    panel = (BLACK, BLACK, BLACK, screen, BLACK, BLACK)
    return [
        block(wood, (width, 0.4, 0.36), (0, 0, 0.27)),
        *legs(BLACK, width / 2 - 0.1, 0.14, 0.1, 0.02),
        *doors,
        *knobs,
        *boxes,
        block(BLACK, (0.3, 0.2, 0.02), (0, 0.02, 0.46), 0.006),
        block(BLACK, (0.06, 0.04, 0.1), (0, 0.06, 0.5)),
        block(panel, (1.0, 0.04, 0.58), (0, 0.05, 0.82)),
    ]


def plant(rng: np.random.Generator, pot: Material, tall: Scalar = 1.2, leaves: int = 26) -> Piece:
    """Return a pot with a stem and broad leaves around it."""
    green = [
        Material(Pattern.LEAF, c, seed=k)
        for k, c in enumerate((("#2f6b2f", "#4c8f3c", "#a9c77a"), ("#3d7a3a", "#27592c", "#9dbb70")))
    ]
    soil = Material(Pattern.STONE, ("#3a2a1e", "#4a3626", "#241a12"), 0.3, 0.4)
    parts = [
        frustum((pot, pot, soil), 0.14, 0.2, (0, 0, 0), 0.32, 0.01),
        cylinder(green[1], 0.016, (0, 0, 0.3), tall - 0.42),
    ]
    for k in range(leaves):
        yaw, up = 137.5 * k, 0.42 + (tall - 0.5) * (k + 0.5) / leaves
        length, tilt = rng.uniform(0.26, 0.4), rng.uniform(-45, 0)
        R = rotation(yaw, tilt)
        x, y, z = R @ np.array([length * 0.52, 0, 0]) + np.array([0, 0, up])
        leaf = block(
            green[k % 2],
            (length, 0.11, 0.012),
            (float(x), float(y), float(z)),
            0.0055,
            (yaw, tilt, rng.uniform(-25, 25)),
        )
        parts.append(leaf)
    return parts
