"""Umeyama's alignment: exact recovery, no reflections, the degenerate cases."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xrdslam.evaluation import Alignment, EvaluationError, umeyama


def cloud(seed: int = 0, n: int = 40) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, 3)) * [3.0, 2.0, 1.0]


def motion(seed: int = 0, scale: float = 1.0) -> Alignment:
    rng = np.random.default_rng(seed)
    return Alignment(scale, Rotation.random(rng=rng).as_matrix(), rng.normal(size=3) * 10)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("scale", [0.01, 1.0, 7.5])
def test_a_similarity_is_recovered_exactly(seed: int, scale: float) -> None:
    points, true = cloud(seed), motion(seed, scale)
    found = umeyama(points, true.apply(points), with_scale=True)
    assert found.scale == pytest.approx(scale, rel=1e-13)
    np.testing.assert_allclose(found.rotation, true.rotation, atol=1e-13)
    np.testing.assert_allclose(found.translation, true.translation, atol=1e-12)
    assert found.is_unique


def test_without_scale_the_scale_stays_one() -> None:
    assert umeyama(cloud(), 2.0 * cloud(), with_scale=False).scale == 1.0


@pytest.mark.parametrize("seed", range(5))
def test_points_on_a_plane_are_aligned_by_a_rotation(seed: int) -> None:
    flat = cloud(seed) * [1.0, 1.0, 0.0]
    true = motion(seed)
    found = umeyama(flat, true.apply(flat), with_scale=False)
    assert found.is_unique
    np.testing.assert_allclose(found.rotation, true.rotation, atol=1e-13)


@pytest.mark.parametrize("axis", range(3))
def test_a_mirror_image_gets_a_rotation_never_a_reflection(axis: int) -> None:
    mirrored = cloud() * np.where(np.arange(3) == axis, -1.0, 1.0)
    found = umeyama(mirrored, cloud(), with_scale=True)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)


def test_points_on_a_line_are_aligned_with_a_warning_flag() -> None:
    line = np.linspace(0, 5, 20)[:, None] * np.array([1.0, 2.0, -1.0])
    true = motion(3)
    found = umeyama(line, true.apply(line), with_scale=False)
    assert not found.is_unique
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(found.apply(line), true.apply(line), atol=1e-12)


def test_a_line_with_a_trace_of_width_is_unique() -> None:
    line = np.linspace(0, 5, 20)[:, None] * np.array([1.0, 0.0, 0.0])
    line[::2, 1] += 1e-3  # a millimetre on five metres: (1e-3/2)^2 / 1.5^2, about 1e-7 of the spread, far above 1e-12
    assert umeyama(line, motion(1).apply(line), with_scale=False).is_unique


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_points_are_refused(n: int) -> None:
    with pytest.raises(EvaluationError, match="at least 3"):
        umeyama(cloud(n=n), cloud(n=n), with_scale=False)


def test_points_that_are_no_numbers_are_refused() -> None:
    broken = cloud()
    broken[3, 1] = np.inf
    with pytest.raises(EvaluationError, match="finite"):
        umeyama(broken, cloud(), with_scale=False)


@pytest.mark.parametrize("still", ["source", "target"])
def test_no_scale_is_invented_for_a_trajectory_that_stands_still(still: str) -> None:
    point = np.ones((40, 3))
    source, target = (point, cloud()) if still == "source" else (cloud(), point)
    with pytest.raises(EvaluationError, match="no scale"):
        umeyama(source, target, with_scale=True)


def test_poses_keep_rotations_under_a_scaled_alignment() -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = cloud(n=3)
    true = motion(4, scale=3.0)
    moved = true.apply_to_poses(poses)
    np.testing.assert_allclose(moved[:, :3, 3], true.apply(poses[:, :3, 3]))
    np.testing.assert_allclose(moved[:, :3, :3] @ moved[:, :3, :3].transpose(0, 2, 1), poses[:, :3, :3], atol=1e-14)
    assert (poses[:, :3, 3] == cloud(n=3)).all()  # the argument is left alone
