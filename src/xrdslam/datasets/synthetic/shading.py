"""Light that leaves a surface point: texture times stored irradiance (numba device functions).

Every surface is Lambertian, so a point has one colour from wherever it is seen.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int64, UInt8

from xrdslam.datasets.synthetic.bvh import Bvh
from xrdslam.datasets.synthetic.charts import chart_half, chart_of, chart_plane
from xrdslam.datasets.synthetic.compiled import compiled, inlined
from xrdslam.datasets.synthetic.scene import PackedScene
from xrdslam.datasets.synthetic.solids import core_gradient
from xrdslam.datasets.synthetic.textures import albedo

__all__ = ["Lightmap", "World", "display_linear", "radiance", "srgb_byte", "srgb_codes", "surface_frame"]


class Lightmap(NamedTuple):
    """Irradiance on a grid per chart: chart c of solid i has rows[i, c] x columns[i, c] samples from start[i, c] on."""

    start: Int64[np.ndarray, "n 6"]
    columns: Int64[np.ndarray, "n 6"]
    rows: Int64[np.ndarray, "n 6"]
    irradiance: Float32[np.ndarray, "t 3"]
    exposure: float
    """Display value per radiance."""


class World(NamedTuple):
    """All that a kernel needs to answer what a ray sees."""

    scene: PackedScene
    bvh: Bvh
    light: Lightmap


@inlined
def to_local(scene: PackedScene, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a world point in the frame of solid i."""
    R, c = scene.R[i], scene.centre[i]
    x, y, z = x - c[0], y - c[1], z - c[2]
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@inlined
def turn(R: np.ndarray, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return R (x, y, z)."""
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@inlined
def surface_frame(
    scene: PackedScene, i: int, x: float, y: float, z: float
) -> tuple[int, float, float, float, float, float, float]:
    """Return chart, local point and world normal (towards free space) of a surface point of solid i."""
    s = scene.size[i]
    px, py, pz = to_local(scene, i, x, y, z)
    _, gx, gy, gz = core_gradient(scene.shape[i], px, py, pz, s[0], s[1], s[2])
    chart = chart_of(scene.shape[i], gx, gy, gz)
    nx, ny, nz = turn(scene.R[i], gx, gy, gz)
    if i == 0:  # the room is seen from inside
        return chart, px, py, pz, -nx, -ny, -nz
    return chart, px, py, pz, nx, ny, nz


@inlined
def irradiance_at(light: Lightmap, i: int, chart: int, fu: float, fv: float) -> tuple[float, float, float]:
    """Return the stored irradiance at (fu, fv) in [0, 1] of a chart, bilinear."""
    columns, rows = light.columns[i, chart], light.rows[i, chart]
    a, b = min(max(fu, 0.0), 1.0) * (columns - 1), min(max(fv, 0.0), 1.0) * (rows - 1)
    column, row = min(int(a), columns - 2), min(int(b), rows - 2)
    a, b = a - column, b - row
    k = light.start[i, chart] + row * columns + column
    e = light.irradiance
    w00, w01, w10, w11 = (1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b
    return (
        w00 * e[k, 0] + w01 * e[k + 1, 0] + w10 * e[k + columns, 0] + w11 * e[k + columns + 1, 0],
        w00 * e[k, 1] + w01 * e[k + 1, 1] + w10 * e[k + columns, 1] + w11 * e[k + columns + 1, 1],
        w00 * e[k, 2] + w01 * e[k + 1, 2] + w10 * e[k + columns, 2] + w11 * e[k + columns + 1, 2],
    )


@inlined
def radiance(
    world: World, i: int, chart: int, px: float, py: float, pz: float, w: float, has_glow: bool
) -> tuple[float, float, float]:
    """Return the linear radiance of solid i at a local point for a pixel `w` [m] wide; glow is its own light."""
    scene = world.scene
    shape, s, m = scene.shape[i], scene.size[i], scene.material[i, chart]
    u, v = chart_plane(shape, chart, s, px, py, pz)
    hu, hv = chart_half(shape, chart, s)
    r, g, b = albedo(scene.pattern, scene.look, m, u, v, hu, hv, px, py, pz, w)
    er, eg, eb = irradiance_at(world.light, i, chart, 0.5 + 0.5 * u / hu, 0.5 + 0.5 * v / hv)
    glow = scene.look[m, 11] if has_glow else 0.0
    return r * (er / math.pi + glow), g * (eg / math.pi + glow), b * (eb / math.pi + glow)


@compiled
def display_linear(value: float, exposure: float) -> float:
    """Return exposed radiance with a soft shoulder, in [0, 1)."""
    return 1.0 - math.exp(-value * exposure)


@compiled
def srgb_byte(value: float) -> int:
    """Return the sRGB code of a linear value in [0, 1] (IEC 61966-2-1)."""
    c = 12.92 * value if value <= 0.0031308 else 1.055 * value ** (1.0 / 2.4) - 0.055
    return int(min(max(c, 0.0), 1.0) * 255.0 + 0.5)


def srgb_codes(steps: int = 1 << 14) -> UInt8[np.ndarray, " n"]:
    """Return the codes of `steps` linear values in [0, 1): a table right to a fifth of a code."""
    value = (np.arange(steps) + 0.5) / steps
    code = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1.0 / 2.4) - 0.055)
    return np.floor(code * 255.0 + 0.5).astype(np.uint8)
