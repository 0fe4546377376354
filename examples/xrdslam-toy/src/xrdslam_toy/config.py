"""The toy's settings. Imports no torch, so that listing it costs nothing."""

from dataclasses import dataclass, field
from typing import Any

from xrdslam.core.config import AlgorithmConfig, MappingConfig, TrackingConfig, require

__all__ = ["ToyConfig", "ToyMappingConfig", "ToyTrackingConfig"]


@dataclass
class ToyTrackingConfig(TrackingConfig):
    """Projective point-to-plane ICP."""

    name: str = "toy"
    iterations: int = 15
    """Gauss-Newton steps."""
    max_distance: float = 0.1
    """Pairs farther apart [m] take no part."""
    min_share: float = 0.2
    """A frame of whose points a smaller share finds a partner is lost."""

    def __post_init__(self) -> None:
        require(self.iterations >= 1, "algo.tracking.iterations", self.iterations, "be at least 1")
        require(self.max_distance > 0, "algo.tracking.max_distance", self.max_distance, "be a positive length [m]")
        require(0 <= self.min_share <= 1, "algo.tracking.min_share", self.min_share, "lie between 0 and 1")


@dataclass
class ToyMappingConfig(MappingConfig):
    """Nothing to set: the map decides what it lacks."""

    name: str = "toy"


@dataclass
class ToyConfig(AlgorithmConfig):
    """The whole method."""

    name: str = "toy"
    voxel: float = 0.05
    """Edge [m] of the cells that hold one point each."""
    tracking: Any = field(default_factory=ToyTrackingConfig)
    mapping: Any = field(default_factory=ToyMappingConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.voxel > 0, "algo.voxel", self.voxel, "be a positive length [m]")
