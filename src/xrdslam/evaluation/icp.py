"""Iterative closest points: the rigid motion that lays one cloud on another, from a start that is nearly right."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xrdslam.evaluation.alignment import Alignment, umeyama
from xrdslam.evaluation.errors import EvaluationError

__all__ = ["IcpResult", "point_to_point"]

Points = Float[NDArray[np.float64], "n 3"]
Targets = Float[NDArray[np.float64], "m 3"]
_SETTLED_M = 1e-6


@dataclass(frozen=True, eq=False)
class IcpResult:
    """What was found, and how well it fits."""

    alignment: Alignment
    iterations: int
    matched_share: float
    """Of the source points, how many have a target point in reach at the end."""

    @property
    def rotation_deg(self) -> float:
        """How far it turned."""
        cosine = (np.trace(self.alignment.rotation) - 1) / 2
        return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def point_to_point(source: Points, target: Targets, reach_m: float = 0.1, iterations: int = 50) -> IcpResult:
    """Return the motion of `source` onto `target` by matching each point to its nearest within `reach_m`.

    Besl and McKay, PAMI 1992, with the reach of the published framework (10 cm). It ends when no point moves by more
    than a micrometre. EvaluationError where fewer than three points have a match.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(target)
    rotation, translation = np.eye(3), np.zeros(3)
    moved, share, done, is_settled = source, 0.0, 0, False
    while done < iterations and not is_settled:
        done += 1
        distance, nearest = tree.query(moved, distance_upper_bound=reach_m, workers=-1)
        is_matched = np.isfinite(distance)
        share = float(is_matched.mean())
        if is_matched.sum() < 3:
            raise EvaluationError(f"ICP: {is_matched.sum()} of {len(source)} points have a match within {reach_m} m")
        step = umeyama(moved[is_matched], target[nearest[is_matched]], with_scale=False)
        rotation, translation = step.rotation @ rotation, step.rotation @ translation + step.translation
        before, moved = moved, step.apply(moved)
        is_settled = float(np.linalg.norm(moved - before, axis=1).max()) < _SETTLED_M
    return IcpResult(Alignment(1.0, rotation, translation), done, share)
