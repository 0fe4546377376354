"""A hand-held walk through a room: a smooth closed round of poses that looks at what stands there.

The statistics are those of the eight 2000-frame Replica trajectories that NICE-SLAM published (docs/synthetic.md has
the table): the camera wanders at a nearly even speed on a way that bends every half metre, and looks about on a clock
of its own, mostly a little, now and then a lot. Positions and directions of view are uniform cubic B-splines, whose
every piece hangs on four control points only: so each point is drawn until its own piece is clear, never the whole.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline

from xrdslam.core.errors import DataError
from xrdslam.datasets.synthetic.distance import signed_distance
from xrdslam.datasets.synthetic.scene import PackedScene

__all__ = ["MotionConfig", "handheld_loop"]

Curve = Float64[np.ndarray, "n 6"]
"""Columns x, y, z [m], yaw, pitch, roll [rad]."""
SWAY = ((0.35, 0.004, 0.25), (0.9, 0.0012, 0.08), (1.7, 0.0003, 0.02))
"""Hand tremor: frequency [Hz], amplitude in position [m] and in angle [deg]."""
FRAMES_PER_SECOND = 30.0
CANDIDATES = 48
"""Control points drawn at once, of which the first that serves is taken."""
BASIS = np.array([[-1, 3, -3, 1], [3, -6, 0, 4], [-3, 3, 3, 1], [1, 0, 0, 0]]) / 6.0
"""Cubic B-spline: weight of each of four control points by powers 3, 2, 1, 0 of the piece's parameter in [0, 1)."""


@dataclass
class MotionConfig:
    """How the camera walks."""

    way_m: float = 0.0115
    """Mean way a frame [m]."""
    turn_deg: float = 0.5
    """Mean turn a frame [deg]."""
    frames: int = 2000
    """Length of a round, about."""
    clearance: float = 0.4
    """Least distance [m] from any surface, before tremor."""
    heights: tuple[float, float] = (0.8, 1.95)
    reach: float = 1.0
    """Share of the room's half length and width that the way may use."""
    stride: float = 0.44
    """Distance [m] between control points of the way."""
    glance_frames: int = 36
    """Frames between control points of the direction of view."""
    pitch_deg: tuple[float, float] = (-52.0, 12.0)
    view: float = 1.1
    """Least distance [m] of what the middle of the image shows, at control points."""
    tries: int = 60


def handheld_loop(
    scene: PackedScene, rng: np.random.Generator, config: MotionConfig | None = None
) -> Float64[np.ndarray, "n 4 4"]:
    """Return T_world_camera of one round, about `config.frames` frames; the frame after the last is the first."""
    config = config or MotionConfig()
    for _ in range(config.tries):
        way = _way(scene, rng, config)
        if way is None:
            continue
        position = _evenly(way, config.way_m, rng)
        view = _view_at_pace(scene, position, rng, config)
        curve = np.column_stack((position, view, np.zeros(len(position))))
        return _poses(curve + _tremor(len(curve), rng))
    raise DataError(f"no walk keeps {config.clearance} m from every surface of this room; give it more free floor")


def _spline(control: Float64[np.ndarray, "k d"], at: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, "n d"]:
    """Return the closed uniform cubic B-spline at parameters in [0, k)."""
    piece = np.floor(at).astype(int)
    t = at - piece
    weight = np.stack((t**3, t**2, t, np.ones_like(t)), 1) @ BASIS.T
    near = control[(piece[:, None] + np.arange(4)) % len(control)]
    curve: Float64[np.ndarray, "n d"] = (weight[:, :, None] * near).sum(1)
    return curve


