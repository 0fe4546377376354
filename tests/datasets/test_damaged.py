"""A corpus of damage over all formats: each is an error that names its file and a remedy, or under skip costs a frame.

Every case starts from a sound sequence of five frames. `lost` are the frames that on_error=skip leaves out; none where
what is wrong concerns the sequence as a whole, which is refused under either.
"""

# ruff: noqa: E501  (a table: one case a line)

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from xrdslam.core.errors import DataError

Damage = Callable[[Any], object]


@dataclasses.dataclass(frozen=True)
class Case:
    family: str
    name: str
    damage: Damage
    message: str
    lost: tuple[int, ...] | None = (2,)

    def __str__(self) -> str:
        return f"{self.family}: {self.name}"


def cut(path: Path, share: float = 0.5) -> None:
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])


def replaced_by(path: Path, make: Callable[[Path], object]) -> None:
    path.unlink()
    make(path)


def image(path: Path, *shape: int, dtype: type = np.uint8) -> None:
    assert cv2.imwrite(str(path), np.ones(shape, dtype))


def line(path: Path, number: int, text: str | None) -> None:
    """Replace a line, counted from 0; None removes it."""
    lines = path.read_text().splitlines()
    lines[number : number + 1] = [] if text is None else [text]
    path.write_text("\n".join(lines) + "\n")


def change(layout: Any, edit: Callable[[dict[str, Any]], object]) -> None:
    """Change what a transforms.json holds; frames are sorted as they are read."""
    values = layout.values()
    values["frames"].reverse()
    edit(values)
    layout.write_values(values)


