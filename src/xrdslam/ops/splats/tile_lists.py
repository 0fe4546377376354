"""Tile lists that outlive one render: tracking renders the same map some tens of times from nearly the same pose."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.errors import ConfigError
from xrdslam.ops.splats.scratch import Scratch
from xrdslam.ops.splats.types import PinholeLike

__all__ = ["BuiltLists", "MapKey", "TileLists"]


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
class MapKey:
    """What must not change for lists to hold: the camera, the limits, and the tensors' memory and content.

    The tensors are kept alive, so that no other can take their address meanwhile; colours need not be among them.
    """

    settings: tuple[float | int, ...]
    tensors: tuple[Tensor, ...]
    versions: tuple[int, ...]

    @classmethod
    def of(cls, camera: PinholeLike, limits: tuple[float, ...], tensors: Iterable[Tensor]) -> "MapKey":
        """Remember tensors as they are now."""
        intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        kept = tuple(tensor.detach() for tensor in tensors)
        return cls((*intrinsics, *limits), kept, tuple(tensor._version for tensor in kept))

    def same_as(self, other: "MapKey") -> bool:
        """Say whether two keys are of the same memory with the same content."""
        pairs = list(zip(self.tensors, other.tensors, strict=True))
        same_memory = all(a.data_ptr() == b.data_ptr() and a.shape == b.shape for a, b in pairs)
        return same_memory and self.versions == other.versions and self.settings == other.settings


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
    _key: MapKey | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        limits = (self.margin_px, self.max_rotation, self.max_translation)
        if not all(math.isfinite(v) and v >= 0 for v in limits):
            raise ConfigError(f"tile lists with margin_px, max_rotation, max_translation = {limits}: need finite, >= 0")

    def clear(self) -> None:
        """Forget the lists, and let go of the map: the next render builds new ones."""
        self._built = self._key = None

    def held(self, key: MapKey, T_camera_world: Float[np.ndarray, "4 4"]) -> BuiltLists | None:
        """Return the lists if they are of the same map and camera and of a pose near enough."""
        if self._built is None or self._pose is None or self._key is None or not key.same_as(self._key):
            return None
        motion = T_camera_world.astype(np.float64) @ np.linalg.inv(self._pose)
        angle = np.linalg.norm(motion[:3, :3] - np.eye(3), 2)  # 2 sin(angle / 2): what bounds a point's motion
        near_enough = angle <= self.max_rotation and np.linalg.norm(motion[:3, 3]) <= self.max_translation
        return self._built if near_enough else None

    def keep(self, key: MapKey, T_camera_world: Float[np.ndarray, "4 4"], built: BuiltLists) -> None:
        """Hold new lists."""
        self._key, self._pose, self._built = key, T_camera_world.astype(np.float64), built
        self.num_builds += 1
