"""What this distribution registers."""

from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import AlgorithmInfo, MappingMethodInfo, TrackingMethodInfo

__all__ = ["xrdslam_algorithms", "xrdslam_mapping_methods", "xrdslam_tracking_methods"]


@hookimpl
def xrdslam_algorithms() -> list[AlgorithmInfo]:
    """Register the algorithm."""
    return [
        AlgorithmInfo(
            "toy",
            "xrdslam_toy.algorithm:Toy",
            "xrdslam_toy.config:ToyConfig",
            "depth odometry by point-to-plane ICP, with a map of coloured points",
            tracking="toy",
            mapping="toy",
        )
    ]


@hookimpl
def xrdslam_tracking_methods() -> list[TrackingMethodInfo]:
    """Register the tracking method."""
    return [
        TrackingMethodInfo(
            "toy",
            "xrdslam_toy.tracking:ToyTracking",
            "xrdslam_toy.config:ToyTrackingConfig",
            "each frame registered to the one before by projective point-to-plane ICP",
        )
    ]


@hookimpl
def xrdslam_mapping_methods() -> list[MappingMethodInfo]:
    """Register the mapping method."""
    return [
        MappingMethodInfo(
            "toy",
            "xrdslam_toy.mapping:ToyMapping",
            "xrdslam_toy.config:ToyMappingConfig",
            "points put where the map has none",
        )
    ]
