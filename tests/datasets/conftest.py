"""Small sequences of the toy room, written in the layout of every family: exact depth and poses, images of 40x30.

`layouts` maps a family to a `Layout`: it writes itself, opens itself, and knows where each frame's files are.
"""

import dataclasses
import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xrdslam.core.dataset import Dataset
from xrdslam.datasets.config import (
    CoFusionConfig,
    EurocConfig,
    RgbdFolderConfig,
    RosbagConfig,
    ScanNetConfig,
    TransformsConfig,
    TumRgbdConfig,
    VideoConfig,
)
from xrdslam.testing.toy_sequence import toy_sequence

COUNT = 5
WIDTH, HEIGHT = 40, 30
FX = FY = 36.0
CX, CY = 19.5, 14.5
INTRINSICS = [FX, FY, CX, CY]
T_BODY_CAMERA = np.array([[0.0, -1, 0, 0.02], [1, 0, 0, -0.06], [0, 0, 1, 0.01], [0, 0, 0, 1]])
START_NS = 1_403_715_285_262_142_976  # float64 holds it to 256 ns only


@dataclasses.dataclass(frozen=True)
class Toy:
    """A frame of the toy room as files hold it: 8 bits of colour, depth in metres, T_world_camera."""

    rgb: np.ndarray
    depth: np.ndarray
    pose: np.ndarray


@functools.cache
def toys() -> tuple[Toy, ...]:
    sequence = toy_sequence(COUNT, WIDTH, HEIGHT)
    return tuple(
        Toy(np.round(frame.rgb.numpy() * 255).astype(np.uint8), depth.numpy(), pose.numpy())
        for frame, pose in zip(sequence, sequence.poses, strict=True)
        if (depth := frame.depth) is not None
    )


def write_image(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image[..., ::-1] if image.ndim == 3 else image)


def quat_xyzw(pose: np.ndarray) -> list[float]:
    return [float(v) for v in Rotation.from_matrix(pose[:3, :3]).as_quat()]


def numbers(values: object) -> str:
    return " ".join(repr(float(v)) for v in np.ravel(values))


class Layout:
    """A sequence in the layout of a family, inside `folder`."""

    family = "none"
    scale = 1000.0  # levels per metre
    has_depth = True

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def write(self) -> "Layout":
        for i, toy in enumerate(toys()):
            self.write_frame(i, toy)
        self.write_rest()
        return self

    def write_frame(self, i: int, toy: Toy) -> None:
        write_image(self.colour_path(i), toy.rgb)
        write_image(self.depth_path(i), np.round(toy.depth * self.scale).astype(np.uint16))

    def colour_path(self, i: int) -> Path:
        raise NotImplementedError

    def depth_path(self, i: int) -> Path:
        raise NotImplementedError

    def time_ns(self, i: int) -> int:
        return round(i * 1e9 / 30)

    def write_rest(self) -> None:
        """Write what is not an image."""

    def open(self, **knobs: object) -> Dataset:
        raise NotImplementedError

    def edit(self, path: Path, change: Callable[[list[str]], list[str]]) -> Path:
        """Change the lines of a text file."""
        path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")
        return path


class TumRgbdLayout(Layout):
    family = "tum_rgbd"
    scale = 5000.0

    def time_ns(self, i: int) -> int:
        return 1_305_031_239_529_662_000 + i * 33_333_000

    def seconds(self, i: int, offset_ns: int = 0) -> str:
        ns = self.time_ns(i) + offset_ns
        return f"{ns // 10**9}.{ns % 10**9 // 1000:06d}"

    def colour_path(self, i: int) -> Path:
        return self.folder / "rgb" / f"{self.seconds(i)}.png"

    def depth_path(self, i: int) -> Path:
        return self.folder / "depth" / f"{self.seconds(i, 5_000_000)}.png"

    def write_rest(self) -> None:
        order = range(COUNT)
        rgb = [f"{self.seconds(i)} rgb/{self.colour_path(i).name}" for i in order]
        depth = [f"{self.seconds(i, 5_000_000)} depth/{self.depth_path(i).name}" for i in order]
        truth = [
            f"{self.seconds(i)} {numbers(toys()[i].pose[:3, 3])} {numbers(quat_xyzw(toys()[i].pose))}" for i in order
        ]
        for name, lines in (("rgb", rgb), ("depth", depth), ("groundtruth", truth)):
            (self.folder / f"{name}.txt").write_text("\n".join(["# a comment", *lines, ""]))

    def open(self, **knobs: object) -> Dataset:
        from xrdslam.datasets.tum_rgbd import TumRgbdDataset

        return TumRgbdDataset(TumRgbdConfig(**{"path": str(self.folder), "intrinsics": INTRINSICS, **knobs}))


