"""Trajectories from text files, and which of their poses belong together."""

from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64, Int64
from numpy.typing import NDArray

from xrdslam.core.errors import DataError
from xrdslam.core.geometry import so3
from xrdslam.evaluation.errors import EvaluationError

__all__ = ["StampedPoses", "associated", "matches", "read_tum"]

Stamps = Int64[NDArray[np.int64], " n"]
Others = Int64[NDArray[np.int64], " m"]


@dataclass(frozen=True, eq=False)
class StampedPoses:
    """Poses, T_world_camera, with their times in order."""

    timestamps_ns: Stamps
    T_world_camera: Float64[NDArray[np.float64], "n 4 4"]


def read_tum(path: Path) -> StampedPoses:
    """Read `time tx ty tz qx qy qz qw`, one pose a line, in order of time; nanoseconds stay exact.

    DataError naming the line for anything else, a quaternion that is none, and two poses of one time.
    """
    rows: dict[int, list[float]] = {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as a trajectory ({error})") from error
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            stamp, values = int(Decimal(words[0]) * 10**9), [float(word) for word in words[1:]]
        except (InvalidOperation, ValueError, OverflowError) as error:
            raise DataError(f"{path}, line {number}: not numbers: {line!r}") from error
        if len(values) != 7 or not 0.5 < np.linalg.norm(values[3:]) < 2:
            raise DataError(f"{path}, line {number}: must be `time tx ty tz qx qy qz qw`, found {line!r}")
        if stamp in rows:
            raise DataError(f"{path}, line {number}: a second pose for the time {words[0]}")
        rows[stamp] = values
    stamps = np.array(sorted(rows), dtype=np.int64)
    table = np.array([rows[stamp] for stamp in stamps.tolist()], dtype=np.float64).reshape(-1, 7)
    quats_wxyz = table[:, [6, 3, 4, 5]]
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, :3, :3] = so3.from_quat_wxyz(torch.from_numpy(quats_wxyz)).numpy()
    poses[:, :3, 3] = table[:, :3]
    return StampedPoses(stamps, poses)


def matches(first_ns: Stamps, second_ns: Others, tolerance_s: float) -> Int64[NDArray[np.int64], "k 2"]:
    """Return pairs of rows that are each other's nearest in time, at most `tolerance_s` apart. Both are sorted.

    Each pose is used once; sorting and bisection, so that hours of poses take a moment.
    """
    if not len(first_ns) or not len(second_ns):
        return np.empty((0, 2), np.int64)
    to_second, to_first = _nearest(first_ns, second_ns), _nearest(second_ns, first_ns)
    rows = np.arange(len(first_ns))
    is_mutual = to_first[to_second] == rows
    is_near = np.abs(second_ns[to_second] - first_ns) <= round(tolerance_s * 1e9)
    kept = rows[is_mutual & is_near]
    return np.stack((kept, to_second[kept]), 1)


def associated(
    estimate: StampedPoses, truth: StampedPoses, tolerance_s: float
) -> tuple[Float64[NDArray[np.float64], "n 4 4"], Float64[NDArray[np.float64], "n 4 4"]]:
    """Return rows of estimated and true poses that belong together; one without a partner stands beside NaN."""
    pairs = matches(estimate.timestamps_ns, truth.timestamps_ns, tolerance_s)
    if not len(pairs):
        raise EvaluationError(
            f"no two poses are within {tolerance_s} s: {_span(estimate)} estimated, {_span(truth)} true; "
            "are both in one clock? evaluation.max_time_difference_s allows more"
        )
    alone = [np.setdiff1d(np.arange(len(side.timestamps_ns)), pairs[:, k]) for k, side in enumerate((estimate, truth))]
    stamps = np.concatenate(
        (
            estimate.timestamps_ns[pairs[:, 0]],
            estimate.timestamps_ns[alone[0]],
            truth.timestamps_ns[alone[1]],
        )
    )
    count = len(stamps)
    found, true = (np.full((count, 4, 4), np.nan) for _ in range(2))
    both, end = len(pairs), len(pairs) + len(alone[0])
    found[:both], true[:both] = estimate.T_world_camera[pairs[:, 0]], truth.T_world_camera[pairs[:, 1]]
    found[both:end], true[end:] = estimate.T_world_camera[alone[0]], truth.T_world_camera[alone[1]]
    order = np.argsort(stamps, kind="stable")
    return found[order], true[order]


def _nearest(stamps_ns: Stamps, among_ns: Others) -> Int64[NDArray[np.int64], " n"]:
    """Return the row of `among_ns` nearest to each stamp, the earlier of two as near."""
    after = np.searchsorted(among_ns, stamps_ns).clip(1, max(1, len(among_ns) - 1))
    before = after - 1
    if len(among_ns) == 1:
        return np.zeros(len(stamps_ns), np.int64)
    is_after = among_ns[after] - stamps_ns < stamps_ns - among_ns[before]
    return np.where(is_after, after, before)


def _span(side: StampedPoses) -> str:
    if not len(side.timestamps_ns):
        return "no poses"
    first, last = 1e-9 * side.timestamps_ns[[0, -1]]
    return f"{len(side.timestamps_ns)} poses from {first:.3f} to {last:.3f} s"
