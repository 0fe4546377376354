"""A ROS recording: a ROS 1 bag, or a ROS 2 folder of db3 or MCAP files, read by the package `rosbags` (no ROS needed).

Colour is an Image or CompressedImage, depth 16UC1 (millimetres), 32FC1 (metres) or compressedDepth, the camera a
CameraInfo, poses Odometry, PoseStamped, TransformStamped or tf. What is not set is taken where only one topic can be
meant; `python -m xrdslam.datasets inspect` shows what that is. Times are those of the messages' headers. Colour and
depth join within `dataset.max_time_offset_s`, colour without a depth is left out and counted in the log; poses are
interpolated. Depth of another camera than colour is moved into it, where fixed transforms say how they sit.
"""

import contextlib
import logging
import weakref
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError, MissingExtraError
from xrdslam.datasets.config import RosbagConfig
from xrdslam.datasets.folders import recording
from xrdslam.datasets.images import UNIT_LEVELS
from xrdslam.datasets.registration import register_depth
from xrdslam.datasets.ros_messages import camera_info, decode_depth, decode_rgb, header_time_ns
from xrdslam.datasets.ros_poses import POSE_TYPES, TransformTree, pose_of, track_of
from xrdslam.datasets.ros_topics import choose, colour_topic, depth_topic, info_topic
from xrdslam.datasets.sequence import Record, RgbdSequence
from xrdslam.datasets.source import Lens, stated_lens
from xrdslam.datasets.times import NS_PER_S, associated

__all__ = ["RosbagDataset"]

log = logging.getLogger(__name__)

LEVELS_PER_METRE = 1000.0
SAME_VIEW_PX = 2.0
TF_TYPE = "tf2_msgs/msg/TFMessage"
TF_TYPES = (TF_TYPE, "tf/msg/tfMessage")


