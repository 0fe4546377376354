"""Furniture of offices: swivel chairs, desks with screens, long tables, partitions, cabinets, machines."""

import math

import numpy as np

from xrdslam.datasets.synthetic.furniture import (
    BLACK,
    PAPER,
    Piece,
    block,
    books,
    cylinder,
    frustum,
    legs,
    place,
    sphere,
)
from xrdslam.datasets.synthetic.scene import Material, Pattern, Scalar

__all__ = [
    "METAL",
    "bin_basket",
    "boxes",
    "cabinet",
    "coat_stand",
    "copier",
    "filing",
    "long_table",
    "monitor",
    "partition",
    "row_chair",
    "screen_wall",
    "stand_desk",
    "swivel_chair",
    "water_cooler",
    "workplace",
]

METAL = Material(Pattern.PLAIN, ("#8e9196", "#a9acb0", "#8e9196"), 0.4, 0.2)
KEYS = Material(Pattern.CHECKER, ("#3a3a40", "#4a4a52", "#17171a"), 0.1)


def swivel_chair(cloth: Material) -> Piece:
    """Return an office chair on a star of five castors; one sits on it looking along -y."""
    parts = [cylinder(METAL, 0.03, (0, 0, 0.1), 0.34), frustum(BLACK, 0.06, 0.04, (0, 0, 0.06), 0.08, 0.01)]
    for k in range(5):
        arm = [block(BLACK, (0.3, 0.045, 0.035), (0.16, 0, 0.09), 0.015), sphere(BLACK, 0.032, (0.29, 0, 0.033))]
        parts += place(arm, 0, 0, 72.0 * k + 18)
    return [
        *parts,
        block(cloth, (0.5, 0.48, 0.09), (0, 0, 0.47), 0.042),
        block(cloth, (0.46, 0.08, 0.56), (0, 0.25, 0.84), 0.038, (0, 0, -8)),
        block(BLACK, (0.06, 0.03, 0.42), (0, 0.27, 0.6), 0.012, (0, 0, -8)),
        *(block(BLACK, (0.05, 0.26, 0.03), (s * 0.28, 0.02, 0.68), 0.014) for s in (-1, 1)),
        *(block(BLACK, (0.03, 0.04, 0.22), (s * 0.28, 0.08, 0.57), 0.012) for s in (-1, 1)),
    ]


def row_chair(shell: Material) -> Piece:
    """Return a stacking chair: a moulded seat and back on thin legs."""
    return [
        *legs(METAL, 0.2, 0.19, 0.44, 0.016),
        block(shell, (0.44, 0.42, 0.035), (0, 0, 0.455), 0.017),
        block(shell, (0.42, 0.03, 0.34), (0, 0.23, 0.68), 0.014, (0, 0, -12)),
        *(block(METAL, (0.02, 0.02, 0.3), (s * 0.17, 0.22, 0.55), 0.009, (0, 0, -10)) for s in (-1, 1)),
    ]


def monitor(screen: Material, width: Scalar = 0.58) -> Piece:
    """Return a monitor on its foot, standing on the origin."""
    face = (BLACK, BLACK, BLACK, screen, BLACK, BLACK)
    return [
        frustum(BLACK, 0.13, 0.12, (0, 0.03, 0), 0.015, 0.005),
        block(BLACK, (0.05, 0.03, 0.22), (0, 0.05, 0.11)),
        block(face, (width, 0.03, 0.6 * width), (0, 0.02, 0.12 + 0.3 * width)),
    ]


def stand_desk(wood: Material, width: Scalar = 1.5, depth: Scalar = 0.75) -> Piece:
    """Return a desk on two T-shaped metal legs, with a modesty panel."""
    top = [block(wood, (width, depth, 0.03), (0, 0, 0.735), 0.008)]
    for s in (-1, 1):
        x = s * (width / 2 - 0.14)
        top += [
            block(METAL, (0.08, 0.05, 0.66), (x, 0.05, 0.39)),
            block(METAL, (0.07, depth - 0.1, 0.03), (x, 0, 0.04), 0.012),
        ]
    return [*top, block(wood, (width - 0.3, 0.018, 0.3), (0, depth / 2 - 0.06, 0.55))]


