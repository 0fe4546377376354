"""Frames in shared memory: who reads a sequence writes each frame once, everybody else looks at it."""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
import torch
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.dataset import Dataset
from xrdslam.core.errors import RunError
from xrdslam.core.frame import Frame, ImuSamples, StereoView
from xrdslam.core.pose import RotationKind
from xrdslam.engine.multiprocess.memory import PlacedTensor, SharedMemory, place

__all__ = ["FrameRing", "Holder", "PlacedFrame"]

IMU = "imu."
RIGHT = "right"


class Holder(IntEnum):
    """Who may still look at a frame in the ring."""

    TRACKER = 0
    MAPPER = 1
    PARENT = 2


@dataclass(frozen=True)
class PlacedFrame:
    """Everything about a frame but its images, which lie in a slot of the ring."""

    index: int
    timestamp_ns: int
    camera: Camera
    slot: int
    turn: int
    """How often the slot had been used."""
    places: dict[str, PlacedTensor]
    kind: RotationKind
    rotation: np.ndarray
    translation: np.ndarray
    T_world_camera_gt: np.ndarray | None
    baseline_m: float | None
    """Of a rectified pair, whose right image lies in the slot too."""

    def at(self, frame: Frame) -> "PlacedFrame":
        """Return the same with the pose that a frame has now, in its very parameters."""
        rotation, translation = (p.detach().cpu().numpy() for p in (frame.pose.rotation, frame.pose.translation))
        return replace(self, rotation=rotation.copy(), translation=translation.copy())


class FrameRing:
    """Slots of one size that are used again once nobody holds them; a keyframe keeps its slot.

    Slots are as many as the sequence has frames, but only those that were used take memory: the ring is as long as the
    frames that are alive at one time. One process fills it; each holder lets go by writing a byte of its own, so
    that no lock is needed, which a process that is killed could keep.
    """

    def __init__(self, dataset: Dataset) -> None:
        pixels = dataset.camera.width * dataset.camera.height
        page = os.sysconf("SC_PAGE_SIZE")
        self._slot_size = -(-(2 * 4 * 4 * pixels + 2**20) // page) * page  # rgb and depth twice over, and the rest
        self._num_slots = len(dataset) + 8
        self._images = SharedMemory(self._num_slots * self._slot_size)
        self._table = SharedMemory(self._num_slots * 16)
        self._filled: dict[int, PlacedFrame] = {}

    @property
    def _holds(self) -> np.ndarray:
        return self._table.bytes.numpy()[: 8 * self._num_slots].reshape(-1, 8)

    @property
    def _turns(self) -> np.ndarray:
        turns: np.ndarray = self._table.bytes.numpy()[8 * self._num_slots :].view(np.int64)
        return turns

    def fill(self, frames: Iterable[Frame], holders: Iterable[Holder]) -> Iterator[Frame]:
        """Write frame after frame, and yield each as everybody else sees it; `take` says where it is."""
        held = list(holders)
        for frame in frames:
            placed = self._filled[frame.index] = self.put(frame, held)
            yield self.frame(placed)

    def take(self, index: int) -> PlacedFrame:
        """Return where a frame is that `fill` yielded in this process; once."""
        return self._filled.pop(index)

    def put(self, frame: Frame, holders: Sequence[Holder]) -> PlacedFrame:
        """Write a frame into a slot that nobody holds, and return where it is."""
        tensors = _tensors(frame)
        places, end = place(tensors)
        if end > self._slot_size:
            raise RunError(f"frame {frame.index} takes {end} bytes, larger than the dataset's camera says")
        slot = int(np.argmin(self._holds.any(1)))
        self._turns[slot] += 1  # who still looks at the slot's last frame sees that it is gone
        self._holds[slot, list(holders)] = 1
        for name, where in places.items():  # by numpy: torch would start threads for this one, which reads ahead, and
            # OpenMP that has more threads than cores no longer lets them spin: the tracker's own kernels are slower
            self._images.tensor(where, slot * self._slot_size).numpy()[...] = tensors[name].numpy()
        given = frame.T_world_camera_gt
        return PlacedFrame(
            frame.index,
            frame.timestamp_ns,
            frame.camera,
            slot,
            int(self._turns[slot]),
            places,
            frame.pose.kind,
            frame.pose.rotation.detach().cpu().numpy().copy(),
            frame.pose.translation.detach().cpu().numpy().copy(),
            None if given is None else given.detach().cpu().numpy().copy(),
            None if frame.stereo is None else frame.stereo.baseline_m,
        )

    def frame(self, placed: PlacedFrame) -> Frame:
        """Return the frame that lies at a place, its images views of the ring."""
        start = placed.slot * self._slot_size
        tensors = {name: self._images.tensor(where, start) for name, where in placed.places.items()}
        imu = {name.removeprefix(IMU): t.clone() for name, t in tensors.items() if name.startswith(IMU)}
        given = placed.T_world_camera_gt
        frame = Frame(
            placed.index,
            placed.timestamp_ns,
            placed.camera,
            tensors["rgb"],
            tensors.get("depth"),
            None if given is None else torch.from_numpy(given.copy()),
            ImuSamples(**imu) if imu else None,
            placed.kind,
            None if placed.baseline_m is None else StereoView(tensors[RIGHT], placed.baseline_m),
        )
        with torch.no_grad():
            frame.pose.rotation.copy_(torch.from_numpy(placed.rotation))
            frame.pose.translation.copy_(torch.from_numpy(placed.translation))
        return frame

    def copy(self, placed: PlacedFrame) -> Frame | None:
        """Return the frame with images of its own, for who holds nothing; None where its slot has another by now."""
        frame = self.frame(placed)
        frame.rgb, frame.depth = frame.rgb.clone(), None if frame.depth is None else frame.depth.clone()
        if frame.stereo is not None:
            frame.stereo = replace(frame.stereo, rgb=frame.stereo.rgb.clone())
        return frame if self.is_there(placed) else None

    def is_there(self, placed: PlacedFrame) -> bool:
        """Say whether the slot still has this frame; who holds nothing copies first and asks afterwards."""
        return int(self._turns[placed.slot]) == placed.turn

    def let_go(self, placed: PlacedFrame, holder: Holder) -> None:
        """Say that a holder does not look at the frame any more."""
        self._holds[placed.slot, holder] = 0


def _tensors(frame: Frame) -> dict[str, Tensor]:
    tensors: dict[str, Any] = {"rgb": frame.rgb, "depth": frame.depth}
    if frame.stereo is not None:
        tensors[RIGHT] = frame.stereo.rgb
    if frame.imu is not None:
        tensors |= {f"{IMU}{name}": value for name, value in vars(frame.imu).items()}
    return {name: tensor for name, tensor in tensors.items() if tensor is not None}
