"""What an optimisation step looks at: a whole image, or a bundle of rays from several frames."""

from dataclasses import dataclass
from typing import Literal

from jaxtyping import Float, Int64
from torch import Tensor

from xrdslam.core.frame import Frame

__all__ = ["Batch", "BatchKind", "ImageBatch", "RayBatch", "Stage"]

BatchKind = Literal["image", "rays"]
Stage = Literal["tracking", "mapping"]


@dataclass
class ImageBatch:
    """One frame at one pose; the pose may carry a gradient."""

    frame: Frame
    T_world_camera: Float[Tensor, "4 4"]


@dataclass
class RayBatch:
    """World-frame rays, directions with z = 1 in their camera, so that the ray parameter is the depth along z.

    `frame_slot` says from which of the batch's poses a ray comes; origins and directions carry the poses' gradients.
    """

    origins_world: Float[Tensor, "n 3"]
    directions_world: Float[Tensor, "n 3"]
    rgb: Float[Tensor, "n 3"]
    depth: Float[Tensor, " n"]
    frame_slot: Int64[Tensor, " n"]


Batch = ImageBatch | RayBatch
