"""One moment of a sequence: what was measured, and where the camera is thought to be."""

from collections.abc import Collection
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from xrdslam.core.camera import Camera
from xrdslam.core.pose import OptimizablePose, RotationKind

__all__ = ["Frame", "ImuSamples", "StereoView"]


@dataclass(frozen=True)
class StereoView:
    """The right image of a rectified pair, as the frame's camera sees it from `baseline_m` to the right (its x)."""

    rgb: Float[Tensor, "h w 3"]
    baseline_m: float


@dataclass(frozen=True)
class ImuSamples:
    """Inertial samples since the frame before: angular velocity [rad/s], specific force [m/s^2], body axes."""

    timestamps_ns: Int64[Tensor, " n"]
    angular_velocity: Float[Tensor, "n 3"]
    acceleration: Float[Tensor, "n 3"]


class Frame(nn.Module):
    """A frame: images as buffers (`frame.to(device)` uploads them once), the pose as a module.

    `pose` is a working copy for optimisers; the trajectory of the Algorithm owns what is believed (see Algorithm).
    """

    rgb: Float[Tensor, "h w 3"]
    depth: Float[Tensor, "h w"] | None
    T_world_camera_gt: Float[Tensor, "4 4"] | None

    def __init__(
        self,
        index: int,
        timestamp_ns: int,
        camera: Camera,
        rgb: Float[Tensor, "h w 3"],
        depth: Float[Tensor, "h w"] | None = None,
        T_world_camera_gt: Float[Tensor, "4 4"] | None = None,
        imu: ImuSamples | None = None,
        rotation: RotationKind = "axis_angle",
        stereo: StereoView | None = None,
    ) -> None:
        """Hold rgb in [0, 1], depth [m] along z with 0 = no measurement, and start the pose at the identity."""
        super().__init__()
        if tuple(rgb.shape[:2]) != (camera.height, camera.width):
            size = (camera.height, camera.width)
            raise ValueError(f"image of {tuple(rgb.shape[:2])}, camera of {size} (rows, columns)")
        self.index = index
        self.timestamp_ns = timestamp_ns
        self.camera = camera
        self.imu = imu
        self.stereo = stereo
        self.register_buffer("rgb", rgb)
        self.register_buffer("depth", depth)
        self.register_buffer("T_world_camera_gt", T_world_camera_gt)
        self.pose = OptimizablePose.from_matrix(torch.eye(4, dtype=rgb.dtype, device=rgb.device), rotation)

    @property
    def device(self) -> torch.device:
        """Where the images are."""
        return self.rgb.device

    def fault(self, needs: Collection[str]) -> str | None:
        """Say why the frame is of no use to a method that needs these modalities, or None."""
        if not bool(torch.isfinite(self.rgb.sum())):
            return "its image is not finite"
        if "depth" not in needs or self.depth is None:
            return None
        if not bool(torch.isfinite(self.depth.sum())):
            return "its depth is not finite"
        return None if bool((self.depth > 0).any()) else "no pixel has a depth"

    def points_camera(self) -> Float[Tensor, "n 3"]:
        """Return the camera-frame points [m] of every pixel that has a depth, in raster order."""
        if self.depth is None:
            raise ValueError(f"frame {self.index} has no depth")
        rays = self.camera.rays(self.camera.pixels(self.depth.dtype, self.device))
        return (rays * self.depth[..., None])[self.depth > 0]
