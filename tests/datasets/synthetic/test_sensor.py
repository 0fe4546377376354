"""What the sensor does to a frame, against the statistics that its settings state."""

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from xrdslam.core.camera import Camera
from xrdslam.core.errors import ConfigError
from xrdslam.datasets.synthetic.config import SensorConfig, SyntheticConfig
from xrdslam.datasets.synthetic.dataset import SyntheticDataset
from xrdslam.datasets.synthetic.sensor import (
    arrived,
    drift,
    expose,
    measure_depth,
    shutter_poses,
    to_codes,
    to_linear,
)  # fmt: skip

CAMERA = Camera(200.0, 200.0, 159.5, 119.5, 320, 240)


def flat(z: float) -> NDArray[np.float32]:
    return np.full((240, 320), z, np.float32)


def measured(exact: NDArray[np.float32], **knobs: float) -> NDArray[np.float64]:
    return measure_depth(exact, CAMERA, SensorConfig(**knobs), 0, 3).astype(np.float64)


def test_a_perfect_sensor_changes_no_bit() -> None:
    exact = np.random.default_rng(0).uniform(0.5, 4, (240, 320)).astype(np.float32)
    assert measure_depth(exact, CAMERA, SensorConfig(), 0, 3) is exact
    codes = np.arange(256, dtype=np.uint8)[:, None, None].repeat(3, 2)
    np.testing.assert_array_equal(expose(to_linear(codes), SensorConfig(), 0, 3), codes)


