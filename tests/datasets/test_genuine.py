"""Genuine files, found through XRDSLAM_DATA: the surface that one frame measures is where another frame sees it.

That holds only if poses, axes, intrinsics and the depth's scale are all read right, so each is also put wrong here, and
must do worse.
"""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.datasets.config import ReplicaConfig, SevenScenesConfig
from xrdslam.datasets.replica import ReplicaDataset
from xrdslam.datasets.sequence import RgbdSequence
from xrdslam.datasets.seven_scenes import SevenScenesDataset


def folder(*parts: str) -> Path:
    root = os.environ.get("XRDSLAM_DATA")
    if root is None:
        pytest.skip("XRDSLAM_DATA is not set: no genuine sequences to read")
    path = Path(root, *parts)
    if not path.is_dir():
        pytest.skip(f"XRDSLAM_DATA has no {'/'.join(parts)}")
    return path


def room0() -> RgbdSequence:
    return ReplicaDataset(ReplicaConfig(scene="room0", root=str(folder("Replica"))))


def whiteroom() -> RgbdSequence:
    return ReplicaDataset(ReplicaConfig(path=str(folder("Rendered", "whiteroom"))))


def redkitchen() -> RgbdSequence:
    return SevenScenesDataset(SevenScenesConfig(scene="redkitchen", root=str(folder("7-Scenes"))))


def redkitchen_jpeg() -> RgbdSequence:
    return SevenScenesDataset(SevenScenesConfig(scene="redkitchen", root=str(folder("7-Scenes-jpg"))))


def disagreement(one: Frame, other: Frame, camera: Camera, to_pose: Callable[[Tensor], Tensor], scale: float) -> float:
    """Return the median |z - depth| [m] of one frame's points in the other, where all four neighbours are measured."""
    assert one.depth is not None
    assert other.depth is not None
    assert one.T_world_camera_gt is not None
    assert other.T_world_camera_gt is not None
    measured = one.depth > 0
    points_one = camera.unproject(camera.pixels(), one.depth * scale)[measured]
    T_other_one = se3.inverse(to_pose(other.T_world_camera_gt)) @ to_pose(one.T_world_camera_gt)
    pixels, z = camera.project(se3.transform(T_other_one, points_one))
    grid = ((pixels + 0.5) / torch.tensor([camera.width, camera.height]) * 2 - 1)[None, None]
    maps = torch.stack((other.depth * scale, (other.depth > 0).float()))[None]
    depth, coverage = torch.nn.functional.grid_sample(maps, grid, align_corners=False)[0, :, 0]
    seen = camera.contains(pixels) & (z > 0) & (coverage > 0.999)
    assert seen.float().mean() > 0.3
    return float((depth - z)[seen].abs().median())


def kept(T: Tensor) -> Tensor:
    return T


def flipped(T: Tensor) -> Tensor:
    return T @ torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0]))


SEQUENCES = [
    # frames apart, limit [m]: measured 0.17 mm, 0.06 mm (exact depth, rounded to 0.15 mm), 9.2 mm, 6.8 mm (a Kinect)
    pytest.param(room0, 19, 3e-4, id="room0"),
    pytest.param(whiteroom, 20, 1e-4, id="whiteroom"),
    pytest.param(redkitchen, 11, 12e-3, id="redkitchen"),
    pytest.param(redkitchen_jpeg, 30, 9e-3, id="redkitchen-jpeg"),
]


@pytest.mark.parametrize(("opened", "gap", "limit"), SEQUENCES)
def test_depth_of_one_frame_is_where_another_measures_it(
    opened: Callable[[], RgbdSequence], gap: int, limit: float
) -> None:
    dataset = opened()
    dataset.check()
    one, other, camera = dataset[0], dataset[gap], dataset.camera
    right = disagreement(one, other, camera, kept, 1.0)
    assert right < limit
    assert disagreement(one, other, camera, se3.inverse, 1.0) > 3 * right  # world-to-camera in place of camera-to-world
    assert disagreement(one, other, camera, flipped, 1.0) > 3 * right  # OpenGL's axes


@pytest.mark.parametrize(
    ("opened", "gap"), [pytest.param(room0, 19, id="room0"), pytest.param(whiteroom, 20, id="whiteroom")]
)
def test_exact_depth_tells_a_hundredth_of_focal_length_and_scale_and_half_a_pixel(
    opened: Callable[[], RgbdSequence], gap: int
) -> None:
    dataset = opened()
    one, other, camera = dataset[0], dataset[gap], dataset.camera
    right = disagreement(one, other, camera, kept, 1.0)
    focal = [{axis: getattr(camera, axis) * factor} for axis in ("fx", "fy") for factor in (0.99, 1.01)]
    for change in [*focal, {"cx": camera.cx + 0.5}, {"cy": camera.cy + 0.5}]:
        assert disagreement(one, other, dataclasses.replace(camera, **change), kept, 1.0) > 1.2 * right, change
    for scale in (0.99, 1.01):
        assert disagreement(one, other, camera, kept, scale) > 1.2 * right


def test_resized_frames_agree_as_the_full_ones_do() -> None:
    path = str(folder("Rendered", "whiteroom"))
    dataset = ReplicaDataset(ReplicaConfig(path=path, size=[200, 113]))  # 3 to 1, and not quite
    assert disagreement(dataset[0], dataset[20], dataset.camera, kept, 1.0) < 1e-3


def test_facts_of_the_genuine_files() -> None:
    for opened, count, size in [(room0, 20, (1200, 680)), (whiteroom, 200, (600, 340)), (redkitchen, 12, (640, 480))]:
        dataset = opened()
        assert (len(dataset), (dataset.camera.width, dataset.camera.height)) == (count, size)
        assert dataset.modalities == {"rgb", "depth", "pose"}
    assert whiteroom().ground_truth_mesh is not None
    assert redkitchen()[0].timestamp_ns == 5_000_000_000  # frame 150, at 30 a second
    empty = (redkitchen_jpeg()[0].depth == 0).float().mean()
    assert 0.10 < float(empty) < 0.12  # 65535 where the Kinect saw nothing
