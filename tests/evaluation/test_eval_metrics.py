"""The one call: a run's poses and map in, metrics and pictures out."""

import csv
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError
from xrdslam.core.model import Rendering
from xrdslam.evaluation import EvalMetrics, EvaluationConfig, EvaluationError, Trajectories

CAMERA = Camera(30.0, 30.0, 20.0, 12.0, 40, 24)


@dataclass
class Shot:
    index: int
    camera: Camera
    rgb: Tensor
    depth: Tensor | None


def shots(n: int) -> list[Shot]:
    return [Shot(i, CAMERA, torch.full((24, 40, 3), 0.5), torch.full((24, 40), 2.0)) for i in range(n)]


def render(camera: Camera, T_world_camera: Tensor) -> Rendering:
    """A map that is 0.1 too bright and 1 cm too far for each metre along x."""
    depth = torch.full((camera.height, camera.width), 2.0) + 0.01 * T_world_camera[0, 3]
    return Rendering(torch.full((camera.height, camera.width, 3), 0.6), depth, torch.ones_like(depth))


def truth(n: int = 11) -> np.ndarray:
    poses = np.tile(np.eye(4), (n, 1, 1))
    t = np.arange(float(n))
    poses[:, :3, 3] = np.stack([t, np.sin(t), 0.2 * np.cos(2 * t)], 1)
    return poses


def scaled(poses: np.ndarray, factor: float) -> np.ndarray:
    result = poses.copy()
    result[:, :3, 3] *= factor
    return result


def test_a_whole_evaluation(tmp_path: Path) -> None:
    lost = np.zeros(11, dtype=bool)
    lost[4] = True
    run = Trajectories(scaled(truth(), 1.1), truth(), truth(), lost)
    config = EvaluationConfig(every=5, pictures_every=10)
    metrics = EvalMetrics(config).evaluate(run, render, shots(11), {"frames_per_second": 2.5}, run_dir=tmp_path)

    assert metrics["trajectory/final/ate_rmse_cm"] == pytest.approx(0.0, abs=1e-10)
    assert metrics["trajectory/online/ate_rmse_cm"] > 10.0
    assert metrics["trajectory/online/ate_sim3_rmse_cm"] == pytest.approx(0.0, abs=1e-10)
    assert metrics["trajectory/online/ate_mean_cm"] < metrics["trajectory/online/ate_rmse_cm"]
    assert metrics["trajectory/final/rpe_translation_rmse_cm"] == pytest.approx(0.0, abs=1e-10)
    assert metrics["trajectory/final/rpe_rotation_rmse_deg"] == 0.0
    assert metrics["trajectory/lost_frames"] == 1
    assert metrics["rendering/train/psnr_db"] == pytest.approx(20.0, abs=1e-5)
    assert metrics["rendering/train/depth_l1_cm"] == pytest.approx((0 + 5 + 10) / 3, rel=1e-5)  # frames 0, 5 and 10
    assert metrics["rendering/train/ms_ssim"] is None
    assert metrics["profile/frames_per_second"] == 2.5
    for group in ("trajectory/online", "trajectory/final", "trajectory", "rendering/train", "profile"):
        assert isinstance(metrics[f"{group}/protocol"], dict)
    assert metrics["trajectory/online/protocol"]["matched_frames"] == 11
    assert metrics["trajectory/online/protocol"]["ate_sim3_scale"] == pytest.approx(1 / 1.1)

    assert json.loads((tmp_path / "metrics.json").read_text()) == metrics
    written = sorted(str(file.relative_to(tmp_path)) for file in tmp_path.rglob("*.png") if "panels" not in file.parts)
    assert written == [
        "renders/frame_000000.png",
        "renders/frame_000010.png",
        "trajectory/final.png",
        "trajectory/online.png",
    ]
    with (tmp_path / "renders" / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["index"] for row in rows] == ["0", "5", "10"]
    assert float(rows[1]["depth_l1_cm"]) == pytest.approx(5.0, rel=1e-5)
    assert rows[1]["ms_ssim"] == ""


def test_nothing_is_written_without_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    EvalMetrics().evaluate(Trajectories(truth(), truth(), truth()), render, shots(11))
    assert list(tmp_path.iterdir()) == []


def test_pictures_can_be_switched_off(tmp_path: Path) -> None:
    config = EvaluationConfig(pictures_every=0, trajectory_pictures=False)
    EvalMetrics(config).evaluate(Trajectories(truth(), truth(), truth()), render, shots(11), run_dir=tmp_path)
    assert list(tmp_path.rglob("*.png")) == []
    assert (tmp_path / "metrics.json").exists()


