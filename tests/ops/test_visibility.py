"""Which points depth images saw: the kernel against its twin, and each condition by itself."""

import numpy as np
import pytest
import torch

from xrdslam.core.camera import Camera
from xrdslam.core.geometry import se3, so3
from xrdslam.ops.visibility import visible, visible_reference

CAMERA = Camera(50.0, 55.0, 31.0, 22.5, 64, 48)


def scene(seed: int, views: int = 4, points: int = 3000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    turns = so3.exp(torch.from_numpy(rng.normal(size=(views, 3)) * 0.5))
    poses = se3.compose(turns, torch.from_numpy(rng.normal(size=(views, 3)))).numpy()
    depths = rng.uniform(0.5, 4.0, size=(views, 48, 64)).astype(np.float32)
    depths[rng.random(depths.shape) < 0.2] = 0.0
    return rng.normal(size=(points, 3)) * 3, poses, depths


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("has_depth", [True, False])
def test_the_kernel_says_what_the_twin_says(seed: int, has_depth: bool) -> None:
    points, poses, depths = scene(seed)
    images = [torch.from_numpy(depth) for depth in depths] if has_depth else None
    matrices = [torch.from_numpy(pose) for pose in poses]
    expected = visible_reference(torch.from_numpy(points), CAMERA, matrices, images, 0.06).numpy()
    found = visible(points, CAMERA, poses, depths if has_depth else None, 0.06)
    assert np.array_equal(found, expected)
    assert 0.01 < found.mean() < 0.99


@pytest.mark.parametrize(
    ("point", "is_seen"),
    [
        ([0, 0, 2], True),
        ([0, 0, 2.05], True),
        ([0, 0, 2.07], False),  # behind what was measured
        ([0, 0, 0.1], True),  # before it
        ([0, 0, -2], False),
        ([0, 0, 0], False),
        ([1.299, 0, 2], True),  # 50 * 1.299 / 2 + 31 = 63.475: the last column
        ([1.301, 0, 2], False),  # 63.525: beyond it
        ([0, -0.836, 2], True),  # 55 * -0.836 / 2 + 22.5 = -0.49: the first row
        ([0, -0.837, 2], False),
        ([np.nan, 0, 2], False),
        ([0, 0, np.inf], False),
        ([np.inf, 0, 2], False),
    ],
)
def test_each_condition_by_itself(point: list[float], is_seen: bool) -> None:
    depth = np.full((1, 48, 64), 2.0, np.float32)
    assert visible(np.array([point], dtype=np.float64), CAMERA, np.eye(4)[None], depth, 0.06)[0] == is_seen


def test_a_pixel_without_depth_saw_nothing_and_no_view_sees_nothing() -> None:
    point = np.array([[0.0, 0.0, 1.0]])
    assert not visible(point, CAMERA, np.eye(4)[None], np.zeros((1, 48, 64), np.float32), 0.06)[0]
    assert not visible(point, CAMERA, np.zeros((0, 4, 4)), None, 0.06)[0]
    assert visible(point, CAMERA, np.eye(4)[None], None, 0.06)[0]


def test_the_same_for_one_and_two_threads() -> None:
    points, poses, depths = scene(9)
    before = torch.get_num_threads()
    try:
        found = []
        for threads in (1, 2):
            torch.set_num_threads(threads)
            found.append(visible(points, CAMERA, poses, depths, 0.06))
    finally:
        torch.set_num_threads(before)
    assert np.array_equal(*found)
