"""What the core distribution itself registers, through the same hooks as any plugin."""

from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.records import DatasetInfo, MappingMethodInfo, TrackingMethodInfo, ViewerInfo

__all__ = ["xrdslam_datasets", "xrdslam_mapping_methods", "xrdslam_tracking_methods", "xrdslam_viewers"]


@hookimpl
def xrdslam_datasets() -> list[DatasetInfo]:
    """Register the dataset families."""
    return [
        DatasetInfo(
            "synthetic",
            "xrdslam.datasets.synthetic.dataset:SyntheticDataset",
            "xrdslam.datasets.synthetic.config:SyntheticConfig",
            "a ray-cast room made on the spot: exact poses and depth, nothing to download",
        ),
        DatasetInfo(
            "replica",
            "xrdslam.datasets.replica:ReplicaDataset",
            "xrdslam.datasets.config:ReplicaConfig",
            "Replica's rooms and offices as NICE-SLAM rendered them",
        ),
        DatasetInfo(
            "seven_scenes",
            "xrdslam.datasets.seven_scenes:SevenScenesDataset",
            "xrdslam.datasets.config:SevenScenesConfig",
            "Microsoft's 7-Scenes, Kinect recordings",
        ),
        DatasetInfo(
            "tum_rgbd",
            "xrdslam.datasets.tum_rgbd:TumRgbdDataset",
            "xrdslam.datasets.config:TumRgbdConfig",
            "TUM's RGB-D benchmark: Kinect recordings with motion capture",
        ),
        DatasetInfo(
            "scannet",
            "xrdslam.datasets.scannet:ScanNetDataset",
            "xrdslam.datasets.config:ScanNetConfig",
            "ScanNet's rooms, exported from .sens",
        ),
        DatasetInfo(
            "co_fusion",
            "xrdslam.datasets.co_fusion:CoFusionDataset",
            "xrdslam.datasets.config:CoFusionConfig",
            "Co-Fusion's rendered room with moving things (extra `exr`)",
        ),
        DatasetInfo(
            "euroc",
            "xrdslam.datasets.euroc:EurocDataset",
            "xrdslam.datasets.config:EurocConfig",
            "EuRoC's drone: grey images, mono or stereo, with IMU; no depth",
        ),
        DatasetInfo(
            "rgbd_folder",
            "xrdslam.datasets.rgbd_folder:RgbdFolderDataset",
            "xrdslam.datasets.config:RgbdFolderConfig",
            "your own images, with depth and poses where there are any",
        ),
        DatasetInfo(
            "transforms",
            "xrdslam.datasets.transforms:TransformsDataset",
            "xrdslam.datasets.config:TransformsConfig",
            "a transforms.json of nerfstudio, NeRFCapture or Polycam",
        ),
        DatasetInfo(
            "video",
            "xrdslam.datasets.video:VideoDataset",
            "xrdslam.datasets.config:VideoConfig",
            "a video file, monocular",
        ),
        DatasetInfo(
            "rosbag",
            "xrdslam.datasets.rosbag:RosbagDataset",
            "xrdslam.datasets.config:RosbagConfig",
            "a ROS 1 bag or ROS 2 recording, such as a RealSense's (extra `rosbag`)",
        ),
    ]


@hookimpl
def xrdslam_tracking_methods() -> list[TrackingMethodInfo]:
    """Register the stock tracking methods, which follow no map."""
    return [
        TrackingMethodInfo(
            "ground_truth",
            "xrdslam.methods.ground_truth:GroundTruthTracking",
            "xrdslam.methods.config:GroundTruthTrackingConfig",
            "the data's own poses",
        ),
        TrackingMethodInfo(
            "constant_velocity",
            "xrdslam.methods.constant_velocity:ConstantVelocityTracking",
            "xrdslam.methods.config:ConstantVelocityTrackingConfig",
            "the last motion once more: the floor that any tracker must beat",
        ),
        TrackingMethodInfo(
            "gicp",
            "xrdslam.methods.gicp:GicpTracking",
            "xrdslam.methods.config:GicpTrackingConfig",
            "depth registered to a Gaussian voxel map (generalised ICP; extra `gicp`)",
        ),
    ]


@hookimpl
def xrdslam_mapping_methods() -> list[MappingMethodInfo]:
    """Register the stock mapping methods."""
    return [
        MappingMethodInfo(
            "none",
            "xrdslam.methods.no_mapping:NoMapping",
            "xrdslam.methods.config:NoMappingConfig",
            "no map: pure odometry",
        ),
    ]


@hookimpl
def xrdslam_viewers() -> list[ViewerInfo]:
    """Register the ways of watching a run."""
    return [
        ViewerInfo(
            "viser",
            "xrdslam.viewer.live:LiveViewer",
            "xrdslam.viewer.config:LiveViewerConfig",
            "a page on this machine that shows the run while it goes on (extra `viewer`)",
        ),
    ]
