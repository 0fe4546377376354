"""Sequences of colour (and depth) image files: what every family of layouts shares.

A family finds its files, poses and camera and hands them over as records; this base picks the frames, checks their
files before the first is processed, and reads them.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float32, Float64

from xrdslam.core.camera import Camera
from xrdslam.core.dataset import Dataset, Modality
from xrdslam.core.errors import ConfigError, DataError
from xrdslam.core.frame import Frame
from xrdslam.datasets.config import DatasetConfig
from xrdslam.datasets.fit import ImageFit
from xrdslam.datasets.images import probe_depth, probe_rgb, read_depth, read_rgb

__all__ = ["Record", "RgbdSequence", "SourceCamera"]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Record:
    """One frame before it is read; `fault` says what the family has already found wrong with it."""

    timestamp_ns: int
    rgb: Path
    depth: Path | None = None
    T_world_camera: Float64[np.ndarray, "4 4"] | None = None
    fault: str | None = None


@dataclass(frozen=True)
class SourceCamera:
    """The camera of the files as they are: that of colour, the meaning of a depth level, and where both came from."""

    camera: Camera
    stated_in: str
    depth_scale: float = 1.0  # levels per metre
    invalid_depth: tuple[int, ...] = ()  # levels that mean "no measurement", beside 0
    depth_size: tuple[int, int] | None = None  # (width, height) [px] where depth files differ from colour
    rgb_size: tuple[int, int] | None = None  # (width, height) [px] where colour files differ from `camera`


class RgbdSequence(Dataset):
    """A sequence of image files.

    Under `on_error="skip"` a frame with anything wrong (its image, its depth, its pose) is left out as a whole, so that
    each frame which does come carries all the `modalities`; `dataset[i]` of such a frame still raises.
    Families whose files are no PNG or JPEG override `probe_rgb`, `probe_depth`, `read_rgb` and `read_depth`.
    """

    may_be_grey: ClassVar[bool] = False
    """Whether one channel is an image too; where it is not, it is somebody's mask or preview."""

    def __init__(
        self,
        config: DatasetConfig,
        name: str,
        records: Sequence[Record],
        source: SourceCamera,
        faults: Sequence[str] = (),
    ) -> None:
        """Take all records of a sequence, before `dataset.frames`, and the faults of the sequence as a whole."""
        self.on_error = "skip" if config.on_error == "skip" else "raise"
        self.records = _selected(records, config, name)
        self.faults = tuple(faults)
        self.source = source
        self._fit = ImageFit(
            source.camera, config.size, source.depth_size, config.max_depth, config.crop, source.rgb_size
        )
        self._name = name

    @property
    def name(self) -> str:
        """`<family>/<scene>`; with `dataset.path`, the folder's name is the scene."""
        return self._name

    @property
    def camera(self) -> Camera:
        """The camera of every frame: undistorted, cropped and resized."""
        return self._fit.camera

    @property
    def modalities(self) -> frozenset[Modality]:
        """What every sound frame carries."""
        found: set[Modality] = {"rgb"}
        sound = [record for record in self.records if record.fault is None]
        if sound and all(record.depth is not None for record in sound):
            found.add("depth")
        if sound and all(record.T_world_camera is not None for record in sound):
            found.add("pose")
        return frozenset(found)

    def __len__(self) -> int:
        """Return the number of frames that `dataset.frames` picked, damaged ones included."""
        return len(self.records)

    def __getitem__(self, index: int) -> Frame:
        """Read one frame; DataError where it is damaged. Its index counts the frames that `dataset.frames` picked."""
        record = self.records[index]
        if record.fault is not None:
            raise DataError(record.fault)
        rgb = self.read_rgb(record.rgb)
        self._hold_to_size(record.rgb, rgb.shape[1::-1], self._fit.rgb_size)
        pose = record.T_world_camera
        return Frame(
            index=range(len(self))[index],
            timestamp_ns=record.timestamp_ns,
            camera=self.camera,
            rgb=torch.from_numpy(self._fit.rgb(rgb)),
            depth=None if record.depth is None else self._read_fitted_depth(record.depth),
            T_world_camera_gt=None if pose is None else torch.from_numpy(pose.astype(np.float32)),
        )

    def check(self) -> None:
        """Look at every file of the picked frames without decoding it; raise, or warn of what will be skipped."""
        super().check()
        damaged = [fault for index in range(len(self)) if (fault := self.fault_of(index)) is not None]
        found = [*self.faults, *damaged]
        if not found:
            return
        report = found[0] + (f" (and {len(found) - 1} more in {self.name})" if len(found) > 1 else "")
        if self.on_error == "raise":
            raise DataError(report)
        if len(damaged) == len(self):
            raise DataError(f"dataset {self.name}: all {len(self)} frames are damaged, none is left; first: {report}")
        log.warning("%s: %d of %d frames will be skipped: %s", self.name, len(damaged), len(self), report)

    def fault_of(self, index: int) -> str | None:
        """Say what is wrong with a frame as far as can be seen without decoding it, or None."""
        record = self.records[index]
        if record.fault is not None:
            return record.fault
        try:
            self.probe(record)
        except DataError as error:
            return str(error)
        return None

    def probe(self, record: Record) -> None:
        """Raise a DataError for what the headers of a record's files give away."""
        self._hold_to_size(record.rgb, self.probe_rgb(record.rgb), self._fit.rgb_size)
        if record.depth is not None:
            self._hold_to_size(record.depth, self.probe_depth(record.depth), self._fit.depth_size)

    def probe_rgb(self, path: Path) -> tuple[int, int]:
        """Return the width, height [px] of a colour file without decoding it; DataError where it is damaged."""
        return probe_rgb(path, self.may_be_grey).size

    def probe_depth(self, path: Path) -> tuple[int, int]:
        """Return the width, height [px] of a depth file without decoding it; DataError where it is damaged."""
        return probe_depth(path).size

    def read_rgb(self, path: Path) -> Float32[np.ndarray, "h w 3"]:
        """Read a colour file at its own size, in [0, 1]."""
        return read_rgb(path, self.may_be_grey)

    def read_depth(self, path: Path) -> Float32[np.ndarray, "h w"]:
        """Read a depth file at its own size [m]."""
        return read_depth(path, self.source.depth_scale, self.source.invalid_depth)

    def _read_fitted_depth(self, path: Path) -> Float32[torch.Tensor, "h w"]:
        depth = self.read_depth(path)
        self._hold_to_size(path, depth.shape[::-1], self._fit.depth_size)
        return torch.from_numpy(self._fit.depth(depth))

    def _hold_to_size(self, path: Path, found: tuple[int, ...], expected: tuple[int, int]) -> None:
        if found != expected:
            raise DataError(
                f"{path}: an image of {found[0]}x{found[1]} px, but {self.source.stated_in} is for"
                f" {expected[0]}x{expected[1]} px; give the intrinsics of these images"
                " (to work at another size, set dataset.size instead)"
            )


def _selected(records: Sequence[Record], config: DatasetConfig, name: str) -> list[Record]:
    """Apply `dataset.frames` and `dataset.drop`; a stop behind the end is the end, said in the log."""
    try:
        picked = config.picked(len(records))
    except ConfigError as error:
        raise ConfigError(f"{error} of {name}") from error
    stop = config.frames[1]
    if stop is not None and stop > len(records):
        log.warning("dataset.frames=%s: %s ends after %d frames", list(config.frames), name, len(records))
    return [records[number] for number in picked]
