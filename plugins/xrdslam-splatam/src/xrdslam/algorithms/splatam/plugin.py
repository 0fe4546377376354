"""What this distribution registers."""

from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import AlgorithmInfo, MappingMethodInfo, TrackingMethodInfo

__all__ = ["xrdslam_algorithms", "xrdslam_mapping_methods", "xrdslam_tracking_methods"]


@hookimpl
def xrdslam_algorithms() -> list[AlgorithmInfo]:
    """Register the algorithm."""
    return [
        AlgorithmInfo(
            "splatam",
            "xrdslam.algorithms.splatam.algorithm:Splatam",
            "xrdslam.algorithms.splatam.config:SplatamConfig",
            "dense RGB-D SLAM on 3-D Gaussians, tracked and mapped through their renders",
            tracking="splatam",
            mapping="splatam",
            paper="Keetha et al., SplaTAM: Splat, Track & Map 3D Gaussians for Dense RGB-D SLAM, CVPR 2024",
            published="xrdslam.algorithms.splatam:published.yaml",
        )
    ]


@hookimpl
def xrdslam_tracking_methods() -> list[TrackingMethodInfo]:
    """Register the tracking method, for any map that takes image batches."""
    return [
        TrackingMethodInfo(
            "splatam",
            "xrdslam.algorithms.splatam.tracking:SplatamTracking",
            "xrdslam.algorithms.splatam.config:SplatamTrackingConfig",
            "the pose moved down the gradient of a whole image's colour and depth",
        )
    ]


@hookimpl
def xrdslam_mapping_methods() -> list[MappingMethodInfo]:
    """Register the mapping method."""
    return [
        MappingMethodInfo(
            "splatam",
            "xrdslam.algorithms.splatam.mapping:SplatamMapping",
            "xrdslam.algorithms.splatam.config:SplatamMappingConfig",
            "Gaussians seeded where the map is missing, then optimised over a window of keyframes",
        )
    ]
