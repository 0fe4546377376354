"""Which part of a surface counts: what the frames of the sequence saw, under a protocol that has a name.

Poses are always the true ones and depth is what was measured, or what rays cast at the true mesh say: a run's own
estimate has no part in what it is held against.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from xrdslam.core.camera import Camera
from xrdslam.ops.visibility import visible

__all__ = ["CULLING", "DepthView", "Seen", "seen", "seen_under"]

Points = Float[NDArray[np.float64], "n 3"]
Seen = Callable[[Points], Bool[NDArray[np.bool_], " n"]]

CULLING = {
    "frustum": "in the image of some frame, at any distance",
    "frustum_occlusion": "in the image of some frame, on a pixel with measured depth, not farther behind it than the"
    " margin",
    "virtual_cameras": "as frustum_occlusion, or so seen from a virtual view, whose depth is cast at the true surface",
}
"""Each protocol's name, and what it keeps of both surfaces."""


@dataclass(frozen=True, eq=False)
class DepthView:
    """What a frame measured, and from where."""

    camera: Camera
    T_world_camera: Float[NDArray[np.float64], "4 4"]
    depth: Float[NDArray[np.float32], "h w"]


def seen(
    points_world: Points, views: Iterable[DepthView], margin_m: float, occlusion: bool = True
) -> Bool[NDArray[np.bool_], " n"]:
    """Say which points some view saw: inside its image, and with `occlusion` on measured depth, not behind it."""
    found = np.zeros(len(points_world), np.bool_)
    for camera, alike in groupby(views, key=lambda view: view.camera):
        group = list(alike)
        poses = np.stack([view.T_world_camera for view in group])
        depths = np.stack([view.depth for view in group]) if occlusion else None
        found |= visible(points_world, camera, poses, depths, margin_m)
    return found


def seen_under(culling: str, frames: Sequence[DepthView], virtual: Sequence[DepthView], margin_m: float) -> Seen:
    """Return the question of a protocol: which of these points [m] count?"""
    views = [*frames, *virtual] if culling == "virtual_cameras" else list(frames)
    return lambda points_world: seen(points_world, views, margin_m, occlusion=culling != "frustum")
