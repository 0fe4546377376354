"""Rays that keyframes left behind."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from xrdslam.core.batch import RayBatch
from xrdslam.core.frame import Frame

__all__ = ["RayBank"]


class RayBank:
    """A share of each keyframe's pixels: camera-frame direction, colour and depth, seven numbers a ray."""

    def __init__(self) -> None:
        self.indices: list[int] = []
        """Frame indices of the keyframes, in the order of their slots."""
        self.rays = torch.empty(0, 7)
        self.slots = torch.empty(0, dtype=torch.int64)

    def add(self, frame: Frame, share: float, generator: torch.Generator) -> None:
        """Draw from a keyframe, without replacement, over the whole image."""
        camera, depth = frame.camera, frame.depth
        pixels = camera.width * camera.height
        count = max(1, int(share * pixels))
        drawn = torch.randperm(pixels, generator=generator)[:count].to(frame.device)
        u, v = drawn % camera.width, drawn // camera.width
        directions = camera.rays(torch.stack((u, v), -1).to(frame.rgb.dtype))
        measured = frame.rgb.new_zeros(count) if depth is None else depth[v, u]
        rows = torch.cat((directions, frame.rgb[v, u], measured[:, None]), 1)
        slot = torch.full((count,), len(self.indices), device=frame.device)
        self.rays = torch.cat((self.rays.to(rows), rows))
        self.slots = torch.cat((self.slots.to(slot), slot))
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
        return in_world(self.rays[drawn], self.slots[drawn], rotations, centers)

    def state_dict(self) -> dict[str, Tensor]:
        """Return everything, for a resumed run."""
        indices = torch.tensor(self.indices, dtype=torch.int64)
        return {"indices": indices, "rays": self.rays.clone(), "slots": self.slots.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        self.indices = state["indices"].tolist()
        self.rays, self.slots = state["rays"].clone(), state["slots"].clone()


def in_world(
    rays: Float[Tensor, "n 7"],
    slots: Int64[Tensor, " n"],
    rotations: Float[Tensor, "k 3 3"],
    centers: Float[Tensor, "k 3"],
) -> RayBatch:
    """Turn rays into the world; gradients reach the poses, summed over their rays by a matrix product."""
    turned = (rotations.index_select(0, slots) @ rays[:, :3, None])[..., 0]
    return RayBatch(centers.index_select(0, slots), turned, rays[:, 3:6], rays[:, 6], slots)
