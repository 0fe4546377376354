"""Trajectories from files: exact times, damaged lines, association by time against brute force and evo."""

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface
from scipy.spatial.transform import Rotation

from xrdslam.core.errors import DataError
from xrdslam.evaluation import EvalMetrics, EvaluationConfig, EvaluationError
from xrdslam.evaluation.trajectory_files import StampedPoses, associated, matches, read_tum

START_NS = 1_305_031_102_175_304_123  # float64 would round it to 256 ns


def walk(count: int = 60, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = np.cumsum(rng.normal(size=(count, 3)) * [0.05, 0.04, 0.03], 0)
    poses[:, :3, :3] = Rotation.from_rotvec(np.cumsum(rng.normal(size=(count, 3)) * 0.05, 0)).as_matrix()
    return poses


def disturbed(poses: np.ndarray, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noisy = poses.copy()
    noisy[:, :3, 3] += rng.normal(size=(len(poses), 3)) * 0.01
    noisy[:, :3, :3] @= Rotation.from_rotvec(rng.normal(size=(len(poses), 3)) * 0.01).as_matrix()
    return noisy


def written(path: Path, stamps_ns: np.ndarray, poses: np.ndarray) -> Path:
    quats = Rotation.from_matrix(poses[:, :3, :3]).as_quat()  # xyzw
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for stamp, pose, quat in zip(stamps_ns.tolist(), poses, quats, strict=True):
        numbers = " ".join(repr(float(v)) for v in (*pose[:3, 3], *quat))
        lines.append(f"{stamp // 10**9}.{stamp % 10**9:09d} {numbers}")
    path.write_text("\n".join(lines) + "\n")
    return path


def two_files(folder: Path) -> tuple[Path, Path]:
    """Return an estimate at 30 Hz and a truth at 100 Hz that jitters, begins later and has a gap; as TUM's are."""
    rng = np.random.default_rng(3)
    estimated = START_NS + np.arange(60) * 33_333_333
    true = START_NS + 250_000_000 + np.arange(180) * 10_000_000 + rng.integers(-2_000_000, 2_000_000, 180)
    true = np.delete(true, slice(60, 90))
    poses = disturbed(walk(60))
    return written(folder / "estimate.txt", estimated, poses), written(folder / "truth.txt", true, walk(150, 5))


def test_times_and_poses_are_read_as_written(tmp_path: Path) -> None:
    stamps, poses = START_NS + np.arange(7) * 33_333_333, walk(7)
    read = read_tum(written(tmp_path / "t.txt", stamps, poses))
    assert read.timestamps_ns.tolist() == stamps.tolist()
    np.testing.assert_allclose(read.T_world_camera, poses, atol=1e-14)


def test_lines_out_of_order_are_sorted_and_commas_and_comments_allowed(tmp_path: Path) -> None:
    (tmp_path / "t.txt").write_text("# a comment\n\n2.5, 1, 2, 3, 0, 0, 0, 1\n1e0 4 5 6 0 0 1 0\n")
    read = read_tum(tmp_path / "t.txt")
    assert read.timestamps_ns.tolist() == [10**9, 2_500_000_000]
    assert read.T_world_camera[:, 0, 3].tolist() == [4.0, 1.0]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("1 2 3", "must be `time"),
        ("1 2 3 4 5 6 7 x", "not numbers"),
        ("nan 0 0 0 0 0 0 1", "not numbers"),
        ("2 0 0 0 0 0 0 0", "must be `time"),  # no rotation
        ("1.0 0 0 0 0 0 0 1", "a second pose for the time 1.0"),
    ],
)
def test_a_damaged_line_is_named(tmp_path: Path, line: str, said: str) -> None:
    (tmp_path / "t.txt").write_text(f"1 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(DataError, match=f"line 2: .*{said}"):
        read_tum(tmp_path / "t.txt")
    with pytest.raises(DataError, match="cannot be read"):
        read_tum(tmp_path / "missing.txt")


def by_brute_force(a: np.ndarray, b: np.ndarray, tolerance_ns: int) -> list[list[int]]:
    """Every pair that is mutually nearest; written as its definition."""
    gaps = np.abs(a[:, None] - b[None])
    return [
        [i, int(gaps[i].argmin())]
        for i in range(len(a))
        if gaps[i].min() <= tolerance_ns and int(gaps[:, gaps[i].argmin()].argmin()) == i
    ]


@pytest.mark.parametrize("seed", range(20))
def test_matches_are_those_of_the_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 40, 2)
    a, b = (np.sort(rng.choice(2000, size, replace=False)) * 1_000_000 for size in sizes)
    assert matches(a, b, 0.02).tolist() == by_brute_force(a, b, 20_000_000)


