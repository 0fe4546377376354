"""What is fixed to a room's walls: doors, windows with curtains or blinds, radiators, boards, clocks.

Pieces as in `furniture`: the back in the plane y = 0, facing -y.
"""

from xrdslam.datasets.synthetic.furniture import BLACK, BRASS, Piece, block, frustum, sphere
from xrdslam.datasets.synthetic.scene import Light, Material, Pattern, Scalar, Vector

__all__ = ["blind", "board", "clock", "curtains", "daylight", "door", "pipes", "radiator", "window"]


def door(wood: Material) -> Piece:
    """Return a door of 0.85 x 2.05 m with its frame."""
    panels = [
        block(wood, (0.3, 0.012, h), (x, -0.03, z), 0.004)
        for x in (-0.19, 0.19)
        for z, h in ((0.55, 0.75), (1.45, 0.8))
    ]
    posts = [block(wood, (0.08, 0.05, 2.1), (sx * 0.465, -0.025, 1.05)) for sx in (-1, 1)]
    return [
        block(wood, (0.85, 0.03, 2.03), (0, -0.015, 1.015)),
        *panels,
        *posts,
        block(wood, (1.01, 0.05, 0.08), (0, -0.025, 2.09)),
        sphere(BRASS, 0.03, (0.35, -0.06, 1.0)),
    ]


def window(view: Material, frame: Material, width: Scalar = 1.5, height: Scalar = 1.22) -> Piece:
    """Return a window around the origin: the view behind its bars, and a sill."""
    w, h = width / 2, height / 2
    bars = [block(frame, (x, 0.05, z), (cx, -0.035, cz), 0.006) for cx, cz, x, z in (
        (-w - 0.01, 0, 0.07, height + 0.08), (w + 0.01, 0, 0.07, height + 0.08), (0, 0, 0.05, height),
        (0, h + 0.01, width + 0.06, 0.07), (0, -h - 0.01, width + 0.06, 0.07), (0, 0.25 * h, width - 0.04, 0.035),
    )]  # fmt: skip
    sill = block(frame, (width + 0.25, 0.2, 0.035), (0, -0.1, -h - 0.07), 0.008)
    return [block(view, (width, 0.02, height), (0, -0.01, 0)), *bars, sill]


def daylight(radiance: Vector, width: Scalar = 1.5, height: Scalar = 1.22) -> Light:
    """Return the light that falls in through a window around the origin."""
    return Light((0.0, -0.1, 0.0), (0.48 * width, 0.0, 0.0), (0.0, 0.0, 0.48 * height), radiance)


def curtains(cloth: Material, width: Scalar = 1.5, height: Scalar = 1.9, low: Scalar = -1.07) -> Piece:
    """Return a rail with two bundles of four round folds, for a window around the origin."""
    folds = [
        block(
            cloth,
            (0.09, 0.09, height),
            (sx * (width / 2 + 0.11 + 0.075 * k), -0.09 - 0.02 * (k % 2), low + height / 2),
            0.044,
        )
        for sx in (-1, 1)
        for k in range(4)
    ]
    return [*folds, block(BRASS, (width + 1.0, 0.03, 0.03), (0, -0.1, low + height + 0.03), 0.0145)]


def blind(slat: Material, width: Scalar = 1.5, height: Scalar = 0.7, top: Scalar = 0.66) -> Piece:
    """Return a blind of tilted slats, let down `height` from `top`."""
    count = int(height / 0.06)
    slats = [
        block(slat, (width, 0.052, 0.004), (0, -0.1, top - 0.05 - 0.06 * k), 0.0, (0, 0, 28)) for k in range(count)
    ]
    return [block(slat, (width + 0.04, 0.06, 0.05), (0, -0.1, top), 0.01), *slats]


def radiator(paint: Material, width: Scalar = 1.06, height: Scalar = 0.55) -> Piece:
    """Return a ribbed radiator standing 15 cm off the floor."""
    count = int(width / 0.1)
    return [
        block(paint, (0.06, 0.08, height), ((k - (count - 1) / 2) * 0.1, -0.09, 0.15 + height / 2), 0.02)
        for k in range(count)
    ]


def board(face: Material, frame: Material, width: Scalar, height: Scalar) -> Piece:
    """Return a board around the origin with a ledge, pens and a sponge on it."""
    pens = [Material(Pattern.PLAIN, (c, c, c)) for c in ("#b02020", "#2040a0", "#208040")]
    ledge = -height / 2 - 0.03
    return [
        block(face, (width, 0.02, height), (0, -0.01, 0)),
        *(block(frame, (width + 0.06, 0.03, 0.03), (0, -0.015, s * (height + 0.03) / 2), 0.006) for s in (-1, 1)),
        *(block(frame, (0.03, 0.03, height), (s * (width + 0.03) / 2, -0.015, 0), 0.006) for s in (-1, 1)),
        block(frame, (0.7 * width, 0.09, 0.015), (0, -0.045, ledge), 0.004),
        *(block(m, (0.13, 0.018, 0.018), (-0.2 + 0.2 * k, -0.06, ledge + 0.017), 0.008) for k, m in enumerate(pens)),
        block(BLACK, (0.12, 0.05, 0.04), (0.25 * width, -0.05, ledge + 0.027), 0.01),
    ]


def clock(radius: Scalar = 0.16) -> Piece:
    """Return a round clock around the origin."""
    dial = Material(Pattern.CLOCK, ("#f0ece0", "#2a2420", "#1a1a1a"))
    disc = frustum((BLACK, BLACK, dial), radius, radius, (0, -0.025, -0.02), 0.04, 0.0, (0, 0, 90))
    return [disc]


def pipes(metal: Material, width: Scalar, count: int = 2) -> Piece:
    """Return round pipes along a wall with brackets, stacked upwards from the origin."""
    tubes = [block(metal, (width, 0.06, 0.06), (0, -0.09, 0.1 * k), 0.0299) for k in range(count)]
    holds = [
        block(BLACK, (0.03, 0.13, 0.1 * count), (x * width / 2, -0.065, 0.05 * (count - 1)), 0.004)
        for x in (-0.8, 0, 0.8)
    ]
    return [*tubes, *holds]
