"""The walk: smooth, closed, clear of surfaces, as fast as a hand-held camera."""

import numpy as np
import pytest
from numpy.typing import NDArray

from xrdslam.core.errors import DataError
from xrdslam.datasets.synthetic.distance import signed_distance
from xrdslam.datasets.synthetic.motion import MotionConfig, handheld_loop
from xrdslam.datasets.synthetic.rooms import ROOMS, build_room
from xrdslam.datasets.synthetic.statistics import measure


@pytest.mark.parametrize("name", sorted(ROOMS))
def test_the_walk_moves_like_replica_s_and_keeps_clear(name: str) -> None:
    """Ranges around Replica's eight trajectories, each relative to its own mean (docs/synthetic.md has them)."""
    room = build_room(name, 0)
    scene, pace = room.pack(), room.pace
    T = handheld_loop(scene, np.random.default_rng([0, 1]), MotionConfig(pace.way_m, pace.turn_deg))
    moves = measure(np.concatenate((T, T[:1])))
    assert 1800 < len(T) < 2200
    assert moves.way_cm[0] == pytest.approx(100 * pace.way_m, rel=0.01)
    assert moves.way_cm[1] == pytest.approx(moves.way_cm[0], rel=0.04)  # Replica: 0.97-1.03 of the mean
    assert 1.15 < moves.way_cm[2] / moves.way_cm[0] < 1.5  # 1.25-1.37
    assert moves.turn_deg[0] == pytest.approx(pace.turn_deg, rel=0.3)
    assert 0.6 < moves.turn_deg[1] / moves.turn_deg[0] < 1.05  # 0.74-0.87
    assert 1.7 < moves.turn_deg[2] / moves.turn_deg[0] < 3.0  # 1.98-2.42
    assert 0.015 < moves.acceleration_mm / (10 * moves.way_cm[0]) < 0.06  # 0.031-0.040
    assert signed_distance(scene, T[:, :3, 3]).min() > 0.38
    np.testing.assert_allclose(
        T[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (len(T), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1.0, atol=1e-12)


def test_statistics_are_those_of_a_circle() -> None:
    """Radius 0.8 m in 400 frames, looking along the way: closed forms of every entry."""
    angle = 2 * np.pi * np.arange(401) / 400
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(401), np.ones(401)
    T = np.tile(np.eye(4), (401, 1, 1))
    T[:, :3, :3] = np.stack((c, -s, zero, s, c, zero, zero, zero, one), 1).reshape(-1, 3, 3)
    T[:, :3, 3] = 0.8 * np.stack((c, s, zero), 1)
    chord = 2 * np.sin(np.pi / 400)
    moves = measure(T)
    np.testing.assert_allclose(moves.way_cm, 80 * chord, rtol=1e-9)
    np.testing.assert_allclose(moves.turn_deg, 0.9, rtol=1e-9)
    assert moves.acceleration_mm == pytest.approx(800 * chord**2, rel=1e-9)
    assert moves.jerk_mm == pytest.approx(800 * chord**3, rel=1e-6)
    assert moves.turn_change_deg < 1e-9


@pytest.fixture(scope="module")
def walk() -> NDArray[np.float64]:
    return handheld_loop(build_room("room0", 0).pack(), np.random.default_rng(0))


def test_the_walk_is_smooth_across_its_seam(walk: NDArray[np.float64]) -> None:
    p = walk[:, :3, 3]
    bend = np.linalg.norm(np.roll(p, -1, 0) - 2 * p + np.roll(p, 1, 0), axis=1)
    assert bend.max() < 0.006  # [m per frame^2]; Replica's greatest is 0.004
    seam = np.concatenate((walk[-40:], walk[:40]))
    assert measure(seam).jerk_mm < 0.2
    assert measure(seam).turn_change_deg < 0.08


def test_the_camera_stands_upright(walk: NDArray[np.float64]) -> None:
    assert (walk[:, 2, 1] < -0.5).all()  # the image's y axis points down
    assert np.abs(np.degrees(np.arcsin(walk[:, 2, 0]))).max() < 1.0  # roll


def test_a_room_without_free_floor_is_refused() -> None:
    scene = build_room("room0", 0).pack()
    with pytest.raises(DataError, match=r"no walk keeps 3\.0 m"):
        handheld_loop(scene, np.random.default_rng(0), MotionConfig(clearance=3.0, tries=2))
