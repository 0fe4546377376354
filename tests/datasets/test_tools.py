"""`python -m xrdslam.datasets`: guessing, inspecting, converting; each on the small sequence of every family."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from xrdslam.command_line.datasets import main, open_dataset
from xrdslam.core.errors import DataError
from xrdslam.datasets.convert import convert
from xrdslam.datasets.guess import guess_family
from xrdslam.datasets.inspection import inspect_dataset

PATHS = {"video": "clip.avi", "rosbag": "clip.bag", "rosbag-db3": "clip", "rosbag-mcap": "clip"}
WITH_DEPTH = ("rgbd_folder", "transforms", "rosbag", "scannet", "co_fusion")


def place(written: Any) -> Path:
    return written.folder / PATHS.get(written.family, ".")


def settings(written: Any) -> list[str]:
    return ["intrinsics=[36,36,19.5,14.5]"] if written.family == "tum_rgbd" else []


def test_the_family_is_guessed(written: Any) -> None:
    assert guess_family(place(written)) == written.family.partition("-")[0]


def test_every_family_is_inspected_and_drawn(
    written: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sheet = tmp_path / "sheet.png"
    if written.family not in ("rgbd_folder", "euroc", "video"):  # a picture takes a second; these have all there is
        monkeypatch.setattr("xrdslam.datasets.contact_sheet.write_contact_sheet", lambda *_: None)
    main(["inspect", str(place(written)), *settings(written), "--sheet", str(sheet)])
    said = capsys.readouterr().out
    assert "5 frames" in said
    assert "40x30 px, fx 36.00" in said
    assert "LOOK HERE" not in said
    assert ("reprojection depth under the poses is off by" in said) == written.has_depth
    assert f"dataset={written.family.partition('-')[0]}/custom dataset.path={place(written)}" in said
    if not sheet.exists():
        return
    picture = cv2.imread(str(sheet))
    assert picture.shape[0] > 500
    assert picture.std() > 20


@pytest.fixture
def folder(layouts: dict[str, Any], tmp_path: Path) -> Any:
    return layouts["rgbd_folder"](tmp_path / "office").write()


WRONG = {
    "poses are world-to-camera": {"pose_direction": "world_to_camera"},
    "poses have OpenGL's axes": {"pose_axes": "opengl"},
    "depth is 5 times as far": {"depth_scale": 5000.0},
    "depth is 0.1 times as far": {"depth_scale": 100.0},
    "focal lengths are 1.4 times as long": {"intrinsics": [36 / 1.4, 36 / 1.4, 19.5, 14.5]},
    "focal lengths are 0.5 times as long": {"intrinsics": [72.0, 72.0, 19.5, 14.5]},
}


@pytest.mark.parametrize("reading", WRONG)
def test_what_is_read_wrong_is_named(folder: Any, layouts: dict[str, Any], reading: str) -> None:
    """The files are right, the settings are not; the reading that mends them is the one that is proposed."""
    inspection = inspect_dataset(folder.open(**WRONG[reading]))
    assert inspection.agreement.better == reading
    assert any(reading in warning for warning in inspection.warnings())
    right = inspect_dataset(folder.open())
    assert right.agreement.better is None
    assert right.agreement.as_read < 1e-3  # measured 3.5e-4: the depth of spheres is not linear between pixels
    assert right.agreement.as_read < 0.3 * inspection.agreement.as_read


def test_poses_of_a_renderer_are_recognised(folder: Any, toy_frames: tuple[Any, ...]) -> None:
    """OpenGL's view matrices: world to camera, y up, z backward."""
    views = [np.diag([1.0, -1.0, -1.0, 1.0]) @ np.linalg.inv(toy.pose) for toy in toy_frames]
    (folder.folder / "poses.txt").write_text("\n".join(" ".join(map(repr, V.ravel().tolist())) for V in views))
    assert inspect_dataset(folder.open()).agreement.better == "poses are world-to-camera in OpenGL's axes"
    mended = folder.open(pose_axes="opengl", pose_direction="world_to_camera")
    np.testing.assert_allclose(mended[1].T_world_camera_gt, toy_frames[1].pose, atol=1e-6)


def test_intrinsics_of_another_size_are_noticed(folder: Any) -> None:
    warnings = list(inspect_dataset(folder.open(intrinsics=[18.0, 18.0, 9.5, 7.0])).warnings())
    assert any("far from the middle" in warning for warning in warnings)