class RosbagDataset(RgbdSequence):
    """The frames of a ROS recording; messages are read one by one, when they are asked for."""

    def __init__(self, config: RosbagConfig) -> None:
        """Choose the topics, list their messages by time, read the camera and the poses."""
        self.path = recording(config, "the .bag file or ROS 2 folder")
        self._bag = Bag(self.path)
        topics = self._bag.topics
        self.rgb_topic = colour_topic(topics, config.rgb_topic, str(self.path))
        self.depth_topic = depth_topic(topics, config.depth_topic, str(self.path))
        chosen = [t for t in (self.rgb_topic, self.depth_topic) if t is not None]
        self._at = {topic: self._bag.times(topic) for topic in chosen}  # header's time -> bag's time
        self._frame_ids = {topic: self._bag.first(topic).header.frame_id for topic in chosen}
        first = decode_rgb(self._bag.first(self.rgb_topic), f"{self.path}, {self.rgb_topic}")
        size = (first.shape[1], first.shape[0])
        lens = stated_lens(config, self._lens(self.rgb_topic, config.info_topic), "")
        if lens is None:
            raise DataError(f"{self.path}: no CameraInfo for {self.rgb_topic}; set dataset.intrinsics=[fx,fy,cx,cy]")
        stated_in = lens.stated_in or f"the CameraInfo of {self.rgb_topic}"
        source = lens._replace(stated_in=stated_in).source(size, config, LEVELS_PER_METRE)
        self._depth_camera, self._T_colour_depth = self._depth_view(source.camera)
        name = f"{config.family}/{self.path.stem}"
        super().__init__(config, name, self._records(config), source)
        log.info("%s: colour %s, depth %s, poses %s", self.path, self.rgb_topic, self.depth_topic, self.pose_source)

    def probe_rgb(self, path: Path) -> tuple[int, int]:
        """Say nothing: a message is seen to be whole when it is read."""
        return self._fit.rgb_size

    def probe_depth(self, path: Path) -> tuple[int, int]:
        """Say nothing: a message is seen to be whole when it is read."""
        return self._fit.depth_size

    def read_rgb(self, path: Path) -> np.ndarray:
        """Read and decode a message."""
        rgb = decode_rgb(self._message(path, self.rgb_topic), str(path))
        return np.asarray(cv2.LUT(rgb, UNIT_LEVELS), dtype=np.float32)

    def read_depth(self, path: Path) -> np.ndarray:
        """Read and decode a message, and move it into the colour camera where it is of another."""
        assert self.depth_topic is not None, "records have depth only where there is a topic"
        depth = decode_depth(self._message(path, self.depth_topic), self.source.depth_scale, str(path))
        for level in self.source.invalid_depth:
            depth[depth == np.float32(level / self.source.depth_scale)] = 0
        if self._depth_camera is None:
            return depth
        if depth.shape != (self._depth_camera.height, self._depth_camera.width):
            raise DataError(f"{path}: {depth.shape[1]}x{depth.shape[0]} px, its CameraInfo is of another size; mend it")
        depth = np.where(np.isfinite(depth), depth, np.float32(0))
        return register_depth(depth, self._depth_camera, self.source.camera.undistorted(), self._T_colour_depth)

    def _message(self, path: Path, topic: str) -> Any:  # noqa: ANN401  # classes made at run time
        return self._bag.message(topic, self._at[topic][int(path.name)])

    def _label(self, topic: str, time_ns: int) -> Path:
        return self.path / topic.strip("/") / str(time_ns)  # how messages call it; there is no such file

    def _records(self, config: RosbagConfig) -> list[Record]:
        """Join colour and depth by time and find each frame's pose."""
        times = sorted(self._at[self.rgb_topic])
        tolerance_ns = round(config.max_time_offset_s * NS_PER_S)
        poses = self._poses(config, tolerance_ns)
        labels: list[Path | None] = [None] * len(times)
        if self.depth_topic is not None:
            others = sorted(self._at[self.depth_topic])
            partners, apart_ns = associated(times, others, tolerance_ns)
            if (partners < 0).all():
                raise DataError(
                    f"{self.path}: no image of {self.rgb_topic} has one of {self.depth_topic} within"
                    f" {config.max_time_offset_s} s, the nearest are {apart_ns.min() / NS_PER_S:.3f} s apart; raise"
                    " dataset.max_time_offset_s, or set dataset.depth_topic=none"
                )
            labels = [self._label(self.depth_topic, others[j]) if j >= 0 else None for j in partners.tolist()]
            alone = labels.count(None)
            if alone:
                log.info("%s: %d of %d colour images have no depth in time", self.path, alone, len(times))
        return [
            Record(time_ns, self._label(self.rgb_topic, time_ns), label, None if poses is None else poses(time_ns))
            for time_ns, label in zip(times, labels, strict=True)
            if label is not None or self.depth_topic is None
        ]

    def _lens(self, images: str, given: str | None) -> Lens | None:
        topic = info_topic(self._bag.topics, given, images, str(self.path))
        if topic is None:
            return None
        return camera_info(self._bag.first(topic), f"{self.path}, {topic}", "rect" in images.rpartition("/")[2])

    def _depth_view(self, colour: Camera) -> tuple[Camera | None, np.ndarray]:
        """Return the depth's own camera and T_colour_depth where it is another view than colour's, else nothing."""
        if self.depth_topic is None or "aligned" in self.depth_topic or "registered" in self.depth_topic:
            return None, np.eye(4)
        lens = self._lens(self.depth_topic, None)
        if lens is None or lens.size is None:
            return None, np.eye(4)
        depth = Camera(*lens.intrinsics, *lens.size)
        frames = [self._frame_ids[topic] for topic in (self.rgb_topic, self.depth_topic)]
        T = np.eye(4) if frames[0] == frames[1] else self._bag.transforms().fixed(*frames)
        seen = depth.resized(colour.width, colour.height)
        off = max(abs(getattr(seen, key) - getattr(colour, key)) for key in ("fx", "fy", "cx", "cy"))
        if off <= SAME_VIEW_PX and (T is None or np.allclose(T, np.eye(4), atol=1e-4)):
            return None, np.eye(4)
        if T is None:
            raise DataError(
                f"{self.path}: {self.depth_topic} is of another camera ({frames[1]}) than {self.rgb_topic}"
                f" ({frames[0]}) and no fixed transform says how they sit; record the aligned depth (for a RealSense:"
                " align_depth.enable:=true) or /tf_static, or choose dataset.depth_topic"
            )
        return depth, T

    def _poses(self, config: RosbagConfig, tolerance_ns: int) -> Any:  # noqa: ANN401  # a function of time, or None
        """Return a function from a time [ns] to T_world_camera, none where the recording does not say."""
        self.pose_source = "none"
        camera = self._frame_ids[self.rgb_topic]
        stamped = [topic for topic, kind in self._bag.topics.items() if kind in POSE_TYPES]
        if config.pose_topic == "none":
            return None
        if config.pose_topic is None and not stamped:
            return self._poses_of_tf(config, camera, tolerance_ns)
        topic = choose(stamped, self._bag.topics, config.pose_topic, "pose_topic", "poses", str(self.path))
        if self._bag.topics[topic] in TF_TYPES:
            return self._poses_of_tf(config, camera, tolerance_ns)
        track, child = track_of(map(pose_of, self._bag.messages(topic)), f"{self.path}, {topic}")
        T_child_camera = self._bag.transforms().fixed(child, camera) if child and child != camera else np.eye(4)
        if T_child_camera is None:
            log.warning("%s: %s has poses of %r; no fixed transform leads to the camera %r, they are taken as its own",
                        self.path, topic, child, camera)  # fmt: skip
            T_child_camera = np.eye(4)
        self.pose_source = topic
        return partial(_pose_at, track, T_child_camera, tolerance_ns)

    def _poses_of_tf(self, config: RosbagConfig, camera: str, tolerance_ns: int) -> Any:  # noqa: ANN401
        tree = self._bag.transforms()
        chain = tree.chain(camera)
        root = config.fixed_frame.lstrip("/") if config.fixed_frame else chain[-1]
        if root not in chain:
            raise DataError(
                f"dataset.fixed_frame={root}: tf leads from the camera {camera!r} to"
                f" {', '.join(chain[1:]) or 'nowhere'}; choose one of these, or dataset.pose_topic=none"
            )
        if not tree.moves(camera):
            return None
        self.pose_source = f"tf, {camera} in {root}"
        return partial(_pose_in_tree, tree, root, camera, tolerance_ns)


