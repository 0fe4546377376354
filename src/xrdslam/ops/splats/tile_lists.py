"""Tile lists that outlive one render: tracking renders the same map some tens of times from nearly the same pose."""

import math
from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.errors import ConfigError
from xrdslam.ops.splats.scratch import Scratch
from xrdslam.ops.splats.types import PinholeLike

__all__ = ["BuiltLists", "TileLists"]


@dataclass
class BuiltLists:
    """Which Gaussians each tile draws, in which order, and where their gradients go; see `binning` and `projection`."""

    scratch: Scratch
    candidates: np.ndarray
    counts: np.ndarray
    slots: np.ndarray
    offsets: np.ndarray
    entries: np.ndarray
    keys: np.ndarray
    num_slots: int
    is_sorted: bool = False


@dataclass
class TileLists:
    """Tile lists to be passed to one `render` after another; they are rebuilt when, and only when, they must be.

    They are used again while the camera and the Gaussians' means, scales, rotations and opacities are the same tensors,
    unchanged (their version counters tell), the pose is within `max_rotation` [rad] and `max_translation` [m] of the
    one they were built from, and every footprint lies inside the tiles that list it, which is checked anew at each
    render: the image holds every Gaussian it should, always. Footprints are listed `margin_px` wider than they are, so
    that small motion does not break the lists; what the pose limits could bring into the image is watched as well.

    What may be stale is the order within a tile: two Gaussians can be drawn in the wrong order if their depths differ
    by less than the limits can change them, 2 (max_translation + max_rotation * distance). The backward uses the same
    order as the forward.
    """

    margin_px: float = 2.0
    max_rotation: float = 0.01
    max_translation: float = 0.02
    num_builds: int = 0
    num_renders: int = 0
    _built: BuiltLists | None = field(default=None, repr=False)
    _pose: Float[np.ndarray, "4 4"] | None = field(default=None, repr=False)
    _key: tuple[object, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        limits = (self.margin_px, self.max_rotation, self.max_translation)
        if not all(math.isfinite(v) and v >= 0 for v in limits):
            raise ConfigError(f"tile lists with margin_px, max_rotation, max_translation = {limits}: need finite, >= 0")

    def clear(self) -> None:
        """Forget the lists: the next render builds new ones."""
        self._built = None

    def held(self, key: tuple[object, ...], T_camera_world: Float[np.ndarray, "4 4"]) -> BuiltLists | None:
        """Return the lists if they are of the same map and camera and of a pose near enough."""
        if self._built is None or self._pose is None or key != self._key:
            return None
        motion = T_camera_world.astype(np.float64) @ np.linalg.inv(self._pose)
        angle = np.linalg.norm(motion[:3, :3] - np.eye(3), 2)  # 2 sin(angle / 2): what bounds a point's motion
        near_enough = angle <= self.max_rotation and np.linalg.norm(motion[:3, 3]) <= self.max_translation
        return self._built if near_enough else None

    def keep(self, key: tuple[object, ...], T_camera_world: Float[np.ndarray, "4 4"], built: BuiltLists) -> None:
        """Hold new lists."""
        self._key, self._pose, self._built = key, T_camera_world.astype(np.float64), built
        self.num_builds += 1


def identity(camera: PinholeLike, limits: tuple[float, ...], *tensors: Tensor | None) -> tuple[object, ...]:
    """Return what must not change for lists to hold: camera, limits, and the tensors' memory and version."""
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
    seen = [(t.data_ptr(), t._version, tuple(t.shape)) for t in tensors if isinstance(t, torch.Tensor)]
    return (intrinsics, limits, *seen)
