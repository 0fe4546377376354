"""What this distribution registers."""

from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import AlgorithmInfo, MappingMethodInfo, TrackingMethodInfo

__all__ = ["xrdslam_algorithms", "xrdslam_mapping_methods", "xrdslam_tracking_methods"]


@hookimpl
def xrdslam_algorithms() -> list[AlgorithmInfo]:
    """Register the algorithm."""
    return [
        AlgorithmInfo(
            "co_slam",
            "xrdslam.algorithms.co_slam.algorithm:CoSlam",
            "xrdslam.algorithms.co_slam.config:CoSlamConfig",
            "dense RGB-D SLAM on a hash grid and one-blob coordinates, bundle-adjusted over all keyframes' rays",
            tracking="co_slam",
            mapping="co_slam",
            paper="Wang, Wang and Agapito, Co-SLAM: Joint Coordinate and Sparse Parametric Encodings for Neural"
            " Real-Time SLAM, CVPR 2023",
            published="xrdslam.algorithms.co_slam:published.yaml",
        )
    ]


@hookimpl
def xrdslam_tracking_methods() -> list[TrackingMethodInfo]:
    """Register the tracking method, for any map that takes ray batches."""
    return [
        TrackingMethodInfo(
            "co_slam",
            "xrdslam.algorithms.co_slam.tracking:CoSlamTracking",
            "xrdslam.algorithms.co_slam.config:CoSlamTrackingConfig",
            "the pose moved down the gradient of a few thousand rays' losses",
        )
    ]


@hookimpl
def xrdslam_mapping_methods() -> list[MappingMethodInfo]:
    """Register the mapping method, for any map that takes ray batches."""
    return [
        MappingMethodInfo(
            "co_slam",
            "xrdslam.algorithms.co_slam.mapping:CoSlamMapping",
            "xrdslam.algorithms.co_slam.config:CoSlamMappingConfig",
            "map and all keyframe poses adjusted together on rays that each keyframe left in a bank",
        )
    ]
