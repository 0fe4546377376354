"""The map of NICE-SLAM: a field in a box that grows with what is seen."""

from collections.abc import Sequence
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from xrdslam.algorithms.nice_slam.config import NiceSlamMapConfig
from xrdslam.algorithms.nice_slam.field import Level, NiceField
from xrdslam.algorithms.nice_slam.frustum import seen_by
from xrdslam.algorithms.nice_slam.losses import mapping_losses, tracking_losses
from xrdslam.algorithms.nice_slam.rays import exit_depths, sample_depths, see
from xrdslam.algorithms.nice_slam.rendering import render_rays
from xrdslam.core.batch import Batch, BatchKind, RayBatch, Stage
from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.model import Model, Rendering, View
from xrdslam.core.optimisation import ParameterGroup
from xrdslam.core.surface import TriangleMesh
from xrdslam.ops.field_surface import field_surface, rendered_points

__all__ = ["NiceSlamMap", "bounds_of"]

_MESH_VIEWS = 50


class NiceSlamMap(Model):
    """Grids over a box; beyond it everything is solid."""

    batch_kind: ClassVar[BatchKind] = "rays"
    bounds: Float[Tensor, "2 3"]
    visited: Float[Tensor, "k 4 4"]
    """T_world_camera of the frames that were mapped."""

    def __init__(
        self, config: NiceSlamMapConfig, bounds: Float[Tensor, "2 3"], grows: bool = True, seed: int = 0
    ) -> None:
        """Take the corners of the box [m], and whether it grows."""
        super().__init__()
        self.config = config
        self.grows = grows
        self.generator = torch.Generator().manual_seed(seed)
        self.field = NiceField(config, bounds, self.generator)
        self.register_buffer("bounds", bounds.float())
        self.register_buffer("visited", torch.zeros(0, 4, 4))
        self.level: Level = "color"
        """What takes part in the mapping losses."""

    @property
    def size(self) -> int:
        """Vertices of all grids, once the first frame has come."""
        return sum(len(grid.table) for grid in self.field.grids) if len(self.visited) else 0

    @torch.no_grad()
    def extend(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> int:
        """Begin, and enlarge the box by what the frame sees beyond it."""
        before = self.size
        self.visited = torch.cat((self.visited, T_world_camera.detach()[None].to(self.visited)))
        if self.grows:
            found = bounds_of(frame, T_world_camera, self.config.margin_m).to(self.bounds)
            wanted = torch.stack((torch.minimum(found[0], self.bounds[0]), torch.maximum(found[1], self.bounds[1])))
            if not torch.equal(wanted, self.bounds):
                for grid in self.field.grids:
                    grid.grow(wanted, self.generator)
                self.bounds.copy_(wanted)
        return self.size - before

    def parameter_groups(self) -> list[ParameterGroup]:
        """Return all grids and the colour decoder, with the rates of the last level."""
        rate = self.config.lr_grid
        names = ("middle", "fine", "color")
        tables = [ParameterGroup(n, [g.table], rate) for n, g in zip(names, self.field.grids, strict=True)]
        return [*tables, ParameterGroup("decoder", list(self.field.color_decoder.parameters()), self.config.lr_decoder)]

    def choose(self, frames: Sequence[Frame], margin_m: float) -> tuple[nn.Parameter, ...]:
        """Let an optimiser see only the features that the frames can say something about; `settle` ends that."""
        values = []
        for grid in self.field.grids:
            vertices = grid.layout.vertices(self.bounds.device)
            seen = torch.stack([seen_by(vertices, frame, margin_m) for frame in frames]).any(0)
            values.append(grid.choose(seen.nonzero()[:, 0]))
        return tuple(values)

    def settle(self) -> None:
        """Take the features over that an optimiser moved."""
        for grid in self.field.grids:
            grid.settle()

    def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
        """Return the weighted losses of rays, without those whose measured point lies beyond the box."""
        assert isinstance(batch, RayBatch), "the engine gives rays to maps of rays"
        config = self.config
        ends = exit_depths(batch.origins_world.detach(), batch.directions_world.detach(), self.bounds)
        kept = ((ends > 0.01) & (ends >= batch.depth)).nonzero()[:, 0]
        origins, directions = batch.origins_world[kept], batch.directions_world[kept]
        rgb, depth, ends = batch.rgb[kept], batch.depth[kept], ends[kept]
        depths = sample_depths(depth, ends, config, self.generator)
        level: Level = self.level if stage == "mapping" else "color"
        seen = see(self.field, origins, directions, depths, ends, level)
        if stage == "tracking":
            found = tracking_losses(seen, rgb, depth, config.outlier_factor)
            return {"depth": found.depth, "rgb": config.tracking_weight_rgb * found.rgb}
        found = mapping_losses(seen, rgb, depth)
        return {"depth": found.depth} | ({"rgb": config.weight_rgb * found.rgb} if level == "color" else {})

    @torch.no_grad()
    def render(self, camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> Rendering:
        """Return what a camera sees: rays searched for the first surface, then sampled about it."""
        if self.size == 0:
            black = torch.zeros(camera.height, camera.width, 3, device=self.bounds.device)
            return Rendering(black, black[..., 0], black[..., 0])
        directions = camera.rays(device=self.bounds.device).reshape(-1, 3) @ T_world_camera[:3, :3].mT
        origins = T_world_camera[:3, 3].expand_as(directions)
        rgb, depth, opacity = render_rays(self.field, self.bounds, origins, directions, self.config.render_step_m)
        shape = (camera.height, camera.width)
        return Rendering(rgb.reshape(*shape, 3), depth.reshape(shape), opacity.reshape(shape))

    @torch.no_grad()
    def mesh(self, views: Sequence[View]) -> TriangleMesh:
        """Return the surface of occupancy 1/2 near what the views and the frames between them saw.

        Keyframes are far apart here: every mapped frame is looked from, or evenly some of them where there are many.
        """
        stride = max(1, len(self.visited) // _MESH_VIEWS)
        between = [View(views[0].camera, pose) for pose in self.visited[::stride]] if views else []
        points = rendered_points(self, [*views, *between])
        device = self.bounds.device
        return field_surface(
            points,
            self.config.mesh_voxel_m,
            lambda p: -self.field.logits(p.to(device)),
            lambda p: self.field.rgb(p.to(device)),
        )

    def _load_from_state_dict(self, state_dict: dict[str, Tensor], prefix: str, *args: Any) -> None:  # noqa: ANN401
        """Take the number of frames from the state."""
        self.visited = torch.empty_like(state_dict[prefix + "visited"], device=self.visited.device)
        super()._load_from_state_dict(state_dict, prefix, *args)

    def get_extra_state(self) -> Tensor:
        """Return the state of the random numbers, for a resumed run."""
        return self.generator.get_state()

    def set_extra_state(self, state: Tensor) -> None:
        """Take over what `get_extra_state` returned."""
        self.generator.set_state(state)


def bounds_of(
    frame: Frame, T_world_camera: Float[Tensor, "4 4"], margin_m: float, share: float = 0.999
) -> Float[Tensor, "2 3"]:
    """Return the box [m] of the camera and what it measured, `margin_m` wider to every side.

    A few outliers (all but `share` of an axis) are left out.
    """
    centre = T_world_camera[:3, 3]
    points = se3.transform(T_world_camera, frame.points_camera()[::7]).sort(0).values
    last = len(points) - 1
    if last < 0:
        return torch.stack((centre - margin_m, centre + margin_m)).detach().cpu()
    low, high = points[round(last * (1 - share))], points[round(last * share)]
    low, high = torch.minimum(low, centre), torch.maximum(high, centre)
    return torch.stack((low - margin_m, high + margin_m)).detach().cpu()