class ScanNetLayout(Layout):
    family = "scannet"

    def colour_path(self, i: int) -> Path:
        return self.folder / "frames" / "color" / f"{i}.png"

    def depth_path(self, i: int) -> Path:
        return self.folder / "frames" / "depth" / f"{i}.png"

    def pose_path(self, i: int) -> Path:
        return self.folder / "frames" / "pose" / f"{i}.txt"

    def write_frame(self, i: int, toy: Toy) -> None:
        super().write_frame(i, toy)
        write_image(self.colour_path(i), toy.rgb.repeat(2, 0).repeat(2, 1))  # twice the depth's size
        self.pose_path(i).parent.mkdir(exist_ok=True)
        self.pose_path(i).write_text("\n".join(numbers(row) for row in toy.pose))

    def write_rest(self) -> None:
        folder = self.folder / "frames" / "intrinsic"
        folder.mkdir(exist_ok=True)
        for name, s in (("depth", 1), ("color", 2)):
            rows = [
                [s * FX, 0, (CX + 0.5) * s - 0.5, 0],
                [0, s * FY, (CY + 0.5) * s - 0.5, 0],
                [0, 0, 1, 0],
                [0, 0, 0, 1],
            ]
            (folder / f"intrinsic_{name}.txt").write_text("\n".join(numbers(row) for row in rows))

    def open(self, **knobs: object) -> Dataset:
        from xrdslam.datasets.scannet import ScanNetDataset

        return ScanNetDataset(ScanNetConfig(**{"path": str(self.folder), **knobs}))


class CoFusionLayout(Layout):
    family = "co_fusion"
    scale = 1.0

    def colour_path(self, i: int) -> Path:
        return self.folder / "colour" / f"Color{i + 1:04d}.png"

    def depth_path(self, i: int) -> Path:
        return self.folder / "depth_noise" / f"Depth{i + 1:04d}.exr"

    def time_ns(self, i: int) -> int:
        return round((i + 1) * 1e9 / 30)

    def write_frame(self, i: int, toy: Toy) -> None:
        import OpenEXR

        write_image(self.colour_path(i), toy.rgb)
        self.depth_path(i).parent.mkdir(exist_ok=True)
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"Y": toy.depth.astype(np.float32)}) as file:
            file.write(str(self.depth_path(i)))

    def write_rest(self) -> None:
        path = self.folder / "trajectories" / "gt-cam-0.txt"
        path.parent.mkdir()
        lines = [f"{i + 1} {numbers(toy.pose[:3, 3])} {numbers(quat_xyzw(toy.pose))}" for i, toy in enumerate(toys())]
        path.write_text("\n".join(lines) + "\n")
        (self.folder / "calibration.txt").write_text(f"{numbers(INTRINSICS)} {WIDTH} {HEIGHT}\n")

    def open(self, **knobs: object) -> Dataset:
        from xrdslam.datasets.co_fusion import CoFusionDataset

        return CoFusionDataset(CoFusionConfig(**{"path": str(self.folder), **knobs}))