def test_the_tolerance_is_inclusive_and_each_pose_is_used_once() -> None:
    a = np.array([0, 20_000_000], dtype=np.int64)
    assert matches(a, np.array([20_000_000]), 0.02).tolist() == [[1, 0]]
    assert matches(a[:1], np.array([20_000_000]), 0.02).tolist() == [[0, 0]]
    assert matches(a[:1], np.array([20_000_001]), 0.02).tolist() == []
    assert matches(a[:0], a, 0.02).tolist() == matches(a, a[:0], 0.02).tolist() == []


def test_hours_of_poses_are_matched_at_once() -> None:
    """A comparison of all with all would be 4e10 gaps, 320 GB of them."""
    stamps = START_NS + np.arange(200_000) * 10_000_000
    assert len(matches(stamps, stamps + 4_000_000, 0.02)) == 200_000


@pytest.mark.parametrize("tolerance_s", [0.002, 0.003, 0.004])  # evo lets two poses share one
def test_figures_of_two_files_are_evos(tmp_path: Path, tolerance_s: float) -> None:
    estimate, truth = two_files(tmp_path)
    found, true = associated(read_tum(estimate), read_tum(truth), tolerance_s)
    reference = file_interface.read_tum_trajectory_file(truth)
    theirs = file_interface.read_tum_trajectory_file(estimate)
    reference, theirs = sync.associate_trajectories(reference, theirs, max_diff=tolerance_s)
    both = np.isfinite(found).all((1, 2)) & np.isfinite(true).all((1, 2))
    assert both.sum() == theirs.num_poses > 10
    np.testing.assert_allclose(found[both, :3, 3], theirs.positions_xyz, atol=1e-12)
    metrics_ = EvalMetrics(EvaluationConfig(max_time_difference_s=tolerance_s)).evaluate_files(
        read_tum(estimate), read_tum(truth)
    )
    for key, with_scale in (("ate_rmse_cm", False), ("ate_sim3_rmse_cm", True)):
        assert metrics_[f"trajectory/final/{key}"] == pytest.approx(100 * _evo(reference, theirs, with_scale), abs=1e-9)
    protocol = metrics_["trajectory/final/protocol"]
    assert protocol["matched_frames"] == theirs.num_poses
    assert protocol["frames_without_ground_truth"] == 60 - theirs.num_poses
    assert protocol["frames_without_estimate"] == 150 - theirs.num_poses


def _evo(reference: PoseTrajectory3D, estimate: PoseTrajectory3D, with_scale: bool) -> float:
    aligned = PoseTrajectory3D(poses_se3=list(estimate.poses_se3), timestamps=estimate.timestamps)
    aligned.align(reference, correct_scale=with_scale)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    return float(ape.get_statistic(metrics.StatisticsType.rmse))


def test_clocks_that_share_nothing_are_refused_with_what_they_say() -> None:
    estimate = StampedPoses(np.arange(10) * 10**9, walk(10))
    truth = StampedPoses(START_NS + np.arange(10) * 10**9, walk(10))
    with pytest.raises(EvaluationError, match=r"10 poses from 0\.000 to 9\.000 s.*one clock"):
        associated(estimate, truth, 0.02)


@pytest.mark.parametrize("change", ["mirrored", "shuffled", "scaled", "shifted"])
def test_a_wrong_trajectory_is_not_forgiven(change: str) -> None:
    stamps = np.arange(60) * 33_333_333
    poses = walk(60)
    if change == "mirrored":
        poses[:, 0, 3] *= -1
    elif change == "scaled":
        poses[:, :3, 3] *= 1.3
    elif change == "shuffled":
        poses = poses[np.random.default_rng(0).permutation(60)]
    else:  # every pose a frame late: the tolerance must not slide them back
        poses = np.concatenate((poses[:1], poses[:-1]))
    figures = EvalMetrics().evaluate_files(StampedPoses(stamps, poses), StampedPoses(stamps, walk(60)))
    assert figures["trajectory/final/ate_rmse_cm"] > 2.0
    assert (figures["trajectory/final/ate_sim3_rmse_cm"] < 1e-9) == (change == "scaled")