def _way(scene: PackedScene, rng: np.random.Generator, config: MotionConfig) -> Float64[np.ndarray, "k 3"] | None:
    """Draw control points one by one, each so that the spline's last piece is clear and the start can be reached."""
    count = max(8, round(config.way_m * config.frames / (0.89 * config.stride)))
    half = np.maximum(config.reach * (scene.size[0, :2] - config.clearance), 0.0)
    low, high = np.array([*-half, config.heights[0]]), np.array([*half, config.heights[1]])
    points = np.empty((0, 3))
    t = np.linspace(0, 1, 9)
    weights = np.stack((t**3, t**2, t, np.ones_like(t)), 1) @ BASIS.T
    for _ in range(6 * count):
        if len(points) == count:
            break
        tried = _candidates(points, rng, config, low, high, count - len(points))
        first = next((k for k in range(len(tried)) if _is_free(scene, points, tried[k], weights, config)), None)
        # a dead end: go back a few points and try another way
        points = points[: max(len(points) - 4, 0)] if first is None else np.vstack((points, tried[first]))
    if len(points) < count:
        return None
    joint = _spline(points, np.arange(0, count, 1 / 16))
    is_free = float(signed_distance(scene, joint).min()) > config.clearance
    is_smooth = float(np.linalg.norm(np.diff(joint, axis=0), axis=1).min()) * 16 > 0.5 * config.stride
    return points if is_free and is_smooth else None


def _is_free(
    scene: PackedScene,
    points: Float64[np.ndarray, "k 3"],
    point: Float64[np.ndarray, "3"],
    weights: Float64[np.ndarray, "n 4"],
    config: MotionConfig,
) -> bool:
    """Return whether a next control point, and the piece of the spline it completes, are clear and without cusp."""
    if len(points) < 3:
        return float(signed_distance(scene, point)) > config.clearance
    piece = weights[:, :3] @ points[-3:] + weights[:, 3, None] * point
    steps = np.linalg.norm(np.diff(piece, axis=0), axis=1) * (len(weights) - 1)
    if float(steps.min()) < 0.55 * config.stride:  # a cusp: it could only be passed with a jerk
        return False
    return float(signed_distance(scene, np.vstack((piece, point))).min()) > config.clearance


def _candidates(
    points: Float64[np.ndarray, "k 3"],
    rng: np.random.Generator,
    config: MotionConfig,
    low: Float64[np.ndarray, "3"],
    high: Float64[np.ndarray, "3"],
    left: int,
) -> Float64[np.ndarray, "n 3"]:
    """Return control points a stride from the last, bent from the way so far, from which `left` strides lead home."""
    if len(points) == 0:
        return rng.uniform(low, high, (CANDIDATES, 3))
    last = points[-1]
    ahead = last - points[-2] if len(points) > 1 else rng.normal(size=3)
    yaw = math.atan2(ahead[1], ahead[0]) + rng.normal(0, 0.75, CANDIDATES) * np.linspace(1, 3, CANDIDATES)
    home = points[0] - last
    if float(np.linalg.norm(home)) > config.stride * max(left - 2, 0.5) * 0.8:
        yaw = math.atan2(home[1], home[0]) + rng.normal(0, 0.25, CANDIDATES)
    rise = rng.normal(0, 0.45, CANDIDATES) - 0.5 * (last[2] - 0.5 * (low[2] + high[2]))
    rise = np.clip(rise, -0.8, 0.8)
    flat = config.stride * np.sqrt(1 - (rise / np.maximum(1, np.abs(rise))) ** 2 * 0.64)
    tried = last + np.stack((flat * np.cos(yaw), flat * np.sin(yaw), config.stride * rise), 1)
    inside = ((tried >= low) & (tried <= high)).all(1)
    return np.concatenate((tried[inside], np.clip(tried[~inside], low, high)))


