"""Which points some depth image saw: the kernel and its plain torch twin."""

from collections.abc import Sequence

import numba
import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Float64
from numpy.typing import NDArray
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.ops.simd import parallel_kernel
from xrdslam.ops.threads import kernel_threads

__all__ = ["visible", "visible_reference"]

_NEAREST_M = 1e-6


def visible(
    points_world: Float64[NDArray[np.float64], "n 3"],
    camera: Camera,
    T_world_camera: Float64[NDArray[np.float64], "k 4 4"],
    depths: Float32[NDArray[np.float32], "k h w"] | None,
    margin_m: float,
) -> Bool[NDArray[np.bool_], " n"]:
    """Say which points at least one of k views saw.

    A view sees a point that is in front of it, nearest to one of its pixels, and, where there are depth images [m], if
    that pixel has a depth and the point is at most `margin_m` behind it.
    """
    found = np.zeros(len(points_world), np.bool_)
    views = np.ascontiguousarray(T_world_camera, dtype=np.float64)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    images = np.zeros((0, camera.height, camera.width), np.float32) if depths is None else depths
    with kernel_threads():
        _visible(np.ascontiguousarray(points_world), lens, camera.width, camera.height, views, images, margin_m, found)
    return found


def visible_reference(
    points_world: Float[Tensor, "n 3"],
    camera: Camera,
    T_world_camera: Sequence[Float[Tensor, "4 4"]],
    depths: Sequence[Float[Tensor, "h w"]] | None,
    margin_m: float,
) -> Bool[Tensor, " n"]:
    """Return the same, view after view, on any device."""
    found = torch.zeros(len(points_world), dtype=torch.bool, device=points_world.device)
    for k, pose in enumerate(T_world_camera):
        x, y, z = ((points_world - pose[:3, 3]) @ pose[:3, :3]).unbind(1)
        front = z > _NEAREST_M
        safe = torch.where(front, z, torch.ones_like(z))
        u, v = (camera.fx * x / safe + camera.cx).round(), (camera.fy * y / safe + camera.cy).round()
        inside = front & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        if depths is not None:
            column, row = (torch.where(inside, i, torch.zeros_like(i)).long() for i in (u, v))
            depth = depths[k][row, column].to(z)
            inside &= (depth > 0) & (z <= depth + margin_m)
        found |= inside
    return found


@parallel_kernel
def _visible(
    points: np.ndarray,
    lens: np.ndarray,
    width: int,
    height: int,
    views: np.ndarray,
    images: np.ndarray,
    margin_m: float,
    found: np.ndarray,
) -> None:
    has_depth = len(images) > 0
    for n in numba.prange(len(points)):
        for k in range(len(views)):
            pose = views[k]
            x, y, z = points[n, 0] - pose[0, 3], points[n, 1] - pose[1, 3], points[n, 2] - pose[2, 3]
            depth = x * pose[0, 2] + y * pose[1, 2] + z * pose[2, 2]
            if not depth > _NEAREST_M:  # a point that is not finite is seen by nobody
                continue
            u = np.rint(lens[0] * (x * pose[0, 0] + y * pose[1, 0] + z * pose[2, 0]) / depth + lens[2])
            v = np.rint(lens[1] * (x * pose[0, 1] + y * pose[1, 1] + z * pose[2, 1]) / depth + lens[3])
            if not (u >= 0 and u < width and v >= 0 and v < height):
                continue
            if has_depth:
                measured = images[k, int(v), int(u)]
                if not (measured > 0 and depth <= measured + margin_m):
                    continue
            found[n] = True
            break
