"""The walk: smooth, closed, clear of surfaces, as fast as a hand-held camera."""

import numpy as np
import pytest
from numpy.typing import NDArray

from xrdslam.core.errors import DataError
from xrdslam.datasets.synthetic.distance import signed_distance
from xrdslam.datasets.synthetic.motion import MotionConfig, handheld_loop
from xrdslam.datasets.synthetic.rooms import ROOMS, build_room


def steps(T: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Translation [cm] and rotation [deg] from each frame to the next, the last to the first."""
    after = np.roll(T, -1, axis=0)
    R = T[:, :3, :3].transpose(0, 2, 1) @ after[:, :3, :3]
    sine = 0.5 * np.linalg.norm(R - R.transpose(0, 2, 1), axis=(1, 2)) / np.sqrt(2)
    return 100 * np.linalg.norm(after[:, :3, 3] - T[:, :3, 3], axis=1), np.degrees(np.arcsin(sine))


@pytest.mark.parametrize("name", sorted(ROOMS))
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_walk_moves_like_replica_s_and_keeps_clear(name: str, seed: int) -> None:
    scene = build_room(name, seed).pack()
    T = handheld_loop(scene, np.random.default_rng(seed))
    way, turn = steps(T)
    assert 0.58 < way.mean() < 1.46  # the range of Replica's scenes, as in the module's docstring
    assert np.percentile(way, 95) < 2.0
    assert 0.25 < turn.mean() < 0.65
    assert np.percentile(turn, 95) < 1.54
    assert way.max() < 3.5
    assert turn.max() < 3.0
    assert signed_distance(scene, T[:, :3, 3]).min() > 0.4
    np.testing.assert_allclose(
        T[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (len(T), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1.0, atol=1e-12)


def test_the_walk_is_smooth_across_its_seam() -> None:
    T = handheld_loop(build_room("room0", 0).pack(), np.random.default_rng(0))
    p = T[:, :3, 3]
    bend = np.linalg.norm(np.roll(p, -1, 0) - 2 * p + np.roll(p, 1, 0), axis=1)
    assert bend.max() < 0.004  # [m per frame^2]: 4 m/s^2 at most, tremor and turns together
    turn = steps(T)[1]
    assert turn[-3:].max() <= turn[:-3].max()
    assert turn[-3:].min() > 0


def test_the_camera_stands_upright() -> None:
    T = handheld_loop(build_room("room0", 0).pack(), np.random.default_rng(0))
    assert (T[:, 2, 1] < -0.7).all()  # the image's y axis points down
    assert np.abs(np.degrees(np.arcsin(T[:, 2, 0]))).max() < 1.0  # roll


def test_a_room_without_free_floor_is_refused() -> None:
    scene = build_room("room0", 0).pack()
    with pytest.raises(DataError, match=r"no walk keeps 3\.0 m"):
        handheld_loop(scene, np.random.default_rng(0), MotionConfig(clearance=3.0, tries=2))
