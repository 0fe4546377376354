"""A synthetic sequence: exact, repeatable, the same colours from everywhere."""

from pathlib import Path

import numpy as np
import pytest
import torch

from xrdslam.core.errors import ConfigError, UnknownNameError
from xrdslam.core.frame import Frame
from xrdslam.core.geometry import se3
from xrdslam.datasets.synthetic.config import SyntheticConfig
from xrdslam.datasets.synthetic.dataset import SyntheticDataset
from xrdslam.datasets.synthetic.distance import signed_distance


def small(**knobs: object) -> SyntheticDataset:
    return SyntheticDataset(
        SyntheticConfig(**{"num_frames": 40, "width": 96, "height": 72, "lighting": "coarse", **knobs})
    )


def seen_again(dataset: SyntheticDataset, i: int, j: int) -> tuple[torch.Tensor, ...]:
    """Pixels of frame i carried into frame j: (difference of depth, colours in i, colours sampled in j)."""
    a, b = dataset[i], dataset[j]
    T_b_a = np.linalg.inv(dataset.T_world_camera(j)) @ dataset.T_world_camera(i)
    points = se3.transform(torch.from_numpy(T_b_a), dataset.camera.rays().double() * a.depth[..., None].double())
    uv, z = dataset.camera.project(points)
    ok = dataset.camera.contains(uv, 1.0) & (z > 0)
    size = torch.tensor([dataset.camera.width - 1.0, dataset.camera.height - 1.0])
    grid = (2 * uv / size - 1)[None].float()
    images = torch.cat((b.depth[None], b.rgb.permute(2, 0, 1)))[None]
    sampled = torch.nn.functional.grid_sample(images, grid, align_corners=True)[0]
    return sampled[0][ok] - z[ok].float(), a.rgb[ok], sampled[1:].permute(1, 2, 0)[ok]


def test_depth_and_colour_agree_between_frames_under_the_exact_poses(room: SyntheticDataset) -> None:
    for i, j in ((0, 1), (3, 13), (5, 35)):
        gap, colour_i, colour_j = seen_again(room, i, j)
        assert len(gap) > 2000
        assert gap.abs().median() < 1e-3  # bilinear interpolation of 1/plane and of round things at 96 px
        visible = gap.abs() < 0.01
        assert visible.float().mean() > 0.7
        assert (colour_i - colour_j)[visible].abs().median() < 0.02  # texture below a pixel is what differs


def test_every_pixel_s_point_is_on_a_surface(room: SyntheticDataset) -> None:
    frame, T = room[7], room.T_world_camera(7)
    rays = room.camera.rays().double().numpy()
    points = T[:3, 3] + (rays * frame.depth.numpy()[..., None].astype(np.float64)) @ T[:3, :3].T
    distance = np.abs(signed_distance(room.scene.pack(), points))
    assert distance.max() < 5e-6  # float32 rays and depth at up to 6 m
    assert (frame.depth > 0).all()


def test_frames_follow_the_conventions(room: SyntheticDataset) -> None:
    assert len(room) == 40
    assert room.name == "synthetic/room0"
    assert room.modalities == {"rgb", "depth", "pose"}
    frame = room[-1]
    assert isinstance(frame, Frame)
    assert (frame.index, frame.timestamp_ns) == (39, 1_300_000_000)
    assert frame.rgb.shape == (72, 96, 3)
    assert frame.rgb.dtype == frame.depth.dtype == torch.float32
    assert (frame.rgb * 255 - (frame.rgb * 255).round()).abs().max() < 1e-4
    assert 0.05 < frame.rgb.mean() < 0.95
    assert frame.rgb.std() > 0.1
    camera = room.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (48, 48, 47.5, 35.5)  # pixel (0, 0) is a centre
    low, high = room.bounds
    position = frame.T_world_camera_gt[:3, 3]
    assert (position > low).all()
    assert (position < high).all()
    with pytest.raises(IndexError):
        room[40]
    room.check()


def test_frames_pick_size_and_depth_follow_the_common_knobs(room: SyntheticDataset) -> None:
    picked = small(frames=[4, -1, 3], size=[48, 36], max_depth=2.5)
    assert len(picked) == 12
    np.testing.assert_array_equal(picked.T_world_camera(2), room.T_world_camera(10))
    assert (picked.camera.width, picked.camera.fx) == (48, 24)
    depth, full = picked[0].depth, small(size=[48, 36])[4].depth
    torch.testing.assert_close(depth, torch.where(full <= 2.5, full, 0), rtol=0, atol=0)
    assert (depth == 0).any()
    with pytest.raises(ConfigError, match="picks none"):
        small(frames=[50, None, 1])


def test_a_longer_sequence_begins_with_the_shorter_and_goes_round(room: SyntheticDataset) -> None:
    longer = small(num_frames=5000)
    np.testing.assert_array_equal(longer.T_world_camera(39), room.T_world_camera(39))
    poses = [longer.T_world_camera(i).tobytes() for i in range(5000)]
    round_trip = poses.index(poses[0], 1)
    assert len(set(poses)) == round_trip > 1800


def test_the_cache_gives_the_bits_of_rendering_and_survives_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XRDSLAM_CACHE", str(tmp_path))
    plain = small(cache=False)[3]
    assert not any(tmp_path.iterdir())
    first = small()[3]
    files = sorted(tmp_path.rglob("*.cache"))
    assert len(files) == 3  # walk, light, frame
    again = small()[3]
    for path in files:
        path.write_bytes(path.read_bytes()[:-9])
    mended = small()[3]
    for frame in (first, again, mended):
        assert torch.equal(frame.rgb, plain.rgb)
        assert torch.equal(frame.depth, plain.depth)
        assert torch.equal(frame.T_world_camera_gt, plain.T_world_camera_gt)


def test_a_frame_from_the_cache_needs_no_light(room: SyntheticDataset, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = room[2].rgb

    def refuse(*_: object) -> None:
        raise AssertionError("rendered again")

    monkeypatch.setattr("xrdslam.datasets.synthetic.dataset.bake", refuse)
    monkeypatch.setattr("xrdslam.datasets.synthetic.dataset.render", refuse)
    assert torch.equal(small()[2].rgb, kept)


def test_seeds_make_different_rooms_and_walks(room: SyntheticDataset) -> None:
    other = small(seed=1)
    assert other.scene.pack().digest() != room.scene.pack().digest()
    assert not np.array_equal(other.T_world_camera(0), room.T_world_camera(0))
    assert small().scene.pack().digest() == room.scene.pack().digest()


def test_the_mesh_is_made_once(room: SyntheticDataset) -> None:
    path = room.ground_truth_mesh
    assert path.read_bytes()[:3] == b"ply"
    stamp = path.stat().st_mtime_ns
    assert room.ground_truth_mesh == path
    assert path.stat().st_mtime_ns == stamp


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(UnknownNameError, match="room0"):
        small(scene="attic")
    with pytest.raises(ConfigError, match=r"dataset\.num_frames"):
        SyntheticConfig(num_frames=0)
    with pytest.raises(ConfigError, match=r"dataset\.lighting"):
        SyntheticConfig(lighting="dim")
