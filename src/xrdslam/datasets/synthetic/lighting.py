"""Baking: irradiance of every chart from the lights with soft shadows, and from all other surfaces in two bounces.

Sample positions depend on nothing but the surface point, so that light is part of the scene and not of a view.
Samples that lie inside another solid are never seen; they take the mean of their neighbours so that interpolation does
not drag their darkness into sight.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64

from xrdslam.datasets.synthetic.bvh import STACK, Bvh, blocker, build_bvh, first_hit
from xrdslam.datasets.synthetic.charts import chart_half, chart_point
from xrdslam.datasets.synthetic.compiled import compiled
from xrdslam.datasets.synthetic.distance import solid_distance
from xrdslam.datasets.synthetic.rows import over_rows
from xrdslam.datasets.synthetic.scene import PackedScene
from xrdslam.datasets.synthetic.shading import Lightmap, World, radiance, surface_frame, turn

__all__ = ["LightingConfig", "bake", "light_up"]

LIFT = 2e-3
"""How far off the surface [m] light is gathered."""


@dataclass
class LightingConfig:
    """How finely light is stored and sampled."""

    spacing: float = 0.06
    """Distance between samples [m]."""
    light_samples: int = 4
    """Samples along each side of a rectangular light."""
    gather_rays: int = 72
    """Directions in which every sample looks for light from other surfaces, in the last bounce; before, a quarter."""
    bounces: int = 2
    exposure: float = 0.62
    """Exposed radiance of a white surface in the mean light of the room."""


def bake(scene: PackedScene, config: LightingConfig) -> Lightmap:
    """Return the lightmap of a scene: the same bits for any number of threads."""
    bvh = build_bvh(scene)
    start, columns, rows, owner = layout(scene, config.spacing)
    count = len(owner)
    position, normal, is_open = np.empty((count, 3)), np.empty((count, 3)), np.empty(count, np.bool_)
    over_rows(sample_points, count, scene, columns, rows, owner, position, normal, is_open)
    direct = np.zeros((count, 3), np.float32)
    over_rows(gather_direct, count, scene, bvh, position, normal, is_open, config.light_samples, direct)
    fill(direct, is_open, start, columns, rows)
    light = Lightmap(start, columns, rows, direct, 1.0)
    for left in reversed(range(config.bounces)):
        directions = cosine_directions(max(config.gather_rays // (4 if left else 1), 1))
        indirect = np.zeros((count, 3), np.float32)
        over_rows(gather_bounce, count, World(scene, bvh, light), position, normal, is_open, directions, indirect)
        fill(indirect, is_open, start, columns, rows)
        light = light._replace(irradiance=direct + indirect)
    mean = float(light.irradiance[is_open].mean(dtype=np.float64))
    return light._replace(exposure=config.exposure * math.pi / max(mean, 1e-9))


def light_up(scene: PackedScene, light: Lightmap) -> World:
    """Put a scene and its light together."""
    return World(scene, build_bvh(scene), light)


Grid = Int64[np.ndarray, "n 6"]


def layout(scene: PackedScene, spacing: float) -> tuple[Grid, Grid, Grid, Int64[np.ndarray, "t 4"]]:
    """Give every chart a grid; return start, columns, rows, and (solid, chart, row, column) of every sample."""
    count = len(scene.shape)
    start, columns, rows = (np.zeros((count, 6), dtype=np.int64) for _ in range(3))
    owners, total = [], 0
    for i in range(count):
        for chart in range(6 if scene.shape[i] == 0 else 3):
            hu, hv = chart_half(int(scene.shape[i]), chart, scene.size[i])
            nu, nv = (max(3, math.ceil(2 * h / spacing) + 1) for h in (hu, hv))
            start[i, chart], columns[i, chart], rows[i, chart] = total, nu, nv
            row, column = np.divmod(np.arange(nu * nv), nu)
            owners.append(np.stack((np.full_like(row, i), np.full_like(row, chart), row, column), 1))
            total += nu * nv
    return start, columns, rows, np.concatenate(owners)


@compiled
def sample_points(
    begin: int, end: int, scene: PackedScene, columns: np.ndarray, rows: np.ndarray, owner: np.ndarray,
    position: np.ndarray, normal: np.ndarray, is_open: np.ndarray,
) -> None:  # fmt: skip
    """Find every sample's world position (lifted off the surface), its normal, and whether it lies in free space."""
    for t in range(begin, end):
        i, chart, row, column = owner[t]
        hu, hv = chart_half(scene.shape[i], chart, scene.size[i])
        inset = min(0.012, 0.2 * min(hu, hv))  # off the edge, so that an abutting wall does not hide the sample
        u = (2.0 * column / (columns[i, chart] - 1) - 1.0) * (hu - inset)
        v = (2.0 * row / (rows[i, chart] - 1) - 1.0) * (hv - inset)
        x, y, z, nx, ny, nz = chart_point(scene.shape[i], chart, scene.size[i], u, v)
        x, y, z = turn(scene.R[i], x, y, z)
        nx, ny, nz = turn(scene.R[i], nx, ny, nz)
        sign = -1.0 if i == 0 else 1.0
        normal[t, 0], normal[t, 1], normal[t, 2] = sign * nx, sign * ny, sign * nz
        position[t, 0] = x + scene.centre[i, 0] + LIFT * normal[t, 0]
        position[t, 1] = y + scene.centre[i, 1] + LIFT * normal[t, 1]
        position[t, 2] = z + scene.centre[i, 2] + LIFT * normal[t, 2]
        is_open[t] = True
        for j in range(len(scene.shape)):
            if solid_distance(scene, j, position[t, 0], position[t, 1], position[t, 2]) < 0.5 * LIFT:
                is_open[t] = False
                break


