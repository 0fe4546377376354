"""What lays a run's world on the true one, for its surface: the path of the camera, or its first pose."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from xrdslam.evaluation.alignment import Alignment
from xrdslam.evaluation.metrics import JsonValue
from xrdslam.evaluation.trajectory import (
    AlignmentKind,
    AnyPoses,
    Poses,
    TrajectoryError,
    absolute_trajectory_error,
    is_finite,
)

__all__ = ["Spread", "SurfaceAlignment", "spread", "surface_alignment"]

STRAIGHT = 0.05
"""A path whose extent aside is less than this share of its extent along fixes no turn about its line."""
LEAST_ASIDE_M = 0.01
"""Nor does one that goes aside less than this, which is about what trackers err by."""


@dataclass(frozen=True)
class Spread:
    """How far places lie from their middle (root mean square): along the line that fits them best, and off it."""

    along_m: float
    aside_m: float

    @property
    def fixes_rotation(self) -> bool:
        """Whether a motion of these places has one rotation, whatever errors of a tracker's size lie on them."""
        return self.aside_m >= max(STRAIGHT * self.along_m, LEAST_ASIDE_M)


@dataclass(frozen=True, eq=False)
class SurfaceAlignment:
    """How a surface is laid on the true one, and by what."""

    motion: Alignment
    is_by_path: bool
    path: Spread

    def protocol(self, kind: str) -> dict[str, JsonValue]:
        """Return what is said of it beside the figures."""
        motion = "Sim(3)" if kind == "sim3" else "SE(3)"
        by_first = (
            f"the first pose's {motion}: the true path goes aside of a line by less than {100 * STRAIGHT:g} % of its "
            f"extent, or {100 * LEAST_ASIDE_M:g} cm, and fixes no rotation"
        )
        return {
            "alignment": f"the final trajectory's {motion}" if self.is_by_path else by_first,
            "alignment_scale": self.motion.scale,
            "alignment_path_along_cm": 100 * self.path.along_m,
            "alignment_path_aside_cm": 100 * self.path.aside_m,
        }


def surface_alignment(estimate: Poses, ground_truth: AnyPoses, kind: AlignmentKind = "se3") -> SurfaceAlignment:
    """Return the motion that the least error of the path asks for, unless the path fixes no rotation.

    The error of a straight path is least under many turns about its line, and noise chooses one of them: a surface far
    from the line would go anywhere. Then the first pose that both have, orientation included, lays one world on the
    other (with the path's scale, which a line does fix). The true path alone decides which, so that all methods on a
    sequence are measured alike. EvaluationError as `absolute_trajectory_error` raises it.
    """
    error: TrajectoryError = absolute_trajectory_error(estimate, ground_truth, kind)
    has_both = is_finite(estimate) & is_finite(ground_truth)
    path = spread(ground_truth[has_both, :3, 3])
    if path.fixes_rotation:
        return SurfaceAlignment(error.alignment, True, path)
    first = int(np.argmax(has_both))
    T_estimate_camera, T_true_camera, scale = estimate[first], ground_truth[first], error.alignment.scale
    rotation = T_true_camera[:3, :3] @ T_estimate_camera[:3, :3].T
    translation = T_true_camera[:3, 3] - scale * rotation @ T_estimate_camera[:3, 3]
    return SurfaceAlignment(Alignment(scale, rotation, translation), False, path)


def spread(points: Float64[NDArray[np.float64], "n 3"]) -> Spread:
    """Return the spread [m] of places along their main line and off it, from their principal axes."""
    axes = np.linalg.svd(points - points.mean(0), compute_uv=False) / np.sqrt(len(points))
    return Spread(float(axes[0]), float(np.hypot(*axes[1:3])))
