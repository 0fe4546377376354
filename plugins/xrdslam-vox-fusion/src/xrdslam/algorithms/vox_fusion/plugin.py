"""What this distribution registers."""

from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import AlgorithmInfo, MappingMethodInfo, TrackingMethodInfo

__all__ = ["xrdslam_algorithms", "xrdslam_mapping_methods", "xrdslam_tracking_methods"]


@hookimpl
def xrdslam_algorithms() -> list[AlgorithmInfo]:
    """Register the algorithm."""
    return [
        AlgorithmInfo(
            "vox_fusion",
            "xrdslam.algorithms.vox_fusion.algorithm:VoxFusion",
            "xrdslam.algorithms.vox_fusion.config:VoxFusionConfig",
            "dense RGB-D SLAM on features of sparse voxels, every frame mapped with random keyframes",
            tracking="vox_fusion",
            mapping="vox_fusion",
            paper="Yang, Li, Zhai, Ming, Liu and Zhang, Vox-Fusion: Dense Tracking and Mapping with Voxel-based Neural"
            " Implicit Representation, ISMAR 2022",
            published="xrdslam.algorithms.vox_fusion:published.yaml",
        )
    ]


@hookimpl
def xrdslam_tracking_methods() -> list[TrackingMethodInfo]:
    """Register the tracking method, for any map that takes ray batches."""
    return [
        TrackingMethodInfo(
            "vox_fusion",
            "xrdslam.algorithms.vox_fusion.tracking:VoxFusionTracking",
            "xrdslam.algorithms.vox_fusion.config:VoxFusionTrackingConfig",
            "the pose moved down the gradient of a thousand rays' losses, lost where the map has no voxels",
        )
    ]


@hookimpl
def xrdslam_mapping_methods() -> list[MappingMethodInfo]:
    """Register the mapping method, for any map that takes ray batches."""
    return [
        MappingMethodInfo(
            "vox_fusion",
            "xrdslam.algorithms.vox_fusion.mapping:VoxFusionMapping",
            "xrdslam.algorithms.vox_fusion.config:VoxFusionMappingConfig",
            "map and poses of the frame and of random keyframes adjusted on as many rays of each",
        )
    ]
