"""The toy's map: one coloured point a voxel."""

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.model import Model, Rendering
from xrdslam.core.surface import PointCloud

__all__ = ["PointMap"]

NEAR = 0.05
"""Points nearer than this [m] are not drawn."""
OFFSETS = torch.tensor([-1.0, 0.0, 1.0])


class PointMap(Model):
    """World-frame points [m] and their colours, at most one point in each voxel."""

    points: Float[Tensor, "n 3"]
    colors: Float[Tensor, "n 3"]

    def __init__(self, voxel: float) -> None:
        super().__init__()
        self.voxel = voxel
        self.register_buffer("points", torch.empty(0, 3))
        self.register_buffer("colors", torch.empty(0, 3))

    @property
    def size(self) -> int:
        return len(self.points)

    def extend(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> int:
        """Add the first point, in raster order, of every voxel that has none."""
        if frame.depth is None:
            return 0
        seen = se3.transform(T_world_camera, frame.points_camera())
        colors = frame.rgb[frame.depth > 0]
        is_finite = (seen.isfinite() & colors.isfinite()).all(1)
        points = torch.cat((self.points, seen[is_finite]))
        colors = torch.cat((self.colors, colors[is_finite]))
        first = self._first_of_each_voxel(points)
        added = len(first) - self.size
        self.points, self.colors = points[first], colors[first]
        return added

    def _first_of_each_voxel(self, points: Float[Tensor, "n 3"]) -> Tensor:
        """Return, in order, the rows that come first in their voxel; the map's own points come before any other."""
        _, voxel_of = torch.unique(torch.floor(points / self.voxel), dim=0, return_inverse=True)
        rows = torch.arange(len(points), device=points.device)
        first = torch.full_like(rows, len(points)).scatter_reduce(0, voxel_of, rows, "amin")
        return first[first < len(points)].sort().values

    def render(self, camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> Rendering:
        """Draw every point as a square of 3 x 3 pixels; the nearest wins, and of equally near ones the oldest."""
        points_camera = se3.transform(se3.inverse(T_world_camera), self.points)
        pixels, z = camera.project(points_camera)
        squares = pixels.round()[:, None] + torch.cartesian_prod(OFFSETS, OFFSETS).to(pixels)
        drawn = camera.contains(squares) & (z > NEAR)[:, None]
        rows = torch.arange(self.size, device=z.device)[:, None].expand_as(drawn)[drawn]
        pixel_of = (squares[drawn] @ squares.new_tensor([1.0, camera.width])).long()
        num_pixels = camera.width * camera.height
        nearest = z.new_full((num_pixels,), torch.inf).scatter_reduce(0, pixel_of, z[rows], "amin")
        wins = z[rows] == nearest[pixel_of]
        owner = rows.new_full((num_pixels,), self.size).scatter_reduce(0, pixel_of[wins], rows[wins], "amin")
        is_seen = owner < self.size
        rgb, depth = z.new_zeros(num_pixels, 3), z.new_zeros(num_pixels)
        rgb[is_seen], depth[is_seen] = self.colors[owner[is_seen]], nearest[is_seen]
        size = (camera.height, camera.width)
        return Rendering(rgb.reshape(*size, 3), depth.reshape(size), is_seen.to(z).reshape(size))

    def point_cloud(self) -> PointCloud:
        """Return the points."""
        return PointCloud(self.points.cpu().numpy(), self.colors.cpu().numpy())
