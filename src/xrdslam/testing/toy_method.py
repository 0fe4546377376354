"""A complete method in a hundred lines, for tests of what surrounds methods: its map can equal the toy room exactly."""

from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.batch import Batch, BatchKind, ImageBatch, Stage
from xrdslam.core.camera import Camera
from xrdslam.core.config import AlgorithmConfig, IterativeMappingConfig, IterativeTrackingConfig
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.core.mapping import GradientMapping
from xrdslam.core.model import Model, Rendering
from xrdslam.core.optimisation import ParameterGroup
from xrdslam.core.tracking import GradientTracking
from xrdslam.testing.toy_room import NUM_WAVES, PAINT, WALLS, colour, distance_to_walls

__all__ = ["ToyAlgorithm", "ToyModel", "ToyRayModel", "toy_algorithm"]


class ToyModel(Model):
    """A box of painted walls: six wall positions [m] and the amplitudes of the paint, one row a primitive.

    The first frame brings four waves of paint and each later one another, up to all that the toy room has.
    """

    walls: nn.Parameter
    amplitudes: nn.Parameter

    def __init__(self) -> None:
        super().__init__()
        self.walls = nn.Parameter(torch.zeros(2, 3))
        self.amplitudes = nn.Parameter(torch.zeros(0, 3))

    @classmethod
    def exact(cls) -> "ToyModel":
        """Return the map that equals the toy room without its balls."""
        model = cls()
        model.walls = nn.Parameter(WALLS.float())
        model.amplitudes = nn.Parameter(PAINT.float())
        return model

    @property
    def size(self) -> int:
        return len(self.amplitudes)

    def extend(self, frame: Frame, T_world_camera: Float[Tensor, "4 4"]) -> int:
        """Stretch the box to what is seen, and add paint (zero, so that nothing changes until it is optimised)."""
        points = se3.transform(T_world_camera, frame.points_camera())
        seen = torch.cat((points, T_world_camera[None, :3, 3]))
        if self.size:
            seen = torch.cat((seen, self.walls.detach()))
        added = min(4 if self.size == 0 else 1, NUM_WAVES - self.size)
        with torch.no_grad():
            self.walls.copy_(torch.stack((seen.amin(0), seen.amax(0))))
        grown = torch.cat((self.amplitudes.detach(), self.amplitudes.new_zeros(added, 3)))
        self.amplitudes = nn.Parameter(grown)
        return added

    def parameter_groups(self) -> list[ParameterGroup]:
        return [ParameterGroup("walls", [self.walls], 1e-3), ParameterGroup("paint", [self.amplitudes], 2e-2)]

    def losses(self, batch: Batch, stage: Stage) -> dict[str, Tensor]:
        """Return mean squared errors of colour, and of depth where there is one."""
        if isinstance(batch, ImageBatch):
            origins, directions = _rays(batch.frame.camera, batch.T_world_camera)
            rgb, depth = batch.frame.rgb.reshape(-1, 3), batch.frame.depth
            measured = torch.zeros_like(rgb[:, 0]) if depth is None else depth.reshape(-1)
        else:
            origins, directions, rgb, measured = batch.origins_world, batch.directions_world, batch.rgb, batch.depth
        t = distance_to_walls(origins, directions, self.walls)
        errors = colour(origins + t[:, None] * directions, self.amplitudes) - rgb
        valid = measured > 0
        depth_sq = torch.where(valid, t - measured, torch.zeros_like(t)).square().sum() / valid.sum().clamp(min=1)
        return {"rgb": errors.square().mean(), "depth": depth_sq}

    def render(self, camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> Rendering:
        origins, directions = _rays(camera, T_world_camera)
        t = distance_to_walls(origins, directions, self.walls).clamp(min=0)
        seen = (t > 0) & (self.size > 0)
        rgb = torch.where(seen[:, None], colour(origins + t[:, None] * directions, self.amplitudes), 0.0)
        images = (rgb, torch.where(seen, t, 0.0)[:, None], seen.to(t)[:, None])
        rgb, depth, opacity = (image.reshape(camera.height, camera.width, -1) for image in images)
        return Rendering(rgb, depth[..., 0], opacity[..., 0])


class ToyRayModel(ToyModel):
    """The same map, read through bundles of rays."""

    batch_kind: ClassVar[BatchKind] = "rays"


class ToyAlgorithm(Algorithm):
    """Follows and paints the toy room by gradient descent; `model_class` says which kind of batches its map reads."""

    model_class: type[ToyModel] = ToyModel

    def build_model(self, scene: Scene, frame: Frame) -> Model:
        return self.model_class()


def toy_algorithm(
    seed: int = 0,
    model_class: type[ToyModel] = ToyModel,
    tracking: IterativeTrackingConfig | None = None,
    mapping: IterativeMappingConfig | None = None,
    **settings: object,
) -> ToyAlgorithm:
    """Build the toy method; `settings` are the algorithm's own."""
    tracking = tracking or IterativeTrackingConfig("toy", iterations=15, lr_rotation=2e-3, lr_translation=2e-3)
    mapping = mapping or IterativeMappingConfig("toy", iterations=20, keyframes="window", window=3)
    config = AlgorithmConfig("toy", keyframe_every=2, tracking=tracking, mapping=mapping)
    for key, value in settings.items():
        setattr(config, key, value)
    config.__post_init__()
    algorithm = ToyAlgorithm(config, GradientTracking(tracking, seed), GradientMapping(mapping, seed))
    algorithm.model_class = model_class
    return algorithm


def _rays(camera: Camera, T_world_camera: Float[Tensor, "4 4"]) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
    """Return the origin and direction (z = 1 in the camera) of every pixel's ray."""
    directions = camera.rays(device=T_world_camera.device).reshape(-1, 3).to(T_world_camera) @ T_world_camera[:3, :3].T
    return T_world_camera[:3, 3].expand_as(directions), directions