class Bag:
    """A recording, opened when it is first read; it can be pickled, and opens again where it arrives."""

    def __init__(self, path: Path) -> None:
        """Take a .bag file, a ROS 2 folder, or one of the files in it."""
        self.path = path.parent if path.suffix in (".db3", ".mcap") else path
        if self.path.is_dir() and not (self.path / "metadata.yaml").is_file():
            raise DataError(
                f"{self.path}: no metadata.yaml, which a ROS 2 recording has beside its files; `ros2 bag reindex`"
                " writes it"
            )
        self._reader: Any = None
        self._tree: TransformTree | None = None

    @property
    def topics(self) -> dict[str, str]:
        """The type of each topic that has messages."""
        return {c.topic: c.msgtype for c in self._opened().connections if c.msgcount}

    def times(self, topic: str) -> dict[int, int]:
        """Return the recorder's time of each message by its header's time [ns]; of two with one time, the first."""
        reader = self._opened()
        found: dict[int, int] = {}
        for raw, at_ns in self._raw(topic):
            found.setdefault(header_time_ns(raw, reader.is2, at_ns), at_ns)
        return found

    def first(self, topic: str) -> Any:  # noqa: ANN401  # classes made at run time
        """Return the first message of a topic."""
        return next(iter(self.messages(topic)))

    def messages(self, topic: str) -> Iterator[Any]:
        """Yield the messages of a topic."""
        for raw, _ in self._raw(topic):
            yield self._decoded(raw, topic)

    def message(self, topic: str, at_ns: int) -> Any:  # noqa: ANN401
        """Return the message that was recorded at a time."""
        raw = next((raw for raw, _ in self._raw(topic, at_ns, at_ns + 1)), None)
        if raw is None:
            raise DataError(f"{self.path}, {topic}: the message of {at_ns} ns is gone; was the file replaced?")
        return self._decoded(raw, topic)

    def transforms(self) -> TransformTree:
        """Return the tree of tf and tf_static."""
        if self._tree is None:
            topics = [topic for topic, kind in self.topics.items() if kind in TF_TYPES]
            self._tree = TransformTree((m, "static" in topic) for topic in topics for m in self.messages(topic))
        return self._tree

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_reader": None}

    def _raw(self, topic: str, start: int | None = None, stop: int | None = None) -> Iterator[tuple[bytes, int]]:
        reader = self._opened()
        connections = [c for c in reader.connections if c.topic == topic]
        with _reported(self.path):
            for _, at_ns, raw in reader.messages(connections, start, stop):
                yield raw, at_ns

    def _decoded(self, raw: bytes, topic: str) -> Any:  # noqa: ANN401
        reader = self._opened()
        kind = next(c.msgtype for c in reader.connections if c.topic == topic)
        with _reported(self.path):
            return reader.deserialize(raw, kind)

    def _opened(self) -> Any:  # noqa: ANN401  # the package is an extra
        if self._reader is None:
            try:
                from rosbags.highlevel import AnyReader
                from rosbags.typesys import Stores, get_typestore
            except ImportError as error:
                raise MissingExtraError(
                    f"{self.path}: ROS recordings need the extra `rosbag`: pip install 'xrdslam[rosbag]' (the package"
                    " rosbags)"
                ) from error
            with _reported(self.path):
                reader = AnyReader([self.path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
                reader.open()
            weakref.finalize(self, reader.close)
            self._reader = reader
        return self._reader


@contextlib.contextmanager
def _reported(path: Path) -> Iterator[None]:
    """Turn whatever the package raises on damaged files into an error of ours."""
    try:
        yield
    except (DataError, GeneratorExit):
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DataError(f"{path}: not a whole ROS recording ({reason}); copy it again, or reindex it") from error


def _pose_at(track: Any, T_child_camera: np.ndarray, tolerance_ns: int, time_ns: int) -> np.ndarray:  # noqa: ANN401
    return np.asarray(track.at(time_ns, tolerance_ns) @ T_child_camera)


def _pose_in_tree(tree: TransformTree, root: str, camera: str, tolerance_ns: int, time_ns: int) -> np.ndarray:
    return tree.at(root, camera, time_ns, tolerance_ns)
