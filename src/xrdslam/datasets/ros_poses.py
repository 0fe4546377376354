"""Where a ROS recording says the camera was: transforms between frames, odometry, poses."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

from xrdslam.core.errors import DataError
from xrdslam.datasets.times import NS_PER_S
from xrdslam.datasets.tracks import Track

__all__ = ["POSE_TYPES", "TransformTree", "pose_of", "rigid", "track_of"]

POSE_TYPES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)


class TransformTree:
    """Frames and where each sits in its parent, for ever or at times."""

    def __init__(self, messages: Iterable[tuple[Any, bool]]) -> None:
        """Take TFMessages, and of each whether it holds for ever."""
        samples: dict[str, dict[int, np.ndarray]] = defaultdict(dict)
        self.parents: dict[str, str] = {}
        self._fixed: dict[str, np.ndarray] = {}
        for message, is_fixed in messages:
            for stamped in message.transforms:
                child = stamped.child_frame_id.lstrip("/")
                self.parents[child] = stamped.header.frame_id.lstrip("/")
                T_parent_child = rigid(stamped.transform.translation, stamped.transform.rotation)
                if is_fixed:
                    self._fixed[child] = T_parent_child
                else:
                    samples[child][stamp_ns(stamped.header)] = T_parent_child
        self._tracks = {child: Track(list(at), np.stack(list(at.values()))) for child, at in samples.items()}

    def chain(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on to the root."""
        frames = [frame.lstrip("/")]
        while (parent := self.parents.get(frames[-1])) is not None and parent not in frames:
            frames.append(parent)
        return frames

    def moves(self, frame: str) -> bool:
        """Say whether a frame was seen at different places in its root."""
        return any(link in self._tracks and len(self._tracks[link]) > 1 for link in self.chain(frame)[:-1])

    def fixed(self, ancestor: str, frame: str) -> Float64[np.ndarray, "4 4"] | None:
        """Return T_ancestor_frame where fixed transforms lead from one to the other, either way."""
        ancestor, frame = ancestor.lstrip("/"), frame.lstrip("/")
        up, down = self.chain(frame), self.chain(ancestor)
        meeting = next((link for link in up if link in down), None)
        links = [*up[: up.index(meeting)], *down[: down.index(meeting)]] if meeting is not None else [""]
        if not all(link in self._fixed for link in links):
            return None
        return np.asarray(np.linalg.inv(self._product(down, meeting)) @ self._product(up, meeting))

    def at(self, root: str, frame: str, timestamp_ns: int, tolerance_ns: int) -> Float64[np.ndarray, "4 4"]:
        """Return T_root_frame at a time, NaN where it is unknown."""
        chain = self.chain(frame)
        T = np.eye(4)
        for link in chain[: chain.index(root.lstrip("/"))]:
            known = self._fixed.get(link)
            T = (self._tracks[link].at(timestamp_ns, tolerance_ns) if known is None else known) @ T
        return T

    def _product(self, chain: list[str], ancestor: str | None) -> np.ndarray:
        """Return T_ancestor_first of fixed links."""
        T = np.eye(4)
        for link in chain[: chain.index(ancestor or "")]:
            T = self._fixed[link] @ T
        return T


def pose_of(message: Any) -> tuple[int, np.ndarray, str]:  # noqa: ANN401  # classes made at run time
    """Return the time [ns], T_world_child and the child's name (empty where the message has none)."""
    child = getattr(message, "child_frame_id", "")
    if hasattr(message, "transform"):
        return stamp_ns(message.header), rigid(message.transform.translation, message.transform.rotation), child
    pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
    return stamp_ns(message.header), rigid(pose.position, pose.orientation), child


def stamp_ns(header: Any) -> int:  # noqa: ANN401
    """Return the time of a header."""
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)


def rigid(position: Any, orientation: Any) -> Float64[np.ndarray, "4 4"]:  # noqa: ANN401
    """Return the rigid motion of a Vector3 or Point and a Quaternion; all NaN where it is none."""
    quat_xyzw = np.array([orientation.x, orientation.y, orientation.z, orientation.w])
    translation = np.array([position.x, position.y, position.z])
    T = np.eye(4)
    if not (np.isfinite(quat_xyzw).all() and np.isfinite(translation).all() and np.linalg.norm(quat_xyzw) > 1e-6):
        return np.full((4, 4), np.nan)
    T[:3, :3] = Rotation.from_quat(quat_xyzw).as_matrix()
    T[:3, 3] = translation
    return T


def track_of(poses: Iterator[tuple[int, np.ndarray, str]], source: str) -> tuple[Track, str]:
    """Return the poses of a topic over time and the frame that they are of."""
    found = list(poses)
    if not found:
        raise DataError(f"{source}: has no message; choose another dataset.pose_topic, or none")
    return Track([time for time, _, _ in found], np.stack([T for _, T, _ in found])), found[0][2]
