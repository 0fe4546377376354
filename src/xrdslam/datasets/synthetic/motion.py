"""A hand-held walk through a room: a smooth closed loop of poses that looks at the furniture.

Speeds were set near those of the eight 2000-frame Replica trajectories that NICE-SLAM published, measured per frame
(range over scenes): translation mean 0.58-1.46 cm, median 0.58-1.46, 95th percentile 0.78-2.00; rotation mean
0.36-0.65 deg, median 0.30-0.51, 95th percentile 0.78-1.54; pitch within -74..39 deg, no roll, height spread 0.8-1.2 m.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from xrdslam.core.errors import DataError
from xrdslam.datasets.synthetic.distance import signed_distance
from xrdslam.datasets.synthetic.scene import PackedScene

__all__ = ["MotionConfig", "handheld_loop"]

Curve = Float64[np.ndarray, "n 6"]
"""Columns x, y, z [m], yaw, pitch, roll [rad]."""
SWAY = ((0.35, 0.004, 0.25), (0.9, 0.0015, 0.1), (1.7, 0.0005, 0.04))
"""Hand tremor: frequency [Hz], amplitude in position [m] and in angle [deg]."""
FRAMES_PER_SECOND = 30.0


@dataclass
class MotionConfig:
    """How the camera walks."""

    clearance: float = 0.42
    """Least distance [m] from any surface, before tremor."""
    heights: tuple[float, float] = (1.05, 1.75)
    knots: int = 14
    """Way points of the loop."""
    speed: float = 0.0135
    """Metres a frame where the camera does not turn."""
    turn_deg: float = 1.0
    """Degrees a frame where the camera does not move."""
    tries: int = 200


def handheld_loop(
    scene: PackedScene, rng: np.random.Generator, config: MotionConfig | None = None
) -> Float64[np.ndarray, "n 4 4"]:
    """Return T_world_camera of one round, some 1100 frames; the frame after the last is the first."""
    config = config or MotionConfig()
    for _ in range(config.tries):
        spline = _way(scene, rng, config)
        dense = spline(np.linspace(0, 1, 4000, endpoint=False))
        if float(signed_distance(scene, dense[:, :3]).min()) >= config.clearance:
            curve = _timed(spline, config)
            return _poses(curve + _tremor(len(curve), rng))
    raise DataError(f"no walk keeps {config.clearance} m from every surface of this room; give it more free floor")


def _way(scene: PackedScene, rng: np.random.Generator, config: MotionConfig) -> CubicSpline:
    """Draw way points around the room's middle and directions of view across it; join them by a periodic spline."""
    k = config.knots
    angle = 2 * math.pi * (np.arange(k) + rng.uniform(-0.25, 0.25, k)) / k + rng.uniform(0, 2 * math.pi)
    half = scene.size[0, :2] - config.clearance - 0.2
    position = np.empty((k, 3))
    for n in range(k):
        position[n] = _way_point(scene, rng, config, angle[n], half)
    across = angle + math.pi + rng.uniform(-0.6, 0.6, k)
    pitch = np.radians(rng.uniform(-32, -6, k))
    turned = across - 2 * math.pi * np.arange(k) / k  # periodic once the full turn of the loop is taken out
    knots = np.column_stack((position, turned, pitch, np.zeros(k)))
    closed = CubicSpline(np.arange(k + 1) / k, np.vstack((knots, knots[:1])), bc_type="periodic")
    closed.extrapolate = True  # the end is a full turn after the start, not the start again
    closed.c[-2, :, 3] += 2 * math.pi  # and put back as a slope
    starts = np.arange(k) / k
    closed.c[-1, :, 3] += 2 * math.pi * starts
    return closed


def _way_point(
    scene: PackedScene, rng: np.random.Generator, config: MotionConfig, angle: float, half: Float64[np.ndarray, "2"]
) -> Float64[np.ndarray, "3"]:
    """Return a free point in the given direction from the room's middle, a quarter to all of the way to the wall."""
    reach = float(np.min(half / np.maximum(np.abs([math.cos(angle), math.sin(angle)]), 1e-9)))
    r = reach * rng.uniform(0.25, 1.0, 32)
    z = rng.uniform(*config.heights, 32)
    points = np.column_stack((r * math.cos(angle), r * math.sin(angle), z))
    free = signed_distance(scene, points) > config.clearance + 0.1
    return np.asarray(points[int(np.argmax(free))])


def _timed(spline: CubicSpline, config: MotionConfig) -> Curve:
    """Sample the loop once a frame: a step costs the time of its way and of its turn, as the legs of a triangle.

    The cost is smoothed along the loop, so that the camera slows down where its way doubles back.
    """
    u = np.linspace(0, 1, 20001)
    step = np.diff(spline(u), axis=0)
    way = np.linalg.norm(step[:, :3], axis=1) / config.speed
    turn = np.degrees(np.linalg.norm(step[:, 3:5], axis=1)) / config.turn_deg
    cost = gaussian_filter1d(np.hypot(way, turn), 0.3 * len(way) / config.knots, mode="wrap")
    time = np.concatenate(([0.0], np.cumsum(cost)))
    frames = round(float(time[-1]))
    curve: Curve = spline(np.interp(np.arange(frames) * (time[-1] / frames), time, u))
    return curve


def _tremor(frames: int, rng: np.random.Generator) -> Curve:
    """Return small periodic motions about the smooth way, whole numbers of waves to the loop."""
    total = np.zeros((frames, 6))
    for hertz, metres, degrees in SWAY:
        waves = np.maximum(1, np.rint(hertz * rng.uniform(0.8, 1.25, 6) * frames / FRAMES_PER_SECOND))
        phase = 2 * math.pi * (np.outer(np.arange(frames) / frames, waves) + rng.uniform(0, 1, 6))
        total += np.array([metres] * 3 + [math.radians(degrees)] * 3) * np.sin(phase)
    return total


def _poses(curve: Curve) -> Float64[np.ndarray, "n 4 4"]:
    """Build poses in OpenCV axes from positions and yaw, pitch, roll."""
    yaw, pitch, roll = curve[:, 3:].T
    zero = np.zeros_like(yaw)
    forward = np.stack((np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)), 1)
    level = np.stack((np.sin(yaw), -np.cos(yaw), zero), 1)
    below = np.cross(forward, level)
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    T_world_camera = np.tile(np.eye(4), (len(curve), 1, 1))
    T_world_camera[:, :3, 0], T_world_camera[:, :3, 1] = c * level + s * below, c * below - s * level
    T_world_camera[:, :3, 2], T_world_camera[:, :3, 3] = forward, curve[:, :3]
    return T_world_camera
