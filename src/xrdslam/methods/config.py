"""Settings of the stock tracking and mapping methods. Imports no torch."""

from dataclasses import dataclass, field
from itertools import pairwise

from xrdslam.core.config import MappingConfig, TrackingConfig, require

__all__ = [
    "ConstantVelocityTrackingConfig",
    "GicpTrackingConfig",
    "GroundTruthTrackingConfig",
    "NoMappingConfig",
]


@dataclass
class GroundTruthTrackingConfig(TrackingConfig):
    """The data's own poses."""

    name: str = "ground_truth"
    lost_agreement: float = 0.0


@dataclass
class ConstantVelocityTrackingConfig(TrackingConfig):
    """The prediction itself, whatever the image shows."""

    name: str = "constant_velocity"
    lost_agreement: float = 0.0


@dataclass
class NoMappingConfig(MappingConfig):
    """No map."""

    name: str = "none"


@dataclass
class GicpTrackingConfig(TrackingConfig):
    """Depth registered to a Gaussian voxel map.

    One set of values for rendered rooms, Kinect and HoloLens depth: lengths are those of indoor scenes.
    """

    name: str = "gicp"
    columns: int = 160
    """Depth is read at every n-th pixel, so that about this many columns remain whatever the image's width."""
    max_depth_m: float = 10.0
    """Farther depth is not used."""
    point_spacing_m: float = 0.03
    """Points of a scan are averaged in cells of this size, which thins what is near the camera."""
    num_neighbours: int = 10
    """Points that a point's surface orientation is estimated from."""
    voxel_m: float = 0.05
    """Voxels of the map that the pose is finally registered to."""
    coarse_voxels_m: list[float] = field(default_factory=lambda: [0.4, 0.15])
    """Voxels of the maps that a registration which ends badly starts over from, coarsest first: the coarsest bounds how
    far the prediction may be off."""
    max_iterations: int = 30
    """Per map."""
    confident_overlap: float = 0.85
    """A registration with this share of the points in the map's voxels is taken without trying another."""
    min_overlap: float = 0.35
    """With less the frame is lost."""
    min_points: int = 100
    """With fewer points the frame is lost."""
    insert_distance_m: float = 0.05
    """A scan goes into the map when the camera has moved this far since the last that did, ..."""
    insert_angle_rad: float = 0.05
    """... or turned this far, ..."""
    insert_overlap: float = 0.9
    """... or when less of the scan than this lies in the map."""

    def __post_init__(self) -> None:
        super().__post_init__()
        counts = {"columns": 1, "num_neighbours": 5, "max_iterations": 1, "min_points": 10}
        for key, least in counts.items():
            require(getattr(self, key) >= least, f"algo.tracking.{key}", getattr(self, key), f"be at least {least}")
        for key in ("max_depth_m", "point_spacing_m", "voxel_m"):
            require(getattr(self, key) > 0, f"algo.tracking.{key}", getattr(self, key), "be positive")
        for key in ("insert_distance_m", "insert_angle_rad"):
            require(getattr(self, key) >= 0, f"algo.tracking.{key}", getattr(self, key), "not be negative")
        for key in ("confident_overlap", "min_overlap", "insert_overlap"):
            require(0 <= getattr(self, key) <= 1, f"algo.tracking.{key}", getattr(self, key), "lie in [0, 1]")
        sizes = [*self.coarse_voxels_m, self.voxel_m]
        shrinking = all(a > b for a, b in pairwise(sizes))
        must = f"shrink towards voxel_m={self.voxel_m}"
        require(shrinking, "algo.tracking.coarse_voxels_m", self.coarse_voxels_m, must)
