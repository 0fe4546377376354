"""What is EuRoC's own: integer time, inertial samples between frames, the body's pose, a rectified pair."""

import itertools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from xrdslam.core.errors import ConfigError, DataError
from xrdslam.datasets.config import EurocConfig


@pytest.fixture
def euroc(layouts: dict[str, Any], tmp_path: Path) -> Any:
    return layouts["euroc"](tmp_path).write()


def test_frames_carry_the_samples_since_the_frame_before(euroc: Any) -> None:
    frames = list(euroc.open().frames())
    assert len(frames[0].imu.timestamps_ns) == 0
    for before, frame in itertools.pairwise(frames):
        stamps = frame.imu.timestamps_ns
        assert len(stamps) == 5  # 100 samples a second, 20 frames
        assert bool((stamps > before.timestamp_ns).all())
        assert bool((stamps <= frame.timestamp_ns).all())
    # Samples come every 10 ms from 30 ms before the first frame on; the sample says its number.
    assert frames[1].imu.angular_velocity[:, 0].tolist() == [4, 5, 6, 7, 8]
    assert frames[1].imu.acceleration[0].tolist() == [pytest.approx(9.81), 4.5, 0]


def test_samples_of_frames_left_out_go_to_the_next(euroc: Any) -> None:
    assert len(euroc.open(frames=[0, None, 2])[1].imu.timestamps_ns) == 10
    euroc.colour_path(2).write_bytes(b"")
    dataset = euroc.open(on_error="skip")
    assert [len(frame.imu.timestamps_ns) for frame in dataset.frames()] == [0, 5, 10, 5]
    assert [len(frame.imu.timestamps_ns) for frame in dataset.frames(start=2)] == [10, 5]  # of a resumed run


def test_samples_are_turned_into_the_body(euroc: Any) -> None:
    quarter_about_z = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    euroc.write_sensor("imu0", quarter_about_z, with_camera=False)
    sample = euroc.open()[1].imu.acceleration[0]
    np.testing.assert_allclose(sample, [-4.5, 9.81, 0], rtol=1e-6)


def test_an_imu_away_from_the_body_is_refused(euroc: Any) -> None:
    away = np.eye(4)
    away[0, 3] = 0.1
    euroc.write_sensor("imu0", away, with_camera=False)
    with pytest.raises(DataError, match=r"imu0/sensor\.yaml: the IMU sits .* m from the body"):
        euroc.open()


@pytest.mark.parametrize("title", ["#timestamp [ns],filename", "timestamp [ns],filename", None])
def test_a_title_may_be_a_comment_or_a_row_or_none(euroc: Any, title: str | None) -> None:
    euroc.edit(euroc.folder / "mav0/cam0/data.csv", lambda lines: ([title] if title else []) + lines[1:])
    assert [frame.timestamp_ns for frame in euroc.open().frames()] == [euroc.time_ns(i) for i in range(5)]


def test_without_ground_truth_or_imu_there_is_none(euroc: Any) -> None:
    (euroc.folder / "mav0/state_groundtruth_estimate0/data.csv").unlink()
    for path in (euroc.folder / "mav0/imu0").iterdir():
        path.unlink()
    (euroc.folder / "mav0/imu0").rmdir()
    dataset = euroc.open()
    assert dataset.modalities == {"rgb"}
    assert dataset[1].imu is None


def test_frames_outside_the_ground_truth_have_unknown_poses(euroc: Any) -> None:
    euroc.edit(euroc.folder / "mav0/state_groundtruth_estimate0/data.csv", lambda lines: lines[:3])
    known = [bool(frame.T_world_camera_gt.isfinite().all()) for frame in euroc.open().frames()]
    assert known == [True, True, False, False, False]


