"""The map of Vox-Fusion: sparse voxels where something was measured, features on their corners, one decoder."""

import logging
from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from xrdslam.algorithms.vox_fusion.config import VoxFusionMapConfig
from xrdslam.algorithms.vox_fusion.decoder import Decoder
from xrdslam.algorithms.vox_fusion.field import VoxelField
from xrdslam.algorithms.vox_fusion.losses import kept_rays, ray_losses
from xrdslam.algorithms.vox_fusion.rendering import render_rays
from xrdslam.algorithms.vox_fusion.surface import voxel_surface
from xrdslam.core.batch import Batch, BatchKind, RayBatch, Stage
from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.model import Model, Rendering, View
from xrdslam.core.optimisation import ParameterGroup
from xrdslam.core.surface import TriangleMesh
from xrdslam.ops.ragged_rendering import ragged_sdf_weights, ragged_sums
from xrdslam.ops.voxel_hash import SparseVoxels, traverse
from xrdslam.ops.voxel_rays import RaySamples, points_along, sample_hits

__all__ = ["VoxelMap"]

log = logging.getLogger(__name__)


class VoxelMap(Model):
    """Voxels never go; their corners' rows keep their places. Outside of voxels there is nothing: free space."""

    batch_kind: ClassVar[BatchKind] = "rays"
    coords: Tensor
    """Of every voxel, in the order of creation: from these the tables are made again."""

    def __init__(self, config: VoxFusionMapConfig, seed: int = 0) -> None:
        super().__init__()
        self.config = config
        self.generator = torch.Generator().manual_seed(seed)
        self.decoder = Decoder(config.features, config.width, self.generator)
        self.table = nn.Parameter(self._fresh(config.rows))
        self.grid = SparseVoxels(config.voxel_m)
        self.register_buffer("coords", torch.zeros(0, 3, dtype=torch.int32))
        self.precision = _usable(config.precision)

    @property
    def size(self) -> int:
        """Number of voxels."""
        return len(self.grid)

    def extend(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> int:
        """Create the voxels that hold a measured point; where the table is full, it doubles (see the mapper)."""
        points_camera = frame.points_camera()
        points_camera = points_camera[points_camera[:, 2] < self.config.max_depth_m]
        added = self.grid.insert(se3.transform(T_world_camera, points_camera))
        self.coords = self.grid.coords.clone().to(self.table.device)
        if self.grid.num_vertices > len(self.table):
            more = max(len(self.table), self.grid.num_vertices - len(self.table))
            with torch.no_grad():
                self.table = nn.Parameter(torch.cat((self.table, self._fresh(more).to(self.table))))
        return added

    def parameter_groups(self) -> list[ParameterGroup]:
        """Return the decoder and the features."""
        return [
            ParameterGroup("decoder", list(self.decoder.parameters()), self.config.lr_decoder),
            ParameterGroup("features", [self.table], self.config.lr_features),
        ]

    @property
    def field(self) -> VoxelField:
        """What the voxels hold."""
        return VoxelField(self.grid, self.table, self.decoder.weights, self.precision)

    def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
        """Return the weighted losses of the rays that have a depth and pass a voxel; in tracking without outliers."""
        assert isinstance(batch, RayBatch), "the engine gives rays to maps of rays"
        config = self.config
        samples = self.sample(batch)
        offsets, depths, rays = samples.offsets, samples.depths, samples.rays
        points = points_along(batch.origins_world, batch.directions_world, samples)

        def has_weight(sdf: Tensor) -> Tensor:
            return ragged_sdf_weights(sdf, depths, offsets, config.truncation_m) > config.min_color_weight

        sdf, rgb, chosen = self.field.at(points, samples.voxels, has_weight)
        weights = ragged_sdf_weights(sdf, depths, offsets, config.truncation_m)
        seen_depth = ragged_sums(weights * depths, offsets)
        seen_rgb = ragged_sums(weights[chosen, None] * rgb, torch.searchsorted(chosen, offsets))
        counts = samples.counts > 0
        if stage == "tracking":
            with torch.no_grad():
                variance = ragged_sums(weights * (depths - seen_depth[rays]).square(), offsets)
                counts = kept_rays(seen_depth - batch.depth, variance, counts, config.outlier_ratio)
        found = ray_losses(
            sdf,
            depths,
            rays,
            seen_rgb,
            seen_depth,
            batch.rgb,
            batch.depth,
            counts,
            config.truncation_m,
            config.padded_m / config.step_m,
            torch.where(self._far_before(batch, samples), float(config.free_space_every), 1.0),
        )
        return {
            "rgb": config.weight_rgb * found.rgb,
            "depth": config.weight_depth * found.depth,
            "sdf": config.weight_sdf * found.sdf,
            "free_space": config.weight_free_space * found.free_space,
        }

    @torch.no_grad()
    def sample(self, batch: RayBatch) -> RaySamples:
        """Sample rays within voxels up to a truncation behind the measured depth; those without a depth not at all.

        What lies farther has neither weight nor loss. Published rays are drawn where there is a depth. Far before the
        surface samples are thinned out, from a random one on: they only say that space is free.
        """
        depth, config = batch.depth, self.config
        has_depth = (depth > 0) & (depth < config.max_depth_m)
        far = torch.where(has_depth, depth + config.truncation_m, 0.0)
        hits = traverse(self.grid, batch.origins_world, batch.directions_world, far)
        samples = sample_hits(hits, config.step_m, self.generator, config.max_samples)
        if config.free_space_every == 1:
            return samples
        first = torch.randint(config.free_space_every, (1,), generator=self.generator).to(samples.offsets)
        place = torch.arange(len(samples.depths), device=samples.offsets.device) + first
        return samples.where(~self._far_before(batch, samples) | (place % config.free_space_every == 0))

    def _far_before(self, batch: RayBatch, samples: RaySamples) -> Bool[Tensor, " m"]:
        """Say which samples lie so far before the measured depth that the field is 1 there and has no weight."""
        return batch.depth[samples.rays] - samples.depths > 2 * self.config.truncation_m

    @torch.no_grad()
    def render(self, camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> Rendering:
        """Return what a camera sees: the first surface within the voxels that a ray passes."""
        directions = camera.rays(device=self.table.device).reshape(-1, 3) @ T_world_camera[:3, :3].mT
        origins = T_world_camera[:3, 3].expand_as(directions)
        rgb, depth, opacity = render_rays(self.field, origins, directions, self.config)
        shape = (camera.height, camera.width)
        return Rendering(rgb.reshape(*shape, 3), depth.reshape(shape), opacity.reshape(shape))

    @torch.no_grad()
    def mesh(self, views: Sequence[View]) -> TriangleMesh:
        """Return the zero surface within the voxels, whatever was seen of them."""
        return voxel_surface(self.field, self.config.mesh_resolution)

    def get_extra_state(self) -> Tensor:
        """Return the state of the random numbers, for a resumed run."""
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Take over what `get_extra_state` returned."""
        self.generator.set_state(state)

    def _load_from_state_dict(self, state_dict: dict[str, Any], prefix: str, *rest: Any) -> None:  # noqa: ANN401
        """Take on the size of the map that is loaded, then its values."""
        coords, table = state_dict[f"{prefix}coords"], state_dict[f"{prefix}table"]
        self.grid = SparseVoxels(self.config.voxel_m)
        self.grid.insert_cells(coords)
        self.coords = torch.zeros_like(coords, device=self.coords.device)
        if table.shape != self.table.shape:
            self.table = nn.Parameter(torch.empty_like(table, device=self.table.device))
        super()._load_from_state_dict(state_dict, prefix, *rest)

    def _fresh(self, rows: int) -> Float[Tensor, "rows f"]:
        """Return new features: N(0, 0.01^2), as published."""
        return 0.01 * torch.randn(rows, self.config.features, generator=self.generator)


def _usable(precision: str) -> torch.dtype:
    """Return the precision of the wide layers: bfloat16 where it is asked for and the processor multiplies it."""
    if precision == "float32":
        return torch.float32
    if torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported():
        log.info("algo.map.precision=bfloat16: the decoder's wide layers are multiplied in bfloat16")
        return torch.bfloat16
    log.warning("algo.map.precision=bfloat16: this processor does not multiply bfloat16; float32 is used")
    return torch.float32
