"""ATE and RPE against closed forms, invariances and evo."""

from collections.abc import Callable

import numpy as np
import pytest
from evo.core import metrics, trajectory
from scipy.spatial.transform import Rotation

from xrdslam.evaluation import EvaluationError, absolute_trajectory_error, relative_pose_error


def poses_of(centres: np.ndarray, rotations: np.ndarray | None = None) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(centres), 1, 1))
    poses[:, :3, 3] = centres
    if rotations is not None:
        poses[:, :3, :3] = rotations
    return poses


def wander(seed: int = 0, n: int = 80) -> np.ndarray:
    """A smooth 3-D path with turning orientations."""
    rng = np.random.default_rng(seed)
    centres = np.cumsum(np.cumsum(rng.normal(size=(n, 3)) * [0.02, 0.015, 0.01], 0), 0)
    return poses_of(centres, Rotation.from_rotvec(np.cumsum(rng.normal(size=(n, 3)) * 0.05, 0)).as_matrix())


def disturbed(poses: np.ndarray, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = poses_of(
        rng.normal(size=(len(poses), 3)) * 0.01,
        Rotation.from_rotvec(rng.normal(size=(len(poses), 3)) * 0.01).as_matrix(),
    )
    return poses @ noise


def rigid(seed: int = 2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return poses_of(rng.normal(size=(1, 3)) * 5, Rotation.random(1, rng=rng).as_matrix())[0]


def spread(poses: np.ndarray) -> np.ndarray:
    """Eigenvalues of the scatter of the centres [m^2], descending."""
    centred = poses[:, :3, 3] - poses[:, :3, 3].mean(0)
    return np.linalg.eigvalsh(centred.T @ centred / len(centred))[::-1]


# Two squares whose corners are lifted by +-1 cm and +-7 cm in the pattern x*y: orthogonal to 1, x and y, so that
# no rigid motion takes any of it away.
SQUARE = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0], [2, 2, 0], [-2, 2, 0], [-2, -2, 0], [2, -2, 0.0]])
LIFT = np.array([1, -1, 1, -1, 7, -7, 7, -7.0]) / 100


def test_every_statistic_on_a_closed_form() -> None:
    lifted = SQUARE + LIFT[:, None] * [0, 0, 1]
    error = absolute_trajectory_error(poses_of(lifted), poses_of(SQUARE))
    # |e| is 1 cm four times and 7 cm four times
    assert error.rmse_cm == pytest.approx(5.0)  # sqrt((1 + 49) / 2)
    assert error.mean_cm == pytest.approx(4.0)  # the mean is not the RMSE
    assert error.median_cm == pytest.approx(4.0)
    assert error.max_cm == pytest.approx(7.0)
    assert error.std_cm == pytest.approx(3.0)  # 25 - 16 = 9
    np.testing.assert_allclose(error.errors_cm, 100 * np.abs(LIFT), atol=1e-12)
    assert error.matched == 8


def test_the_last_frame_counts() -> None:
    truth = wander(n=10)
    estimate = truth.copy()
    estimate[-1, :3, 3] += [1.0, 0.0, 0.0]
    error = absolute_trajectory_error(estimate, truth, "none")
    assert error.rmse_cm == pytest.approx(100 * np.sqrt(1 / 10))
    assert error.errors_cm[-1] == pytest.approx(100.0)
    assert error.matched == 10


def test_centres_are_compared_not_the_translations_of_the_inverse() -> None:
    truth = wander()
    turned = truth.copy()
    turned[:, :3, :3] = truth[:, :3, :3] @ Rotation.from_euler("y", 90, degrees=True).as_matrix()
    assert absolute_trajectory_error(turned, truth).rmse_cm == pytest.approx(0.0, abs=1e-10)
    inverted = absolute_trajectory_error(np.linalg.inv(disturbed(truth)), np.linalg.inv(truth))
    assert abs(inverted.rmse_cm - absolute_trajectory_error(disturbed(truth), truth).rmse_cm) > 0.1


@pytest.mark.parametrize("kind", ["se3", "sim3"])
def test_a_shifted_and_turned_trajectory_has_no_error(kind: str) -> None:
    assert absolute_trajectory_error(rigid() @ wander(), wander(), kind).rmse_cm < 1e-10


