"""How far an estimated trajectory is from the true one: absolute (ATE) and relative (RPE) errors.

Poses are T_world_camera; positions are camera centres (the last column), never the translation of the inverse.
Row i of both arrays is the same frame. Rows with a non-finite number are left out and counted.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import NDArray

from xrdslam.evaluation.alignment import Alignment, umeyama
from xrdslam.evaluation.errors import EvaluationError

__all__ = [
    "AlignmentKind",
    "AnyPoses",
    "Poses",
    "RelativePoseError",
    "TrajectoryError",
    "absolute_trajectory_error",
    "is_finite",
    "relative_pose_error",
]

AlignmentKind = Literal["se3", "sim3", "none"]
Poses = Float64[NDArray[np.float64], "n 4 4"]
AnyPoses = Float64[NDArray[np.float64], "_ 4 4"]  # of any length: a mismatch is refused in words
Errors = Float64[NDArray[np.float64], " n"]


@dataclass(frozen=True, eq=False)
class TrajectoryError:
    """Distances [cm] between matched camera centres after the alignment of the estimate to the ground truth."""

    rmse_cm: float
    mean_cm: float
    median_cm: float
    max_cm: float
    std_cm: float
    errors_cm: Errors
    """One for each frame; NaN where either pose is missing."""
    alignment: Alignment
    alignment_kind: AlignmentKind
    matched: int
    missing_ground_truth: int
    missing_estimate: int
    """Frames that have a true pose and no finite estimate: they are in no average, so say how many."""


@dataclass(frozen=True)
class RelativePoseError:
    """Root mean squares of the error of the motion over `delta_frames`, over all pairs (i, i + delta)."""

    translation_rmse_cm: float
    rotation_rmse_deg: float
    delta_frames: int
    pairs: int
    scale: float


def is_finite(poses: Poses) -> Bool[NDArray[np.bool_], " n"]:
    """Say which poses are made of numbers."""
    return np.asarray(np.isfinite(poses).all((1, 2)))


def absolute_trajectory_error(
    estimate: Poses, ground_truth: AnyPoses, alignment: AlignmentKind = "se3"
) -> TrajectoryError:
    """Return the ATE of Sturm et al., IROS 2012: e_i = |truth_i - A estimate_i| of centres, A the best alignment."""
    has_both = _matched(estimate, ground_truth)
    matched = int(has_both.sum())
    needed = 1 if alignment == "none" else 3
    if matched < needed:
        raise EvaluationError(
            f"ATE with alignment {alignment!r} needs {needed} frames with an estimated and a true pose, "
            f"found {matched} of {len(has_both)}"
        )
    source, target = estimate[has_both, :3, 3], ground_truth[has_both, :3, 3]
    motion = Alignment.identity() if alignment == "none" else umeyama(source, target, with_scale=alignment == "sim3")
    distances_cm = 100.0 * np.linalg.norm(target - motion.apply(source), axis=1)
    errors_cm = np.full(len(has_both), np.nan)
    errors_cm[has_both] = distances_cm
    return TrajectoryError(
        rmse_cm=float(np.sqrt((distances_cm**2).mean())),
        mean_cm=float(distances_cm.mean()),
        median_cm=float(np.median(distances_cm)),
        max_cm=float(distances_cm.max()),
        std_cm=float(distances_cm.std()),
        errors_cm=errors_cm,
        alignment=motion,
        alignment_kind=alignment,
        matched=matched,
        missing_ground_truth=int((~is_finite(ground_truth)).sum()),
        missing_estimate=int((is_finite(ground_truth) & ~is_finite(estimate)).sum()),
    )


def relative_pose_error(
    estimate: Poses, ground_truth: AnyPoses, delta_frames: int = 1, scale: float = 1.0
) -> RelativePoseError:
    """Return the RPE: E_i = (Q_i^-1 Q_{i+d})^-1 (P_i^-1 P_{i+d}) of truth Q and estimate P (Sturm et al., 2012, eq. 2).

    It needs no alignment. `scale` multiplies the estimate's translations, for estimates without a metric scale.
    """
    if delta_frames < 1:
        raise EvaluationError(f"RPE over {delta_frames} frames: the distance must be at least one frame")
    has_both = _matched(estimate, ground_truth)
    starts = np.flatnonzero(has_both[:-delta_frames] & has_both[delta_frames:])
    if len(starts) == 0:
        raise EvaluationError(
            f"RPE over {delta_frames} frames needs a pair of frames that far apart with estimated and true poses, "
            f"found none among {len(has_both)} frames, {int(has_both.sum())} of them matched"
        )
    scaled = estimate.copy()
    scaled[:, :3, 3] *= scale
    motion_true, motion_estimated = (_motions(poses, starts, delta_frames) for poses in (ground_truth, scaled))
    difference = _inverse(motion_true) @ motion_estimated
    translations_cm = 100.0 * np.linalg.norm(difference[:, :3, 3], axis=1)
    angles_deg = np.degrees(_angles(difference[:, :3, :3]))
    return RelativePoseError(
        translation_rmse_cm=float(np.sqrt((translations_cm**2).mean())),
        rotation_rmse_deg=float(np.sqrt((angles_deg**2).mean())),
        delta_frames=delta_frames,
        pairs=len(starts),
        scale=scale,
    )


def _matched(estimate: Poses, ground_truth: AnyPoses) -> NDArray[np.bool_]:
    if estimate.shape != ground_truth.shape or estimate.shape[1:] != (4, 4):
        raise EvaluationError(
            f"trajectories must be (N, 4, 4) arrays of the same frames, found {estimate.shape} estimated and "
            f"{ground_truth.shape} true; fill missing poses with NaN"
        )
    return is_finite(estimate) & is_finite(ground_truth)


def _motions(T_world_camera: Poses, starts: NDArray[np.intp], delta: int) -> AnyPoses:
    return np.asarray(_inverse(T_world_camera[starts]) @ T_world_camera[starts + delta])


def _inverse(T_a_b: Poses) -> Poses:
    T_b_a = np.zeros_like(T_a_b)
    T_b_a[:, :3, :3] = T_a_b[:, :3, :3].transpose(0, 2, 1)
    T_b_a[:, :3, 3] = -np.einsum("nji,nj->ni", T_a_b[:, :3, :3], T_a_b[:, :3, 3])
    T_b_a[:, 3, 3] = 1.0
    return T_b_a


def _angles(R: Float64[NDArray[np.float64], "n 3 3"]) -> Errors:
    """Return rotation angles [rad] in [0, pi]; atan2(2 sin, 2 cos), as arccos loses half the digits near 0."""
    axis_sin = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], 1)
    return np.asarray(np.arctan2(np.linalg.norm(axis_sin, axis=1), np.trace(R, axis1=1, axis2=2) - 1.0))
