"""Distances and ray hits of convex solids, in their local frame (numba device functions, float64).

The distance to a convex body is a convex function along a ray. So Newton's iteration from outside never oversteps the
first hit, a slope that is no longer negative proves a miss, and one routine serves every shape; flat faces need no
iteration, spheres have their closed form.
"""

import math

from xrdslam.datasets.synthetic.compiled import compiled, inlined

__all__ = ["EPS", "core_gradient", "outer_half", "ray_room", "ray_solid", "reciprocal"]

EPS = 1e-9
"""Distance [m] below which Newton's iteration has arrived."""
NEWTON_STEPS = 64
Four = tuple[float, float, float, float]


@compiled
def box_gradient(x: float, y: float, z: float, a: float, b: float, c: float) -> Four:
    """Return signed distance and its gradient for the box of half extents (a, b, c)."""
    qx, qy, qz = abs(x) - a, abs(y) - b, abs(z) - c
    sx, sy, sz = math.copysign(1.0, x), math.copysign(1.0, y), math.copysign(1.0, z)
    ox, oy, oz = max(qx, 0.0), max(qy, 0.0), max(qz, 0.0)
    d = math.sqrt(ox * ox + oy * oy + oz * oz)
    if d > 0.0:
        return d, sx * ox / d, sy * oy / d, sz * oz / d
    if qx >= qy and qx >= qz:
        return qx, sx, 0.0, 0.0
    if qy >= qz:
        return qy, 0.0, sy, 0.0
    return qz, 0.0, 0.0, sz


@compiled
def frustum_gradient(x: float, y: float, z: float, bottom: float, top: float, h: float) -> Four:
    """Return signed distance and its gradient for the frustum of half height h: a 2-D trapezoid in (r, z)."""
    r = math.sqrt(x * x + y * y)
    ex, ey = (x / r, y / r) if r > 0.0 else (1.0, 0.0)
    length = math.sqrt(4.0 * h * h + (top - bottom) ** 2)
    nr, nz = 2.0 * h / length, (bottom - top) / length  # outward normal of the slanted side
    side = (r - bottom) * nr + (z + h) * nz
    cap = abs(z) - h
    up = math.copysign(1.0, z)
    if side <= 0.0 and cap <= 0.0:
        return (side, nr * ex, nr * ey, nz) if side > cap else (cap, 0.0, 0.0, up)
    along = ((r - bottom) * (top - bottom) + (z + h) * 2.0 * h) / (length * length)
    along = min(max(along, 0.0), 1.0)
    dr, dz = r - (bottom + along * (top - bottom)), z - (along * 2.0 - 1.0) * h
    cr, cz = r - min(r, top if up > 0.0 else bottom), z - up * h  # nearest point of the nearer cap
    if cap > 0.0 and cr * cr + cz * cz <= dr * dr + dz * dz:
        dr, dz = cr, cz
    d = math.sqrt(dr * dr + dz * dz)
    if d <= 0.0:
        return 0.0, nr * ex, nr * ey, nz
    return d, dr / d * ex, dr / d * ey, dz / d


@compiled
def core_gradient(shape: int, x: float, y: float, z: float, a: float, b: float, c: float) -> Four:
    """Return signed distance and gradient of a solid's core."""
    if shape == 0:
        return box_gradient(x, y, z, a, b, c)
    return frustum_gradient(x, y, z, a, b, c)


@compiled
def outer_half(shape: int, a: float, b: float, c: float, radius: float) -> tuple[float, float, float]:
    """Return the half extents of the local bounding box."""
    if shape == 0:
        return a + radius, b + radius, c + radius
    widest = max(a, b) + radius
    return widest, widest, c + radius


@inlined
def reciprocal(d: float) -> float:
    """Return 1/d, huge but finite at 0, so that slabs of axis-parallel rays need no case of their own."""
    return 1.0 / d if abs(d) > 1e-30 else 1e30


@inlined
def slab(o: float, inverse: float, half: float, near: float, far: float) -> tuple[float, float]:
    """Cut the interval (near, far) of the ray o + t / inverse by |x| <= half."""
    t0, t1 = (-half - o) * inverse, (half - o) * inverse
    return max(near, min(t0, t1)), min(far, max(t0, t1))


@compiled
def ray_sphere(ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, radius: float) -> float:
    """Return the first t >= 0 where the ray enters the sphere at the origin, or inf."""
    dd = dx * dx + dy * dy + dz * dz
    od = ox * dx + oy * dy + oz * dz
    gap = ox * ox + oy * oy + oz * oz - radius * radius
    disc = od * od - dd * gap
    if disc < 0.0 or od > 0.0:
        return math.inf
    return max((-od - math.sqrt(disc)) / dd, 0.0)


@compiled
def ray_solid(  # the whole first-hit search in one place
    shape: int, a: float, b: float, c: float, radius: float,
    ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, far: float,
) -> float:  # fmt: skip
    """Return the first t in [0, far) where the ray o + t d (d of any length) meets the solid, or inf."""
    hx, hy, hz = outer_half(shape, a, b, c, radius)
    t, end = slab(ox, reciprocal(dx), hx, 0.0, far)
    t, end = slab(oy, reciprocal(dy), hy, t, end)
    t, end = slab(oz, reciprocal(dz), hz, t, end)
    if t > end:
        return math.inf
    if shape == 0 and radius == 0.0:
        return t
    if shape == 0 and max(a, b, c) == 0.0:
        return ray_sphere(ox, oy, oz, dx, dy, dz, radius)
    for _ in range(NEWTON_STEPS):
        d, gx, gy, gz = core_gradient(shape, ox + t * dx, oy + t * dy, oz + t * dz, a, b, c)
        d -= radius
        if d <= EPS:
            return t
        slope = gx * dx + gy * dy + gz * dz
        if slope >= -1e-12:
            return math.inf
        t -= d / slope
        if t >= end + EPS:
            return math.inf
    return math.inf


@inlined
def ray_room(
    hx: float, hy: float, hz: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> float:
    """Return t where a ray from inside leaves the box of half extents (hx, hy, hz)."""
    tx = (math.copysign(hx, dx) - ox) / dx if dx != 0.0 else math.inf
    ty = (math.copysign(hy, dy) - oy) / dy if dy != 0.0 else math.inf
    tz = (math.copysign(hz, dz) - oz) / dz if dz != 0.0 else math.inf
    return min(tx, min(ty, tz))
