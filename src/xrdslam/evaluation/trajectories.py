"""The poses of a run, row by row of the same frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool
from numpy.typing import NDArray

from xrdslam.evaluation.errors import EvaluationError
from xrdslam.evaluation.trajectory import AnyPoses

__all__ = ["Trajectories"]


@dataclass(frozen=True, eq=False)
class Trajectories:
    """The poses of a run, T_world_camera, row by row of the same frames; a missing pose is a row of NaN."""

    online: AnyPoses
    """As first reported."""
    final: AnyPoses
    """As believed after the last frame."""
    ground_truth: AnyPoses | None = None
    is_lost: Bool[NDArray[np.bool_], " _"] | None = None
    """Frames that kept a predicted pose because tracking failed."""
    num_recognised: int | None = None
    """Frames that were lost and recognised at once."""
    indices: Sequence[int] | None = None
    """The frame index of each row; None: row i is frame i."""
    has_metric_scale: bool = True
    """False for monocular estimates: RPE translations then use the scale of the Sim(3) alignment."""
    is_held_out: Bool[NDArray[np.bool_], " _"] | None = None
    """Frames that were kept from the mapper."""
    sequence_frames: int | None = None
    """How many frames the sequence has, those that were skipped or never reached among them."""

    def __post_init__(self) -> None:
        """Refuse rows that do not belong together."""
        optional = {
            "ground_truth": self.ground_truth,
            "is_lost": self.is_lost,
            "indices": self.indices,
            "is_held_out": self.is_held_out,
        }
        rows = {"online": len(self.online), "final": len(self.final)}
        rows |= {name: len(value) for name, value in optional.items() if value is not None}
        if len(set(rows.values())) > 1:
            raise EvaluationError(f"trajectories of one run need a row for each frame, found {rows}; fill with NaN")

    @cached_property
    def rows(self) -> dict[int, int]:
        """The row of each frame index."""
        indices = range(len(self.final)) if self.indices is None else self.indices
        return {int(index): row for row, index in enumerate(indices)}

    @cached_property
    def held_out(self) -> frozenset[int]:
        """The indices of the frames that were kept from the mapper."""
        if self.is_held_out is None:
            return frozenset()
        return frozenset(index for index, row in self.rows.items() if self.is_held_out[row])
