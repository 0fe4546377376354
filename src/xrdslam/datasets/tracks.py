"""A trajectory that was recorded beside the images: poses at times of their own, asked for at any other."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation, Slerp

from xrdslam.core.errors import DataError
from xrdslam.datasets.poses import quaternion_pose, read_pose_lines
from xrdslam.datasets.times import NS_PER_S, nanoseconds

__all__ = ["Track", "read_track", "read_tum_track"]


class Track:
    """Poses in time order, interpolated: positions on the line, orientations on the great circle (slerp)."""

    def __init__(self, timestamps_ns: Sequence[int], poses: Float64[np.ndarray, "n 4 4"]) -> None:
        """Take T_world_body (or of a camera) at each time, in any order; of a time that comes twice, the first."""
        self.timestamps_ns, first = np.unique(np.asarray(timestamps_ns, dtype=np.int64), return_index=True)
        self.poses = poses[first]

    def __len__(self) -> int:
        return len(self.timestamps_ns)

    def at(self, timestamp_ns: int, tolerance_ns: int) -> Float64[np.ndarray, "4 4"]:
        """Return the pose at a time, all NaN where it is unknown.

        Known is what lies between two poses that are both at most `tolerance_ns` away, or within a tenth of that from
        one of them (a sequence's first and last frames are often a moment outside).
        """
        place = int(np.searchsorted(self.timestamps_ns, timestamp_ns))
        after = min(place, len(self) - 1)
        before = after if len(self) and self.timestamps_ns[after] == timestamp_ns else max(place - 1, 0)
        if len(self) == 0:
            return np.full((4, 4), np.nan)
        gaps = [abs(int(self.timestamps_ns[i]) - timestamp_ns) for i in (before, after)]
        if before != after and max(gaps) <= tolerance_ns:
            return self._between(before, after, timestamp_ns)
        near = (before, after)[int(np.argmin(gaps))]
        return self.poses[near].copy() if min(gaps) <= tolerance_ns // 10 else np.full((4, 4), np.nan)

    def _between(self, before: int, after: int, timestamp_ns: int) -> Float64[np.ndarray, "4 4"]:
        start, end = int(self.timestamps_ns[before]), int(self.timestamps_ns[after])
        share = (timestamp_ns - start) / (end - start)
        ends = self.poses[[before, after]]
        pose = np.eye(4)
        pose[:3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix(ends[:, :3, :3]))(share).as_matrix()
        pose[:3, 3] = (1 - share) * ends[0, :3, 3] + share * ends[1, :3, 3]
        return pose


def read_tum_track(path: Path) -> tuple[Track, list[str]]:
    """Read lines of `time [s] tx ty tz qx qy qz qw`, camera (or body) to world; and what is wrong with which line."""
    lines = ((text.replace(",", " ").split(), source) for text, source in read_pose_lines(path))
    return read_track(lines, "xyzw")


def read_track(
    lines: Iterable[tuple[Sequence[str], str]], order: Literal["xyzw", "wxyz"], unit: int = NS_PER_S
) -> tuple[Track, list[str]]:
    """Parse the words of lines: time in units of `unit` ns, tx ty tz, a quaternion in `order`, and ignored words."""
    poses: dict[int, np.ndarray] = {}
    faults = []
    for words, source in lines:
        try:
            if len(words) < 8:
                raise DataError(
                    f"{source}: a line is a time, tx ty tz and a quaternion, found {len(words)} numbers;"
                    " complete the line, or remove it"
                )
            time_ns = nanoseconds(words[0], source, unit)
            pose = quaternion_pose(words[1:8], source, order)
        except DataError as error:
            faults.append(str(error))
            continue
        if time_ns in poses:
            faults.append(f"{source}: the time {words[0]} stands there twice; remove one of its lines")
        poses.setdefault(time_ns, pose)
    return Track(list(poses), np.array(list(poses.values())).reshape(-1, 4, 4)), faults