FILES: list[tuple[str, Damage, str]] = [  # what can happen to the colour image of a frame, in any format of files
    ("truncated", lambda s: cut(s.colour_path(2)), "truncated"),
    ("empty", lambda s: s.colour_path(2).write_bytes(b""), "empty file"),
    ("web page", lambda s: s.colour_path(2).write_text("<html>"), "neither PNG nor JPEG"),
    ("other size", lambda s: image(s.colour_path(2), 7, 9, 3), "an image of 9x7 px"),
    ("16 bits", lambda s: image(s.colour_path(2), 30, 40, 3, dtype=np.uint16), "3 of 16"),
    (
        "dangling link",
        lambda s: replaced_by(s.colour_path(2), lambda p: p.symlink_to("/nowhere/x.png")),
        "no such file",
    ),
    (
        "loop of links",
        lambda s: replaced_by(s.colour_path(2), lambda p: p.symlink_to(p)),
        "cannot be read|no such file",
    ),
    ("pipe", lambda s: replaced_by(s.colour_path(2), os.mkfifo), "not a file"),
    ("folder", lambda s: replaced_by(s.colour_path(2), Path.mkdir), "not a file"),
]
DEPTHS: list[tuple[str, Damage, str]] = [
    ("depth truncated", lambda s: cut(s.depth_path(2), 0.7), "truncated"),
    ("depth of 8 bits", lambda s: image(s.depth_path(2), 30, 40), "1 of 8"),
    ("depth in colour", lambda s: image(s.depth_path(2), 30, 40, 3), "3 of 8"),
    ("depth of another size", lambda s: image(s.depth_path(2), 5, 6, dtype=np.uint16), "an image of 6x5 px"),
    ("depth missing", lambda s: s.depth_path(2).unlink(), "no such file|has no depth"),
]
CASES = [Case(family, *damage) for family in ("tum_rgbd", "euroc", "rgbd_folder", "transforms") for damage in FILES]
CASES += [Case(family, *damage) for family in ("tum_rgbd", "scannet", "rgbd_folder", "transforms") for damage in DEPTHS]
CASES += [
    # TUM: lists of times and files.
    Case("tum_rgbd", "list missing", lambda s: (s.folder / "depth.txt").unlink(), r"depth\.txt: no such file", None),
    Case("tum_rgbd", "list empty", lambda s: (s.folder / "rgb.txt").write_text("# none\n"), "lists no file", None),
    Case("tum_rgbd", "list binary", lambda s: (s.folder / "rgb.txt").write_bytes(b"\xff\xfe\x00"), "not a readable", None),
    Case("tum_rgbd", "no time", lambda s: line(s.folder / "rgb.txt", 3, "noon rgb/x.png"), "line 4: 'noon' is not"),
    Case("tum_rgbd", "NaN as time", lambda s: line(s.folder / "rgb.txt", 3, "nan rgb/x.png"), "line 4: 'nan' is not"),
    Case("tum_rgbd", "no file", lambda s: line(s.folder / "rgb.txt", 3, s.seconds(2)), "line 4: a line is a time and a"),
    Case("tum_rgbd", "leads out", lambda s: line(s.folder / "rgb.txt", 3, f"{s.seconds(2)} ../../x.png"), "leads out of"),
    Case("tum_rgbd", "absolute", lambda s: line(s.folder / "rgb.txt", 3, f"{s.seconds(2)} /etc/passwd"), "leads out of"),
    Case("tum_rgbd", "time twice", lambda s: line(s.folder / "rgb.txt", 3, f"{s.seconds(1)} rgb/x.png"), "stands there twice"),
    Case(
        "tum_rgbd",
        "other recording's depth",
        lambda s: s.edit(s.folder / "depth.txt", lambda lines: [text.replace("130503", "140503", 1) for text in lines]),
        r"no colour image has a depth image within 0\.02 s, the nearest are 99999999",
        None,
    ),
    Case(
        "tum_rgbd",
        "other recording's poses",
        lambda s: s.edit(s.folder / "groundtruth.txt", lambda lines: [text.replace("130503", "140503", 1) for text in lines]),
        r"groundtruth\.txt: has no pose within",
        None,
    ),
    Case("tum_rgbd", "NaN pose", lambda s: line(s.folder / "groundtruth.txt", 3, f"{s.seconds(2)} nan 0 0 0 0 0 1"),
         r"groundtruth\.txt, line 4: the pose has a NaN", ()),
    Case("tum_rgbd", "infinite pose", lambda s: line(s.folder / "groundtruth.txt", 3, f"{s.seconds(2)} inf 0 0 0 0 0 1"),
         r"groundtruth\.txt, line 4: the pose has a NaN or infinity", ()),
    Case("tum_rgbd", "no quaternion", lambda s: line(s.folder / "groundtruth.txt", 3, f"{s.seconds(2)} 0 0 0 0 0 0 3"),
         "the quaternion has length 3", ()),
    Case("tum_rgbd", "short pose", lambda s: line(s.folder / "groundtruth.txt", 3, f"{s.seconds(2)} 0 0 0"),
         "found 4 numbers", ()),
    # ScanNet.
    Case("scannet", "no intrinsics", lambda s: (s.folder / "frames/intrinsic/intrinsic_depth.txt").unlink(),
         r"intrinsic_depth\.txt: no such file", None),
    Case("scannet", "zero intrinsics",
         lambda s: (s.folder / "frames/intrinsic/intrinsic_depth.txt").write_text("0 " * 16), "must be above 0", None),
    Case("scannet", "words", lambda s: (s.folder / "frames/intrinsic/intrinsic_color.txt").write_text("a b c"),
         "intrinsics are a matrix of numbers", None),
    Case("scannet", "three numbers", lambda s: (s.folder / "frames/intrinsic/intrinsic_color.txt").write_text("1 2 3"),
         "found 3 numbers", None),
    Case("scannet", "no pose", lambda s: s.pose_path(2).unlink(), "frame 2 has no pose"),
    Case("scannet", "NaN pose", lambda s: s.pose_path(2).write_text("nan " * 16), "the pose has a NaN"),
    Case("scannet", "scaled pose", lambda s: s.pose_path(2).write_text("2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1"), "not orthonormal"),
    Case("scannet", "cut pose", lambda s: s.pose_path(2).write_text("1 0 0 0"), "found 4"),
    Case("scannet", "no colour", lambda s: s.colour_path(2).unlink(), "frame 2 has no colour image"),
    Case("scannet", "no folder", lambda s: (s.folder / "frames/depth").rename(s.folder / "x"), "no such folder", None),
    # Co-Fusion.
    Case("co_fusion", "EXR truncated", lambda s: cut(s.depth_path(2), 0.9), "truncated OpenEXR"),
    Case("co_fusion", "EXR header cut", lambda s: cut(s.depth_path(2), 0.05), "truncated OpenEXR"),
    Case("co_fusion", "EXR empty", lambda s: s.depth_path(2).write_bytes(b""), "empty"),
    Case("co_fusion", "PNG as EXR", lambda s: s.depth_path(2).write_bytes(s.colour_path(2).read_bytes()), "no OpenEXR"),
    Case("co_fusion", "no depth", lambda s: s.depth_path(2).unlink(), "frame 3 has no depth image"),
    Case("co_fusion", "bad calibration", lambda s: (s.folder / "calibration.txt").write_text("x"), "holds fx fy cx", None),
    Case("co_fusion", "zero calibration", lambda s: (s.folder / "calibration.txt").write_text("0 0 1 1 40 30"), "focal", None),
    Case("co_fusion", "no trajectory", lambda s: (s.folder / "trajectories/gt-cam-0.txt").unlink(), "no such file", None),
    Case("co_fusion", "NaN pose", lambda s: line(s.folder / "trajectories/gt-cam-0.txt", 2, "3 nan 0 0 0 0 0 1"), "NaN"),
    # EuRoC.
    Case("euroc", "no table", lambda s: (s.folder / "mav0/cam0/data.csv").unlink(), r"data\.csv: no such file", None),
    Case("euroc", "table empty", lambda s: (s.folder / "mav0/cam0/data.csv").write_text(""), "lists no image", None),
    Case("euroc", "time twice", lambda s: line(s.folder / "mav0/cam0/data.csv", 3, f"{s.time_ns(1)},x.png"), "twice"),
    Case("euroc", "leads out", lambda s: line(s.folder / "mav0/cam0/data.csv", 3, f"{s.time_ns(2)},../x.png"), "leads out"),
    Case("euroc", "no sensor.yaml", lambda s: (s.folder / "mav0/cam0/sensor.yaml").unlink(), "no such file", None),
    Case("euroc", "bad YAML", lambda s: (s.folder / "mav0/cam0/sensor.yaml").write_text("a: [1"), "not YAML", None),
    Case("euroc", "no T_BS", lambda s: (s.folder / "mav0/imu0/sensor.yaml").write_text("rate_hz: 200"), "no T_BS", None),
    Case("euroc", "IMU NaN", lambda s: line(s.folder / "mav0/imu0/data.csv", 5, f"{s.time_ns(0) + 7},nan,0,0,0,0,0"),
         "6 finite numbers", ()),
    Case("euroc", "IMU cut", lambda s: line(s.folder / "mav0/imu0/data.csv", 5, "1,2"), "6 finite numbers", ()),
    # A folder of images.
    Case("rgbd_folder", "no camera", lambda s: (s.folder / "K.txt").unlink(), "which camera", None),
    Case("rgbd_folder", "zero focal length", lambda s: (s.folder / "K.txt").write_text("0 0 1 0 0 1 0 0 1"), "above 0", None),
    Case("rgbd_folder", "centre outside", lambda s: (s.folder / "K.txt").write_text("500 500 320 240"), "is outside", None),
    Case("rgbd_folder", "one pose too few", lambda s: line(s.folder / "poses.txt", 4, None), "4 poses for 5 frames", None),
    Case("rgbd_folder", "pose of five", lambda s: line(s.folder / "poses.txt", 2, "1 2 3 4 5"), "5 numbers; a pose", None),
    Case("rgbd_folder", "NaN pose", lambda s: line(s.folder / "poses.txt", 2, "nan " * 16), "line 3: the pose has a NaN"),
    Case("rgbd_folder", "poses empty", lambda s: (s.folder / "poses.txt").write_text(""), "holds no pose", None),
    Case("rgbd_folder", "no images", lambda s: [s.colour_path(i).unlink() for i in range(5)], "no colour images", None),
    # transforms.json.
    Case("transforms", "no file", lambda s: (s.folder / "transforms.json").unlink(), "no such file", None),
    Case("transforms", "cut", lambda s: cut(s.folder / "transforms.json"), "not JSON", None),
    Case("transforms", "a list", lambda s: s.write_values([1]), "holds a list", None),
    Case("transforms", "no frames", lambda s: s.write_values({"fl_x": 1}), "no list of frames", None),
    Case("transforms", "no camera", lambda s: change(s, lambda v: v.pop("fl_x")), "no fl_x", None),
    Case("transforms", "zero focal length", lambda s: change(s, lambda v: v.update(fl_x=0)), "above 0", None),
    Case("transforms", "fisheye", lambda s: change(s, lambda v: v.update(camera_model="OPENCV_FISHEYE")), "pinhole", None),
    Case("transforms", "scale 0", lambda s: change(s, lambda v: v.update(depth_unit_scale_factor=0)), "above 0", None),
    Case("transforms", "NaN pose", lambda s: change(s, lambda v: v["frames"][2]["transform_matrix"][0].__setitem__(0, np.nan)),
         "the pose has a NaN"),
    Case("transforms", "2x2", lambda s: change(s, lambda v: v["frames"][2].update(transform_matrix=[[1, 0], [0, 1]])), "not 4x4"),
    Case("transforms", "leads out", lambda s: change(s, lambda v: v["frames"][2].update(depth_file_path="../x.png")),
         "leads out"),
    # Video and bags.
    Case("video", "cut", lambda s: cut(s.file, 0.02), "not a video|cannot be decoded|a video of", None),
    Case("video", "text", lambda s: s.file.write_text("clip"), "not a video", None),
    Case("video", "no intrinsics", lambda s: s.file.with_suffix(".txt").unlink(), "which camera", None),
    Case("rosbag", "cut", lambda s: cut(s.path), "not a whole ROS recording", None),
    Case("rosbag", "text", lambda s: s.path.write_text("bag"), "not a whole ROS recording", None),
    Case("rosbag-db3", "no metadata", lambda s: (s.path / "metadata.yaml").unlink(), r"no metadata\.yaml", None),
    Case("rosbag-db3", "no file", lambda s: next(s.path.glob("*.db3")).unlink(), "not a whole ROS recording", None),
    Case("rosbag-mcap", "cut", lambda s: cut(next(s.path.glob("*.mcap"))), "not a whole ROS recording", None),
]  # fmt: skip


