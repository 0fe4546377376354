"""A surface is laid on the true one by the path only where the path says how."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from xrdslam.evaluation.alignment import Alignment, umeyama
from xrdslam.evaluation.surface_alignment import LEAST_ASIDE_M, STRAIGHT, spread, surface_alignment

WORLD = Alignment(1.0, Rotation.from_rotvec([0.4, -0.3, 1.1]).as_matrix(), np.array([1.0, -2.0, 0.5]))
"""Where the estimate's world lies in the true one, before errors."""
FRAMES = 12


def walk(aside_m: float, along_m: float = 1.0) -> np.ndarray:
    """Return true poses on a way whose spread is as given: a line, and a cosine beside it that is orthogonal to it."""
    t = np.linspace(-1, 1, FRAMES)
    line, beside = t / t.std(), np.cos(2 * np.pi * t)
    beside = (beside - beside.mean()) / beside.std()
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, :3, :3] = Rotation.from_euler("y", 0.2 * t[:, None]).as_matrix()
    poses[:, 0, 3], poses[:, 1, 3] = along_m * line, aside_m * beside
    return poses


def estimated(truth: np.ndarray, noise_m: float = 0.002, scale: float = 1.0) -> np.ndarray:
    """Return what a tracker makes of it: in a world of its own, the first pose exact, the others with errors."""
    T_world_true = np.eye(4)
    T_world_true[:3, :3], T_world_true[:3, 3] = WORLD.rotation, WORLD.translation
    poses = np.linalg.inv(T_world_true) @ truth
    poses[1:, :3, 3] += np.random.default_rng(3).normal(0, noise_m, (FRAMES - 1, 3))
    poses[:, :3, 3] *= scale
    return poses


def turned_deg(found: Alignment) -> float:
    """Return how far an alignment's rotation is from the true one."""
    return float(np.degrees(Rotation.from_matrix(found.rotation.T @ WORLD.rotation).magnitude()))


def test_the_spread_is_measured_along_the_main_line_and_off_it() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(0, (3.0, 0.4, 0.3), (200_000, 3)) @ WORLD.rotation.T + 7
    found = spread(points)
    assert found.along_m == pytest.approx(3.0, rel=0.01)
    assert found.aside_m == pytest.approx(0.5, rel=0.01)


@pytest.mark.parametrize(
    ("along_m", "aside_m", "fixes"),
    [
        (1.0, 1.02 * STRAIGHT, True),
        (1.0, 0.98 * STRAIGHT, False),  # a corridor
        (0.05, 1.02 * LEAST_ASIDE_M, True),
        (0.05, 0.98 * LEAST_ASIDE_M, False),  # hardly moved
        (0.0, 0.0, False),  # stood still
    ],
)
def test_a_path_fixes_the_rotation_where_it_goes_aside_far_enough(along_m: float, aside_m: float, fixes: bool) -> None:
    truth = walk(aside_m, along_m)
    found = surface_alignment(truth, truth)
    assert found.path.fixes_rotation is found.is_by_path is fixes
    np.testing.assert_allclose(found.motion.rotation, np.eye(3), atol=1e-9)  # the estimate is the truth


def test_errors_of_a_straight_path_turn_no_surface() -> None:
    """Two millimetres of error on a straight metre: the path's own alignment turns the world by tens of degrees."""
    truth = walk(aside_m=0.0)
    estimate = estimated(truth)
    by_path = umeyama(estimate[:, :3, 3], truth[:, :3, 3], with_scale=False)
    assert turned_deg(by_path) > 20
    found = surface_alignment(estimate, truth)
    assert turned_deg(found.motion) < 1e-6
    point = np.array([[0.5, 2.0, 3.0]])
    np.testing.assert_allclose(found.motion.apply(in_estimated_world(point)), point, atol=1e-9)


def in_estimated_world(points: np.ndarray) -> np.ndarray:
    """Return points of the true world in the estimate's."""
    return (points - WORLD.translation) @ WORLD.rotation


def test_a_winding_path_is_aligned_by_all_of_it() -> None:
    truth = walk(aside_m=0.4)
    estimate = estimated(truth)
    estimate[0, :3, :3] = estimate[0, :3, :3] @ Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix()  # a bad first pose
    found = surface_alignment(estimate, truth)
    assert turned_deg(found.motion) < 1.0
    assert found.protocol("se3")["alignment"] == "the final trajectory's SE(3)"


def test_a_straight_path_has_a_scale_all_the_same() -> None:
    truth = walk(aside_m=0.0)
    found = surface_alignment(estimated(truth, noise_m=1e-4, scale=0.5), truth, "sim3")
    assert found.motion.scale == pytest.approx(2.0, rel=1e-3)
    assert turned_deg(found.motion) < 1e-6
    np.testing.assert_allclose(
        found.motion.apply(0.5 * in_estimated_world(np.ones((1, 3)))), np.ones((1, 3)), atol=0.01
    )  # the scale's error, 1e-4 / 1, times metres


def test_the_first_pose_that_both_have_is_taken_and_the_protocol_says_so() -> None:
    truth = walk(aside_m=0.0)
    estimate = estimated(truth, noise_m=0.0)
    estimate[0] = np.nan
    truth[1] = np.nan
    found = surface_alignment(estimate, truth)
    assert turned_deg(found.motion) < 1e-6
    said = found.protocol("se3")
    assert str(said["alignment"]).startswith(
        "the first pose's SE(3): the true path goes aside of a line by less than 5 %"
    )
    assert said["alignment_path_aside_cm"] == pytest.approx(0.0, abs=1e-9)