@pytest.mark.parametrize("z", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("correlation", [0.0, 1.0, 2.0])
def test_depth_noise_has_the_deviation_of_its_disparity(z: float, correlation: float) -> None:
    """sigma_z = z^2 / (f b) sigma_d to first order; 76800 pixels, alike over 4 pi c^2 of them, tell it."""
    error = measured(flat(z), depth_noise=0.06, depth_correlation=correlation) - z
    expected = z * z / (575 * 0.075) * 0.06
    independent = error.size / max(1.0, 4 * np.pi * correlation**2)
    assert error.std() == pytest.approx(expected, rel=5 / np.sqrt(2 * independent) + 0.01)
    assert abs(error.mean()) < 5 * expected / np.sqrt(independent) + 2 * expected**2 / z
    beside = np.corrcoef(error[:, 1:].ravel(), error[:, :-1].ravel())[0, 1]
    alike = np.exp(-1 / (4 * correlation**2)) if correlation else 0.0  # of a Gaussian-filtered field
    assert beside == pytest.approx(alike, abs=0.05)


def test_disparity_comes_in_steps() -> None:
    exact = np.linspace(4.0, 5.0, 240 * 320, dtype=np.float32).reshape(240, 320)
    z = measured(exact, disparity_step=0.125)
    assert np.abs(np.rint(575 * 0.075 / z / 0.125) - 575 * 0.075 / z / 0.125).max() < 1e-4  # float32's rounding
    steps = np.diff(np.unique(z))
    np.testing.assert_allclose(steps[-1], 25 / (575 * 0.075) * 0.125, rtol=0.05)  # 7 cm at 5 m
    assert np.abs(z - exact).max() < 0.52 * steps.max()


def test_the_projector_s_shadow_is_as_wide_as_its_parallax() -> None:
    exact = flat(3.0)
    exact[60:180, 120:200] = 1.0
    z = measured(exact, shadows=True)
    is_lost = z == 0
    width = 200 * 0.075 * (1 / 1.0 - 1 / 3.0)  # 10 px beside the nearer surface, on the side away from the projector
    assert is_lost[100].sum() in (int(width), int(width) + 1)
    assert is_lost[100, 120 - int(width) : 120].all()
    assert not is_lost[:60].any()
    assert measured(flat(2.0), shadows=True).min() > 0


@pytest.mark.parametrize(("angle_deg", "is_kept"), [(12.0, True), (8.0, False)])
def test_a_grazing_surface_is_lost(angle_deg: float, is_kept: bool) -> None:
    """A plane through the optical axis' point at 2 m that the middle ray meets at the given angle."""
    slope = 1 / np.tan(np.radians(angle_deg))  # dz/dx
    rays = CAMERA.rays().numpy()
    exact = (2.0 / (1 - slope * rays[..., 0]).clip(0.05)).astype(np.float32)
    z = measured(exact, grazing_deg=10.0)
    assert (z[100:140, 159:161] > 0).all() == is_kept
    assert (measured(flat(2.0), grazing_deg=10.0) > 0).all()


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_holes_take_their_share_in_patches(share: float) -> None:
    lost = np.array([measure_depth(flat(2.0), CAMERA, SensorConfig(holes=share), 0, k) == 0 for k in range(8)])
    assert lost.mean() == pytest.approx(share, rel=0.1)
    neighbours = lost[:, :, 1:][lost[:, :, :-1]].mean()  # chance that the pixel beside a hole is one
    assert neighbours > 0.7


def test_near_surfaces_are_not_measured() -> None:
    assert (measured(flat(0.49), min_depth=0.5) == 0).all()
    assert (measured(flat(0.51), min_depth=0.5) == np.float32(0.51)).all()


@pytest.mark.parametrize("code", [30, 128, 220])
def test_colour_noise_grows_with_the_light(code: int) -> None:
    linear = to_linear(np.full((240, 320, 3), code, np.uint8))
    noise = expose(linear, SensorConfig(rgb_noise=3.0), 0, 5).astype(float) - code
    expected = np.sqrt(9 * (0.2 + 1.6 * code / 255) + 1 / 12)  # and the rounding to codes
    assert noise.std() == pytest.approx(expected, rel=0.01)  # 230400 samples: 0.15 percent each way
    assert abs(noise.mean()) < 0.05


@pytest.mark.parametrize("stream", [4, 5])
def test_drift_is_smooth_and_of_unit_variance(stream: int) -> None:
    values = np.array([[drift(seed, 0, stream, k) for k in range(0, 1200, 5)] for seed in range(40)])
    assert values.var() == pytest.approx(1, abs=0.15)  # 40 seeds of 40 s
    assert abs(values.mean()) < 0.15
    assert np.abs(np.diff([drift(0, 0, stream, k) for k in range(200)])).max() < 0.2  # in a thirtieth of a second


def test_exposure_drift_scales_the_light_in_stops() -> None:
    linear = np.full((4, 4, 3), 0.2, np.float32)
    config = SensorConfig(exposure_drift=0.3)
    for frame in (0, 17):
        stops = 0.3 * drift(0, 0, 4, frame)
        np.testing.assert_array_equal(
            expose(linear, config, 0, frame), np.rint(to_codes(linear * np.float32(2**stops)))
        )
    tinted = expose(linear, SensorConfig(white_balance_drift=0.5), 0, 20)[0, 0]
    assert tinted[1] == np.rint(to_codes(linear))[0, 0, 1]
    assert tinted[0] != tinted[1] or tinted[2] != tinted[1]


@pytest.mark.parametrize(("dropped", "burst"), [(0.1, 2.0), (0.3, 4.0)])
def test_frames_are_dropped_in_bursts(dropped: float, burst: float) -> None:
    ok = arrived(60_000, SensorConfig(dropped=dropped, drop_burst=burst), 0)
    assert ok[0]
    assert (~ok).mean() == pytest.approx(dropped, rel=0.1)
    begins = (~ok[1:] & ok[:-1]).sum()
    assert (~ok).sum() / begins == pytest.approx(burst, rel=0.1)
    np.testing.assert_array_equal(arrived(100, SensorConfig(dropped=dropped, drop_burst=burst), 0), ok[:100])


def test_the_shutter_opens_about_the_frame_s_moment() -> None:
    loop = np.tile(np.eye(4), (5, 1, 1))
    loop[:, 0, 3] = np.arange(5) * 0.03
    poses = shutter_poses(loop, 2, SensorConfig(exposure_ms=20.0, blur_samples=4))
    way = 0.03 * 20 * 30 / 1000  # 0.6 of a frame's 3 cm
    np.testing.assert_allclose(poses[:, 0, 3], 0.06 + way * np.array([-0.375, -0.125, 0.125, 0.375]), atol=1e-12)
    np.testing.assert_allclose(poses[:, :3, :3], np.tile(np.eye(3), (4, 1, 1)), atol=1e-12)


def test_a_dataset_hands_out_what_its_sensor_measures(room: SyntheticDataset) -> None:
    sensor = SensorConfig(depth_noise=0.06, holes=0.1, rgb_noise=2.0, exposure_ms=15.0, blur_samples=2, dropped=0.3)
    small = {"num_frames": 40, "width": 96, "height": 72, "lighting": "coarse"}
    noisy = SyntheticDataset(SyntheticConfig(**small, sensor=sensor))  # type: ignore[arg-type]
    assert 20 < len(noisy) < 36
    numbers = [round(noisy._picked[k]) for k in range(len(noisy))]
    k = next(k for k in range(len(numbers)) if numbers[k] > k)  # behind the first gap
    frame, exact = noisy[k], room[numbers[k]]
    assert frame.index == k
    assert frame.timestamp_ns == exact.timestamp_ns
    assert torch.equal(frame.T_world_camera_gt, exact.T_world_camera_gt)
    seen = frame.depth > 0
    assert 0.7 < seen.float().mean() < 0.98
    error = (frame.depth - exact.depth)[seen] / exact.depth[seen] ** 2
    assert error.std() == pytest.approx(0.06 / (575 * 0.075), rel=0.2)
    assert 0.005 < (frame.rgb - exact.rgb).abs().mean() < 0.1
    again = SyntheticDataset(SyntheticConfig(**small, sensor=sensor))[k]  # type: ignore[arg-type]
    assert torch.equal(again.rgb, frame.rgb)
    assert torch.equal(again.depth, frame.depth)


@pytest.mark.parametrize(
    ("knob", "value"),
    [("depth_noise", -1.0), ("holes", 1.0), ("dropped", -0.1), ("exposure_ms", 40.0), ("blur_samples", 1),
     ("grazing_deg", 90.0), ("depth_baseline", 0.0), ("drop_burst", 0.5)],
)  # fmt: skip
def test_impossible_sensors_are_refused(knob: str, value: float) -> None:
    with pytest.raises(ConfigError, match=rf"dataset\.sensor\.{knob}"):
        SensorConfig(**{knob: value})  # type: ignore[arg-type]
