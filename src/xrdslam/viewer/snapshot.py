"""What a watcher sees of a run at one moment, as arrays of their own: the run may go on."""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from xrdslam.core.algorithm import Algorithm
from xrdslam.core.frame import Frame
from xrdslam.core.surface import PointCloud

__all__ = ["Snapshot", "Watched", "keyframe_cloud", "picture", "rendering_of", "thinned"]

POINTS_OF_A_KEYFRAME = 4000
FAREST_M = 20.0


@runtime_checkable
class Watched(Protocol):
    """What a viewer reads of a run."""

    @property
    def algorithm(self) -> Algorithm:
        """The method, with its map and its trajectory."""

    @property
    def title(self) -> str:
        """`<method> on <dataset>`."""


class Snapshot(NamedTuple):
    """A moment of a run."""

    frame_index: int
    status: str
    T_world_camera: Float[np.ndarray, "4 4"]
    fov_rad: float
    """Of the camera, vertically."""
    aspect: float
    path: Float[np.ndarray, "n 3"]
    """Camera centres as believed now [m]."""
    keyframes: Float[np.ndarray, "k 4 4"]
    rgb: UInt8[np.ndarray, "h w 3"]
    rendering: UInt8[np.ndarray, "h w 3"] | None
    cloud: PointCloud | None


def picture(rgb: Float[Tensor, "h w 3"], width: int) -> UInt8[np.ndarray, "_ _ 3"]:
    """Return a small picture."""
    import cv2

    image = np.rint(255 * rgb.detach().clamp(0, 1).cpu().numpy()).astype(np.uint8)
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))


def rendering_of(algorithm: Algorithm, frame: Frame, width: int) -> UInt8[np.ndarray, "_ _ 3"] | None:
    """Return the map seen from where the frame is thought to be; None where the map cannot say.

    The state of torch's random numbers is put back: a watched run gives the bits of an unwatched one.
    """
    model, camera = getattr(algorithm, "model", None), frame.camera  # none before the first frame is in the map
    if model is None or not model.supports("render") or model.size == 0:
        return None
    small = camera.resized(width, max(1, round(camera.height * width / camera.width)))
    pose = algorithm.trajectory.pose(frame.index).to(frame.rgb)
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        return picture(model.render(small, pose).rgb, width)


def keyframe_cloud(algorithm: Algorithm, kept: dict[int, PointCloud]) -> PointCloud:
    """Return what keyframes measured, from where they are believed to be; `kept` remembers each in its own frame."""
    points, colors = [np.empty((0, 3))], [np.empty((0, 3))]
    for keyframe in algorithm.keyframes:
        if keyframe.depth is None:
            continue
        if keyframe.index not in kept:
            kept[keyframe.index] = _seen(keyframe)
        own = kept[keyframe.index]
        T_world_camera = algorithm.trajectory.pose(keyframe.index).numpy()
        points.append(own.points @ T_world_camera[:3, :3].T + T_world_camera[:3, 3])
        colors.append(np.asarray(own.colors))
    return PointCloud(np.concatenate(points), np.concatenate(colors))


def thinned(cloud: PointCloud, most: int) -> PointCloud:
    """Return at most so many of the points, evenly picked in their order."""
    step = -(-len(cloud.points) // most)
    if step <= 1:
        return cloud
    return PointCloud(cloud.points[::step], None if cloud.colors is None else cloud.colors[::step])


def _seen(frame: Frame) -> PointCloud:
    assert frame.depth is not None, "asked only of frames that measured depth"
    points = frame.points_camera().cpu().numpy()
    colors = frame.rgb[frame.depth > 0].cpu().numpy()
    near = points[:, 2] < FAREST_M
    return thinned(PointCloud(points[near].astype(np.float64), colors[near]), POINTS_OF_A_KEYFRAME)
