"""The pinhole camera: intrinsics, their behaviour under resizing and cropping, rays, projection."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from xrdslam.core.errors import DataError

__all__ = ["Camera"]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera in OpenCV axes (x right, y down, z forward); pixel (0, 0) is the centre of the first pixel.

    u = fx x/z + cx, v = fy y/z + cy. `distortion` holds OpenCV's coefficients (k1, k2, p1, p2[, k3...]); every method
    below treats the camera as already undistorted, `undistort_maps` gets an image there.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise DataError(f"camera size {self.width}x{self.height}: both sides must be at least one pixel")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(math.isfinite(v) for v in numbers) or self.fx <= 0 or self.fy <= 0:
            raise DataError(
                f"camera intrinsics fx={self.fx}, fy={self.fy}, cx={self.cx}, cy={self.cy}: "
                "focal lengths must be positive and everything finite; check the intrinsics of the dataset"
            )
        if len(self.distortion) not in (0, 4, 5, 8, 12, 14):
            raise DataError(
                f"camera distortion {self.distortion}: OpenCV's models have 4, 5, 8, 12 or 14 coefficients "
                "(k1, k2, p1, p2[, k3...]); pad with zeros, or leave it empty for none"
            )

    def K(self, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu") -> Float[Tensor, "3 3"]:
        """Return the intrinsic matrix."""
        rows = [[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]]
        return torch.tensor(rows, dtype=dtype, device=device)

    def resized(self, width: int, height: int) -> "Camera":
        """Return the camera of the image resized to `width` x `height` px.

        Half-pixel rule: the image *area* is what scales, so u' = (u + 1/2) s - 1/2.
        """
        sx, sy = width / self.width, height / self.height
        return dataclasses.replace(
            self,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=(self.cx + 0.5) * sx - 0.5,
            cy=(self.cy + 0.5) * sy - 0.5,
            width=width,
            height=height,
        )

    def cropped(self, left: int, top: int, width: int, height: int) -> "Camera":
        """Return the camera of the window whose first pixel is (left, top); it must lie inside the image."""
        if left < 0 or top < 0 or left + width > self.width or top + height > self.height:
            raise DataError(
                f"crop of {width}x{height} px at ({left}, {top}) leaves the {self.width}x{self.height} px image"
            )
        return dataclasses.replace(self, cx=self.cx - left, cy=self.cy - top, width=width, height=height)

    def undistort_maps(self) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
        """Return the maps (x, y) [px] by which `cv2.remap` undistorts an image, K kept; colour and depth share them."""
        import cv2

        matrix = self.K(torch.float64).numpy()
        coefficients = np.asarray(self.distortion or (0.0,) * 4)
        size = (self.width, self.height)
        map_x, map_y = cv2.initUndistortRectifyMap(matrix, coefficients, None, matrix, size, cv2.CV_32FC1)
        return map_x, map_y

    def undistorted(self) -> "Camera":
        """Return the camera of an image that went through `undistort_maps`."""
        return dataclasses.replace(self, distortion=())

    def pixels(self, dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu") -> Float[Tensor, "h w 2"]:
        """Return every pixel's (u, v) [px]."""
        v, u = torch.meshgrid(
            torch.arange(self.height, dtype=dtype, device=device),
            torch.arange(self.width, dtype=dtype, device=device),
            indexing="ij",
        )
        return torch.stack((u, v), -1)

    def rays(
        self, pixels: Float[Tensor, "*batch 2"] | None = None, device: torch.device | str = "cpu"
    ) -> Float[Tensor, "*rays 3"]:
        """Return camera-frame directions with z = 1, so that the ray parameter *is* the depth; default: every pixel."""
        uv = self.pixels(device=device) if pixels is None else pixels
        x = (uv[..., 0] - self.cx) / self.fx
        y = (uv[..., 1] - self.cy) / self.fy
        return torch.stack((x, y, torch.ones_like(x)), -1)

    def project(
        self, points_camera: Float[Tensor, "*batch 3"]
    ) -> tuple[Float[Tensor, "*batch 2"], Float[Tensor, "*batch"]]:
        """Return pixels [px] and depths z [m]; pixels of points with z <= 0 are meaningless: test the depth first."""
        x, y, z = points_camera.unbind(-1)
        safe = torch.where(z.abs() > 1e-9, z, torch.full_like(z, 1e-9))
        return torch.stack((self.fx * x / safe + self.cx, self.fy * y / safe + self.cy), -1), z

    def unproject(self, pixels: Float[Tensor, "*batch 2"], depth: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch 3"]:
        """Return camera-frame points [m] of pixels [px] at depth z [m]."""
        return self.rays(pixels) * depth[..., None]

    def contains(self, pixels: Float[Tensor, "*batch 2"], border_px: float = 0.0) -> Tensor:
        """Say which pixels lie inside the image, at least `border_px` from its outermost pixel centres."""
        u, v = pixels.unbind(-1)
        inside_u = (u >= border_px) & (u <= self.width - 1 - border_px)
        return inside_u & (v >= border_px) & (v <= self.height - 1 - border_px)
