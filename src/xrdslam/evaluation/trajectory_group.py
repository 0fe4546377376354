"""The figures of one estimated trajectory, and of how much of the sequence was tracked at all."""

import numpy as np

from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.metrics import MetricGroup
from xrdslam.evaluation.trajectories import Trajectories
from xrdslam.evaluation.trajectory import (
    AnyPoses,
    Poses,
    TrajectoryError,
    absolute_trajectory_error,
    is_finite,
    relative_pose_error,
)

__all__ = ["KEYS", "coverage_group", "trajectory_group"]

ATE_STATISTICS = ("rmse_cm", "mean_cm", "median_cm", "max_cm", "std_cm")
RPE_KEYS = ("rpe_translation_rmse_cm", "rpe_rotation_rmse_deg")
ATE_KEYS = tuple(f"ate_{name}" for name in ATE_STATISTICS)
KEYS = (*ATE_KEYS, "ate_sim3_rmse_cm", *RPE_KEYS)


def trajectory_group(
    name: str, estimate: Poses, truth: AnyPoses | None, has_metric_scale: bool, rpe_delta_frames: int
) -> tuple[MetricGroup, TrajectoryError | None]:
    """Return `trajectory/<name>`, and the error of each frame where there is one."""
    group = MetricGroup(f"trajectory/{name}", {"poses": "camera-to-world", "frames": len(estimate)})
    if truth is None:
        group.refuse(KEYS, "the sequence has no ground-truth trajectory")
        return group, None
    error = _add_ate(group, estimate, truth)
    scale = _add_sim3(group, estimate, truth)
    _add_rpe(group, estimate, truth, 1.0 if has_metric_scale else scale, rpe_delta_frames)
    return group, error


def coverage_group(trajectories: Trajectories) -> MetricGroup:
    """Return `trajectory`: frames lost, and the share of the sequence that has a pose which was tracked."""
    processed = len(trajectories.final)
    total = processed if trajectories.sequence_frames is None else trajectories.sequence_frames
    group = MetricGroup(
        "trajectory",
        {
            "frames": processed,
            "sequence_frames": total,
            "lost": "tracking failed, the predicted pose was kept",
            "lost_percent": "of the frames that were processed",
            "coverage": "frames with a pose that were not lost, of all frames of the sequence",
            "recognised": "tracking failed, the frame was recognised and tracked from there: not counted as lost",
            "held_out_frames": len(trajectories.held_out),
        },
    )
    if trajectories.is_lost is None:
        group.refuse(("lost_frames", "lost_percent", "coverage_percent"), "no lost mask was given")
        return group
    lost = int(trajectories.is_lost.sum())
    tracked = int((is_finite(trajectories.final) & ~trajectories.is_lost).sum())
    group.add("lost_frames", lost)
    if trajectories.num_recognised is not None:
        group.add("recognised_frames", trajectories.num_recognised)
    for key, part, whole in (("lost_percent", lost, processed), ("coverage_percent", tracked, total)):
        group.add(key, 100 * part / whole if whole else float("nan"), "there are no frames")
    return group


def _add_rpe(group: MetricGroup, estimate: Poses, truth: AnyPoses, scale: float | None, delta_frames: int) -> None:
    try:
        if scale is None:
            raise EvaluationError("the estimate has no metric scale and no Sim(3) alignment gives one")
        rpe = relative_pose_error(estimate, truth, delta_frames, scale)
    except EvaluationError as error:
        group.refuse(RPE_KEYS, str(error))
        return
    group.add("rpe_translation_rmse_cm", rpe.translation_rmse_cm)
    group.add("rpe_rotation_rmse_deg", rpe.rotation_rmse_deg)
    group.protocol |= {"rpe_delta_frames": rpe.delta_frames, "rpe_pairs": rpe.pairs, "rpe_scale": rpe.scale}


def _add_ate(group: MetricGroup, estimate: Poses, truth: AnyPoses) -> TrajectoryError | None:
    try:
        ate = absolute_trajectory_error(estimate, truth, "se3")
    except EvaluationError as error:
        group.refuse(ATE_KEYS, str(error))
        return None
    for key in ATE_STATISTICS:
        group.add(f"ate_{key}", getattr(ate, key))
    group.protocol |= {
        "ate": "distances of camera centres; rmse is the root of the mean square",
        "ate_alignment": "SE(3), Umeyama 1991, estimate onto ground truth, over all matched frames",
        "ate_sim3_alignment": "Sim(3), the same with one scale",
        "is_alignment_rotation_unique": ate.alignment.is_unique,
        "matched_frames": ate.matched,
        "matched_percent_of_ground_truth": _percent(ate.matched, truth),
        "frames_without_ground_truth": ate.missing_ground_truth,
        "frames_without_estimate": ate.missing_estimate,
    }
    return ate


def _add_sim3(group: MetricGroup, estimate: Poses, truth: AnyPoses) -> float | None:
    """Add the ATE up to scale; return that scale (true per estimated metre)."""
    try:
        ate = absolute_trajectory_error(estimate, truth, "sim3")
    except EvaluationError as error:
        group.refuse(("ate_sim3_rmse_cm",), str(error))
        return None
    group.add("ate_sim3_rmse_cm", ate.rmse_cm)
    group.protocol["ate_sim3_scale"] = ate.alignment.scale
    return ate.alignment.scale


def _percent(matched: int, truth: AnyPoses) -> float:
    return 100 * matched / int(np.isfinite(truth).all((1, 2)).sum())
