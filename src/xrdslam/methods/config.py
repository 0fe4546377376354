"""Settings of the stock methods. Imports no torch."""

from dataclasses import dataclass

from xrdslam.core.config import MappingConfig, TrackingConfig, require

__all__ = [
    "ConstantVelocityTrackingConfig",
    "GicpTrackingConfig",
    "GroundTruthTrackingConfig",
    "NoMappingConfig",
]


@dataclass
class GroundTruthTrackingConfig(TrackingConfig):
    """The data's own poses: nothing to set."""

    name: str = "ground_truth"


@dataclass
class ConstantVelocityTrackingConfig(TrackingConfig):
    """The motion model's prediction as it is: nothing to set."""

    name: str = "constant_velocity"


@dataclass
class GicpTrackingConfig(TrackingConfig):
    """Depth registered to a Gaussian voxel map by generalised ICP."""

    name: str = "gicp"
    iterations: int = 20
    """Gauss-Newton steps at most."""
    downsample: float = 0.05
    """Edge [m] of the grid that thins a frame's points."""
    voxel: float = 0.1
    """Edge [m] of the map's voxels."""
    max_distance: float = 0.2
    """Points farther [m] from the map than this take no part."""
    neighbours: int = 10
    """Points that a covariance is estimated from."""

    def __post_init__(self) -> None:
        require(self.iterations >= 1, "algo.tracking.iterations", self.iterations, "be at least 1")
        require(self.downsample > 0, "algo.tracking.downsample", self.downsample, "be a positive length [m]")
        require(self.voxel > 0, "algo.tracking.voxel", self.voxel, "be a positive length [m]")
        require(self.max_distance > 0, "algo.tracking.max_distance", self.max_distance, "be a positive length [m]")
        require(self.neighbours >= 4, "algo.tracking.neighbours", self.neighbours, "be at least 4")


@dataclass
class NoMappingConfig(MappingConfig):
    """No map: nothing to set."""

    name: str = "none"
