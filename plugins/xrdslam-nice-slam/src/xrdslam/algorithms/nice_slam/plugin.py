"""What this distribution registers."""

from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import AlgorithmInfo, MappingMethodInfo, TrackingMethodInfo

__all__ = ["xrdslam_algorithms", "xrdslam_mapping_methods", "xrdslam_tracking_methods"]


@hookimpl
def xrdslam_algorithms() -> list[AlgorithmInfo]:
    """Register the algorithm."""
    return [
        AlgorithmInfo(
            "nice_slam",
            "xrdslam.algorithms.nice_slam.algorithm:NiceSlam",
            "xrdslam.algorithms.nice_slam.config:NiceSlamConfig",
            "dense RGB-D SLAM on grids of features that pretrained decoders turn into occupancy, coarse to fine",
            tracking="nice_slam",
            mapping="nice_slam",
            paper="Zhu, Peng, Larsson, Xu, Bao, Cui, Oswald and Pollefeys, NICE-SLAM: Neural Implicit Scalable Encoding"
            " for SLAM, CVPR 2022",
            published="xrdslam.algorithms.nice_slam:published.yaml",
        )
    ]


@hookimpl
def xrdslam_tracking_methods() -> list[TrackingMethodInfo]:
    """Register the tracking method, for any map that takes ray batches."""
    return [
        TrackingMethodInfo(
            "nice_slam",
            "xrdslam.algorithms.nice_slam.tracking:NiceSlamTracking",
            "xrdslam.algorithms.nice_slam.config:NiceSlamTrackingConfig",
            "the pose moved down the gradient of a few hundred rays' losses",
        )
    ]


@hookimpl
def xrdslam_mapping_methods() -> list[MappingMethodInfo]:
    """Register the mapping method, for the map of this method."""
    return [
        MappingMethodInfo(
            "nice_slam",
            "xrdslam.algorithms.nice_slam.mapping:NiceSlamMapping",
            "xrdslam.algorithms.nice_slam.config:NiceSlamMappingConfig",
            "grids optimised level by level where the frame looks, then colour and the poses of overlapping keyframes",
        )
    ]