class EurocLayout(Layout):
    family = "euroc"
    has_depth = False

    def time_ns(self, i: int) -> int:
        return START_NS + i * 50_000_128

    def colour_path(self, i: int, camera: str = "cam0") -> Path:
        return self.folder / "mav0" / camera / "data" / f"{self.time_ns(i)}.png"

    def write_frame(self, i: int, toy: Toy) -> None:
        for camera in ("cam0", "cam1"):
            write_image(self.colour_path(i, camera), toy.rgb[..., 1].copy())

    def write_rest(self) -> None:
        T_right = np.eye(4)
        T_right[:3, 3] = (0.11, 0.0, 0.0)  # in the left camera's axes
        for camera, T_body_sensor in (("cam0", T_BODY_CAMERA), ("cam1", T_BODY_CAMERA @ T_right)):
            self.write_sensor(camera, T_body_sensor)
            rows = [f"{self.time_ns(i)},{self.time_ns(i)}.png" for i in range(COUNT)]
            self.write_rows(camera, "#timestamp [ns],filename", rows)
        self.write_sensor("imu0", np.eye(4), with_camera=False)
        stamps = [self.time_ns(0) + k * 10_000_000 for k in range(-3, 25)]
        self.write_rows("imu0", "timestamp,w_x", [f"{t},{k}.0,0.5,0.25,9.81,{k}.5,0" for k, t in enumerate(stamps)])
        truth = [self._truth_row(i) for i in range(COUNT)]
        self.write_rows("state_groundtruth_estimate0", "#timestamp, p", truth)

    def _truth_row(self, i: int) -> str:
        T_world_body = toys()[i].pose @ np.linalg.inv(T_BODY_CAMERA)
        x, y, z, w = quat_xyzw(T_world_body)
        values = [*T_world_body[:3, 3].tolist(), w, x, y, z, *[0.0] * 9]
        return f"{self.time_ns(i)},{','.join(map(repr, values))}"

    def write_rows(self, sensor: str, title: str, rows: list[str]) -> None:
        path = self.folder / "mav0" / sensor / "data.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join([title, *rows, ""]))

    def write_sensor(self, sensor: str, T_body_sensor: np.ndarray, with_camera: bool = True) -> None:
        data = ", ".join(repr(float(v)) for v in T_body_sensor.ravel())
        text = f"%YAML:1.0\n# a comment\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\n"
        if with_camera:
            text += (
                f"camera_model: pinhole\nresolution: [{WIDTH}, {HEIGHT}]\nintrinsics: {INTRINSICS} #fu, fv, cu, cv\n"
            )
            text += "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
        path = self.folder / "mav0" / sensor / "sensor.yaml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def open(self, **knobs: object) -> Dataset:
        from xrdslam.datasets.euroc import EurocDataset

        return EurocDataset(EurocConfig(**{"path": str(self.folder), **knobs}))


class RgbdFolderLayout(Layout):
    family = "rgbd_folder"

    def colour_path(self, i: int) -> Path:
        return self.folder / "images" / f"view_{i}.png"

    def depth_path(self, i: int) -> Path:
        return self.folder / "depth" / f"d{i:03d}.png"

    def write_rest(self) -> None:
        (self.folder / "poses.txt").write_text("\n".join(numbers(toy.pose) for toy in toys()))
        (self.folder / "K.txt").write_text(f"{FX} 0 {CX}\n0 {FY} {CY}\n0 0 1\n")

    def open(self, **knobs: object) -> Dataset:
        from xrdslam.datasets.rgbd_folder import RgbdFolderDataset

        return RgbdFolderDataset(RgbdFolderConfig(**{"path": str(self.folder), **knobs}))


class TransformsLayout(Layout):
    family = "transforms"

    def colour_path(self, i: int) -> Path:
        return self.folder / "images" / f"{i}.png"

    def depth_path(self, i: int) -> Path:
        return self.folder / "depth" / f"{i}.png"

    def values(self) -> dict[str, Any]:
        """What transforms.json holds: OpenGL's axes, the first pixel's centre at (0.5, 0.5)."""
        camera = {"fl_x": FX, "fl_y": FY, "cx": CX + 0.5, "cy": CY + 0.5, "w": WIDTH, "h": HEIGHT}
        flip = np.diag([1.0, -1.0, -1.0, 1.0])
        frames = [
            {
                "file_path": f"images/{i}.png",
                "depth_file_path": f"depth/{i}.png",
                "transform_matrix": (toy.pose @ flip).tolist(),
            }
            for i, toy in enumerate(toys())
        ]
        return {**camera, "frames": frames[::-1]}

    def write_values(self, values: object) -> None:
        (self.folder / "transforms.json").write_text(json.dumps(values))

    def write_rest(self) -> None:
        self.write_values(self.values())

    def open(self, **knobs: object) -> Dataset:
        from xrdslam.datasets.transforms import TransformsDataset

        return TransformsDataset(TransformsConfig(**{"path": str(self.folder), **knobs}))


