"""Which keyframes a mapping step looks at."""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.pose import stacked

__all__ = ["KEYFRAME_POLICIES", "KeyframePolicy", "overlap", "select_keyframes"]

KeyframePolicy = Callable[[Sequence[Frame], Frame, int, torch.Generator], list[Frame]]
"""(candidates, current frame, how many, random numbers) -> at most that many, in any order."""

BLOCK = 32
"""Keyframes that are compared at once."""
NUM_PIXELS = 1600
BORDER_PX = 20.0


def select_keyframes(
    policy: str, keyframes: Sequence[Frame], frame: Frame, window: int, generator: torch.Generator
) -> list[Frame]:
    """Return the frames of a mapping window of size `window`: chosen keyframes, the latest keyframe, the current frame.

    As NICE-SLAM, Point-SLAM and SplaTAM do; "all" ignores the size, and "window" is the latest ones.
    """
    past = [k for k in keyframes if k.index != frame.index]
    if policy == "all" or len(past) + 1 <= window:
        return [*past, frame]
    if window <= 1 or not past:
        return [frame]
    chosen = KEYFRAME_POLICIES[policy](past[:-1], frame, window - 2, generator)
    return [*chosen, past[-1], frame]


def overlap(
    keyframes: Sequence[Frame],
    frame: Frame,
    generator: torch.Generator,
    num_pixels: int = NUM_PIXELS,
    border_px: float = BORDER_PX,
) -> Float[Tensor, " k"]:
    """Return, for each keyframe, the fraction of the frame's measured points that fall into its image.

    SplaTAM's rule: 1600 pixels with depth drawn with replacement, inside if 20 px from the border and in front. On
    small images the border is at most a tenth of the shorter side (20 px of 24 rows would leave nothing inside).
    """
    points_world = _measured(frame, generator, num_pixels)
    if not len(keyframes) or not len(points_world):
        return torch.zeros(len(keyframes))
    blocks = [keyframes[start : start + BLOCK] for start in range(0, len(keyframes), BLOCK)]
    return torch.cat([_seen(block, points_world, border_px) for block in blocks])


def _measured(frame: Frame, generator: torch.Generator, num_pixels: int = NUM_PIXELS) -> Float[Tensor, "n 3"]:
    """Return the points [m] in the world of measured pixels, drawn with replacement; none where nothing is measured."""
    points_camera = frame.points_camera()
    if not len(points_camera):
        return points_camera
    drawn = torch.randint(len(points_camera), (num_pixels,), generator=generator).to(points_camera.device)
    return se3.transform(frame.pose.matrix().detach(), points_camera[drawn])


@torch.no_grad()
def _seen(keyframes: Sequence[Frame], points_world: Float[Tensor, "n 3"], border_px: float) -> Float[Tensor, " k"]:
    """Return, for each of some keyframes, the fraction of the points that falls into its image.

    A point does where it lies inside four planes through the camera's centre: products of matrices, no division. One
    behind the camera is outside of one of two opposite planes.
    """
    sides = torch.tensor([_sides(keyframe.camera, border_px) for keyframe in keyframes]).to(points_world)
    T_keyframe_world = se3.inverse(stacked([keyframe.pose for keyframe in keyframes]))
    planes_world = (sides @ T_keyframe_world[:, :3]).transpose(0, 1).reshape(-1, 4)
    depths = torch.addmm(planes_world[:, 3:], planes_world[:, :3], points_world.mT)
    inside = depths.view(4, len(keyframes), -1).amin(0) >= 0
    return inside.to(torch.float32).mean(-1).cpu()


def _sides(camera: Camera, border_px: float) -> list[list[float]]:
    """Return the inward normals, in camera axes, of the planes that bound what a camera sees inside of a border."""
    border = min(border_px, 0.1 * min(camera.width, camera.height))
    left, top = camera.cx - border, camera.cy - border
    right, bottom = camera.width - 1 - border - camera.cx, camera.height - 1 - border - camera.cy
    return [[camera.fx, 0.0, left], [-camera.fx, 0.0, right], [0.0, camera.fy, top], [0.0, -camera.fy, bottom]]


def _random(keyframes: Sequence[Frame], frame: Frame, count: int, generator: torch.Generator) -> list[Frame]:
    order = torch.randperm(len(keyframes), generator=generator)[:count]
    return [keyframes[i] for i in order.tolist()]


def _overlap_random(keyframes: Sequence[Frame], frame: Frame, count: int, generator: torch.Generator) -> list[Frame]:
    """Return the first of a random order that see anything; the others need not be asked, however many there are."""
    points_world = _measured(frame, generator)
    order = _random(keyframes, frame, len(keyframes), generator)
    found: list[Frame] = []
    while order and len(found) < count and len(points_world):
        block, order = order[:BLOCK], order[BLOCK:]
        fractions = _seen(block, points_world, BORDER_PX).tolist()
        found += [k for k, fraction in zip(block, fractions, strict=True) if fraction > 0]
    return found[:count]


def _overlap_ranked(keyframes: Sequence[Frame], frame: Frame, count: int, generator: torch.Generator) -> list[Frame]:
    fractions = overlap(keyframes, frame, generator)
    order = torch.argsort(fractions, descending=True, stable=True)[:count].tolist()
    return [keyframes[i] for i in order if fractions[i] > 0]


def _latest(keyframes: Sequence[Frame], frame: Frame, count: int, generator: torch.Generator) -> list[Frame]:
    return list(keyframes[max(0, len(keyframes) - count) :])


def _all(keyframes: Sequence[Frame], frame: Frame, count: int, generator: torch.Generator) -> list[Frame]:
    return list(keyframes)


KEYFRAME_POLICIES: dict[str, KeyframePolicy] = {
    "random": _random,
    "overlap": _overlap_ranked,
    "overlap_random": _overlap_random,
    "window": _latest,
    "all": _all,
}