def workplace(rng: np.random.Generator, wood: Material, width: Scalar = 1.5, screens: int = 2) -> Piece:
    """Return a desk with screens, keyboard, mouse, papers, a mug of pencils and a row of books on it."""

    def seed() -> int:
        return int(rng.integers(1 << 16))

    parts, z = stand_desk(wood, width), 0.75
    for k in range(screens):
        s = k - (screens - 1) / 2
        tones = (
            ("#9fd0e8", "#3f78a8", "#2f6040"),
            ("#e8c08a", "#7a4a6a", "#3a2f4a"),
            ("#d8dde2", "#5a7a9a", "#2a3a4a"),
        )
        parts += place(
            monitor(Material(Pattern.SCREEN, tones[int(rng.integers(3))], seed=seed())), 0.6 * s, 0.12, -14 * s, z
        )
    mug = Material(
        Pattern.STONE, (str(rng.choice(("#27496d", "#a8432f", "#3f6f4a"))), "#d8d2c4", "#1f1f24"), 0.2, seed=seed()
    )
    ink = [Material(Pattern.PLAIN, (c, c, c)) for c in ("#c9a227", "#b02020", "#2040a0")]
    print_ = Material(Pattern.POSTER, ("#f2f0ea", "#2f5f8f", "#b5562d"), seed=seed())
    parts += [
        block(KEYS, (0.43, 0.14, 0.02), (0, -0.18, z + 0.011), 0.004),
        block(BLACK, (0.06, 0.1, 0.03), (0.3, -0.18, z + 0.015), 0.012),
        *(
            block(
                (PAPER,) * 4 + (print_, PAPER),
                (0.21, 0.297, 0.004),
                (-0.42 + 0.03 * k, -0.16, z + 0.002 + 0.004 * k),
                0.0,
                (12.0 * k - 18, 0, 0),
            )
            for k in range(3)
        ),
        cylinder(mug, 0.042, (0.56, 0.14, z), 0.1),
        *(cylinder(m, 0.005, (0.55 + 0.015 * k, 0.13 + 0.012 * k, z + 0.02), 0.15) for k, m in enumerate(ink)),
        *books(rng, 0.2, (-width / 2 + 0.06, 0.2, z), 0.27),
    ]
    return parts


def long_table(wood: Material, length: Scalar = 2.8, width: Scalar = 1.1) -> Piece:
    """Return a conference table along x with round ends on two drums."""
    half = length / 2 - width / 2
    return [
        block(wood, (2 * half, width, 0.04), (0, 0, 0.73)),
        *(frustum(wood, width / 2, width / 2, (s * half, 0, 0.71), 0.04) for s in (-1, 1)),
        *(frustum(METAL, 0.28, 0.24, (s * half * 0.8, 0, 0), 0.71, 0.02) for s in (-1, 1)),
        block(BLACK, (0.5, 0.14, 0.012), (0, 0, 0.755), 0.005),
        *(frustum(BLACK, 0.09, 0.05, (s * 0.7, 0, 0.75), 0.04, 0.012) for s in (-1, 1)),
    ]


def partition(cloth: Material, frame: Material, width: Scalar, height: Scalar = 1.25) -> Piece:
    """Return a padded screen on two feet, its middle plane y = 0."""
    return [
        block(cloth, (width - 0.04, 0.05, height - 0.16), (0, 0, height / 2 + 0.05), 0.012),
        *(block(frame, (0.03, 0.06, height), (s * (width / 2 - 0.015), 0, height / 2), 0.012) for s in (-1, 1)),
        block(frame, (width, 0.065, 0.035), (0, 0, height), 0.015),
        *(block(frame, (0.06, 0.4, 0.03), (s * (width / 2 - 0.1), 0, 0.015), 0.012) for s in (-1, 1)),
    ]


def filing(paint: Material, rows: int = 4) -> Piece:
    """Return a filing cabinet with labelled drawers."""
    parts, tall = [block(paint, (0.46, 0.6, 0.32 * rows + 0.04), (0, 0, 0.16 * rows + 0.02), 0.01)], 0.32
    label = Material(Pattern.BOOK, ("#efeadc", "#c8bfa8", "#2a2a2a"))
    for k in range(rows):
        z = 0.02 + tall * (k + 0.5)
        parts += [
            block(paint, (0.43, 0.016, tall - 0.02), (0, -0.307, z), 0.005),
            block(METAL, (0.14, 0.03, 0.016), (0, -0.325, z + 0.03), 0.007),
            block(label, (0.1, 0.004, 0.045), (0, -0.317, z + 0.09)),
        ]
    return parts


def cabinet(rng: np.random.Generator, wood: Material, width: Scalar = 1.2, levels: int = 5) -> Piece:
    """Return an open cabinet of ring binders."""
    height = 0.38 * levels + 0.03
    parts = [block(wood, (0.025, 0.36, height), (s * (width / 2 - 0.0125), 0, height / 2)) for s in (-1, 1)]
    parts += [block(wood, (width, 0.015, height), (0, 0.17, height / 2))]
    parts += [block(wood, (width - 0.04, 0.35, 0.025), (0, 0, 0.0125 + 0.38 * k)) for k in range(levels + 1)]
    tints = ("#2f5f8f", "#a8432f", "#3f6f4a", "#d0a030", "#4a4a52", "#d8d2c4")
    for k in range(levels):
        x, end = -width / 2 + 0.04, width / 2 - 0.04 - float(rng.uniform(0, 0.4)) * width
        while x + 0.075 < end:
            tint = str(rng.choice(tints))
            spine = Material(Pattern.BOOK, (tint, "#efeadc", "#1f1f24"), seed=int(rng.integers(1 << 16)))
            wide = float(rng.choice((0.05, 0.075)))
            parts.append(block(spine, (wide - 0.003, 0.28, 0.31), (x + wide / 2, 0.0, 0.38 * k + 0.18), 0.004))
            x += wide
    return parts