def test_damaged_frames_are_counted_and_named(
    folder: Any, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder.colour_path(1).write_bytes(b"")
    folder.depth_path(3).unlink()
    monkeypatch.setattr("xrdslam.datasets.contact_sheet.write_contact_sheet", lambda *_: None)
    main(["inspect", str(folder.folder), "--sheet", str(tmp_path / "x.png")])
    said = capsys.readouterr().out
    assert "DAMAGED      2 frames, first: " in said
    assert "view_1.png: empty file" in said


def test_a_folder_of_recordings_lists_them(layouts: dict[str, Any], tmp_path: Path) -> None:
    for name in ("a", "b"):
        layouts["scannet"](tmp_path / name).write()
    with pytest.raises(DataError, match=r"holds 2; inspect one of .*/a, .*/b"):
        guess_family(tmp_path)
    (tmp_path / "c").mkdir()
    with pytest.raises(DataError, match=r"no layout that is known .* There is: nothing"):
        guess_family(tmp_path / "c")


def test_a_setting_that_there_is_not_is_refused_with_those_there_are(
    folder: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match=r"depth_skale: rgbd_folder has no such setting; there is .*depth_scale"):
        main(["inspect", str(folder.folder), "depth_skale=1"])
    with pytest.raises(SystemExit, match="nowhere: no such file or folder"):
        main(["inspect", "nowhere"])


@pytest.mark.parametrize("layout", ["replica", "tum_rgbd"])
@pytest.mark.parametrize("family", WITH_DEPTH)
def test_what_is_converted_reads_back_equal(
    layouts: dict[str, Any], tmp_path: Path, family: str, layout: str, capsys: pytest.CaptureFixture[str]
) -> None:
    written = layouts[family](tmp_path / "source")
    written.folder.mkdir()
    written.write()
    out = tmp_path / "out"
    main(["convert", str(place(written)), "--to", layout, "--into", str(out)])
    assert "5 frames" in capsys.readouterr().out
    before = written.open()
    after = open_dataset(out, None, [])
    after.check()
    assert (after.camera, len(after)) == (before.camera, len(before))
    half_level = 0.5 / {"replica": 6553.5, "tum_rgbd": 5000.0}[layout]
    for one, other in zip(before.frames(), after.frames(), strict=True):
        np.testing.assert_allclose(other.rgb, one.rgb, rtol=0, atol=0 if family != "scannet" else 0.5 / 255 + 1e-6)
        np.testing.assert_allclose(other.depth, one.depth, rtol=0, atol=half_level + 1e-6)
        np.testing.assert_allclose(other.T_world_camera_gt, one.T_world_camera_gt, rtol=0, atol=1e-6)
        if layout == "tum_rgbd":
            assert other.timestamp_ns == one.timestamp_ns


def test_converting_refuses_what_the_layout_cannot_hold(folder: Any, layouts: dict[str, Any], tmp_path: Path) -> None:
    out = tmp_path / "out"
    with pytest.raises(DataError, match=r"frame 0 has no known pose, .* convert to tum_rgbd"):
        convert(folder.open(poses="none"), "replica", out)
    with pytest.raises(DataError, match=r"more than 65535 levels of which 100000 are a metre; give --depth-scale 1000"):
        convert(folder.open(), "replica", out, depth_scale=1e5)
    with pytest.raises(DataError, match="has no depth, which the layout of replica needs"):
        convert(folder.open(depth="none"), "replica", out)
    assert [path.name for path in tmp_path.iterdir()] == ["office"]  # nothing half-written is left
    out.mkdir()
    with pytest.raises(DataError, match="out: exists"):
        convert(folder.open(), "replica", out)


def test_converting_without_poses_gives_none(folder: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    convert(folder.open(poses="none"), "tum_rgbd", out)
    assert open_dataset(out, None, []).modalities == {"rgb", "depth"}


def test_the_list_names_every_family_and_scene(capsys: pytest.CaptureFixture[str]) -> None:
    main(["list"])
    said = capsys.readouterr().out
    scenes = [
        *("tum_rgbd/fr3_office", "scannet/scene0207_00", "euroc/V2_03_difficult", "co_fusion/room4"),
        *("rgbd_folder/custom", "rosbag/custom", "video/custom", "transforms/custom", "replica/office4"),
    ]
    assert not [scene for scene in scenes if scene not in said]


def test_transforms_json_is_a_path_too(layouts: dict[str, Any], tmp_path: Path) -> None:
    scan = layouts["transforms"](tmp_path / "scan").write()
    path = scan.folder / "transforms.json"
    assert json.loads(path.read_text())["frames"]
    assert len(open_dataset(path, None, [])) == 5
