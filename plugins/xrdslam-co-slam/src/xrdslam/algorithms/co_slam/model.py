"""The map of Co-SLAM: a field of truncated signed distance and colour in a box."""

from collections.abc import Sequence
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from xrdslam.algorithms.co_slam.config import CoSlamMapConfig
from xrdslam.algorithms.co_slam.field import JointField
from xrdslam.algorithms.co_slam.losses import ray_losses
from xrdslam.algorithms.co_slam.rendering import render_rays
from xrdslam.core.batch import Batch, BatchKind, RayBatch, Stage
from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.model import Model, Rendering, View
from xrdslam.core.optimisation import ParameterGroup
from xrdslam.core.surface import TriangleMesh
from xrdslam.ops.field_surface import field_surface, rendered_points
from xrdslam.ops.hash_grid import HashGridLayout, hash_grid
from xrdslam.ops.sampling import jittered, linear_depths, merged
from xrdslam.ops.volume_rendering import composite_sdf

__all__ = ["CoSlamMap"]


class CoSlamMap(Model):
    """Joint encoding of a box; outside of it the encoding goes on by the same rule, only less finely told apart."""

    batch_kind: ClassVar[BatchKind] = "rays"
    bounds: Float[Tensor, "2 3"]
    is_started: Tensor

    def __init__(self, config: CoSlamMapConfig, bounds: Float[Tensor, "2 3"], seed: int = 0) -> None:
        """Take the corners of the box [m]; the finest cells are `voxel_m` along its longest side."""
        super().__init__()
        self.config = config
        self.register_buffer("bounds", bounds.float())
        self.register_buffer("is_started", torch.zeros((), dtype=torch.bool))
        extent = float((bounds[1] - bounds[0]).max())
        self.layout = HashGridLayout.build(max(16, int(extent / config.voxel_m)), config.log2_rows)
        self.field = JointField(self.layout, seed)
        self.generator = torch.Generator().manual_seed(seed)

    @property
    def size(self) -> int:
        """Rows of the hash table, once the first frame has come."""
        return self.layout.num_rows if bool(self.is_started) else 0

    def extend(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> int:
        """Begin: the field has its size from the start."""
        added = self.layout.num_rows - self.size
        self.is_started.fill_(True)
        return added

    def parameter_groups(self) -> list[ParameterGroup]:
        """Return the decoder and the grid with the published rates, betas and epsilons."""
        betas = (0.9, 0.99)
        lr_grid, lr_decoder = self.config.lr_grid, self.config.lr_decoder
        return [
            ParameterGroup("decoder", self.field.decoder(), lr_decoder, betas, weight_decay=1e-6),
            ParameterGroup("grid", [self.field.table], lr_grid, betas, eps=1e-15),
        ]

    def to_unit(self, points_world: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
        """Map the box to the unit cube."""
        return (points_world - self.bounds[0]) / (self.bounds[1] - self.bounds[0])

    def query(self, points_world: Float[Tensor, "n 3"]) -> tuple[Float[Tensor, " n"], Float[Tensor, "n 3"]]:
        """Return signed distance [truncations] and colour."""
        distance, raw = self.field(self.to_unit(points_world))
        return distance, torch.sigmoid(raw)

    def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
        """Return the weighted losses of rays; smoothness joins them in mapping."""
        assert isinstance(batch, RayBatch), "the engine gives rays to maps of rays"
        config = self.config
        depths = self.sample(batch.depth)
        points = batch.origins_world[:, None] + depths[..., None] * batch.directions_world[:, None]
        sdf, rgb = self.query(points.reshape(-1, 3))
        sdf = sdf.reshape(depths.shape)
        seen = composite_sdf(sdf, rgb.reshape(*depths.shape, 3), depths, config.truncation_m)
        found = ray_losses(
            sdf, depths, seen.rgb, seen.depth, batch.rgb, batch.depth, config.truncation_m, config.rgb_without_depth
        )
        weighted = {
            "rgb": config.weight_rgb * found.rgb,
            "depth": config.weight_depth * found.depth,
            "sdf": config.weight_sdf * found.sdf,
            "free_space": config.weight_free_space * found.free_space,
        }
        if stage == "mapping" and config.weight_smoothness > 0 and config.smoothness_samples > 2:
            weighted["smoothness"] = config.weight_smoothness * self.smoothness()
        return weighted

    @torch.no_grad()
    def sample(self, depth: Float[Tensor, " n"]) -> Float[Tensor, "n s"]:
        """Return jittered depths: evenly from the camera to just behind the surface, and more about the surface.

        The published samples go on to `far_m`; what lies more than a truncation behind measured depth has neither
        weight nor loss. Where nothing was measured they do go on to `far_m`.
        """
        config = self.config
        has_depth = depth > 0
        end = torch.where(has_depth, depth + config.truncation_m, config.far_m)
        zeros = torch.zeros_like(depth)
        even = linear_depths(zeros, end, config.num_uniform)
        low = torch.where(has_depth, (depth - config.surface_range_m).clamp(min=0), zeros)
        high = torch.where(has_depth, depth + config.surface_range_m, config.far_m)
        close = linear_depths(low, high, config.num_near_surface)
        return jittered(merged(even, close), self.generator)

    def smoothness(self) -> Float[Tensor, ""]:
        """Return the squared feature differences of neighbours in a random cube of points (paper, equation 10)."""
        config, count = self.config, self.config.smoothness_samples
        extent = self.bounds[1] - self.bounds[0]
        step = torch.minimum(torch.full_like(extent, config.smoothness_voxel_m), extent / count)
        noise = torch.rand(2, 3, generator=self.generator).to(extent.device)
        corner = self.bounds[0] + noise[0] * (extent - step * count).clamp(min=0) + noise[1] * step
        side = torch.arange(count - 1, dtype=extent.dtype, device=extent.device)
        cube = torch.stack(torch.meshgrid(side, side, side, indexing="ij"), -1)
        points = self.to_unit((corner + cube * step).reshape(-1, 3))
        features = hash_grid(points, self.field.table, self.layout).reshape(*cube.shape[:3], -1)
        differences = [features.diff(dim=axis).square().sum() for axis in range(3)]
        return torch.stack(differences).sum() / count**3

    @torch.no_grad()
    def render(self, camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> Rendering:
        """Return what a camera sees: rays searched for the first surface, then sampled about it."""
        if self.size == 0:
            black = torch.zeros(camera.height, camera.width, 3, device=self.bounds.device)
            return Rendering(black, black[..., 0], black[..., 0])
        directions = camera.rays(device=self.bounds.device).reshape(-1, 3) @ T_world_camera[:3, :3].mT
        origins = T_world_camera[:3, 3].expand_as(directions)
        rgb, depth, opacity = render_rays(self.field, self.to_unit, self.bounds, origins, directions, self.config)
        shape = (camera.height, camera.width)
        return Rendering(rgb.reshape(*shape, 3), depth.reshape(shape), opacity.reshape(shape))

    @torch.no_grad()
    def mesh(self, views: Sequence[View]) -> TriangleMesh:
        """Return the zero surface near what the views see."""
        points = rendered_points(self, views)
        device = self.bounds.device
        return field_surface(
            points,
            self.config.mesh_voxel_m,
            lambda p: self.field.distance(self.to_unit(p.to(device))),
            lambda p: self.query(p.to(device))[1],
        )

    def get_extra_state(self) -> Tensor:
        """Return the state of the random numbers, for a resumed run."""
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Take over what `get_extra_state` returned."""
        self.generator.set_state(state)