def bin_basket(tint: Material) -> Piece:
    """Return a waste-paper basket with crumpled paper."""
    balls = [
        sphere(PAPER, 0.05, (0.06 * math.cos(2.4 * k), 0.06 * math.sin(2.4 * k), 0.3 + 0.02 * k)) for k in range(3)
    ]
    return [frustum(tint, 0.12, 0.16, (0, 0, 0), 0.32, 0.005), *balls]


def coat_stand(wood: Material, coat: Material) -> Piece:
    """Return a stand with a coat and a hat on it."""
    arms = [
        block(wood, (0.2, 0.02, 0.02), (0.09 * math.cos(a), 0.09 * math.sin(a), 1.66), 0.009, (math.degrees(a), -25, 0))
        for a in (0.3, 1.87, 3.44, 5.01)
    ]
    return [
        frustum(wood, 0.22, 0.05, (0, 0, 0), 0.06, 0.012),
        cylinder(wood, 0.022, (0, 0, 0.05), 1.68),
        *arms,
        frustum(coat, 0.24, 0.1, (0.12, 0, 0.62), 0.95, 0.06),
        frustum(BLACK, 0.17, 0.16, (-0.1, 0.02, 1.7), 0.02, 0.008),
        frustum(BLACK, 0.1, 0.085, (-0.1, 0.02, 1.71), 0.12, 0.02),
    ]


def water_cooler(blue: Material) -> Piece:
    """Return a dispenser with a bottle on top."""
    white = Material(Pattern.PLAIN, ("#dcdcd8", "#cacac6", "#dcdcd8"), 0.5)
    return [
        block(white, (0.3, 0.32, 1.0), (0, 0, 0.5), 0.03),
        block(BLACK, (0.22, 0.03, 0.2), (0, -0.16, 0.75), 0.008),
        frustum(blue, 0.05, 0.135, (0, 0, 1.0), 0.08, 0.01),
        frustum(blue, 0.135, 0.135, (0, 0, 1.07), 0.34, 0.03),
    ]


def copier(paint: Material) -> Piece:
    """Return a photocopier with trays and a lid."""
    dark = Material(Pattern.PLAIN, ("#4a4c52", "#5c5f66", "#4a4c52"), 0.4)
    return [
        block(paint, (0.62, 0.6, 0.86), (0, 0, 0.47), 0.02),
        *(block(dark, (0.56, 0.02, 0.16), (0, -0.305, 0.16 + 0.18 * k), 0.006) for k in range(3)),
        block(dark, (0.64, 0.6, 0.09), (0, 0, 0.95), 0.02),
        block(paint, (0.6, 0.5, 0.06), (0, 0.03, 1.03), 0.02),
        block(paint, (0.3, 0.36, 0.02), (0.44, 0, 0.8), 0.008, (0, -14, 0)),
        block(
            Material(Pattern.SCREEN, ("#a0d8e8", "#3070a0", "#204060")),
            (0.2, 0.1, 0.012),
            (-0.15, -0.27, 1.01),
            0.0,
            (0, 0, 25),
        ),
    ]


def boxes(rng: np.random.Generator, count: int = 5) -> Piece:
    """Return cardboard boxes of several sizes piled up, each with a printed label."""
    parts, z = Piece(), 0.0
    for k in range(count):
        card = Material(Pattern.FABRIC, ("#b08a5a", "#a67f50", "#8a6a40"), 0.25, seed=int(rng.integers(1 << 16)))
        label = Material(Pattern.POSTER, ("#efeadc", "#a8432f", "#1f1f24"), seed=int(rng.integers(1 << 16)))
        x, y, h = (float(v) for v in rng.uniform((0.34, 0.3, 0.2), (0.56, 0.44, 0.36)))
        turn = float(rng.uniform(-14, 14))
        box = [
            block(card, (x, y, h), (0, 0, h / 2), 0.006),
            block(label, (0.2, 0.004, 0.13), (0.04, -y / 2 - 0.002, h / 2)),
            block(card, (x + 0.002, 0.06, 0.004), (0, 0, h)),
        ]
        parts += place(box, 0.03 * (k % 2), 0, turn, z)
        z += h
    return parts


def screen_wall(picture: Material, width: Scalar = 2.2) -> Piece:
    """Return a projection screen in its case, let down around the origin."""
    return [
        block(picture, (width, 0.012, 0.6 * width), (0, -0.06, 0)),
        block(METAL, (width + 0.16, 0.1, 0.1), (0, -0.06, 0.3 * width + 0.05), 0.04),
        block(BLACK, (width + 0.04, 0.03, 0.03), (0, -0.06, -0.3 * width - 0.015), 0.013),
    ]