@pytest.fixture
def spoilt(request: pytest.FixtureRequest, layouts: dict[str, Any], tmp_path: Path) -> tuple[Case, Any]:
    case: Case = request.param
    layout = layouts[case.family](tmp_path / "scene")
    layout.folder.mkdir()
    layout.write()
    case.damage(layout)
    return case, layout


def test_the_corpus_is_as_large_as_it_says() -> None:
    assert len(CASES) >= 100
    assert len({str(case) for case in CASES}) == len(CASES)


@pytest.mark.timeout(20)
@pytest.mark.parametrize("spoilt", CASES, ids=str, indirect=True)
def test_damage_is_named_or_costs_a_frame(spoilt: tuple[Case, Any]) -> None:
    case, layout = spoilt

    def read(on_error: str) -> list[int]:
        dataset = layout.open(on_error=on_error)
        dataset.check()
        return [frame.timestamp_ns for frame in dataset.frames()]

    with pytest.raises(DataError, match=case.message) as refusal:
        read("raise")
    assert str(layout.folder) in str(refusal.value)  # the file, or the folder
    assert ";" in str(refusal.value) or ":" in str(refusal.value)
    if case.lost is None:
        with pytest.raises(DataError, match=case.message):
            read("skip")
    else:
        assert read("skip") == [layout.time_ns(i) for i in range(5) if i not in case.lost]