@compiled
def gather_direct(
    begin: int, end: int, scene: PackedScene, bvh: Bvh, position: np.ndarray, normal: np.ndarray, is_open: np.ndarray,
    side: int, out: np.ndarray,
) -> None:  # fmt: skip
    """Add the irradiance from the rectangular lights: L cos cos / d^2 over stratified points with nothing between."""
    stack = np.empty(STACK, np.int64)
    for t in range(begin, end):
        if not is_open[t]:
            continue
        p, n = position[t], normal[t]
        for k in range(len(scene.lights)):
            q = scene.lights[k]
            ax = q[4] * q[8] - q[5] * q[7]
            ay = q[5] * q[6] - q[3] * q[8]
            az = q[3] * q[7] - q[4] * q[6]  # edge_u x edge_v: a quarter of the area, along the light's normal
            total, between = 0.0, 0
            for cell in range(side * side):
                a = (2.0 * (cell % side) + 1.0) / side - 1.0
                b = (2.0 * (cell // side) + 1.0) / side - 1.0
                dx = q[0] + a * q[3] + b * q[6] - p[0]
                dy = q[1] + a * q[4] + b * q[7] - p[1]
                dz = q[2] + a * q[5] + b * q[8] - p[2]
                receive = dx * n[0] + dy * n[1] + dz * n[2]
                emit = -(dx * ax + dy * ay + dz * az)
                if receive <= 0.0 or emit <= 0.0:
                    continue
                between = blocker(scene, bvh, p[0], p[1], p[2], dx, dy, dz, between, stack)
                if between == 0:
                    dist_sq = dx * dx + dy * dy + dz * dz
                    total += 4.0 * receive * emit / (dist_sq * dist_sq)
            for c in range(3):
                out[t, c] += q[9 + c] * total / (side * side)


def cosine_directions(count: int) -> Float64[np.ndarray, "n 3"]:
    """Return `count` directions about z, density cos / pi: a Fibonacci spiral on the disc, lifted to the hemisphere."""
    k = np.arange(count)
    r, angle = np.sqrt((k + 0.5) / count), k * math.pi * (3 - math.sqrt(5))
    return np.stack((r * np.cos(angle), r * np.sin(angle), np.sqrt(1 - r * r)), 1)


@compiled
def gather_bounce(
    begin: int, end: int, world: World, position: np.ndarray, normal: np.ndarray, is_open: np.ndarray,
    directions: np.ndarray, out: np.ndarray,
) -> None:  # fmt: skip
    """Set the irradiance from the surfaces around: pi times the mean radiance over cosine-spread directions."""
    stack = np.empty(STACK, np.int64)
    for t in range(begin, end):
        if not is_open[t]:
            continue
        p, (nx, ny, nz) = position[t], normal[t]
        sign = math.copysign(1.0, nz)  # tangents after Duff et al., Building an Orthonormal Basis, Revisited, 2017
        a = -1.0 / (sign + nz)
        b = nx * ny * a
        sr, sg, sb = 0.0, 0.0, 0.0
        for k in range(len(directions)):
            d = directions[k]
            dx = d[0] * (1.0 + sign * nx * nx * a) + d[1] * b + d[2] * nx
            dy = d[0] * sign * b + d[1] * (sign + ny * ny * a) + d[2] * ny
            dz = -d[0] * sign * nx - d[1] * ny + d[2] * nz
            far, i = first_hit(world.scene, world.bvh, p[0], p[1], p[2], dx, dy, dz, 0, stack)
            hit = surface_frame(world.scene, i, p[0] + far * dx, p[1] + far * dy, p[2] + far * dz)
            r, g, bl = radiance(world, i, hit[0], hit[1], hit[2], hit[3], 0.1 + 0.2 * far, False)
            sr, sg, sb = sr + r, sg + g, sb + bl
        share = math.pi / len(directions)
        out[t, 0], out[t, 1], out[t, 2] = share * sr, share * sg, share * sb


def fill(
    values: Float32[np.ndarray, "t 3"], is_open: np.ndarray, start: Grid, columns: Grid, rows: Grid, passes: int = 3
) -> None:
    """Give hidden samples the mean of their known neighbours, in place, `passes` samples deep; the rest stays dark."""
    for s, nu, nv in zip(start.ravel(), columns.ravel(), rows.ravel(), strict=True):
        known = is_open[s : s + nu * nv].reshape(nv, nu)
        if nu == 0 or known.all():
            continue
        grid = values[s : s + nu * nv].reshape(nv, nu, 3)
        for _ in range(passes):
            known = _spread(grid, known)


def _spread(grid: Float32[np.ndarray, "v u 3"], known: np.ndarray) -> np.ndarray:
    padded = np.pad(np.where(known[..., None], grid, 0), ((1, 1), (1, 1), (0, 0)))
    counted = np.pad(known.astype(np.float32), 1)
    v, u = known.shape
    near = [(j, i) for j in range(3) for i in range(3)]
    weight = sum(counted[j : j + v, i : i + u] for j, i in near)
    mean = sum(padded[j : j + v, i : i + u] for j, i in near) / np.maximum(weight, 1)[..., None]
    fresh = ~known & (weight > 0)
    grid[fresh] = mean[fresh]
    return known | fresh
