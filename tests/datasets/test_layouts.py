"""Replica and 7-Scenes on small folders written here: what was written comes back, damage is refused by name.

Both families go through the same tests: a `Layout` knows where each keeps its files.
"""

import dataclasses
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import DataError
from xrdslam.datasets.config import DatasetConfig, ReplicaConfig, SevenScenesConfig
from xrdslam.datasets.prefetch import prefetch
from xrdslam.datasets.replica import ReplicaDataset
from xrdslam.datasets.sequence import RgbdSequence
from xrdslam.datasets.seven_scenes import SevenScenesDataset
from xrdslam.testing.dataset_contract import DatasetContract

COUNT = 4
WALL = 3.0  # the scene is the plane z = WALL [m]


def pose(number: int) -> np.ndarray:
    """A turn about the y axis by a tenth of a radian a frame, a step along each axis."""
    c, s = np.cos(0.1 * number), np.sin(0.1 * number)
    return np.array([[c, 0, s, 0.1 * number], [0, 1, 0, -0.2], [-s, 0, c, 0.3 * number], [0, 0, 0, 1]])


@dataclasses.dataclass
class Layout:
    """A small scene in a family's layout; `first` is the number of its first frame."""

    root: Path
    width: int
    height: int
    first: int = 0
    extension: str = "png"

    family = "none"
    scale = 1000.0
    intrinsics = (585.0, 585.0, 320.0, 240.0)

    def colour_path(self, i: int) -> Path:
        raise NotImplementedError

    def depth_path(self, i: int) -> Path:
        raise NotImplementedError

    def open(self, **knobs: object) -> RgbdSequence:
        raise NotImplementedError

    def write_poses(self, poses: list[str]) -> None:
        raise NotImplementedError

    def colour(self, i: int) -> np.ndarray:
        """Red rises with the column, green with the row, blue with the frame."""
        v, u = np.mgrid[: self.height, : self.width]
        return np.stack((u * 255 // self.width, v * 255 // self.height, 0 * u + 40 * i), -1).astype(np.uint8)

    def levels(self, i: int) -> np.ndarray:
        """Depth levels of the wall as frame i sees it, empty in the first row."""
        v, u = np.mgrid[: self.height, : self.width]
        fx, fy, cx, cy = self.intrinsics
        rays_camera = np.stack(((u - cx) / fx, (v - cy) / fy, np.ones(u.shape)), -1)
        depth = (WALL - pose(i)[2, 3]) / (rays_camera @ pose(i)[2, :3])
        return ((v > 0) * np.round(depth * self.scale)).astype(np.uint16)

    def write(self) -> "Layout":
        for i in range(COUNT):
            self.colour_path(i).parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(self.colour_path(i)), self.colour(i)[..., ::-1])
            cv2.imwrite(str(self.depth_path(i)), self.levels(i))
        self.write_poses([" ".join(map(repr, pose(i).ravel().tolist())) for i in range(COUNT)])
        return self


class ReplicaLayout(Layout):
    family = "replica"
    scale = 2000.0
    intrinsics = (30.0, 31.0, 11.5, 8.5)

    def colour_path(self, i: int) -> Path:
        return self.root / "room7" / "results" / f"frame{i + self.first:06d}.{self.extension}"

    def depth_path(self, i: int) -> Path:
        return self.root / "room7" / "results" / f"depth{i + self.first:06d}.png"

    def write_poses(self, poses: list[str]) -> None:
        (self.root / "room7" / "traj.txt").write_text("\n".join(poses) + "\n")

    def write(self) -> Layout:
        super().write()
        camera = dict(zip(("fx", "fy", "cx", "cy"), self.intrinsics, strict=True))
        camera |= {"w": self.width, "h": self.height, "scale": self.scale}
        (self.root / "cam_params.json").write_text(json.dumps({"camera": camera}))
        return self

    def open(self, **knobs: object) -> RgbdSequence:
        return ReplicaDataset(ReplicaConfig(**{"scene": "room7", "root": str(self.root), **knobs}))


class SevenScenesLayout(Layout):
    family = "seven_scenes"

    def colour_path(self, i: int) -> Path:
        return self.root / "room7" / "seq-01" / f"frame-{i + self.first:06d}.color.{self.extension}"

    def depth_path(self, i: int) -> Path:
        return self.root / "room7" / "seq-01" / f"frame-{i + self.first:06d}.depth.png"

    def write_poses(self, poses: list[str]) -> None:
        for i, text in enumerate(poses):
            words = text.split()
            rows = "\n".join("\t ".join(words[k : k + 4]) for k in range(0, len(words), 4))
            (self.root / "room7" / "seq-01" / f"frame-{i + self.first:06d}.pose.txt").write_text(rows)

    def open(self, **knobs: object) -> RgbdSequence:
        return SevenScenesDataset(SevenScenesConfig(**{"scene": "room7", "root": str(self.root), **knobs}))


@pytest.fixture(params=[ReplicaLayout, SevenScenesLayout], ids=["replica", "seven_scenes"])
def layout(request: pytest.FixtureRequest, tmp_path: Path) -> Layout:
    small = request.param is ReplicaLayout  # 7-Scenes has one camera, of 640x480
    return request.param(tmp_path, 24 if small else 640, 18 if small else 480).write()


@pytest.fixture
def replica(tmp_path: Path) -> ReplicaLayout:
    made = ReplicaLayout(tmp_path, 24, 18)
    made.write()
    return made


@pytest.fixture
def seven_scenes(tmp_path: Path) -> SevenScenesLayout:
    made = SevenScenesLayout(tmp_path, 640, 480)
    made.write()
    return made


# What was written comes back.


def test_values_poses_and_times_come_back(layout: Layout) -> None:
    dataset = layout.open()
    dataset.check()
    assert (dataset.name, len(dataset)) == (f"{layout.family}/room7", COUNT)
    assert dataset.modalities == {"rgb", "depth", "pose"}
    for i, frame in enumerate(dataset.frames()):
        assert frame.index == i
        assert frame.timestamp_ns == round(i * 1e9 / 30)
        np.testing.assert_array_equal(frame.rgb, layout.colour(i) / np.float32(255))
        np.testing.assert_array_equal(frame.depth, layout.levels(i) / np.float32(layout.scale))
        np.testing.assert_allclose(frame.T_world_camera_gt, pose(i), atol=6e-8)  # float32 of numbers up to 1
        assert frame.camera == dataset.camera


def test_jpeg_colour_is_read_too(layout: Layout) -> None:
    for i in range(COUNT):
        layout.colour_path(i).unlink()
    dataclasses.replace(layout, extension="jpg").write()
    dataset = layout.open()
    dataset.check()
    error = (dataset[1].rgb.numpy() - layout.colour(1) / 255.0).__abs__().mean()
    assert error < 3 / 255


def test_frames_may_start_at_any_number(layout: Layout) -> None:
    shutil.rmtree(layout.root / "room7")
    dataset = dataclasses.replace(layout, first=150).write().open()
    dataset.check()
    assert [frame.timestamp_ns for frame in dataset.frames()] == [round(n * 1e9 / 30) for n in range(150, 154)]
    np.testing.assert_allclose(dataset[2].T_world_camera_gt, pose(2), atol=6e-8)


def test_the_knobs_reach_the_frames(layout: Layout) -> None:
    half = (layout.width // 2, layout.height // 2)
    dataset = layout.open(frames=[1, None, 2], size=list(half), max_depth=2.7)
    assert len(dataset) == 2
    assert dataset.camera == layout.open().camera.resized(*half)
    blocks = layout.colour(3).reshape(half[1], 2, half[0], 2, 3).mean((1, 3)) / 255
    np.testing.assert_allclose(dataset[1].rgb, blocks, atol=2e-7)
    depth = dataset[0].depth
    assert depth is not None
    assert depth.shape == half[::-1]
    kept = (layout.levels(1) <= 2.7 * layout.scale) & (layout.levels(1) > 0)
    assert 0.2 < kept.mean() < 0.8
    assert depth.max() <= 2.7
    assert abs(float((depth > 0).float().mean()) - kept.mean()) < 2 / min(half)


def test_a_scene_is_opened_by_its_path_too(layout: Layout) -> None:
    dataset = layout.open(scene="custom", root="/nowhere", path=str(layout.root / "room7"))
    assert dataset.name == f"{layout.family}/room7"
    assert torch.equal(dataset[0].rgb, layout.open()[0].rgb)


def test_replica_camera_may_lie_inside_the_scene_and_goes_first(replica: ReplicaLayout) -> None:
    values = json.loads((replica.root / "cam_params.json").read_text())
    values["camera"]["fx"] = 77.0
    (replica.root / "room7" / "cam_params.json").write_text(json.dumps(values))
    assert replica.open().camera.fx == 77.0


def test_replica_finds_its_mesh(replica: ReplicaLayout) -> None:
    assert replica.open().ground_truth_mesh is None
    inside, beside = replica.root / "room7" / "mesh.ply", replica.root / "room7_mesh.ply"
    for path in (inside, beside):
        path.touch()
        assert replica.open().ground_truth_mesh == path


def test_seven_scenes_holds_65535_for_no_measurement(seven_scenes: SevenScenesLayout) -> None:
    levels = seven_scenes.levels(0)
    levels[5, 7] = 65535
    cv2.imwrite(str(seven_scenes.depth_path(0)), levels)
    depth = seven_scenes.open()[0].depth
    assert depth is not None
    assert depth[5, 7] == 0
    assert depth[5, 8] > 0


def test_seven_scenes_asks_which_sequence(seven_scenes: SevenScenesLayout) -> None:
    scene = seven_scenes.root / "room7"
    shutil.copytree(scene / "seq-01", scene / "seq-02")
    with pytest.raises(DataError, match=r"pick one with dataset\.sequence: seq-01, seq-02"):
        seven_scenes.open()
    assert len(seven_scenes.open(sequence="seq-02")) == COUNT
    assert len(seven_scenes.open(path=str(scene / "seq-02"))) == COUNT
    with pytest.raises(DataError, match=r"dataset\.sequence=seq-03: no such folder in .*seq-01, seq-02"):
        seven_scenes.open(sequence="seq-03")


class LayoutContract(DatasetContract):
    """The contract of a dataset, on the small folder of a family."""

    small: Layout

    def make_dataset(self) -> Dataset:
        return self.small.open()

    def make_damaged(self) -> tuple[Dataset, int]:
        cut_depth(self.small)
        return self.small.open(), 2


class TestReplicaContract(LayoutContract):
    @pytest.fixture(autouse=True)
    def _write(self, replica: ReplicaLayout) -> None:
        self.small = replica


class TestSevenScenesContract(LayoutContract):
    @pytest.fixture(autouse=True)
    def _write(self, seven_scenes: SevenScenesLayout) -> None:
        self.small = seven_scenes


# Damage: each is found before the first frame, named by its file, and left out under on_error=skip.

Damage = Callable[[Layout], str]


def cut_colour(layout: Layout) -> str:
    return cut(layout.colour_path(2))


def cut_jpeg(layout: Layout) -> str:
    cv2.imwrite(str(layout.colour_path(2).with_suffix(".jpg")), layout.colour(2))
    layout.colour_path(2).unlink()
    return cut(layout.colour_path(2).with_suffix(".jpg"))


def cut_depth(layout: Layout) -> str:
    return cut(layout.depth_path(2))


def cut(path: Path) -> str:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return rf"{path.name}: truncated"


def empty_colour(layout: Layout) -> str:
    layout.colour_path(2).write_bytes(b"")
    return rf"{layout.colour_path(2).name}: empty file"


def text_as_colour(layout: Layout) -> str:
    layout.colour_path(2).write_text("<html>404</html>")
    return rf"{layout.colour_path(2).name}: neither PNG nor JPEG"


def colour_of_another_size(layout: Layout) -> str:
    cv2.imwrite(str(layout.colour_path(2)), np.zeros((7, 9, 3), np.uint8))
    return rf"{layout.colour_path(2).name}: an image of 9x7 px, but .* is for {layout.width}x{layout.height} px"


def depth_of_another_size(layout: Layout) -> str:
    cv2.imwrite(str(layout.depth_path(2)), np.zeros((7, 9), np.uint16))
    return rf"{layout.depth_path(2).name}: an image of 9x7 px, but .* is for {layout.width}x{layout.height} px"


def depth_of_8_bits(layout: Layout) -> str:
    cv2.imwrite(str(layout.depth_path(2)), layout.levels(2).astype(np.uint8))
    return rf"{layout.depth_path(2).name}: .* has 1 of 8"


def depth_in_colour(layout: Layout) -> str:
    cv2.imwrite(str(layout.depth_path(2)), layout.colour(2))
    return rf"{layout.depth_path(2).name}: .* has 3 of 8"


def no_depth(layout: Layout) -> str:
    layout.depth_path(2).unlink()
    return r"frame 2 has no depth image .*; found 4 x colour image .*, 3 x depth image .*, 4 x pose"


def no_colour(layout: Layout) -> str:
    layout.colour_path(2).unlink()
    return r"frame 2 has no colour image .*; found 3 x colour image .*, 4 x depth image .*, 4 x pose"


def spoilt_pose(layout: Layout, change: Callable[[np.ndarray], None]) -> str:
    poses = [pose(i) for i in range(COUNT)]
    change(poses[2])
    layout.write_poses([" ".join(map(repr, matrix.ravel().tolist())) for matrix in poses])
    return r"traj\.txt, line 3" if layout.family == "replica" else r"frame-000002\.pose\.txt"


def nan_pose(layout: Layout) -> str:
    def change(matrix: np.ndarray) -> None:
        matrix[:] = np.nan

    return spoilt_pose(layout, change) + ": the pose has a NaN or infinity"


def scaled_pose(layout: Layout) -> str:
    def change(matrix: np.ndarray) -> None:
        matrix[:3, :3] *= 1.1

    return spoilt_pose(layout, change) + r": the rotation of the pose is not orthonormal \(R R\^T - I reaches 0\.21\)"


def mirrored_pose(layout: Layout) -> str:
    def change(matrix: np.ndarray) -> None:
        matrix[:3, 1] *= -1

    return spoilt_pose(layout, change) + ": the rotation of the pose is mirrored"


DAMAGES: list[Damage] = [
    cut_colour,
    cut_jpeg,
    cut_depth,
    empty_colour,
    text_as_colour,
    colour_of_another_size,
    depth_of_another_size,
    depth_of_8_bits,
    depth_in_colour,
    no_depth,
    no_colour,
    nan_pose,
    scaled_pose,
    mirrored_pose,
]


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_refused_before_the_first_frame(layout: Layout, damage: Damage) -> None:
    message = damage(layout)
    dataset = layout.open()
    with pytest.raises(DataError, match=message) as caught:
        dataset.check()
    assert ";" in str(caught.value)  # what was found; what to do
    with pytest.raises(DataError, match=message):  # and who does not check does not get a frame either
        dataset[2]


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_costs_one_frame_under_skip(layout: Layout, damage: Damage, caplog: pytest.LogCaptureFixture) -> None:
    damage(layout)
    dataset = layout.open(on_error="skip")
    dataset.check()
    assert "1 of 4 frames will be skipped" in caplog.text
    frames = list(prefetch(dataset.frames()))
    assert [frame.index for frame in frames] == [0, 1, 3]
    assert dataset.num_skipped == 1
    np.testing.assert_allclose(frames[2].T_world_camera_gt, pose(3), atol=6e-8)
    assert dataset.modalities == {"rgb", "depth", "pose"}


def test_replica_with_too_few_poses_says_how_many_of_each(replica: ReplicaLayout) -> None:
    lines = (replica.root / "room7" / "traj.txt").read_text().splitlines()
    replica.write_poses(lines[:2])
    with pytest.raises(DataError, match=r"frame 2 has no pose \(traj\.txt\); found 4 x .*, 4 x .*, 2 x pose .* 1 more"):
        replica.open().check()
    assert [frame.index for frame in replica.open(on_error="skip").frames()] == [0, 1]


def test_replica_with_too_many_poses_says_how_many_of_each(replica: ReplicaLayout) -> None:
    lines = (replica.root / "room7" / "traj.txt").read_text().splitlines()
    replica.write_poses([*lines, lines[0]])
    with pytest.raises(DataError, match=r"traj\.txt: 5 poses for 4 frames; complete the images, or cut the file"):
        replica.open().check()
    dataset = replica.open(on_error="skip")
    dataset.check()
    for i, frame in enumerate(dataset.frames()):
        np.testing.assert_allclose(frame.T_world_camera_gt, pose(i), atol=6e-8)


def test_seven_scenes_without_a_pose_file_says_how_many_of_each(seven_scenes: SevenScenesLayout) -> None:
    (seven_scenes.root / "room7" / "seq-01" / "frame-000001.pose.txt").unlink()
    with pytest.raises(DataError, match=r"frame 1 has no pose .*; found 4 x .*, 4 x .*, 3 x pose"):
        seven_scenes.open().check()


def test_one_frame_in_two_files_is_refused(layout: Layout) -> None:
    shutil.copy(layout.colour_path(1), layout.colour_path(1).with_suffix(".jpg"))
    with pytest.raises(DataError, match="are the same frame; remove one"):
        layout.open()


def test_an_empty_scene_says_what_belongs_there(layout: Layout) -> None:
    for path in (layout.root / "room7").rglob("frame*"):
        path.unlink()
    for path in (layout.root / "room7").rglob("depth*"):
        path.unlink()
    with pytest.raises(DataError, match=r"room7.*frame.*; copy"):
        layout.open()


def test_replica_without_results_says_what_belongs_there(replica: ReplicaLayout) -> None:
    shutil.rmtree(replica.root / "room7" / "results")
    with pytest.raises(DataError, match=r"results: no such folder; a scene holds results/frame"):
        replica.open()


def test_replica_without_a_trajectory_is_refused(replica: ReplicaLayout) -> None:
    (replica.root / "room7" / "traj.txt").unlink()
    with pytest.raises(DataError, match=r"traj\.txt: no such file"):
        replica.open()


def test_a_missing_scene_names_those_that_are_there(layout: Layout) -> None:
    (layout.root / "office2").mkdir()
    with pytest.raises(DataError, match=r"rom7: no such scene; did you mean 'room7'\? In .* there is: office2, room7"):
        layout.open(scene="rom7")


def test_a_missing_root_names_the_setting(layout: Layout) -> None:
    with pytest.raises(DataError, match=r"dataset\.root=.*nowhere: no such folder .* set dataset\.root"):
        layout.open(root=str(layout.root / "nowhere"))


def test_a_missing_path_names_what_is_beside_it(layout: Layout) -> None:
    with pytest.raises(DataError, match=r"dataset\.path=.*room8: no such folder; did you mean 'room7'"):
        layout.open(path=str(layout.root / "room8"))


def test_replica_without_camera_names_both_places(replica: ReplicaLayout) -> None:
    (replica.root / "cam_params.json").unlink()
    with pytest.raises(DataError, match=r"room7/cam_params\.json: no such file, nor .*/cam_params\.json; "):
        replica.open()


@pytest.mark.parametrize(
    "change",
    [{"fx": 0}, {"fy": -1.0}, {"w": 0}, {"scale": 0}, {"cx": float("nan")}, {"fx": None}, {"h": "high"}, {"cy": ...}],
    ids=str,
)
def test_replica_with_a_senseless_camera_is_refused(replica: ReplicaLayout, change: dict[str, object]) -> None:
    path = replica.root / "cam_params.json"
    values = {**json.loads(path.read_text())["camera"], **change}
    path.write_text(json.dumps({"camera": {key: value for key, value in values.items() if value is not ...}}))
    with pytest.raises(DataError, match=r"cam_params\.json: .*;"):
        replica.open()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"camera": 3}', "\x00"])
def test_replica_with_a_camera_that_is_no_json_is_refused(replica: ReplicaLayout, text: str) -> None:
    (replica.root / "cam_params.json").write_text(text)
    with pytest.raises(DataError, match=r"cam_params\.json: not a description of a camera"):
        replica.open()


def test_the_defaults_of_a_family_are_its_own() -> None:
    assert (ReplicaConfig().family, SevenScenesConfig().family) == ("replica", "seven_scenes")
    assert issubclass(ReplicaConfig, DatasetConfig)