def test_without_ground_truth_the_trajectory_has_no_numbers_but_a_picture(tmp_path: Path) -> None:
    metrics = EvalMetrics().evaluate(Trajectories(truth(), truth()), run_dir=tmp_path)
    assert metrics["trajectory/final/ate_rmse_cm"] is None
    assert metrics["trajectory/final/rpe_rotation_rmse_deg"] is None
    assert "no ground-truth" in metrics["trajectory/final/protocol"]["unavailable"]["ate_rmse_cm"]
    assert metrics["trajectory/lost_frames"] is None
    assert not any(key.startswith("rendering") for key in metrics)
    assert (tmp_path / "trajectory" / "final.png").exists()


@pytest.mark.parametrize("n", [0, 1, 2])
def test_short_runs_get_nulls_with_reasons_not_errors(n: int, tmp_path: Path) -> None:
    metrics = EvalMetrics().evaluate(Trajectories(truth(n), truth(n), truth(n)), render, shots(n), run_dir=tmp_path)
    assert metrics["trajectory/final/ate_rmse_cm"] is None
    assert "needs 3 frames" in metrics["trajectory/final/protocol"]["unavailable"]["ate_rmse_cm"]
    assert (metrics["rendering/train/psnr_db"] is None) == (n == 0)


def test_missing_poses_are_counted() -> None:
    final, reference = truth(), truth()
    final[5], reference[2] = np.nan, np.nan
    metrics = EvalMetrics().evaluate(Trajectories(truth(), final, reference), render, shots(11))
    protocol = metrics["trajectory/final/protocol"]
    assert (protocol["frames"], protocol["matched_frames"]) == (11, 9)
    assert (protocol["frames_without_ground_truth"], protocol["frames_without_estimate"]) == (1, 1)
    assert metrics["rendering/train/protocol"]["frames"] == 2
    assert metrics["rendering/train/protocol"]["frames_without_pose"] == 1


def test_rows_are_found_by_frame_index_where_frames_were_skipped() -> None:
    kept = [0, 1, 3, 4, 5, 7, 10]
    poses = truth()[kept]
    metrics = EvalMetrics().evaluate(Trajectories(poses, poses, poses, indices=kept), render, shots(11))
    assert metrics["rendering/train/depth_l1_cm"] == pytest.approx((0 + 5 + 10) / 3, rel=1e-5)


def test_a_monocular_estimate_is_compared_up_to_its_scale() -> None:
    half = scaled(truth(), 0.5)
    monocular = EvalMetrics().evaluate(Trajectories(half, half, truth(), has_metric_scale=False))
    assert monocular["trajectory/final/rpe_translation_rmse_cm"] == pytest.approx(0.0, abs=1e-9)
    assert monocular["trajectory/final/protocol"]["rpe_scale"] == pytest.approx(2.0)
    metric = EvalMetrics().evaluate(Trajectories(half, half, truth()))
    assert metric["trajectory/final/rpe_translation_rmse_cm"] > 10.0
    assert metric["trajectory/final/protocol"]["rpe_scale"] == 1.0


def test_an_estimate_that_stands_still_has_an_ate_and_no_sim3() -> None:
    still = np.tile(np.eye(4), (11, 1, 1))
    metrics = EvalMetrics().evaluate(Trajectories(still, still, truth(), has_metric_scale=False))
    assert metrics["trajectory/final/ate_rmse_cm"] > 100.0
    assert metrics["trajectory/final/ate_sim3_rmse_cm"] is None
    assert metrics["trajectory/final/rpe_translation_rmse_cm"] is None
    assert metrics["trajectory/final/protocol"]["is_alignment_rotation_unique"] is False


def test_a_map_that_cannot_be_rendered_costs_its_own_numbers_only(tmp_path: Path) -> None:
    def refuses(camera: Camera, T_world_camera: Tensor) -> Rendering:
        raise DataError("the map has no colours")

    metrics = EvalMetrics().evaluate(Trajectories(truth(), truth(), truth()), refuses, shots(11), run_dir=tmp_path)
    assert metrics["trajectory/final/ate_rmse_cm"] == pytest.approx(0.0, abs=1e-10)
    assert metrics["rendering/train/psnr_db"] is None
    assert "no colours" in metrics["rendering/train/protocol"]["unavailable"]["psnr_db"]


def test_a_nan_in_the_profile_is_null() -> None:
    metrics = EvalMetrics().evaluate(Trajectories(truth(), truth()), profile={"profile/frames_per_second": math.nan})
    assert metrics["profile/frames_per_second"] is None


def test_trajectories_of_different_lengths_are_refused() -> None:
    with pytest.raises(EvaluationError, match="'online': 11, 'final': 10"):
        Trajectories(truth(11), truth(10))
