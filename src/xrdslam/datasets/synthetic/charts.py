"""Flat maps of a solid's surface, on which texture is drawn and light is stored (numba device functions).

A box (rounded or not) has six charts, one along each signed axis: x+, x-, y+, y-, z+, z-. A frustum has three: side,
bottom, top. Chart coordinates are metres from the middle of the chart.
"""

import math

import numpy as np

from xrdslam.datasets.synthetic.compiled import compiled, inlined

__all__ = ["chart_half", "chart_of", "chart_plane", "chart_point"]

Four = tuple[float, float, float, float]


@compiled
def chart_of(shape: int, nx: float, ny: float, nz: float) -> int:
    """Return the chart that a local outward normal belongs to."""
    if shape == 1:
        return 1 if nz < -0.8 else (2 if nz > 0.8 else 0)
    ax, ay, az = abs(nx), abs(ny), abs(nz)
    if ax >= ay and ax >= az:
        return 0 if nx > 0.0 else 1
    if ay >= az:
        return 2 if ny > 0.0 else 3
    return 4 if nz > 0.0 else 5


@inlined
def chart_half(shape: int, chart: int, size: np.ndarray) -> tuple[float, float]:
    """Return the half extents of a chart [m]."""
    radius = size[3]
    if shape == 1:
        if chart == 0:
            return math.pi * (0.5 * (size[0] + size[1]) + radius), size[2] + radius
        widest = max(size[0], size[1]) + radius
        return widest, widest
    if chart < 2:
        return size[1] + radius, size[2] + radius
    if chart < 4:
        return size[0] + radius, size[2] + radius
    return size[0] + radius, size[1] + radius


@inlined
def chart_plane(shape: int, chart: int, size: np.ndarray, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the chart coordinates (u, v) [m] of a local surface point."""
    if shape == 1:
        if chart == 0:
            return math.atan2(y, x) * (0.5 * (size[0] + size[1]) + size[3]), z
        return x, y
    if chart < 2:
        return y, z
    if chart < 4:
        return x, z
    return x, y


@compiled
def side_point(size: np.ndarray, u: float, v: float) -> tuple[float, float, float, float, float, float]:
    """Return point and normal on a frustum's slanted side."""
    h, radius = size[2], size[3]
    angle = u / (0.5 * (size[0] + size[1]) + radius)
    length = math.sqrt(4.0 * h * h + (size[1] - size[0]) ** 2)
    nr, nz = 2.0 * h / length, (size[0] - size[1]) / length
    z = min(max(v, -h), h)
    r = size[0] + (size[1] - size[0]) * (0.5 * z / h + 0.5) + radius * nr
    ca, sa = math.cos(angle), math.sin(angle)
    return r * ca, r * sa, z + radius * nz, nr * ca, nr * sa, nz


@compiled
def face_point(
    core_u: float, core_v: float, core_w: float, radius: float, u: float, v: float
) -> tuple[float, float, float, float, float, float]:
    """Return (u, v, height) and normal of the rounded face over (u, v), for a face whose normal axis is the third."""
    pu, pv = u - min(max(u, -core_u), core_u), v - min(max(v, -core_v), core_v)
    away = math.hypot(pu, pv)
    limit = 0.9 * radius  # beyond it the neighbouring chart owns the surface
    if away > limit:
        shrink = limit / away if away > 0.0 else 0.0
        u, v, pu, pv, away = u - pu * (1.0 - shrink), v - pv * (1.0 - shrink), pu * shrink, pv * shrink, limit
    if radius <= 0.0:
        return u, v, core_w, 0.0, 0.0, 1.0
    rise = math.sqrt(radius * radius - away * away)
    return u, v, core_w + rise, pu / radius, pv / radius, rise / radius


@compiled
def chart_point(
    shape: int, chart: int, size: np.ndarray, u: float, v: float
) -> tuple[float, float, float, float, float, float]:
    """Return the local surface point (x, y, z) and outward normal at chart coordinates (u, v)."""
    if shape == 1:
        if chart == 0:
            return side_point(size, u, v)
        rim = (size[0] if chart == 1 else size[1]) + 0.5 * size[3]
        k = min(1.0, 0.97 * rim / max(math.hypot(u, v), 1e-12))
        up = -1.0 if chart == 1 else 1.0
        return u * k, v * k, up * (size[2] + size[3]), 0.0, 0.0, up
    sign = 1.0 if chart & 1 == 0 else -1.0
    if chart < 2:
        p, q, h, np_, nq, nh = face_point(size[1], size[2], size[0], size[3], u, v)
        return sign * h, p, q, sign * nh, np_, nq
    if chart < 4:
        p, q, h, np_, nq, nh = face_point(size[0], size[2], size[1], size[3], u, v)
        return p, sign * h, q, np_, sign * nh, nq
    p, q, h, np_, nq, nh = face_point(size[0], size[1], size[2], size[3], u, v)
    return p, q, sign * h, np_, nq, sign * nh
