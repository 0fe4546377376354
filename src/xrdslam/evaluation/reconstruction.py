"""How near a reconstructed surface is to the true one, and how much of it is there.

Both surfaces are sampled evenly over their area (never at their vertices, which are dense where a mesh is fine), and
samples are kept that count under a culling protocol. What was never seen counts neither against a map nor for it; what
was seen and is missing counts against its completion.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from xrdslam.core.surface import TriangleMesh
from xrdslam.evaluation.alignment import Alignment
from xrdslam.evaluation.culling import Seen
from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.metrics import MetricGroup

__all__ = ["DENSITY", "MEASURES", "ReconstructionError", "compare_surfaces", "moved", "sampled", "seen_samples"]

Points = Float[NDArray[np.float64], "n 3"]
MEASURES = (
    "accuracy_cm",
    "completion_cm",
    "completion_ratio_5cm_percent",
    *(f"{name}_{cm}cm_percent" for cm in (1, 5) for name in ("precision", "recall", "f_score")),
)
DENSITY = 5
"""Samples measured to, for each one that is measured from: two equal surfaces of 2000 samples a square metre would lie
1.1 cm apart (half the root of the area of a sample), with five times as many 0.5 cm."""
_ROUNDS = 12
"""Drawings of samples before the number asked for is given up: much of a large surface may never have been seen."""


@dataclass(frozen=True, eq=False)
class ReconstructionError:
    """Distances between the samples of two surfaces [m]."""

    to_truth_m: Float[NDArray[np.float64], " n"]
    """Of each sample of the estimate to the nearest of the truth."""
    to_estimate_m: Float[NDArray[np.float64], " m"]

    def add_to(self, group: MetricGroup) -> None:
        """Add every measure; F is the harmonic mean of precision and recall (Knapitsch et al., 2017)."""
        group.add("accuracy_cm", 100 * float(self.to_truth_m.mean()))
        group.add("completion_cm", 100 * float(self.to_estimate_m.mean()))
        group.add("completion_ratio_5cm_percent", _percent(self.to_estimate_m, 0.05))
        for cm in (1, 5):
            precision, recall = _percent(self.to_truth_m, cm / 100), _percent(self.to_estimate_m, cm / 100)
            both = precision + recall
            group.add(f"precision_{cm}cm_percent", precision)
            group.add(f"recall_{cm}cm_percent", recall)
            group.add(f"f_score_{cm}cm_percent", 2 * precision * recall / both if both else 0.0)


def compare_surfaces(
    estimate: TriangleMesh,
    truth: TriangleMesh,
    seen: Seen,
    num_samples: int,
    seed: int = 0,
) -> ReconstructionError:
    """Sample what counts of both surfaces; measure `num_samples` of each to the nearest of `DENSITY` times as many.

    Both are in the world of the ground truth. EvaluationError where a surface is empty or nothing of it was seen.
    """
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    dense = DENSITY * num_samples
    found = seen_samples(estimate, seen, dense, rng, "the reconstructed surface")
    true = seen_samples(truth, seen, dense, rng, "the ground-truth surface")
    to_truth, _ = cKDTree(true).query(found[:num_samples], workers=-1)
    to_estimate, _ = cKDTree(found).query(true[:num_samples], workers=-1)
    return ReconstructionError(to_truth, to_estimate)


def moved(mesh: TriangleMesh, alignment: Alignment) -> TriangleMesh:
    """Return a mesh in the frame that it is aligned to, its scale included."""
    return TriangleMesh(alignment.apply(mesh.vertices.astype(np.float64)), mesh.faces)


def sampled(mesh: TriangleMesh, count: int, rng: np.random.Generator) -> Points:
    """Draw points evenly over the area of a mesh [m]."""
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    if not np.isfinite(corners).all():
        raise EvaluationError("the mesh has vertices that are not finite")
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    if not len(areas) or not areas.sum() > 0:
        raise EvaluationError("the mesh has no area")
    drawn = np.searchsorted(np.cumsum(areas), rng.random(count) * areas.sum(), side="right").clip(0, len(areas) - 1)
    u, v = rng.random((2, count))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u)[:, None], np.where(flip, 1 - v, v)[:, None]
    points: np.ndarray = a[drawn] + u * (b - a)[drawn] + v * (c - a)[drawn]
    return points


def seen_samples(mesh: TriangleMesh, seen: Seen, count: int, rng: np.random.Generator, name: str) -> Points:
    """Draw up to `count` points of a surface that count; fewer where much of it was never seen."""
    kept: list[np.ndarray] = []
    total = 0
    for _ in range(_ROUNDS):
        points = sampled(mesh, count, rng)
        kept.append(points[seen(points)])
        total += len(kept[-1])
        if total >= count:
            break
    if total == 0:
        raise EvaluationError(f"no frame saw any of {name}; are both in the same world?")
    return np.concatenate(kept)[:count]


def _percent(distances_m: np.ndarray, threshold_m: float) -> float:
    return 100 * float((distances_m < threshold_m).mean())