def test_a_rectified_pair_sees_points_on_the_same_row_at_the_disparity_of_their_depth(euroc: Any) -> None:
    """Points are projected into both turned, distorted cameras; the images have a dot at each."""
    T_right_turned = np.eye(4)
    T_right_turned[:3, :3] = cv2.Rodrigues(np.array([0.01, -0.03, 0.02]))[0]
    T_right_turned[:3, 3] = (0.11, 0.002, -0.003)
    T_body = {"cam0": np.eye(4), "cam1": T_right_turned}
    K, lens = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]), np.array([-0.2, 0.05, 1e-3, -5e-4])
    points = np.array([[0.0, 0, 2], [0.4, -0.3, 3], [-0.5, 0.2, 2.5], [0.3, 0.4, 4]])
    for camera, T_body_camera in T_body.items():
        euroc.write_sensor(camera, T_body_camera)
        path = euroc.folder / "mav0" / camera / "sensor.yaml"
        text = (
            path.read_text()
            .replace("[40, 30]", "[320, 240]")
            .replace("[36.0, 36.0, 19.5, 14.5]", "[300.0, 300.0, 160.0, 120.0]")
        )
        path.write_text(text.replace("[0.0, 0.0, 0.0, 0.0]\n", f"{lens.tolist()}\n"))
        T = np.linalg.inv(T_body_camera)
        pixels = cv2.projectPoints(points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], K, lens)[0][:, 0]
        v, u = np.mgrid[:240, :320]
        dots = sum(np.exp(-((u - x) ** 2 + (v - y) ** 2) / 8) for x, y in pixels)
        for i in range(5):
            cv2.imwrite(str(euroc.colour_path(i, camera)), np.round(250 * np.clip(dots, 0, 1)).astype(np.uint8))
    dataset = euroc.open(stereo=True)
    dataset.check()
    assert "stereo" in dataset.modalities
    frame = dataset[0]
    assert frame.stereo.baseline_m == pytest.approx(np.linalg.norm(T_right_turned[:3, 3]), rel=1e-9)
    T_camera_body = np.linalg.inv(dataset.T_body_camera)
    for point in points:
        x, y, z = T_camera_body[:3, :3] @ point + T_camera_body[:3, 3]
        u, v = dataset.camera.fx * x / z + dataset.camera.cx, dataset.camera.fy * y / z + dataset.camera.cy
        disparity = dataset.camera.fx * frame.stereo.baseline_m / z
        # Dots of 2 px sampled on whole pixels, maps of 1/32 px.
        np.testing.assert_allclose(dot_near(frame.rgb, u, v), (u, v), atol=0.1)
        np.testing.assert_allclose(dot_near(frame.stereo.rgb, u - disparity, v), (u - disparity, v), atol=0.1)


def dot_near(image: Any, u: float, v: float) -> tuple[float, float]:
    """Return the centre of brightness within 6 px."""
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    weight = image[..., 0].numpy() * (np.hypot(columns - u, rows - v) < 6)
    return float((weight * columns).sum() / weight.sum()), float((weight * rows).sum() / weight.sum())


def test_a_pair_lacking_its_right_image_is_a_fault_of_that_frame(euroc: Any) -> None:
    euroc.edit(euroc.folder / "mav0/cam1/data.csv", lambda lines: lines[:2] + lines[3:])
    with pytest.raises(DataError, match=r"cam1/data\.csv has no image of this time; complete it"):
        euroc.open(stereo=True).check()
    skipping = euroc.open(stereo=True, on_error="skip")
    assert [frame.index for frame in skipping.frames()] == [0, 2, 3, 4]


def test_a_lens_that_is_no_pinhole_is_refused(euroc: Any) -> None:
    path = euroc.folder / "mav0/cam0/sensor.yaml"
    path.write_text(path.read_text().replace("radial-tangential", "equidistant"))
    with pytest.raises(DataError, match=r"equidistant; only a pinhole camera .*: undistort the images first"):
        euroc.open()


def test_the_pair_starts_at_the_left_camera() -> None:
    with pytest.raises(ConfigError, match=r"dataset\.camera=cam1: must be cam0 where dataset\.stereo=true"):
        EurocConfig(camera="cam1", stereo=True)
