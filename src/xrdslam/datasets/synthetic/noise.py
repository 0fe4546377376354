"""Noise as a function of the surface point, faded out where a pixel is too wide to show it (numba device functions)."""

import math

from xrdslam.datasets.synthetic.compiled import compiled, inlined

__all__ = ["cell_random", "edge", "fbm", "gradient_noise", "mix", "smooth_step"]

Three = tuple[float, float, float]


@compiled
def cell_hash(ix: int, iy: int, iz: int, seed: int) -> int:
    """Return 31 well mixed bits of a lattice cell."""
    h = (ix * 73856093) ^ (iy * 19349663) ^ (iz * 83492791) ^ (seed * 2654435761)
    h = (h ^ (h >> 13)) * 1274126177
    h = (h ^ (h >> 16)) * 2246822519
    return (h ^ (h >> 15)) & 0x7FFFFFFF


@compiled
def cell_random(ix: int, iy: int, seed: int) -> float:
    """Return a number in [0, 1) that belongs to a cell."""
    return cell_hash(ix, iy, 7, seed) / 2147483648.0


@inlined
def corner(h: int, x: float, y: float, z: float) -> float:
    """Return the dot product of (x, y, z) with one of sixteen edge directions of a cube, picked by a lattice hash."""
    h = (h ^ (h >> 15)) * 2246822519
    k = (h >> 17) & 15
    u = x if k < 8 else y
    v = y if k < 4 else (x if k == 12 or k == 14 else z)
    return (u if k & 1 == 0 else -u) + (v if k & 2 == 0 else -v)


@compiled
def gradient_noise(x: float, y: float, z: float, seed: int) -> float:
    """Return lattice gradient noise in about [-1, 1] with zero mean (K. Perlin, Improving Noise, 2002).

    Written out corner by corner: the hashes share their parts, and most of a frame's time is spent here.
    """
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    x, y, z = x - fx, y - fy, z - fz
    u = x * x * x * (x * (x * 6.0 - 15.0) + 10.0)
    v = y * y * y * (y * (y * 6.0 - 15.0) + 10.0)
    w = z * z * z * (z * (z * 6.0 - 15.0) + 10.0)
    i, j, k = int(fx) * 73856093, int(fy) * 19349663, int(fz) * 83492791 ^ seed * 2654435761
    i1, j1, k1 = i + 73856093, j + 19349663, int(fz + 1.0) * 83492791 ^ seed * 2654435761
    a, b, c = x - 1.0, y - 1.0, z - 1.0
    n00, n10 = corner(i ^ j ^ k, x, y, z), corner(i1 ^ j ^ k, a, y, z)
    n01, n11 = corner(i ^ j1 ^ k, x, b, z), corner(i1 ^ j1 ^ k, a, b, z)
    m00, m10 = corner(i ^ j ^ k1, x, y, c), corner(i1 ^ j ^ k1, a, y, c)
    m01, m11 = corner(i ^ j1 ^ k1, x, b, c), corner(i1 ^ j1 ^ k1, a, b, c)
    n0, n1 = n00 + u * (n10 - n00), n01 + u * (n11 - n01)
    m0, m1 = m00 + u * (m10 - m00), m01 + u * (m11 - m01)
    n, m = n0 + v * (n1 - n0), m0 + v * (m1 - m0)
    return n + w * (m - n)


@compiled
def visible(frequency: float, footprint: float) -> float:
    """Return the share of a wave [1/m] seen by a pixel of `footprint` [m]: 1 below 0.2 waves a pixel, 0 above 0.55."""
    return min(max((0.55 - frequency * footprint) / 0.35, 0.0), 1.0)


@compiled
def fbm(x: float, y: float, z: float, frequency: float, octaves: int, footprint: float, seed: int) -> float:
    """Return gradient noise summed over octaves from `frequency` [1/m], each with 0.6 of the amplitude before it."""
    total, amplitude = 0.0, 1.0
    for octave in range(octaves):
        seen = visible(frequency, footprint)
        if seen <= 0.0:
            break
        total += amplitude * seen * gradient_noise(x * frequency, y * frequency, z * frequency, seed + octave)
        frequency *= 2.03
        amplitude *= 0.6
    return total


@compiled
def smooth_step(low: float, high: float, x: float) -> float:
    """Return 0 below `low`, 1 above `high`, a cubic between."""
    t = min(max((x - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@compiled
def edge(x: float, width: float) -> float:
    """Return a step at 0 as a pixel of `width` (in the unit of x) sees it: 0 before, 1 after."""
    return min(max(x / max(width, 1e-6) + 0.5, 0.0), 1.0)


@compiled
def mix(a: Three, b: Three, t: float) -> Three:
    """Return (1 - t) a + t b."""
    return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t
