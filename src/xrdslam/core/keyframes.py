"""Which keyframes a mapping step looks at."""

import itertools
from collections.abc import Callable, Iterator, Sequence

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
    num_pixels: int = 1600,
    border_px: float = 20.0,
) -> Float[Tensor, " k"]:
    """Return, for each keyframe, the fraction of the frame's measured points that fall into its image.

    SplaTAM's rule: 1600 pixels with depth drawn with replacement, inside if 20 px from the border and in front. On
    small images the border is at most a tenth of the shorter side (20 px of 24 rows would leave nothing inside).
    """
    points_camera = frame.points_camera()
    if not len(keyframes) or not len(points_camera):
        return torch.zeros(len(keyframes))
    drawn = torch.randint(len(points_camera), (num_pixels,), generator=generator).to(points_camera.device)
    points_world = se3.transform(frame.pose.matrix().detach(), points_camera[drawn])
    fractions = torch.cat(
        [_seen(camera, T_keyframe_world, points_world, border_px) for camera, T_keyframe_world in _blocks(keyframes)]
    )
    return fractions.cpu()


def _seen(
    camera: Camera, T_keyframe_world: Float[Tensor, "k 4 4"], points_world: Float[Tensor, "n 3"], border_px: float
) -> Float[Tensor, " k"]:
    """Return, for each of some keyframes with one camera, the fraction of the points that falls into its image."""
    rotated = points_world @ T_keyframe_world[:, :3, :3].mT
    pixels, depth = camera.project(rotated + T_keyframe_world[:, None, :3, 3])
    border = min(border_px, 0.1 * min(camera.width, camera.height))
    return (camera.contains(pixels, border) & (depth > 0)).float().mean(-1)


def _blocks(keyframes: Sequence[Frame]) -> Iterator[tuple[Camera, Float[Tensor, "k 4 4"]]]:
    """Yield keyframes in blocks that fit a cache and have one camera: what they cost grows with the run."""
    with torch.no_grad():
        for camera, group in itertools.groupby(keyframes, key=lambda keyframe: keyframe.camera):
            block = list(group)
            for start in range(0, len(block), BLOCK):
                poses = stacked([keyframe.pose for keyframe in block[start : start + BLOCK]])
                yield camera, se3.inverse(poses)


def _random(keyframes: Sequence[Frame], frame: Frame, count: int, generator: torch.Generator) -> list[Frame]:
    order = torch.randperm(len(keyframes), generator=generator)[:count]
    return [keyframes[i] for i in order.tolist()]


def _overlap_random(keyframes: Sequence[Frame], frame: Frame, count: int, generator: torch.Generator) -> list[Frame]:
    fractions = overlap(keyframes, frame, generator)
    seen = [k for k, fraction in zip(keyframes, fractions.tolist(), strict=True) if fraction > 0]
    return _random(seen, frame, count, generator)


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