def _evenly(control: Float64[np.ndarray, "k 3"], way_m: float, rng: np.random.Generator) -> Float64[np.ndarray, "n 3"]:
    """Walk along the closed spline in steps of nearly `way_m`: slow waves change their length by a sixth."""
    at = np.linspace(0, len(control), 64 * len(control) + 1)
    dense = _spline(control, at % len(control))
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(dense, axis=0), axis=1))))
    frames = round(length[-1] / way_m)
    clock = np.arange(frames) / frames
    speed = np.ones(frames)
    for waves in rng.integers(3, frames // 120 + 4, 6):
        speed += 0.1 * np.sin(2 * math.pi * (waves * clock + rng.uniform()))
    gone = np.concatenate(([0.0], np.cumsum(speed)))[:-1] * length[-1] / speed.sum()
    return _spline(control, CubicSpline(length, at)(gone) % len(control))


def _view_at_pace(
    scene: PackedScene, position: Float64[np.ndarray, "n 3"], rng: np.random.Generator, config: MotionConfig
) -> Float64[np.ndarray, "n 2"]:
    """Look about until the mean turn is within a twentieth of what is asked; the nearest of six attempts, else."""
    best, least, larger = None, math.inf, 1.45  # the spline takes corners short
    for _ in range(6):
        view = _view(scene, position, rng, config, larger)
        step = np.diff(view, axis=0)
        turned = float(np.degrees(np.hypot(step[:, 0] * np.cos(view[1:, 1]), step[:, 1]).mean())) / config.turn_deg
        if abs(math.log(turned)) < least:
            best, least = view, abs(math.log(turned))
        if least < 0.05:
            break
        larger = min(max(larger / turned, 0.7 * larger), 1.4 * larger)
    assert best is not None
    return best


def _view(
    scene: PackedScene,
    position: Float64[np.ndarray, "n 3"],
    rng: np.random.Generator,
    config: MotionConfig,
    larger: float,
) -> Float64[np.ndarray, "n 2"]:
    """Return yaw and pitch [rad] of every frame: many small glances, a few large, at what is far enough away."""
    frames = len(position)
    count = max(8, round(frames / config.glance_frames))
    mean_step = math.radians(larger * config.turn_deg * frames / count)
    low, high = np.radians(config.pitch_deg)
    eye = position[(np.arange(count) * frames) // count]
    points = np.zeros((count, 2))
    for k in range(count):
        yaw0, pitch0 = points[k - 1] if k else (math.atan2(*-eye[0, 1::-1]), -0.3)
        size = rng.gamma(1.8, mean_step / 1.8, CANDIDATES)
        angle = rng.uniform(0, 2 * math.pi, CANDIDATES)
        step = np.stack((1.1 * size * np.cos(angle), 0.55 * size * np.sin(angle)), 1)
        home = math.remainder(points[0, 0] - yaw0, 2 * math.pi)
        left = count - k
        if k and abs(home) > 0.6 * max(left - 2, 0.5):
            most = max(abs(home) / max(left - 2, 1), 0.2)
            step[:, 0] = np.sign(home) * np.abs(rng.normal(0.6, 0.1, CANDIDATES)).clip(0.2, most)
        tried = np.stack((yaw0 + step[:, 0], np.clip(pitch0 + step[:, 1], low, high)), 1)
        tried[:, 1] += 0.25 * (0.5 * (low + high) - tried[:, 1])  # back towards the middle of the range
        points[k] = tried[_first_far(scene, eye[k], tried, config.view)]
    turns = round((points[-1, 0] - points[0, 0]) / (2 * math.pi))
    at = np.arange(frames) * count / frames - 1.5  # a control point has its greatest weight 1.5 pieces later
    return _turned_spline(points, at, 2 * math.pi * turns)


def _turned_spline(
    control: Float64[np.ndarray, "k 2"], at: Float64[np.ndarray, " n"], turned: float
) -> Float64[np.ndarray, "n 2"]:
    """Return the closed spline of angles whose first column gains `turned` [rad] a round."""
    count = len(control)
    slope = np.array([turned / count, 0.0])
    level = control - np.arange(count)[:, None] * slope
    curve: Float64[np.ndarray, "n 2"] = _spline(level, at % count) + (at[:, None] + 1.5) * slope
    return curve


def _first_far(
    scene: PackedScene, eye: Float64[np.ndarray, "3"], angles: Float64[np.ndarray, "n 2"], least: float
) -> int:
    """Return the first (yaw, pitch) that sees at least `least` [m] far, or the one that sees farthest.

    Twelve steps by the signed distance find the surface to a few centimetres.
    """
    yaw, pitch = angles.T
    rays = np.stack((np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)), 1)
    best, farthest = 0, -1.0
    for begin in range(0, len(rays), 4):
        ray = rays[begin : begin + 4]
        t = np.zeros(len(ray))
        for _ in range(12):
            t += np.maximum(signed_distance(scene, eye + t[:, None] * ray), 0.0)
            if float(t.min()) > least:
                break
        if (t > least).any():
            return begin + int(np.argmax(t > least))
        if float(t.max()) > farthest:
            best, farthest = begin + int(np.argmax(t)), float(t.max())
    return best


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