def test_the_error_does_not_depend_on_the_world() -> None:
    base = absolute_trajectory_error(disturbed(wander()), wander()).rmse_cm
    moved = absolute_trajectory_error(rigid(3) @ disturbed(wander()), rigid(4) @ wander()).rmse_cm
    assert moved == pytest.approx(base, rel=1e-11)


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_a_scaled_trajectory_is_wrong_up_to_se3_and_right_up_to_sim3(scale: float) -> None:
    truth, estimate = wander(), wander()
    estimate[:, :3, 3] *= scale
    # var_truth + var_estimate - 2 trace(D) = (1 - s)^2 sum(lambda)
    expected_cm = 100 * abs(1 - scale) * np.sqrt(spread(truth).sum())
    assert absolute_trajectory_error(estimate, truth, "se3").rmse_cm == pytest.approx(expected_cm)
    similar = absolute_trajectory_error(estimate, truth, "sim3")
    assert similar.rmse_cm < 1e-10
    assert similar.alignment.scale == pytest.approx(1 / scale)


@pytest.mark.parametrize("axis", range(3))
def test_a_mirrored_trajectory_has_the_error_that_the_algebra_says(axis: int) -> None:
    truth, estimate = wander(), wander()
    estimate[:, axis, 3] *= -1
    eigenvalues = spread(truth)
    total, least = eigenvalues.sum(), eigenvalues[-1]
    # no reflection: trace(D S) = total - 2 least
    assert absolute_trajectory_error(estimate, truth, "se3").rmse_cm == pytest.approx(100 * 2 * np.sqrt(least))
    sim3_cm = 100 * np.sqrt(total - (total - 2 * least) ** 2 / total)
    assert absolute_trajectory_error(estimate, truth, "sim3").rmse_cm == pytest.approx(sim3_cm)
    assert sim3_cm > 1.0


def test_the_order_of_frames_matters_only_between_the_two() -> None:
    truth, estimate = wander(), disturbed(wander())
    order = np.random.default_rng(0).permutation(len(truth))
    base = absolute_trajectory_error(estimate, truth)
    both = absolute_trajectory_error(estimate[order], truth[order])
    assert both.rmse_cm == pytest.approx(base.rmse_cm, rel=1e-11)
    np.testing.assert_allclose(both.errors_cm, base.errors_cm[order], atol=1e-10)
    assert absolute_trajectory_error(estimate[order], truth).rmse_cm > 10 * base.rmse_cm


def test_frames_without_a_pose_are_left_out_and_counted() -> None:
    truth, estimate = wander(), disturbed(wander())
    base = absolute_trajectory_error(np.delete(estimate, [0, 7, 79], 0), np.delete(truth, [0, 7, 79], 0))
    truth[0], truth[7, 1, 2], estimate[7], estimate[79, 0, 3] = np.nan, -np.inf, np.nan, np.inf
    error = absolute_trajectory_error(estimate, truth)
    assert error.rmse_cm == pytest.approx(base.rmse_cm, rel=1e-12)
    assert (error.matched, error.missing_ground_truth, error.missing_estimate) == (77, 2, 1)
    assert np.isnan(error.errors_cm[[0, 7, 79]]).all()
    assert np.isfinite(np.delete(error.errors_cm, [0, 7, 79])).all()


@pytest.mark.parametrize(("kind", "enough"), [("se3", 3), ("sim3", 3), ("none", 1)])
def test_too_few_matches_are_an_error(kind: str, enough: int) -> None:
    truth = wander(n=5)
    truth[enough - 1 :] = np.nan
    with pytest.raises(EvaluationError, match=f"needs {enough} frames"):
        absolute_trajectory_error(wander(n=5), truth, kind)
    truth[enough - 1] = wander(n=5)[enough - 1]
    assert absolute_trajectory_error(wander(n=5), truth, kind).rmse_cm < 1e-10


@pytest.mark.parametrize("measure", [absolute_trajectory_error, relative_pose_error])
def test_trajectories_of_different_lengths_are_an_error(measure: Callable[..., object]) -> None:
    with pytest.raises(EvaluationError, match=r"same frames, found \(79, 4, 4\) estimated and \(80, 4, 4\) true"):
        measure(wander()[:-1], wander())


def test_a_straight_drive_has_an_error_although_its_roll_is_free() -> None:
    steps = np.arange(9.0)
    truth = poses_of(steps[:, None] * [1.0, 0.0, 0.0])
    along = 0.03 * np.array([1, -1, 0, 0, 0, 0, 0, -1, 1.0])  # sums to 0, and so does its product with (steps - 4)
    estimate = rigid() @ poses_of((steps + along)[:, None] * [1.0, 0.0, 0.0])
    error = absolute_trajectory_error(estimate, truth)
    assert not error.alignment.is_unique
    assert error.rmse_cm == pytest.approx(100 * np.sqrt((along**2).mean()))


def test_a_tracker_that_never_moves_has_the_spread_of_the_truth() -> None:
    truth = wander()
    still = np.tile(rigid(), (len(truth), 1, 1))
    assert absolute_trajectory_error(still, truth).rmse_cm == pytest.approx(100 * np.sqrt(spread(truth).sum()))
    with pytest.raises(EvaluationError, match="no scale"):
        absolute_trajectory_error(still, truth, "sim3")


