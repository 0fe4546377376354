"""What is believed about where the camera was."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from xrdslam.core.geometry import se3

__all__ = ["Trajectory"]


@dataclass(slots=True)
class _Entry:
    row: int
    """Of its two poses in the tables."""
    timestamp_ns: int
    anchor: int
    is_lost: bool
    is_recognised: bool


class Trajectory:
    """The one owner of poses: T_world_camera of every frame, float64.

    `online` is what was reported when the frame was tracked, never touched again. `current` follows what mapping finds
    later: a keyframe's pose is updated itself, every other frame hangs on its keyframe by the motion between them, so
    that a bundle adjustment that moves a keyframe carries its neighbours along (Co-SLAM's relative trajectory).
    """

    def __init__(self) -> None:
        self._entries: dict[int, _Entry] = {}
        self._online = _stack([])
        self._T_anchor_frame = _stack([])  # tables with rows to spare: small tensors, one a frame, would lie scattered
        self._anchor: int | None = None

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, index: int) -> bool:
        return index in self._entries

    @property
    def indices(self) -> list[int]:
        """Frame indices in the order of tracking."""
        return list(self._entries)

    @property
    def first(self) -> int | None:
        """The index of the frame that it begins with."""
        return next(iter(self._entries), None)

    def lost(self, index: int) -> bool:
        """Say whether a frame kept a predicted pose because tracking failed."""
        return self._entries[index].is_lost

    @property
    def is_lost(self) -> Bool[Tensor, " n"]:
        """Which frames are lost."""
        return torch.tensor([entry.is_lost for entry in self._entries.values()], dtype=torch.bool)

    def recognised(self, index: int) -> bool:
        """Say whether tracking had failed and the place was recognised: a jump from the frame before, no motion."""
        return self._entries[index].is_recognised

    @property
    def is_recognised(self) -> Bool[Tensor, " n"]:
        """Which frames were recognised."""
        return torch.tensor([entry.is_recognised for entry in self._entries.values()], dtype=torch.bool)

    @property
    def timestamps_ns(self) -> Int64[Tensor, " n"]:
        """When the frames were taken."""
        return torch.tensor([entry.timestamp_ns for entry in self._entries.values()], dtype=torch.int64)

    def append(
        self,
        index: int,
        timestamp_ns: int,
        T_world_camera: Tensor,
        is_lost: bool = False,
        is_recognised: bool = False,
    ) -> None:
        """Add a tracked frame; it hangs on the latest keyframe."""
        if index in self._entries:
            raise ValueError(f"frame {index} is in the trajectory already")
        pose = _exact(T_world_camera)
        row = self._reserve(len(self._entries) + 1)
        self._online[row] = pose
        self._entries[index] = _Entry(row, timestamp_ns, index, is_lost, is_recognised)
        self._hang(index, index if self._anchor is None else self._anchor, pose)

    def make_keyframe(self, index: int) -> None:
        """Let a frame stand on its own, and later ones hang on it."""
        self._hang(index, index, self.pose(index))
        self._anchor = index

    def update(self, index: int, T_world_camera: Tensor, anchor: int | None = None) -> None:
        """Say that a frame is now believed elsewhere; `anchor` hangs it on another frame (one that left the graph)."""
        entry = self._entries[index]
        self._hang(index, entry.anchor if anchor is None else anchor, _exact(T_world_camera))

    def update_all(self, poses: Mapping[int, Tensor]) -> None:
        """Say where several frames are now believed, in any order: what others hang on is moved first."""
        for index in sorted(poses, key=lambda index: sum(1 for _ in self._chain(index))):
            self.update(index, poses[index])

    def pose(self, index: int) -> Float64[Tensor, "4 4"]:
        """Return the current belief."""
        return self._resolve(index, {}).clone()

    def online(self) -> Float64[Tensor, "n 4 4"]:
        """Return the poses as they were first reported."""
        return self._online[: len(self._entries)].clone()

    def current(self) -> Float64[Tensor, "n 4 4"]:
        """Return the poses as they are believed now; after the last frame, the final trajectory."""
        known: dict[int, Tensor] = {}
        return _stack([self._resolve(index, known) for index in self._entries])

    def _resolve(self, index: int, known: dict[int, Tensor]) -> Tensor:
        """Return a pose by way of its anchors, each worked out once; a chain may be as long as the sequence."""
        chain = []
        for link in self._chain(index):
            chain.append(link)
            if link in known:
                break
        for link in reversed(chain):
            entry = self._entries[link]
            if link not in known:
                relative = self._T_anchor_frame[entry.row]
                known[link] = relative if entry.anchor == link else known[entry.anchor] @ relative
        return known[index]

    def _chain(self, index: int) -> Iterator[int]:
        """Yield a frame, what it hangs on, what that hangs on, up to one that stands on its own."""
        yield index
        while (anchor := self._entries[index].anchor) != index:
            yield (index := anchor)

    def _hang(self, index: int, anchor: int, T_world_camera: Tensor) -> None:
        if anchor != index and index in self._chain(anchor):
            raise ValueError(f"frame {index} cannot hang on frame {anchor}, which hangs on it")
        relative = T_world_camera if anchor == index else _relative(self.pose(anchor), T_world_camera)
        entry = self._entries[index]
        self._T_anchor_frame[entry.row] = relative
        entry.anchor = anchor

    def _reserve(self, num_rows: int) -> int:
        """Make room for so many frames; return the row of the last."""
        if num_rows > len(self._online):
            room = torch.zeros(max(num_rows, 2 * len(self._online)) - len(self._online), 4, 4, dtype=torch.float64)
            self._online = torch.cat([self._online, room])
            self._T_anchor_frame = torch.cat([self._T_anchor_frame, room])
        return num_rows - 1

    def state_dict(self, indices: Collection[int] | None = None) -> dict[str, Tensor]:
        """Return everything as tensors, for checkpoints, or what is known of some frames, for another process."""
        chosen = self.indices if indices is None else list(indices)
        entries = [self._entries[index] for index in chosen]
        rows = torch.tensor([e.row for e in entries], dtype=torch.int64)
        return {
            "indices": torch.tensor(chosen, dtype=torch.int64),
            "timestamps_ns": torch.tensor([e.timestamp_ns for e in entries], dtype=torch.int64),
            "online": self._online[rows],
            "anchors": torch.tensor([e.anchor for e in entries], dtype=torch.int64),
            "T_anchor_frame": self._T_anchor_frame[rows],
            "is_lost": torch.tensor([e.is_lost for e in entries], dtype=torch.bool),
            "is_recognised": torch.tensor([e.is_recognised for e in entries], dtype=torch.bool),
            "anchor": torch.tensor(-1 if self._anchor is None else self._anchor),
        }

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned."""
        self._entries = {}
        self.merge(state)

    def merge(self, state: dict[str, Tensor]) -> None:
        """Take over what `state_dict` returned for some frames; what is known of others stays.

        Without `anchor` in it, what later frames hang on stays too.
        """
        columns = (state[key].tolist() for key in ("indices", "timestamps_ns", "anchors", "is_lost", "is_recognised"))
        rows = []
        for index, *known in zip(*columns, strict=True):
            row = self._entries[index].row if index in self._entries else self._reserve(len(self._entries) + 1)
            self._entries[index] = _Entry(row, *known)
            rows.append(row)
        self._online[rows], self._T_anchor_frame[rows] = state["online"], state["T_anchor_frame"]
        if "anchor" in state:
            self._anchor = None if int(state["anchor"]) < 0 else int(state["anchor"])


def _exact(T_world_camera: Tensor) -> Tensor:
    return T_world_camera.detach().to("cpu", torch.float64).clone()


def _relative(T_world_anchor: Tensor, T_world_frame: Tensor) -> Tensor:
    """Return T_anchor_frame with T_world_anchor T_anchor_frame = T_world_frame to float64.

    By solving, not by R^T: that is the inverse of a rotation rounded to float32 to 1e-7 only, and what a product is off
    orthonormal doubles with every link of a chain, be it of anchors or of keyframes that first hung on the one before.
    """
    rotation = T_world_anchor[:3, :3]
    columns = T_world_frame[:3].clone()
    columns[:, 3] -= T_world_anchor[:3, 3]
    relative = torch.linalg.solve(rotation, columns)
    return se3.compose(relative[:, :3], relative[:, 3])


def _stack(poses: list[Tensor]) -> Tensor:
    return torch.stack(poses) if poses else torch.empty(0, 4, 4, dtype=torch.float64)
