"""What a user may set about a dataset: the knobs that every family has, and each family's own. Imports no torch."""

from dataclasses import dataclass, field

from xrdslam.core.config import require, require_choice
from xrdslam.core.errors import ConfigError

__all__ = [
    "CoFusionConfig",
    "DatasetConfig",
    "EurocConfig",
    "FilesConfig",
    "RecordingConfig",
    "ReplicaConfig",
    "RgbdFolderConfig",
    "RosbagConfig",
    "ScanNetConfig",
    "SevenScenesConfig",
    "TransformsConfig",
    "TumRgbdConfig",
    "VideoConfig",
]


@dataclass
class DatasetConfig:
    """The knobs that every family has."""

    family: str = "???"
    scene: str = "custom"
    root: str = "data"
    """The folder that holds the family's scenes."""
    path: str | None = None
    """The scene's own folder; goes before `root` and `scene`."""
    frames: list[int | None] = field(default_factory=lambda: [0, None, 1])
    """Which frames of the whole sequence: start, stop, stride; a stop of null (or -1) is the end."""
    drop: list[int] | None = None
    """Frames of the whole sequence that are left out, [start, stop): a gap, to see what a tracker makes of it."""
    size: list[int] | None = None
    """The width and height [px] that images are resized to."""
    crop: list[int] | None = None
    """What is cut off at the left, top, right and bottom [px], after undistortion and before `size`."""
    max_depth: float | None = None
    """Depth beyond this [m] counts as not measured."""
    on_error: str = "raise"
    """What a damaged frame does: raise ends the run before it begins, skip leaves the frame out."""

    def __post_init__(self) -> None:
        must = "be [start, stop, stride] with start and stop from 0 (stop null: to the end) and stride from 1"
        require(len(self.frames) == 3, "dataset.frames", self.frames, must)
        start, stop, stride = self.frames
        allowed = (start or 0) >= 0 and (stop is None or stop >= -1) and (stride is None or stride >= 1)
        require(allowed, "dataset.frames", self.frames, must)
        gap = self.drop is None or (len(self.drop) == 2 and 0 <= self.drop[0] < self.drop[1])
        require(gap, "dataset.drop", self.drop, "be [start, stop], the first frame left out and the first after them")
        sized = self.size is None or (len(self.size) == 2 and min(self.size) >= 1)
        require(sized, "dataset.size", self.size, "be [width, height] in pixels, both at least 1")
        cropped = self.crop is None or (len(self.crop) == 4 and min(self.crop) >= 0)
        require(cropped, "dataset.crop", self.crop, "be [left, top, right, bottom] in pixels, none negative")
        require(self.max_depth is None or self.max_depth > 0, "dataset.max_depth", self.max_depth, "be above 0 metres")
        require_choice("dataset.on_error", self.on_error, ("raise", "skip"))

    def picked(self, count: int) -> list[int]:
        """Return which frames of a sequence of `count` are read; ConfigError where none is left."""
        start, stop, stride = self.frames
        gap = range(*self.drop) if self.drop is not None else ()
        left = [number for number in range(count)[start : None if stop == -1 else stop : stride] if number not in gap]
        if count and not left:
            dropped = f" and dataset.drop={self.drop}" if self.drop is not None else ""
            raise ConfigError(f"dataset.frames={self.frames}{dropped} picks none of the {count} frames")
        return left


@dataclass
class ReplicaConfig(DatasetConfig):
    """Replica as NICE-SLAM rendered it."""

    family: str = "replica"
    root: str = "data/Replica"


@dataclass
class SevenScenesConfig(DatasetConfig):
    """Microsoft's 7-Scenes."""

    family: str = "seven_scenes"
    root: str = "data/7-Scenes"
    sequence: str | None = None
    """The sequence's folder inside the scene's, such as seq-01; needed where there are several."""


@dataclass
class FilesConfig(DatasetConfig):
    """Where the camera and the depth's scale may be said on the command line."""

    intrinsics: list[float] | None = None
    """The camera of the colour files: fx, fy, cx, cy [px]; goes before what files or the family say."""
    distortion: list[float] = field(default_factory=list)
    """OpenCV's coefficients that belong to `intrinsics`: k1, k2, p1, p2[, k3[, k4, k5, k6]]."""
    depth_scale: float | None = None
    """Levels of a depth image per metre; null takes what the family or its files say."""
    invalid_depth: list[int] = field(default_factory=list)
    """Levels that mean no measurement, beside 0; 65535 is one with many sensors."""

    def __post_init__(self) -> None:
        super().__post_init__()
        given = self.intrinsics
        sensible = given is None or (len(given) == 4 and min(given[:2]) > 0)
        require(sensible, "dataset.intrinsics", given, "be [fx, fy, cx, cy] in pixels, focal lengths above 0")
        require(
            len(self.distortion) in (0, 4, 5, 8),
            "dataset.distortion",
            self.distortion,
            "be OpenCV's 4, 5 or 8 coefficients k1, k2, p1, p2[, k3[, k4, k5, k6]]",
        )
        scale = self.depth_scale
        require(scale is None or scale > 0, "dataset.depth_scale", scale, "be above 0 levels per metre")


