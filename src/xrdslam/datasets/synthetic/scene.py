"""What a synthetic room is made of: convex solids, materials, rectangular lights, the box that closes it.

A scene is plain data. `Scene.pack` turns it into flat arrays, the only thing that the kernels see, and whose bytes
identify the scene in the cache.
"""

import hashlib
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

__all__ = [
    "Light",
    "Material",
    "Pace",
    "PackedScene",
    "Pattern",
    "Scalar",
    "Scene",
    "Shape",
    "Solid",
    "Vector",
    "linear_rgb",
    "rotation",
]

Scalar = float | int
Vector = tuple[Scalar, Scalar, Scalar]


class Shape(IntEnum):
    """Convex cores; a solid is a core grown by its `radius` (a box of size 0 with a radius is a sphere)."""

    BOX = 0
    """`size` = half extents along the local axes [m]."""
    FRUSTUM = 1
    """Axis = local z; `size` = radius at the bottom, radius at the top, half height [m]. Equal radii: a cylinder."""


class Pattern(IntEnum):
    """Families of textures; `textures.py` says how each uses a material's colours and numbers."""

    PLAIN = 0
    WOOD = 1
    PLANKS = 2
    FABRIC = 3
    WALLPAPER = 4
    BRICK = 5
    RUG = 6
    PAINTING = 7
    BOOK = 8
    WINDOW = 9
    CHECKER = 10
    LEAF = 11
    SCREEN = 12
    STONE = 13
    CLOCK = 14
    CEILING = 15
    CARPET = 16
    WHITEBOARD = 17
    POSTER = 18
    PLASTER = 19


@dataclass(frozen=True)
class Material:
    """A Lambertian surface: three sRGB colours "#rrggbb", a texture, and light of its own (a factor on its colour)."""

    pattern: Pattern
    colours: tuple[str, str, str]
    scale: float = 1.0
    """Length of the pattern's main feature, in units of that pattern's natural size."""
    detail: float = 0.12
    """Relative amplitude of the fine mottling that every surface carries."""
    seed: int = 0
    emission: float = 0.0


@dataclass(frozen=True)
class Solid:
    """A convex solid at `centre` [m] (world), turned by `R_world_local`; one material, or one per chart."""

    shape: Shape
    size: Vector
    radius: float
    materials: tuple[Material, ...]
    centre: Vector = (0.0, 0.0, 0.0)
    R_world_local: Float64[np.ndarray, "3 3"] = field(default_factory=lambda: np.eye(3))

    def moved(self, R: Float64[np.ndarray, "3 3"], t: Vector) -> "Solid":
        """Return the solid after the rigid motion p -> R p + t."""
        centre = _vector(R @ np.asarray(self.centre) + np.asarray(t))
        return replace(self, centre=centre, R_world_local=R @ self.R_world_local)


@dataclass(frozen=True)
class Light:
    """A rectangle that shines from its front: spanned by two half edges [m], front along edge_u x edge_v."""

    centre: Vector
    edge_u: Vector
    edge_v: Vector
    radiance: Vector

    def moved(self, R: Float64[np.ndarray, "3 3"], t: Vector) -> "Light":
        """Return the light after the rigid motion p -> R p + t."""
        centre, u, v = (R @ np.asarray(x, dtype=np.float64) for x in (self.centre, self.edge_u, self.edge_v))
        return Light(_vector(centre + np.asarray(t)), _vector(u), _vector(v), self.radiance)


class Pace(NamedTuple):
    """How fast a camera walks through a room, on average over frames."""

    way_m: float
    turn_deg: float


