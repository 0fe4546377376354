"""Every family on a small sequence of its own: the contract of a dataset, and what was written comes back."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from xrdslam.core.dataset import Dataset
from xrdslam.testing.dataset_contract import DatasetContract

FAMILIES = [
    *("co_fusion", "euroc", "rgbd_folder", "rosbag", "rosbag-db3", "rosbag-mcap", "scannet", "transforms", "tum_rgbd"),
    "video",
]


@pytest.mark.parametrize("family", FAMILIES)
class TestContract(DatasetContract):
    """The contract of a dataset, for each family."""

    layout: Any

    @pytest.fixture(autouse=True)
    def _write(self, family: str, layouts: dict[str, Any], tmp_path: Path) -> None:
        self.layout = layouts[family](tmp_path)
        self.layout.write()

    def make_dataset(self) -> Dataset:
        return self.layout.open()

    def make_damaged(self) -> tuple[Dataset, int] | None:
        if self.layout.family.startswith(("rosbag", "video")):
            return None  # their frames are not files
        path = self.layout.colour_path(2)
        path.write_bytes(path.read_bytes()[:-20])
        return self.layout.open(), 2


def test_the_contract_is_kept_by_every_layout(layouts: dict[str, Any]) -> None:
    assert sorted(layouts) == FAMILIES


def test_what_was_written_comes_back(written: Any, toy_frames: tuple[Any, ...]) -> None:
    dataset = written.open()
    dataset.check()
    assert len(dataset) == len(toy_frames)
    camera = dataset.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (36.0, 36.0, 19.5, 14.5)
    assert (camera.width, camera.height) == (40, 30)
    for i, (frame, toy) in enumerate(zip(dataset.frames(), toy_frames, strict=True)):
        assert frame.timestamp_ns == written.time_ns(i)
        if written.has_depth:
            # A level is rounded to half of one, and float32 to 2e-7 of a few metres.
            half_level = 0.5 / written.scale if written.scale > 1 else 0
            np.testing.assert_allclose(frame.depth, toy.depth, rtol=0, atol=half_level + 1e-6)
            np.testing.assert_allclose(frame.rgb, toy.rgb / 255, rtol=0, atol=1e-6)
        elif written.family == "euroc":
            np.testing.assert_allclose(frame.rgb[..., 0], toy.rgb[..., 1] / 255, rtol=0, atol=1e-6)
        else:  # JPEG inside
            error, swapped = (np.abs(frame.rgb.numpy() - rgb / 255).mean() for rgb in (toy.rgb, toy.rgb[..., ::-1]))
            assert error < 10 / 255  # measured 7: colour at half the resolution
            assert error < 0.5 * swapped
            continue
        np.testing.assert_allclose(frame.T_world_camera_gt, toy.pose, rtol=0, atol=1e-6)


def test_crop_and_size_reach_image_depth_and_camera(written: Any) -> None:
    whole, cut = written.open(), written.open(crop=[4, 2, 6, 8])
    assert cut.camera == whole.camera.cropped(4, 2, 30, 20)
    np.testing.assert_array_equal(cut[1].rgb, whole[1].rgb[2:22, 4:34])
    if written.has_depth:
        np.testing.assert_array_equal(cut[1].depth, whole[1].depth[2:22, 4:34])
    assert written.open(crop=[4, 2, 6, 8], size=[15, 10]).camera == cut.camera.resized(15, 10)


def test_frames_pick(written: Any) -> None:
    dataset = written.open(frames=[1, None, 2])
    assert [frame.timestamp_ns for frame in dataset.frames()] == [written.time_ns(1), written.time_ns(3)]
