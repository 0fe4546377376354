"""Views of a scene from where no camera was: seeded, inside the room, looking at what the sequence saw.

A place is drawn on the way from a frame's camera to a point that it measured, so it is in free space; from there the
view looks at a point that another frame measured. Only the data and the seed decide, never an estimate: every method is
measured from the same places.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from xrdslam.core.camera import Camera
from xrdslam.evaluation.culling import DepthView, Seen
from xrdslam.evaluation.errors import EvaluationError
from xrdslam.ops.ray_mesh import RayMesh

__all__ = ["CAMERA", "cast_depth", "virtual_views"]

Pose = Float64[NDArray[np.float64], "4 4"]

CAMERA = Camera(60.0, 60.0, 49.5, 49.5, 100, 100)
"""80 degrees, as the published protocol's 500 px with a focal length of 300 px, at a fifth of its pixels."""
FARTHEST = 0.6
"""How far a view's place may be on the way to the measured point, of that way."""
NEAREST_TARGET_M = 0.3
LEAST_SEEN = 0.5
"""A view of which less than this share of pixels shows what the sequence saw is drawn again."""
_ROUNDS = 20


def virtual_views(
    truth: RayMesh, frames: Sequence[DepthView], seen: Seen, count: int, seed: int
) -> tuple[list[DepthView], list[NDArray[np.bool_]]]:
    """Return views with the depth of the true surface [m, 0 = none], and which of their pixels the sequence saw.

    EvaluationError where the frames measured nothing, or too few views show what they saw.
    """
    rng = np.random.default_rng([seed, 1])
    views: list[DepthView] = []
    masks: list[NDArray[np.bool_]] = []
    for _ in range(_ROUNDS * count):
        if len(views) == count:
            return views, masks
        pose = _drawn_pose(frames, rng)
        if pose is None:
            continue
        depth = cast_depth(truth, CAMERA, pose)
        is_counted = (depth > 0) & seen(_points_world(CAMERA, pose, depth)).reshape(depth.shape)
        if is_counted.mean() >= LEAST_SEEN:
            views.append(DepthView(CAMERA, pose, depth.astype(np.float32)))
            masks.append(is_counted)
    raise EvaluationError(
        f"{len(views)} of {count} virtual views show what the frames saw of the true surface; "
        "are the mesh and the frames of one world?"
    )


def cast_depth(mesh: RayMesh, camera: Camera, T_world_camera: Pose) -> Float64[NDArray[np.float64], "h w"]:
    """Return the depth along z [m] of the surface at each pixel's centre, 0 where there is none."""
    directions = _rays(camera) @ T_world_camera[:3, :3].T
    origins = np.broadcast_to(T_world_camera[:3, 3], directions.shape)
    distance = mesh.cast(origins, directions).distance
    return np.where(np.isfinite(distance), distance, 0.0).reshape(camera.height, camera.width)


def _rays(camera: Camera) -> Float64[NDArray[np.float64], "n 3"]:
    """Return the camera-frame direction of each pixel, z = 1, in raster order."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    rays = np.stack(((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)), -1)
    return rays.reshape(-1, 3)


def _points_world(
    camera: Camera, T_world_camera: Pose, depth: Float64[NDArray[np.float64], "h w"]
) -> Float64[NDArray[np.float64], "n 3"]:
    points_camera = _rays(camera) * depth.reshape(-1, 1)
    return np.asarray(points_camera @ T_world_camera[:3, :3].T + T_world_camera[:3, 3])


def _drawn_pose(frames: Sequence[DepthView], rng: np.random.Generator) -> Pose | None:
    """Draw a place and a target; None where a drawn pixel has no depth, or the two are too near or in line with up."""
    frame, other = (frames[int(rng.integers(len(frames)))] for _ in range(2))
    towards, target = _measured_point(frame, rng), _measured_point(other, rng)
    if towards is None or target is None:
        return None
    start = frame.T_world_camera[:3, 3]
    center = start + FARTHEST * rng.random() * (towards - start)
    forward = target - center
    distance = float(np.linalg.norm(forward))
    right = np.cross(frame.T_world_camera[:3, 1], forward / max(distance, 1e-9))
    if distance < NEAREST_TARGET_M or float(np.linalg.norm(right)) < 0.1:
        return None
    z, x = forward / distance, right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = x, np.cross(z, x), z, center
    return pose


def _measured_point(frame: DepthView, rng: np.random.Generator) -> Float64[NDArray[np.float64], "3"] | None:
    """Return the world point of a pixel drawn from a frame, None where it measured nothing."""
    camera = frame.camera
    u, v = int(rng.integers(camera.width)), int(rng.integers(camera.height))
    depth = float(frame.depth[v, u])
    if not depth > 0:
        return None
    ray = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
    return np.asarray(frame.T_world_camera[:3, :3] @ (depth * ray) + frame.T_world_camera[:3, 3])