@dataclass
class TumRgbdConfig(FilesConfig):
    """The RGB-D benchmark of TUM."""

    family: str = "tum_rgbd"
    root: str = "data/TUM_RGBD"
    max_time_offset_s: float = 0.02
    """Colour and depth that are at most this far apart belong together; poses are interpolated between two that are."""

    def __post_init__(self) -> None:
        super().__post_init__()
        offset = self.max_time_offset_s
        require(offset >= 0, "dataset.max_time_offset_s", offset, "not be negative")


@dataclass
class ScanNetConfig(DatasetConfig):
    """ScanNet, as its own tool exports a .sens file."""

    family: str = "scannet"
    root: str = "data/ScanNet"


@dataclass
class CoFusionConfig(FilesConfig):
    """Co-Fusion's synthetic sequences."""

    family: str = "co_fusion"
    root: str = "data/CoFusion"
    depth: str = "depth_noise"
    """Which depth: depth_noise, as a sensor would give it, or depth_original, exact."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice("dataset.depth", self.depth, ("depth_noise", "depth_original"))


@dataclass
class EurocConfig(DatasetConfig):
    """EuRoC MAV: grey images, IMU, no depth."""

    family: str = "euroc"
    root: str = "data/EuRoC"
    camera: str = "cam0"
    """The camera that is followed: cam0 (left) or cam1."""
    stereo: bool = False
    """Give each frame the right image as well, both rectified."""
    max_time_offset_s: float = 0.02
    """Poses are interpolated between two of the ground truth that are at most this far away; others are unknown."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice("dataset.camera", self.camera, ("cam0", "cam1"))
        both = not self.stereo or self.camera == "cam0"
        require(both, "dataset.camera", self.camera, "be cam0 where dataset.stereo=true")
        offset = self.max_time_offset_s
        require(offset >= 0, "dataset.max_time_offset_s", offset, "not be negative")


@dataclass
class RecordingConfig(FilesConfig):
    """A recording of one's own; `dataset.path` says where it lies."""

    root: str = "."
    fps: float = 30.0
    """Frames a second, where nothing in the recording says when each was taken."""
    max_time_offset_s: float = 0.02
    """Colour, depth and poses that have times of their own belong together up to this far apart."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.fps > 0, "dataset.fps", self.fps, "be above 0 frames a second")
        offset = self.max_time_offset_s
        require(offset >= 0, "dataset.max_time_offset_s", offset, "not be negative")


@dataclass
class RgbdFolderConfig(RecordingConfig):
    """A folder of images, with depth, poses and intrinsics in common forms."""

    family: str = "rgbd_folder"
    rgb: str | None = None
    """The colour images inside the folder: a folder's name, or a pattern such as `*.color.jpg`; null looks for them."""
    depth: str | None = None
    """The depth images likewise; none leaves them out."""
    poses: str | None = None
    """A file or a folder of poses; null looks for one, none leaves them out."""
    camera: str | None = None
    """A file of intrinsics; null looks for one, and `dataset.intrinsics` goes before it."""
    pose_direction: str = "camera_to_world"
    """Or world_to_camera."""
    pose_axes: str = "opencv"
    """The camera's axes in the poses: opencv (x right, y down, z forward) or opengl (x right, y up, z backward)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_choice("dataset.pose_direction", self.pose_direction, ("camera_to_world", "world_to_camera"))
        require_choice("dataset.pose_axes", self.pose_axes, ("opencv", "opengl"))


@dataclass
class TransformsConfig(RecordingConfig):
    """A transforms.json of nerfstudio, NeRFCapture, Polycam or instant-ngp; `dataset.path` is it or its folder."""

    family: str = "transforms"
    pixel_centre: float = 0.5
    """Where the file's pixel coordinates have the centre of the first pixel: 0.5 (this format's) or 0."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.pixel_centre in (0.0, 0.5), "dataset.pixel_centre", self.pixel_centre, "be 0 or 0.5")


@dataclass
class VideoConfig(RecordingConfig):
    """A video file, monocular; its own frame rate goes before `fps`."""

    family: str = "video"


@dataclass
class RosbagConfig(RecordingConfig):
    """A ROS 1 bag, or a ROS 2 recording (db3 or MCAP)."""

    family: str = "rosbag"
    rgb_topic: str | None = None
    """Images or compressed images; null takes the only one that can be meant."""
    depth_topic: str | None = None
    """Depth as 16UC1 [mm], 32FC1 [m] or compressedDepth; none leaves it out."""
    info_topic: str | None = None
    """The colour camera's CameraInfo; null takes the one beside the images."""
    pose_topic: str | None = None
    """Odometry, PoseStamped, PoseWithCovarianceStamped or TransformStamped; null takes the only one, tf where the
    transforms lead from the camera to `fixed_frame`, none leaves poses out."""
    fixed_frame: str | None = None
    """The frame of tf that counts as the world; null takes the root of the camera's tree, where it moves."""