class VideoLayout(Layout):
    family = "video"
    has_depth = False

    @property
    def file(self) -> Path:
        return self.folder / "clip.avi"

    def colour_path(self, i: int) -> Path:
        return self.file

    def write(self) -> Layout:
        writer = cv2.VideoWriter(str(self.file), cv2.VideoWriter_fourcc(*"MJPG"), 30.0, (WIDTH, HEIGHT))
        for toy in toys():
            writer.write(toy.rgb[..., ::-1].copy())
        writer.release()
        self.file.with_suffix(".txt").write_text(numbers(INTRINSICS))
        return self

    def open(self, **knobs: object) -> Dataset:
        from xrdslam.datasets.video import VideoDataset

        return VideoDataset(VideoConfig(**{"path": str(self.file), **knobs}))


class RosbagLayout(Layout):
    """A bag of one of three kinds; `depth_encoding` and `compressed` say how images are held."""

    family = "rosbag"
    kind = "ros1"
    depth_encoding = "16UC1"
    compressed = False
    poses = "pose"

    def time_ns(self, i: int) -> int:
        return 1_700_000_000_000_000_123 + i * 33_333_000

    @property
    def path(self) -> Path:
        return self.folder / ("clip.bag" if self.kind == "ros1" else "clip")

    def write(self) -> Layout:
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2
        from rosbags.typesys import Stores, get_typestore

        is_ros1 = self.kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
        plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
        self.writer = Writer1(self.path) if is_ros1 else Writer2(self.path, version=9, storage_plugin=plugin)
        self.connections: dict[str, Any] = {}
        with self.writer:
            self.write_static()
            for i, toy in enumerate(toys()):
                self.write_toy(i, toy)
        return self

    def write_static(self) -> None:
        """Write what comes before the frames."""

    def write_toy(self, i: int, toy: Toy) -> None:
        time = self.time_ns(i)
        rgb, depth = self.images(i, toy)
        self.send("/camera/color/image_raw" + "/compressed" * self.compressed, time, rgb)
        name = "/camera/aligned_depth_to_color/image_raw" + "/compressedDepth" * self.compressed
        self.send(name, time + 4_000_000, depth)
        self.send("/camera/color/camera_info", time, self.info())
        if self.poses == "pose":
            self.send("/mocap/camera", time, self.stamped_pose(time, toy.pose))
        elif self.poses == "tf":
            self.send("/tf", time, self.transforms(time, "map", "base", toy.pose @ np.linalg.inv(T_BODY_CAMERA)))

    def images(self, i: int, toy: Toy) -> tuple[Any, Any]:
        time = self.time_ns(i)
        levels = np.round(toy.depth * 1000).astype(np.uint16)
        if self.compressed:
            png = [cv2.imencode(".png", image)[1].ravel() for image in (toy.rgb[..., ::-1], levels)]
            depth_data = np.concatenate([np.zeros(12, np.uint8), png[1]])
            make = self.store.types["sensor_msgs/msg/CompressedImage"]
            return (
                make(self.header(time), "rgb8; png compressed bgr8", png[0]),
                make(self.header(time + 4_000_000), "16UC1; compressedDepth png", depth_data),
            )
        depth = toy.depth.astype(np.float32) if self.depth_encoding == "32FC1" else levels
        return (
            self.image(time, "bgr8", toy.rgb[..., ::-1]),
            self.image(time + 4_000_000, self.depth_encoding, depth),
        )

    def image(self, time: int, encoding: str, pixels: np.ndarray, padding: int = 8) -> Any:
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
        padded = np.pad(rows, ((0, 0), (0, padding)))
        return self.store.types["sensor_msgs/msg/Image"](
            self.header(time), len(pixels), pixels.shape[1], encoding, 0, padded.shape[1], padded.ravel()
        )

    def info(self) -> Any:
        roi = self.store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        K = np.array([FX, 0, CX, 0, FY, CY, 0, 0, 1])
        P = np.array([FX, 0, CX, 0, 0, FY, CY, 0, 0, 0, 1, 0])
        make = self.store.types["sensor_msgs/msg/CameraInfo"]
        header, R = self.header(self.time_ns(0)), np.eye(3).ravel()
        return make(header, HEIGHT, WIDTH, "plumb_bob", np.zeros(5), K, R, P, 0, 0, roi)

    def header(self, time: int, frame: str = "optical") -> Any:
        stamp = self.store.types["builtin_interfaces/msg/Time"](time // 10**9, time % 10**9)
        make = self.store.types["std_msgs/msg/Header"]
        return make(0, stamp, frame) if self.kind == "ros1" else make(stamp, frame)

    def stamped_pose(self, time: int, pose: np.ndarray) -> Any:
        types = self.store.types
        x, y, z = pose[:3, 3].tolist()
        point = types["geometry_msgs/msg/Point"](x, y, z)
        turn = types["geometry_msgs/msg/Quaternion"](*quat_xyzw(pose))
        inner = types["geometry_msgs/msg/Pose"](point, turn)
        return types["geometry_msgs/msg/PoseStamped"](self.header(time, "map"), inner)

    def transforms(self, time: int, parent: str, child: str, pose: np.ndarray) -> Any:
        types = self.store.types
        x, y, z = pose[:3, 3].tolist()
        move = types["geometry_msgs/msg/Vector3"](x, y, z)
        turn = types["geometry_msgs/msg/Quaternion"](*quat_xyzw(pose))
        inner = types["geometry_msgs/msg/Transform"](move, turn)
        stamped = types["geometry_msgs/msg/TransformStamped"](self.header(time, parent), child, inner)
        return types["tf2_msgs/msg/TFMessage"]([stamped])

    def send(self, topic: str, time: int, message: Any) -> None:
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.kind == "ros1" else self.store.serialize_cdr
        self.writer.write(self.connections[topic], time + 1_000_000, serialize(message, kind))

    def open(self, **knobs: object) -> Dataset:
        from xrdslam.datasets.rosbag import RosbagDataset

        return RosbagDataset(RosbagConfig(**{"path": str(self.path), **knobs}))


class Ros2Layout(RosbagLayout):
    family = "rosbag-db3"
    kind = "db3"
    depth_encoding = "32FC1"
    poses = "tf"

    def write_static(self) -> None:
        self.send("/tf_static", self.time_ns(0), self.transforms(self.time_ns(0), "base", "optical", T_BODY_CAMERA))


class McapLayout(RosbagLayout):
    family = "rosbag-mcap"
    kind = "mcap"
    compressed = True


LAYOUTS: dict[str, type[Layout]] = {
    layout.family: layout
    for layout in (
        *(TumRgbdLayout, ScanNetLayout, CoFusionLayout, EurocLayout),
        *(RgbdFolderLayout, TransformsLayout, VideoLayout, RosbagLayout, Ros2Layout, McapLayout),
    )
}


@pytest.fixture(scope="session")
def layouts() -> dict[str, type[Layout]]:
    return LAYOUTS


@pytest.fixture(params=sorted(LAYOUTS))
def written(request: pytest.FixtureRequest, tmp_path: Path) -> Layout:
    """Each family's sequence, written."""
    layout = LAYOUTS[request.param](tmp_path / "scene")
    layout.folder.mkdir()
    return layout.write()


@pytest.fixture(scope="session")
def toy_frames() -> tuple[Toy, ...]:
    return toys()
