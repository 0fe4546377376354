"""Whether depth, poses, intrinsics and scale belong together: points of one frame, moved by the poses, on another.

A frame's points land where another measures them only if all of these are right. The same is computed under other
readings (poses inverted, axes of OpenGL, other scales and focal lengths), so that a wrong one is seen, and which.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3

__all__ = ["Agreement", "agreement"]

SAMPLES = 4000
GAPS = (1, 3, 10, 30)
BETTER = 0.6
"""A reading that misses by less than this share of what the present one misses is taken for the right one."""
LANDING = 0.4
MEANS_NOTHING = 0.5
"""How far off a point counts as that lands nowhere; a reading that misses by this much is worth nothing."""


class Agreement(NamedTuple):
    """How far points miss the measured depth, as a share of it (median over pairs): as read, and otherwise."""

    as_read: float
    otherwise: dict[str, float]
    num_pairs: int
    motion_m: float

    @property
    def better(self) -> str | None:
        """The reading under which depth agrees clearly better, if there is one."""
        name = min(self.otherwise, key=lambda key: self.otherwise[key], default=None)
        return name if name is not None and self.otherwise[name] < BETTER * self.as_read else None


@dataclasses.dataclass(frozen=True)
class Reading:
    """A way to read the same files; `scale` multiplies depth, `focal` the focal lengths."""

    pose: Callable[[Tensor], Tensor]
    scale: float = 1.0
    focal: float = 1.0


def _kept(T: Tensor) -> Tensor:
    return T


def _flipped(T: Tensor) -> Tensor:
    return T @ torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=T.dtype))


SCALES = (1e-3, 0.1, 0.2, 0.5, 2.0, 5.0, 10.0, 1e3)
FOCALS = (0.5, 0.6, 0.7, 0.84, 1.2, 1.4, 1.7, 2.0)
READINGS = {
    "poses are world-to-camera": Reading(se3.inverse),
    "poses have OpenGL's axes": Reading(_flipped),
    "poses are world-to-camera in OpenGL's axes": Reading(lambda T: _flipped(se3.inverse(T))),
    **{f"depth is {scale:g} times as far": Reading(_kept, scale=scale) for scale in SCALES},
    "depth is 0.1526 times as far (6553.5 levels a metre, not 1000)": Reading(_kept, scale=1000 / 6553.5),
    **{f"focal lengths are {focal:g} times as long": Reading(_kept, focal=focal) for focal in FOCALS},
}


def agreement(read: Callable[[int], Frame], num_frames: int) -> Agreement | None:
    """Compare pairs of frames a few to thirty apart; None where no two with depth and poses are left.

    Both the frames' motion and the share of points that land on measured depth are needed: without motion every reading
    agrees.
    """
    as_read: list[float] = []
    motion: list[float] = []
    otherwise: dict[str, list[float]] = {name: [] for name in READINGS}
    for first, second in _pairs(num_frames):
        one, other = read(first), read(second)
        if not (_is_usable(one) and _is_usable(other)):
            continue
        assert one.T_world_camera_gt is not None
        assert other.T_world_camera_gt is not None
        as_read.append(_miss(one, other, Reading(_kept)))
        for name, reading in READINGS.items():
            otherwise[name].append(_miss(one, other, reading))
        motion.append(float((one.T_world_camera_gt - other.T_world_camera_gt)[:3, 3].norm()))
    if not as_read:
        return None
    best = [k for k in range(len(as_read)) if min(as_read[k], *(m[k] for m in otherwise.values())) < MEANS_NOTHING]
    kept = best or list(range(len(as_read)))
    return Agreement(
        float(np.median(np.array(as_read)[kept])),
        {name: float(np.median(np.array(missed)[kept])) for name, missed in otherwise.items()},
        len(kept),
        float(np.median(motion)),
    )


def _pairs(num_frames: int) -> Iterator[tuple[int, int]]:
    starts: Sequence[int] = sorted({0, num_frames // 3, 2 * num_frames // 3})
    for start in starts:
        for gap in GAPS:
            if start + gap < num_frames:
                yield start, start + gap


def _is_usable(frame: Frame) -> bool:
    pose = frame.T_world_camera_gt
    return frame.depth is not None and pose is not None and bool(pose.isfinite().all())


def _miss(one: Frame, other: Frame, reading: Reading) -> float:
    """Return the median of |z - depth| / depth; where fewer points land on depth than `LANDING`, they miss outright."""
    assert one.depth is not None
    assert other.depth is not None
    assert one.T_world_camera_gt is not None
    assert other.T_world_camera_gt is not None
    camera = dataclasses.replace(one.camera, fx=one.camera.fx * reading.focal, fy=one.camera.fy * reading.focal)
    points = _sampled(one.depth, camera) * reading.scale
    T = se3.inverse(reading.pose(other.T_world_camera_gt.double())) @ reading.pose(one.T_world_camera_gt.double())
    pixels, z = camera.project(se3.transform(T, points))
    seen = (z > 0) & camera.contains(pixels)
    measured = _between_pixels(other.depth, pixels[seen]) * reading.scale
    errors = ((z[seen] - measured).abs() / measured)[measured > 0]
    if len(errors) < LANDING * len(points):
        return 1.0
    return min(float(errors.median()), 1.0)


def _between_pixels(depth: Tensor, pixels: Tensor) -> Tensor:
    """Return depth interpolated at pixels inside the image; 0 where one of the four around was not measured."""
    height, width = depth.shape
    u0, v0 = pixels.floor().long().unbind(-1)
    u0, v0 = u0.clamp(max=width - 2), v0.clamp(max=height - 2)
    right, down = pixels[:, 0] - u0, pixels[:, 1] - v0
    corners = [depth[v0 + dv, u0 + du].double() for dv in (0, 1) for du in (0, 1)]
    shares = [(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right]
    is_measured = torch.stack(corners).min(0).values > 0
    mean = torch.stack([c * w for c, w in zip(corners, shares, strict=True)]).sum(0)
    return torch.where(is_measured, mean, torch.zeros_like(mean))


def _sampled(depth: Tensor, camera: Camera) -> Tensor:
    """Return up to `SAMPLES` points of a depth image, evenly spread."""
    v, u = (depth > 0).nonzero().unbind(-1)
    step = max(1, len(v) // SAMPLES)
    v, u = v[::step], u[::step]
    return camera.unproject(torch.stack((u, v), -1).double(), depth[v, u].double())
