"""Rays that keyframes left behind."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from xrdslam.core.batch import RayBatch
from xrdslam.core.frame import Frame

__all__ = ["RayBank", "in_world", "rays_of"]


class RayBank:
    """A share of each keyframe's pixels: camera-frame direction, colour and depth, seven numbers a ray."""

    def __init__(self) -> None:
        self.indices: list[int] = []
        """Frame indices of the keyframes, in the order of their slots."""
        self._table = torch.empty(0, 7)
        self._num_rays = 0

    @property
    def rays(self) -> Float[Tensor, "n 7"]:
        """All of them, as many of each keyframe, keyframe after keyframe."""
        return self._table[: self._num_rays]

    def add(self, frame: Frame, share: float, generator: torch.Generator) -> None:
        """Draw from a keyframe, without replacement, over the whole image."""
        pixels = frame.camera.width * frame.camera.height
        count = max(1, int(share * pixels))
        rows = rays_of(frame, torch.randperm(pixels, generator=generator)[:count].to(frame.device))
        end = self._num_rays + count
        if end > len(self._table):
            table = rows.new_empty(max(end, 2 * len(self._table)), 7)
            table[: self._num_rays] = self.rays
            self._table = table
        self._table[self._num_rays : end] = rows
        self._num_rays = end
        self.indices.append(frame.index)

    def draw(
        self,
        count: int,
        rotations: Float[Tensor, "k 3 3"],
        centers: Float[Tensor, "k 3"],
        generator: torch.Generator,
    ) -> RayBatch:
        """Draw rays uniformly from all keyframes, in the world by the poses of their slots."""
        drawn = torch.randint(len(self.rays), (count,), generator=generator).to(self.rays.device)
        each = self._num_rays // len(self.indices)
        return in_world(self.rays[drawn], drawn // each, rotations, centers)

    def state_dict(self) -> dict[str, Tensor]:
        """Return everything, for a resumed run."""
        indices = torch.tensor(self.indices, dtype=torch.int64)
        return {"indices": indices, "rays": self.rays.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        self.indices = state["indices"].tolist()
        self._table, self._num_rays = state["rays"].clone(), len(state["rays"])


def rays_of(frame: Frame, pixels: Int64[Tensor, " n"]) -> Float[Tensor, "n 7"]:
    """Return direction, colour and depth (0 where none was measured) of pixels, counted row by row."""
    u, v = pixels % frame.camera.width, pixels // frame.camera.width
    directions = frame.camera.rays(torch.stack((u, v), -1).to(frame.rgb.dtype))
    depth = frame.rgb.new_zeros(len(pixels)) if frame.depth is None else frame.depth[v, u]
    return torch.cat((directions, frame.rgb[v, u], depth[:, None]), 1)


def in_world(
    rays: Float[Tensor, "n 7"],
    slots: Int64[Tensor, " n"],
    rotations: Float[Tensor, "k 3 3"],
    centers: Float[Tensor, "k 3"],
) -> RayBatch:
    """Turn rays into the world; gradients reach the poses, summed over their rays by a matrix product."""
    turned = (rotations.index_select(0, slots) @ rays[:, :3, None])[..., 0]
    return RayBatch(centers.index_select(0, slots), turned, rays[:, 3:6], rays[:, 6], slots)
