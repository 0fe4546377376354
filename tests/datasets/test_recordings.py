"""One's own recordings in the forms that people have them: cameras, poses, names, clips, bags."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError, MissingExtraError
from xrdslam.datasets.cameras import read_camera
from xrdslam.datasets.naming import natural_key, number_or_time
from xrdslam.datasets.registration import register_depth

FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture
def folder(layouts: dict[str, Any], tmp_path: Path) -> Any:
    return layouts["rgbd_folder"](tmp_path / "office").write()


@pytest.fixture
def transforms(layouts: dict[str, Any], tmp_path: Path) -> Any:
    return layouts["transforms"](tmp_path / "scan").write()


# Cameras.

CAMERAS: dict[str, str] = {
    "K.txt": "36 0 19.5\n0 37 14.5\n0 0 1\n",
    "intrinsics.txt": "36 0 19.5 0\n0 37 14.5 0\n0 0 1 0\n0 0 0 1\n",
    "camera.txt": "# fx fy cx cy\n36, 37, 19.5, 14.5",
    "calibration.txt": "36 37 19.5 14.5 40 30",
    "intrinsics.json": '{"fx": 36, "fy": 37, "ppx": 19.5, "ppy": 14.5, "width": 40, "height": 30}',
    "camera_intrinsic.json": '{"width": 40, "height": 30, "intrinsic_matrix": [36, 0, 0, 0, 37, 0, 19.5, 14.5, 1]}',
    "cam_params.json": '{"camera": {"w": 40, "h": 30, "fx": 36, "fy": 37, "cx": 19.5, "cy": 14.5, "scale": 1000}}',
    "camera.json": '{"K": [[36, 0, 19.5], [0, 37, 14.5], [0, 0, 1]]}',
    "camera_info.yaml": (
        "image_width: 40\nimage_height: 30\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
        "  data: [36.0, 0, 19.5, 0, 37.0, 14.5, 0, 0, 1]\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}"
    ),
    "calibration.yaml": (
        "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
        "   data: [ 36., 0., 19.5, 0., 37., 14.5, 0., 0., 1. ]\n"
    ),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_every_common_form_of_intrinsics_is_read(folder: Any, name: str) -> None:
    (folder.folder / "K.txt").unlink()
    (folder.folder / name).write_text(CAMERAS[name])
    assert folder.open().camera == Camera(36.0, 37.0, 19.5, 14.5, 40, 30)


def test_intrinsics_of_another_size_of_the_same_shape_are_scaled(folder: Any) -> None:
    stated = Camera(36.0, 36.0, 19.5, 14.5, 40, 30).resized(160, 120)
    (folder.folder / "K.txt").write_text(f"{stated.fx} {stated.fy} {stated.cx} {stated.cy} 160 120")
    camera = folder.open().camera
    assert (camera.width, camera.height, camera.fx, camera.cx) == (40, 30, 36.0, 19.5)


def test_the_command_line_goes_before_the_files(folder: Any) -> None:
    assert folder.open(intrinsics=[40.0, 41.0, 19.0, 14.0]).camera == Camera(40.0, 41.0, 19.0, 14.0, 40, 30)


def test_a_lens_bends_colour_and_depth_alike(folder: Any) -> None:
    (folder.folder / "K.txt").write_text("36 0 19.5\n0 36 14.5\n0 0 1")
    frame = folder.open(intrinsics=[36.0, 36.0, 19.5, 14.5], distortion=[0.3, 0.0, 0.0, 0.0])[0]
    plain = folder.open()[0]
    assert frame.camera.distortion == ()
    assert not np.allclose(frame.rgb, plain.rgb, atol=0.02)
    assert not np.array_equal(frame.depth, plain.depth)
    assert set(np.unique(frame.depth)) - {0.0} <= set(np.unique(plain.depth))


def test_the_scale_of_depth_is_what_is_said_else_what_the_camera_file_says(folder: Any) -> None:
    depth = folder.open()[0].depth
    np.testing.assert_allclose(folder.open(depth_scale=2000.0)[0].depth * 2, depth, rtol=1e-6)
    (folder.folder / "K.txt").unlink()
    values = {"fx": 36, "fy": 36, "cx": 19.5, "cy": 14.5, "depth_scale": 0.0005}  # metres a level, as a RealSense has
    (folder.folder / "camera.json").write_text(json.dumps(values))
    np.testing.assert_allclose(folder.open()[0].depth * 2, depth, rtol=1e-6)


def test_levels_that_mean_nothing_are_no_depth(folder: Any) -> None:
    level = round(float(folder.open()[0].depth[5, 5]) * 1000)
    assert folder.open(invalid_depth=[level])[0].depth[5, 5] == 0


# Poses.


def quaternion_line(pose: np.ndarray) -> str:
    return " ".join(map(repr, [*pose[:3, 3].tolist(), *Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()]))


def rows(pose: np.ndarray, count: int = 4) -> str:
    return " ".join(map(repr, pose[:count].ravel().tolist()))


POSES: dict[str, Callable[[list[np.ndarray]], str]] = {
    "poses.txt": lambda poses: "\n".join(rows(pose) for pose in poses),
    "traj.txt": lambda poses: "\n".join(rows(pose, 3) for pose in poses),  # KITTI's 3x4
    "trajectory.txt": lambda poses: "\n".join(f"{i} {quaternion_line(pose)}" for i, pose in enumerate(poses)),
    "gt.txt": lambda poses: "\n".join(f"{i}, {rows(pose).replace(' ', ', ')}" for i, pose in enumerate(poses)),
    "pose.txt": lambda poses: "\n".join(quaternion_line(pose) for pose in poses),
    "poses.csv": lambda poses: "x,y,z,qx,qy,qz,qw\n" + "\n".join(quaternion_line(p).replace(" ", ",") for p in poses),
    "camera_poses.txt": lambda poses: "\n".join(
        "\n".join(" ".join(map(repr, row)) for row in p.tolist()) for p in poses
    ),
    "traj.log": lambda poses: "\n".join(
        f"{i} {i} 0\n" + "\n".join(" ".join(map(repr, row)) for row in pose.tolist()) for i, pose in enumerate(poses)
    ),
}


@pytest.mark.parametrize("name", POSES)
def test_every_common_form_of_poses_is_read(folder: Any, toy_frames: tuple[Any, ...], name: str) -> None:
    (folder.folder / "poses.txt").unlink()
    (folder.folder / name).write_text(POSES[name]([toy.pose for toy in toy_frames]) + "\n")
    dataset = folder.open()
    dataset.check()
    for frame, toy in zip(dataset.frames(), toy_frames, strict=True):
        np.testing.assert_allclose(frame.T_world_camera_gt, toy.pose, atol=1e-6)


def test_a_pose_file_for_each_frame_is_joined_by_number(folder: Any, toy_frames: tuple[Any, ...]) -> None:
    (folder.folder / "poses.txt").unlink()
    (folder.folder / "pose").mkdir()
    for i, toy in enumerate(toy_frames):
        (folder.folder / "pose" / f"p{i}.txt").write_text(rows(toy.pose))
    np.testing.assert_allclose(folder.open()[3].T_world_camera_gt, toy_frames[3].pose, atol=1e-6)
    (folder.folder / "pose" / "p3.txt").unlink()
    with pytest.raises(DataError, match=r"frame 3 has no pose; found 5 x colour image, 5 x depth image, 4 x pose"):
        folder.open().check()


def test_the_other_direction_and_the_other_axes_are_turned(folder: Any, toy_frames: tuple[Any, ...]) -> None:
    poses = [toy.pose for toy in toy_frames]
    (folder.folder / "poses.txt").write_text("\n".join(rows(np.linalg.inv(pose)) for pose in poses))
    turned = folder.open(pose_direction="world_to_camera")[2]
    np.testing.assert_allclose(turned.T_world_camera_gt, poses[2], atol=1e-6)
    (folder.folder / "poses.txt").write_text("\n".join(rows(pose @ FLIP_YZ) for pose in poses))
    np.testing.assert_allclose(folder.open(pose_axes="opengl")[2].T_world_camera_gt, poses[2], atol=1e-6)


def test_poses_and_depth_may_be_left_out(folder: Any) -> None:
    assert folder.open(poses="none").modalities == {"rgb", "depth"}
    assert folder.open(depth="none").modalities == {"rgb", "pose"}


# Names.


def test_frames_come_in_natural_order() -> None:
    names = ["frame10.png", "frame9.png", "frame1.png", "Frame2.png"]
    assert sorted(names, key=natural_key)[-2:] == ["frame9.png", "frame10.png"]


@pytest.mark.parametrize(
    ("stem", "expected"),
    [
        ("frame000012", (12, False)),
        ("rgb_7_left", (7, False)),
        ("1305031239.529662", (1305031239529662000, True)),
        ("cam_1305031239_529662", (1305031239529662000, True)),
        ("1403715285262142976", (1403715285262142976, True)),
        ("1403715285262", (1403715285262000000, True)),
        ("1403715285262142", (1403715285262142000, True)),
        ("20240131", (20240131, False)),
        ("left", (None, False)),
    ],
)
def test_numbers_and_times_in_names_are_told_apart(stem: str, expected: tuple[int | None, bool]) -> None:
    assert number_or_time(stem) == expected


def test_images_named_by_time_are_joined_by_time_and_poses_too(folder: Any, toy_frames: tuple[Any, ...]) -> None:
    start = 1_700_000_000_000_000_000
    times = [start + i * 33_000_000 for i in range(5)]
    for i, time in enumerate(times):
        folder.colour_path(i).rename(folder.colour_path(i).with_name(f"{time}.png"))
        folder.depth_path(i).rename(folder.depth_path(i).with_name(f"{time + 3_000_000}.png"))
    lines = [f"{t / 1e9:.9f} {quaternion_line(toy.pose)}" for t, toy in zip(times, toy_frames, strict=True)]
    (folder.folder / "poses.txt").write_text("\n".join(lines))
    dataset = folder.open()
    dataset.check()
    assert [frame.timestamp_ns for frame in dataset.frames()] == times
    np.testing.assert_allclose(dataset[4].T_world_camera_gt, toy_frames[4].pose, atol=1e-5)
    assert dataset.modalities == {"rgb", "depth", "pose"}


def test_patterns_tell_apart_what_lies_in_one_folder(folder: Any) -> None:
    for i in range(5):
        folder.colour_path(i).rename(folder.folder / f"{i}.color.png")
        folder.depth_path(i).rename(folder.folder / f"{i}.z.png")
    dataset = folder.open(rgb="*.color.png", depth="*.z.png")
    dataset.check()
    assert dataset.modalities == {"rgb", "depth", "pose"}


@pytest.mark.parametrize("suffix", ["npy", "exr"])
def test_depth_may_be_floats(folder: Any, toy_frames: tuple[Any, ...], suffix: str, layouts: dict[str, Any]) -> None:
    for i, toy in enumerate(toy_frames):
        folder.depth_path(i).unlink()
        if suffix == "npy":
            np.save(folder.depth_path(i).with_suffix(".npy"), toy.depth)
        else:
            other = layouts["co_fusion"](folder.folder / "exr")
            other.write_frame(i, toy)
            other.depth_path(i).rename(folder.depth_path(i).with_suffix(".exr"))
    dataset = folder.open()
    dataset.check()
    np.testing.assert_array_equal(dataset[2].depth, toy_frames[2].depth)


def test_depth_may_be_smaller_than_colour(folder: Any, toy_frames: tuple[Any, ...]) -> None:
    import cv2

    for i, toy in enumerate(toy_frames):
        cv2.imwrite(str(folder.depth_path(i)), np.round(toy.depth[::2, ::2] * 1000).astype(np.uint16))
    dataset = folder.open()
    dataset.check()
    assert dataset[0].depth.shape == (30, 40)


# transforms.json.


def test_one_camera_in_each_frame_becomes_their_median(transforms: Any, caplog: pytest.LogCaptureFixture) -> None:
    values = transforms.values()
    shared = {key: values.pop(key) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h")}
    for i, frame in enumerate(values["frames"]):
        frame.update(shared, fl_x=36.0 + 0.1 * (i - 2))
    transforms.write_values(values)
    assert transforms.open().camera == Camera(36.0, 36.0, 19.5, 14.5, 40, 30)
    assert "differ by up to 0.56 %" in caplog.text
    values["frames"][0]["fl_x"] = 38.0
    transforms.write_values(values)
    with pytest.raises(DataError, match=r"differ by up to 5\.3% of the focal length .*; one camera is needed"):
        transforms.open()


def test_an_angle_gives_the_focal_length_and_the_middle_the_centre(transforms: Any) -> None:
    values = {"camera_angle_x": 2 * np.arctan(20 / 36.0), "frames": transforms.values()["frames"]}
    transforms.write_values(values)
    camera = transforms.open().camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (pytest.approx(36.0), pytest.approx(36.0), 19.5, 14.5)
    assert transforms.open(pixel_centre=0.0).camera.cx == 20.0


def test_extensions_may_be_left_out_and_frames_come_by_time(transforms: Any) -> None:
    values = transforms.values()
    for i, frame in enumerate(values["frames"]):
        frame["file_path"] = f"./{frame['file_path'].removesuffix('.png')}"
        frame["timestamp"] = 100.0 + 0.5 * i  # the file lists them backwards
    transforms.write_values(values)
    dataset = transforms.open()
    dataset.check()
    assert dataset.records[0].rgb.name == "4.png"
    assert dataset[1].timestamp_ns == 100_500_000_000


@pytest.mark.parametrize("key", ["depth_unit_scale_factor", "integer_depth_scale"])
def test_metres_a_level_are_read(transforms: Any, key: str) -> None:
    depth = transforms.open()[0].depth
    transforms.write_values({**transforms.values(), key: 0.002})
    np.testing.assert_allclose(transforms.open()[0].depth, 2 * depth, rtol=1e-6)


def test_without_depth_it_is_monocular(transforms: Any) -> None:
    values = transforms.values()
    for frame in values["frames"]:
        del frame["depth_file_path"]
    transforms.write_values(values)
    assert transforms.open().modalities == {"rgb", "pose"}


# Video.


def test_going_back_in_a_video_gives_the_same_frame(layouts: dict[str, Any], tmp_path: Path) -> None:
    dataset = layouts["video"](tmp_path).write().open()
    last, first = dataset[4].rgb, dataset[0].rgb
    np.testing.assert_array_equal(dataset[4].rgb, last)
    np.testing.assert_array_equal(dataset[0].rgb, first)
    assert not np.array_equal(first, last)


# Bags.


def test_depth_of_another_camera_is_moved_into_colour(layouts: dict[str, Any], tmp_path: Path) -> None:
    """A wall at z = 2 m, 5 cm to the side, seen by a depth camera of half the resolution, with a box before it."""
    T_to_of = np.eye(4)
    T_to_of[0, 3] = 0.05
    of, to = Camera(50.0, 50.0, 31.5, 23.5, 64, 48), Camera(100.0, 100.0, 63.5, 47.5, 128, 96)
    depth = np.full((48, 64), 2.0, np.float32)
    depth[20:28, 28:36] = 1.0
    moved = register_depth(depth, of, to, T_to_of)
    inner = moved[4:-4, 12:-8]
    holes = inner == 0
    assert set(np.unique(inner[~holes])) == {np.float32(1.0), np.float32(2.0)}
    # The wall moved by 100 * 0.05 / 2 = 2.5 px, the box by 5: behind it 2.5 px of 16 rows cannot be seen.
    assert 16 <= holes.sum() <= 4 * 18
    columns = np.flatnonzero(moved[48] == 1.0)
    assert abs(columns.mean() - ((31.5 + 0.5) * 2 - 0.5 + 5)) <= 0.5
    assert 15 <= len(columns) <= 18


def test_topics_are_chosen_and_said(layouts: dict[str, Any], tmp_path: Path) -> None:
    bag = layouts["rosbag"](tmp_path).write()
    dataset = bag.open()
    assert dataset.rgb_topic == "/camera/color/image_raw"
    assert dataset.depth_topic == "/camera/aligned_depth_to_color/image_raw"
    assert dataset.pose_source == "/mocap/camera"
    assert bag.open(depth_topic="none", pose_topic="none").modalities == {"rgb"}
    with pytest.raises(DataError, match=r"dataset\.rgb_topic=/front: no such topic .* there is: .*/camera/color/image"):
        bag.open(rgb_topic="/front")


def test_tf_leads_through_fixed_and_moving_frames(layouts: dict[str, Any], tmp_path: Path) -> None:
    dataset = layouts["rosbag-db3"](tmp_path).write().open()
    assert dataset.pose_source == "tf, optical in map"
    with pytest.raises(DataError, match=r"dataset\.fixed_frame=world: tf leads from the camera 'optical' to base, map"):
        layouts["rosbag-db3"](tmp_path).open(fixed_frame="world")


def test_a_file_of_a_ros2_recording_stands_for_its_folder(layouts: dict[str, Any], tmp_path: Path) -> None:
    bag = layouts["rosbag-mcap"](tmp_path).write()
    file = next(bag.path.glob("*.mcap"))
    assert len(bag.open(path=str(file))) == 5


def test_camera_files_say_where_they_are_wrong(tmp_path: Path) -> None:
    for text in ("1 2 3", "a b c d", "0 0 19 0 36 14 0 0 1", "36 5 19 0 36 14 0 0 1", "36 36 nan 14"):
        path = tmp_path / "K.txt"
        path.write_text(text)
        with pytest.raises(DataError, match=r"K\.txt: "):
            read_camera(path)


@pytest.mark.parametrize(
    ("family", "module", "extra"), [("co_fusion", "OpenEXR", "exr"), ("rosbag", "rosbags", "rosbag")]
)
def test_a_missing_package_names_the_extra(
    layouts: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, family: str, module: str, extra: str
) -> None:
    written = layouts[family](tmp_path / "scene")
    written.folder.mkdir()
    written.write()
    for name in [name for name in sys.modules if name.split(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"need the extra `{extra}`: pip install 'xrdslam\[{extra}\]'"):
        written.open()[0]
