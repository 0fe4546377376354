"""A room while it is being furnished: pieces are put on the floor or hung on a wall, lamps bring their light."""

from collections.abc import Iterable

import numpy as np

from xrdslam.datasets.synthetic.furniture import block, place
from xrdslam.datasets.synthetic.scene import Light, Material, Pace, Pattern, Scalar, Scene, Solid, Vector, rotation

__all__ = ["Site"]

WALLS = {"north": 0.0, "south": 180.0, "east": -90.0, "west": 90.0}
"""y+, y-, x+, x-: the yaw [deg] of a piece that has its back to the wall."""
FINE = (Pattern.STONE, Pattern.PLASTER, Pattern.CARPET, Pattern.CEILING)


class Site:
    """An empty room of inner `size` [m] and the generator that its builder draws from."""

    def __init__(self, name: str, size: Vector, rng: np.random.Generator) -> None:
        self.name, self.size, self.rng = name, size, rng
        self.solids: list[Solid] = []
        self.lights: list[Light] = []

    def material(
        self, pattern: Pattern, colours: tuple[str, str, str], scale: float = 1.0, detail: float | None = None
    ) -> Material:
        """Return a material with a seed of its own; patterns that are fine all over get no mottling by themselves."""
        if detail is None:
            detail = 0.0 if pattern in FINE else 0.12
        return Material(pattern, colours, scale, detail, int(self.rng.integers(1 << 16)))

    def view(self, colours: tuple[str, str, str]) -> Material:
        """Return what is seen through a window, a little brighter than the room: sky above and below, trees."""
        return Material(Pattern.WINDOW, colours, 1.0, 0.0, int(self.rng.integers(1 << 16)), emission=0.7)

    def art(self, colours: tuple[str, str, str], manner: int) -> Material:
        """Return a painting: 0 a landscape, 1 fields, 2 circles, 3 marbled paint."""
        return Material(Pattern.PAINTING, colours, 1.0, 0.03, 4 * int(self.rng.integers(1 << 12)) + manner)

    def put(self, piece: Iterable[Solid], x: Scalar, y: Scalar, yaw_deg: Scalar = 0.0, z: Scalar = 0.0) -> None:
        """Stand a piece at (x, y), turned about the vertical."""
        self.solids += place(piece, x, y, yaw_deg, z)

    def put_about(self, piece: Iterable[Solid], x: Scalar, y: Scalar, yaw_deg: Scalar = 0.0, z: Scalar = 0.0) -> None:
        """Stand a piece where somebody has left it: within 4 cm and 8 degrees of the place, by the seed."""
        dx, dy, turn = self.rng.uniform(-1, 1, 3)
        self.put(piece, x + 0.04 * dx, y + 0.04 * dy, yaw_deg + 8.0 * turn, z)

    def on_wall(self, piece: Iterable[Solid], wall: str, along: Scalar, z: Scalar = 0.0, off: Scalar = 0.0) -> None:
        """Put a piece's back to a wall, `along` metres from its middle towards x+ or y+, `off` metres away from it."""
        self.solids += place(piece, *self._spot(wall, along, off), WALLS[wall], z)

    def shine(self, light: Light, wall: str, along: Scalar, z: Scalar) -> None:
        """Put a light that shines along -y in its own frame on a wall."""
        self.lights.append(light.moved(rotation(WALLS[wall]), (*self._spot(wall, along, 0.0), z)))

    def ceiling_panel(self, x: Scalar, y: Scalar, half: tuple[Scalar, Scalar], radiance: Vector) -> None:
        """Hang a glowing panel of half extents `half` [m] under the ceiling."""
        top, (a, b) = self.size[2], half
        glow = Material(Pattern.PLAIN, ("#ffffff", "#fff8ee", "#ffffff"), emission=1.6)
        self.solids.append(block(glow, (2 * a, 2 * b, 0.04), (x, y, top - 0.02)))
        self.lights.append(Light((x, y, top - 0.045), (a, 0.0, 0.0), (0.0, -b, 0.0), radiance))

    def bulb(self, x: Scalar, y: Scalar, low: Scalar, high: Scalar, radiance: Vector, half: Scalar = 0.12) -> None:
        """Shine up from `high` and down from `low`: what leaves an open lamp shade."""
        r, g, b = radiance
        self.lights.append(Light((x, y, high), (half, 0.0, 0.0), (0.0, half, 0.0), (r, g, b)))
        self.lights.append(Light((x, y, low), (half, 0.0, 0.0), (0.0, -half, 0.0), (0.6 * r, 0.6 * g, 0.6 * b)))

    def skirting(self, material: Material, height: Scalar = 0.1) -> None:
        """Run a skirting board around the floor."""
        x, y, _ = self.size
        self.solids += [block(material, (x, 0.018, height), (0, s * (y / 2 - 0.009), height / 2)) for s in (-1, 1)]
        self.solids += [block(material, (0.018, y, height), (s * (x / 2 - 0.009), 0, height / 2)) for s in (-1, 1)]

    def scene(self, shell: tuple[Material, ...], pace: Pace) -> Scene:
        """Return the finished room; `shell` is its materials at x+, x-, y+, y-, ceiling, floor."""
        return Scene(self.name, self.size, shell, tuple(self.solids), tuple(self.lights), pace)

    def _spot(self, wall: str, along: Scalar, off: Scalar) -> tuple[Scalar, Scalar]:
        x, y = self.size[0] / 2 - off, self.size[1] / 2 - off
        return {"north": (along, y), "south": (along, -y), "east": (x, along), "west": (-x, along)}[wall]
