"""The rigid or similarity motion that lays one set of points on another."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from xrdslam.evaluation.errors import EvaluationError

__all__ = ["Alignment", "umeyama"]

Points = Float64[NDArray[np.float64], "n 3"]
RANK_TOLERANCE = 1e-12  # of the product of both spreads; off-line rounding noise of float64 centres stays far below it


@dataclass(frozen=True, eq=False)
class Alignment:
    """A similarity: p_target = scale * rotation @ p_source + translation [m]."""

    scale: float
    rotation: Float64[NDArray[np.float64], "3 3"]
    translation: Float64[NDArray[np.float64], "3"]
    is_unique: bool = True
    """False where the points fix no single rotation (on one line, or standing still): the residual is still least."""

    @classmethod
    def identity(cls) -> "Alignment":
        """Return the alignment that moves nothing."""
        return cls(1.0, np.eye(3), np.zeros(3))

    def apply(self, points: Points) -> Points:
        """Move source points [m] into the target's frame."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def apply_to_poses(
        self, T_source_camera: Float64[NDArray[np.float64], "n 4 4"]
    ) -> Float64[NDArray[np.float64], "n 4 4"]:
        """Move camera poses into the target's frame: the scale acts on centres, orientations stay rotations."""
        T_target_camera = T_source_camera.copy()
        T_target_camera[:, :3, :3] = self.rotation @ T_source_camera[:, :3, :3]
        T_target_camera[:, :3, 3] = self.apply(T_source_camera[:, :3, 3])
        return T_target_camera


def umeyama(source: Points, target: Points, with_scale: bool) -> Alignment:
    """Return the least-squares motion of `source` onto `target`, never a reflection.

    Umeyama, PAMI 1991, equations 34-43: cov = U D V^T of the centred points, S = diag(1, 1, det(U) det(V)),
    R = U S V^T, c = tr(D S) / var(source), t = mean(target) - c R mean(source).

    Where R is not unique (d_1 + s d_2 = 0: a line, a single place) the residual is, so that the error of a straight
    drive is a number; `is_unique` tells. A scale is refused where every scale or only zero would fit.
    """
    if len(source) < 3 or source.shape != target.shape:
        raise EvaluationError(f"an alignment needs at least 3 matched points, found {source.shape} and {target.shape}")
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise EvaluationError("an alignment needs finite points; mask the others first")
    mean_source, mean_target = source.mean(0), target.mean(0)
    centred_source, centred_target = source - mean_source, target - mean_target
    var_source, var_target = (float((x**2).sum(1).mean()) for x in (centred_source, centred_target))
    U, d, Vt = np.linalg.svd(centred_target.T @ centred_source / len(source))
    S = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    rotation = (U * S) @ Vt
    spread = np.sqrt(var_source * var_target)
    is_unique = bool(d[1] + S[2] * d[2] > RANK_TOLERANCE * spread)
    scale = _scale(float((d * S).sum()), var_source, spread) if with_scale else 1.0
    return Alignment(scale, rotation, mean_target - scale * rotation @ mean_source, is_unique)


def _scale(trace: float, var_source: float, spread: float) -> float:
    if trace <= RANK_TOLERANCE * spread or var_source == 0.0:
        raise EvaluationError(
            "no scale aligns these points: one of the two trajectories stands still or they do not correlate"
        )
    return trace / var_source
