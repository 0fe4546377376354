"""Trackers and mappers of the methods that draw rays work under one another's maps."""

import itertools

import pytest

from xrdslam.core.algorithm import Scene
from xrdslam.core.records import AlgorithmInfo
from xrdslam.core.registry import installed
from xrdslam.core.trajectory import Trajectory
from xrdslam.engine.build import build_algorithm
from xrdslam.testing import toy_sequence

METHODS = ("co_slam", "vox_fusion")
PAIRS = [(part, *pair) for part in ("tracking", "mapping") for pair in itertools.permutations(METHODS)]


@pytest.mark.parametrize(("part", "own", "other"), PAIRS)
def test_a_part_of_one_follows_the_map_of_another(part: str, own: str, other: str) -> None:
    """Three frames: every pose but the given one is tracked, and is within a few centimetres."""
    registry = installed()
    missing = [name for name in (own, other) if name not in registry.all(AlgorithmInfo)]
    if missing:
        pytest.skip(f"needs the plugins {', '.join(METHODS)}; not installed: {', '.join(missing)}")
    config = registry.algorithm(own).load_config()()
    method = registry.tracking_method if part == "tracking" else registry.mapping_method
    setattr(config, part, method(other).load_config()())
    config.map.truncation_m = 0.1
    config.map_every = config.keyframe_every = 1
    config.tracking.num_pixels = config.mapping.num_pixels = 200
    config.tracking.iterations, config.tracking.first_iterations, config.tracking.border_px = 10, 10, 0
    config.mapping.iterations, config.mapping.first_iterations = 3, 40
    algorithm, data = build_algorithm(config), toy_sequence(num_frames=3)
    for frame in data:
        if frame.index == 0:
            algorithm.start(Scene.of(data), frame)
        else:
            assert not algorithm.track(frame).is_lost
        result = algorithm.map(frame)
        assert result is not None
        assert result.iterations > 0
    trajectory: Trajectory = algorithm.trajectory
    found, true = trajectory.current()[:, :3, 3], data.poses[:, :3, 3]
    assert float((found - true).norm(dim=1).max()) < 0.08
