"""Drawing rays from frames."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.batch import RayBatch
from xrdslam.core.errors import ConfigError
from xrdslam.core.frame import Frame

__all__ = ["sample_rays"]


def sample_rays(
    frames: Sequence[Frame],
    T_world_cameras: Sequence[Float[Tensor, "4 4"]],
    num_rays: int,
    generator: torch.Generator,
    border_px: int = 0,
) -> RayBatch:
    """Draw `num_rays` pixels, shared evenly between the frames, uniformly and with replacement, as world-frame rays.

    Poses may carry gradients; directions have z = 1 in their camera, so t along a ray is the depth. `border_px` keeps
    pixels away from the image border.
    """
    share = [num_rays // len(frames) + (slot < num_rays % len(frames)) for slot in range(len(frames))]
    parts = [
        _rays_of(frame, T_world_camera, count, slot, generator, border_px)
        for slot, (frame, T_world_camera, count) in enumerate(zip(frames, T_world_cameras, share, strict=True))
    ]
    return RayBatch(*(torch.cat(column) for column in zip(*parts, strict=True)))


def _rays_of(
    frame: Frame, T_world_camera: Tensor, count: int, slot: int, generator: torch.Generator, border_px: int
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    camera, device = frame.camera, frame.device
    if 2 * border_px >= min(camera.width, camera.height):
        raise ConfigError(
            f"border_px={border_px}: leaves no pixel of a {camera.width}x{camera.height} px image; "
            "lower algo.tracking.border_px or raise dataset.size"
        )
    u = torch.randint(border_px, camera.width - border_px, (count,), generator=generator).to(device)
    v = torch.randint(border_px, camera.height - border_px, (count,), generator=generator).to(device)
    directions_camera = camera.rays(torch.stack((u, v), -1).to(frame.rgb.dtype))
    directions = directions_camera @ T_world_camera[:3, :3].mT
    origins = T_world_camera[:3, 3].expand(count, 3)
    depth = frame.depth[v, u] if frame.depth is not None else frame.rgb.new_zeros(count)
    return origins, directions, frame.rgb[v, u], depth, torch.full((count,), slot, device=device)