class PackedScene(NamedTuple):
    """A scene as arrays. Solid 0 is the room itself: a box whose *outside* is solid."""

    shape: Int64[np.ndarray, " n"]
    size: Float64[np.ndarray, "n 4"]
    """size x, y, z and radius."""
    centre: Float64[np.ndarray, "n 3"]
    R: Float64[np.ndarray, "n 3 3"]
    material: Int64[np.ndarray, "n 6"]
    """Material of each chart."""
    pattern: Int64[np.ndarray, "m 2"]
    """Pattern and seed of each material."""
    look: Float64[np.ndarray, "m 12"]
    """Three linear rgb colours, scale, detail, emission of each material."""
    lights: Float64[np.ndarray, "k 12"]
    """Centre, half edges, radiance."""

    def digest(self) -> str:
        """Return a hash of every byte."""
        state = hashlib.blake2b(digest_size=16)
        for array in self:
            state.update(repr((array.dtype.str, array.shape)).encode())
            state.update(np.ascontiguousarray(array).tobytes())
        return state.hexdigest()


@dataclass(frozen=True)
class Scene:
    """A closed room centred on the origin of the floor, z up: `size` [m] inside, solids, lights."""

    name: str
    size: Vector
    shell: tuple[Material, ...]
    """Materials of the room at x+, x-, y+, y-, ceiling, floor."""
    solids: tuple[Solid, ...]
    lights: tuple[Light, ...]
    pace: Pace = field(default_factory=lambda: Pace(0.0115, 0.5))

    @property
    def bounds(self) -> Float64[np.ndarray, "2 3"]:
        """Return the room's corners (min, max) [m]."""
        x, y, z = self.size
        return np.array([[-x / 2, -y / 2, 0.0], [x / 2, y / 2, z]])

    def pack(self) -> PackedScene:
        """Flatten to arrays; equal materials are stored once."""
        x, y, z = self.size
        room = Solid(Shape.BOX, (x / 2, y / 2, z / 2), 0.0, self.shell, (0.0, 0.0, z / 2))
        solids = (room, *self.solids)
        table: dict[Material, int] = {}
        charts = [[table.setdefault(m, len(table)) for m in _six(solid.materials)] for solid in solids]
        return PackedScene(
            shape=np.array([int(s.shape) for s in solids], dtype=np.int64),
            size=np.array([(*s.size, s.radius) for s in solids], dtype=np.float64),
            centre=np.array([s.centre for s in solids], dtype=np.float64),
            R=np.array([s.R_world_local for s in solids], dtype=np.float64),
            material=np.array(charts, dtype=np.int64),
            pattern=np.array([(int(m.pattern), m.seed) for m in table], dtype=np.int64).reshape(-1, 2),
            look=np.array([_look(m) for m in table], dtype=np.float64).reshape(-1, 12),
            lights=np.array(
                [(*k.centre, *k.edge_u, *k.edge_v, *k.radiance) for k in self.lights], dtype=np.float64
            ).reshape(-1, 12),
        )


def linear_rgb(colour: str) -> Vector:
    """Return the linear rgb of an sRGB colour "#rrggbb" (IEC 61966-2-1)."""
    c = np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])
    r, g, b = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return float(r), float(g), float(b)


def rotation(yaw_deg: Scalar = 0.0, pitch_deg: Scalar = 0.0, roll_deg: Scalar = 0.0) -> Float64[np.ndarray, "3 3"]:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll)."""
    (cy, cp, cr), (sy, sp, sr) = (f(np.radians([yaw_deg, pitch_deg, roll_deg])) for f in (np.cos, np.sin))
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1.0]])
    y = np.array([[cp, 0, sp], [0, 1.0, 0], [-sp, 0, cp]])
    x = np.array([[1.0, 0, 0], [0, cr, -sr], [0, sr, cr]])
    R: Float64[np.ndarray, "3 3"] = z @ y @ x
    return R


def _vector(array: Float64[np.ndarray, "3"]) -> Vector:
    x, y, z = array
    return float(x), float(y), float(z)


def _six(materials: tuple[Material, ...]) -> tuple[Material, ...]:
    return (materials * 6)[:6] if len(materials) in (1, 3) else materials


def _look(m: Material) -> tuple[float, ...]:
    colours = [channel for colour in m.colours for channel in linear_rgb(colour)]
    return (*colours, m.scale, m.detail, m.emission)
