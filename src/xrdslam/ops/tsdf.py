"""Fusion of depth and colour images into a truncated signed distance field, and its surface."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.geometry import se3
from xrdslam.core.surface import TriangleMesh
from xrdslam.ops import tsdf_kernels as kernels
from xrdslam.ops.coordinate_hash import rehash
from xrdslam.ops.isosurface import extract

__all__ = ["TsdfVolume"]


class TsdfVolume:
    """A sparse field of signed distances [truncations], weights and colours, positive in front of the surface.

    Only blocks of 8^3 samples near a measured surface exist, 12 KiB each: memory follows the surface's area (at
    most twice that while it grows). Works on
    the CPU; images from elsewhere are brought there. The same views in the same order give the same bits for any number
    of threads. See `tsdf_reference.integrate` for the equations.
    """

    def __init__(self, voxel_m: float = 0.01, truncation_m: float = 0.04) -> None:
        """Start empty; a truncation of about four voxels is usual, and it must exceed one."""
        if not 0 < voxel_m < truncation_m < float("inf"):
            raise ValueError(f"voxel_m={voxel_m}, truncation_m={truncation_m}: must be 0 < voxel_m < truncation_m")
        self.voxel_m = voxel_m
        self.truncation_m = truncation_m
        self.num_blocks = 0
        side = kernels.SIDE
        self._coords = np.zeros((0, 3), np.int32)
        self._tsdf = np.zeros((0, side, side, side), np.float32)
        self._weights = np.zeros((0, side, side, side), np.float32)
        self._colors = np.zeros((0, side, side, side, 4), np.float32)  # and their own weight
        self._resize(1024)

    def integrate(
        self,
        rgb: Float[Tensor, "h w 3"],
        depth: Float[Tensor, "h w"],
        camera: Camera,
        T_world_camera: Float[Tensor, "4 4"],
        weight: Float[Tensor, "h w"] | None = None,
    ) -> None:
        """Average a view in. Depth 0 (or not finite) is no measurement: put it where a map's opacity is too low.

        `weight` says how much each pixel counts; by default they all count the same.
        """
        if tuple(depth.shape) != (camera.height, camera.width) or min(depth.shape) < 2:
            raise ValueError(f"depth of shape {tuple(depth.shape)}, camera of {camera.height}x{camera.width} px")
        pixel_weights = torch.ones_like(depth) if weight is None else weight
        usable = torch.isfinite(depth) & (depth > 0) & (pixel_weights > 0)
        depths = _array(torch.where(usable, depth, torch.zeros_like(depth)))
        if not depths.any():
            return
        pose = T_world_camera.detach().cpu().double()
        intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self._allocate(depths, intrinsics, pose.numpy())
        kernels.integrate(
            self._coords,
            self.num_blocks,
            self._tsdf,
            self._weights,
            self._colors,
            _array(rgb),
            depths,
            _array(pixel_weights),
            intrinsics,
            np.ascontiguousarray(se3.inverse(pose).numpy()),
            self.voxel_m,
            self.truncation_m,
        )

    def mesh(self, min_weight: float = 0.0) -> TriangleMesh:
        """Return the coloured surface; a cell takes part when all its corners weigh more than `min_weight`.

        One view gives a point weight 1 in front of the surface, less behind it. The mesh is closed across blocks.
        """
        count = self.num_blocks
        arrays = self._tsdf, self._weights, self._colors
        return extract(self._keys, self._rows, self._coords[:count], *arrays, self.voxel_m, min_weight)

    def _allocate(self, depth: np.ndarray, intrinsics: np.ndarray, T_world_camera: np.ndarray) -> None:
        """Enter the blocks around a view's points, making room where it is needed."""
        pixel = 0
        while pixel < depth.size:
            pixel, self.num_blocks = kernels.allocate(
                depth,
                intrinsics,
                T_world_camera,
                self.voxel_m,
                self.truncation_m,
                self._keys,
                self._rows,
                self._coords,
                self.num_blocks,
                pixel,
            )
            if pixel < depth.size:
                per_pixel = (int(np.ceil(2 * self.truncation_m / (self.voxel_m * kernels.SIDE))) + 2) ** 3
                self._resize(2 * len(self._coords) + per_pixel)

    def _resize(self, capacity: int) -> None:
        """Make room for `capacity` blocks; the hash table stays at most half full."""
        count = self.num_blocks
        self._coords = _grown(self._coords, capacity, count)
        self._tsdf = _grown(self._tsdf, capacity, count)
        self._weights = _grown(self._weights, capacity, count)
        self._colors = _grown(self._colors, capacity, count)
        size = 1 << (2 * capacity - 1).bit_length()
        self._keys = np.full(size, -1, np.int64)
        self._rows = np.full(size, -1, np.int32)
        rehash(self._keys, self._rows, self._coords, count)


def _grown(array: np.ndarray, capacity: int, count: int) -> np.ndarray:
    """Return a longer copy: the first `count` rows, then zeros (which take no memory before they are written)."""
    longer = np.zeros((capacity, *array.shape[1:]), array.dtype)
    longer[:count] = array[:count]
    return longer


def _array(image: Tensor) -> np.ndarray:
    """Return an image as a contiguous float32 array."""
    array: np.ndarray = image.detach().to("cpu", torch.float32).contiguous().numpy()
    return array
