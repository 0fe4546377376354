"""Small sequences of the toy room, written in the layout of every family: exact depth and poses, images of 40x30.

`layouts` maps a family to a `Layout`: it writes itself, opens itself, and knows where each frame's files are.
"""

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xrdslam.core.dataset import Dataset
from xrdslam.datasets.config import CoFusionConfig, EurocConfig, ScanNetConfig, TumRgbdConfig
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


LAYOUTS: dict[str, type[Layout]] = {
    layout.family: layout for layout in (TumRgbdLayout, ScanNetLayout, CoFusionLayout, EurocLayout)
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