def evo_paths(estimate: np.ndarray, truth: np.ndarray) -> tuple[trajectory.PosePath3D, trajectory.PosePath3D]:
    return trajectory.PosePath3D(poses_se3=list(truth)), trajectory.PosePath3D(poses_se3=list(estimate))


@pytest.mark.parametrize("kind", ["none", "se3", "sim3"])
@pytest.mark.parametrize("seed", range(4))
def test_ate_is_what_evo_says(kind: str, seed: int) -> None:
    truth = wander(seed)
    estimate = rigid(seed) @ disturbed(truth, seed + 10)
    reference, other = evo_paths(estimate, truth)
    if kind != "none":
        other.align(reference, correct_scale=kind == "sim3")
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, other))
    error = absolute_trajectory_error(estimate, truth, kind)
    expected = ape.get_all_statistics()
    for name in ("rmse", "mean", "median", "max", "std"):
        assert getattr(error, f"{name}_cm") == pytest.approx(100 * expected[name], abs=1e-9)
    np.testing.assert_allclose(error.errors_cm, 100 * ape.error, atol=1e-9)


@pytest.mark.parametrize("delta", [1, 7])
@pytest.mark.parametrize("seed", range(4))
def test_rpe_is_what_evo_says(delta: int, seed: int) -> None:
    truth = wander(seed)
    estimate = rigid(seed) @ disturbed(truth, seed + 10)
    error = relative_pose_error(estimate, truth, delta)
    assert error.pairs == len(truth) - delta
    for relation, found in (
        (metrics.PoseRelation.translation_part, error.translation_rmse_cm / 100),
        (metrics.PoseRelation.rotation_angle_deg, error.rotation_rmse_deg),
    ):
        rpe = metrics.RPE(relation, delta=delta, delta_unit=metrics.Unit.frames, all_pairs=True)
        rpe.process_data(evo_paths(estimate, truth))
        assert found == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), abs=1e-9)


@pytest.mark.parametrize("delta", [1, 3])
def test_rpe_of_a_constant_drift(delta: int) -> None:
    steps = np.arange(12.0)
    truth = poses_of(steps[:, None] * [0.0, 0.0, 0.10])
    drifting = poses_of(
        steps[:, None] * [0.0, 0.0, 0.11],
        Rotation.from_rotvec(np.radians(0.5) * steps[:, None] * [0, 0, 1]).as_matrix(),
    )
    error = relative_pose_error(drifting, truth, delta)
    assert error.translation_rmse_cm == pytest.approx(delta * 1.0)  # the turn is about the direction of travel
    assert error.rotation_rmse_deg == pytest.approx(delta * 0.5)


@pytest.mark.parametrize("angle_deg", [1e-9, 1e-4, 90.0, 179.9999, 180.0])
def test_rpe_angles_are_exact_at_both_ends(angle_deg: float) -> None:
    turned = poses_of(np.zeros((2, 3)), Rotation.from_rotvec([[0, 0, 0], [0, np.radians(angle_deg), 0]]).as_matrix())
    error = relative_pose_error(turned, poses_of(np.zeros((2, 3))))
    assert error.rotation_rmse_deg == pytest.approx(angle_deg, rel=1e-12)


def test_rpe_needs_no_alignment_and_takes_a_scale() -> None:
    truth = wander()
    base = relative_pose_error(disturbed(truth), truth)
    moved = relative_pose_error(rigid() @ disturbed(truth), truth)
    assert moved.translation_rmse_cm == pytest.approx(base.translation_rmse_cm, rel=1e-10)
    half = wander()
    half[:, :3, 3] *= 0.5
    assert relative_pose_error(half, truth, scale=2.0).translation_rmse_cm < 1e-10
    assert relative_pose_error(half, truth).translation_rmse_cm > 1.0


def test_rpe_does_not_bridge_gaps() -> None:
    truth, estimate = wander(n=10), disturbed(wander(n=10))
    estimate[4] = np.nan
    assert relative_pose_error(estimate, truth).pairs == 7  # not (3, 4), not (4, 5)
    estimate[::2] = np.nan
    with pytest.raises(EvaluationError, match="none among 10 frames, 5 of them"):
        relative_pose_error(estimate, truth)


@pytest.mark.parametrize("delta", [0, -1, 10, 11])
def test_rpe_over_an_impossible_distance_is_an_error(delta: int) -> None:
    with pytest.raises(EvaluationError, match=f"over {delta} frames"):
        relative_pose_error(wander(n=10), wander(n=10), delta)
