"""A sequence of frames."""

import logging
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import torch.utils.data
from jaxtyping import Float64
from torch import Tensor

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError
from xrdslam.core.frame import Frame

__all__ = ["Dataset", "Modality"]

Modality = Literal["rgb", "depth", "imu", "stereo", "pose"]
log = logging.getLogger(__name__)


class Dataset(torch.utils.data.Dataset[Frame], ABC):
    """Frames in time order, converted on read: OpenCV camera axes, metres, rgb in [0, 1], integer nanoseconds.

    `check` finds what is missing or damaged before the first frame is processed. A frame that cannot be read raises a
    DataError naming the file; under `on_error="skip"` `frames()` warns, counts it in `num_skipped` and goes on.
    """

    on_error: Literal["raise", "skip"] = "raise"
    num_skipped: int = 0

    @property
    @abstractmethod
    def name(self) -> str:
        """`<family>/<scene>`, as on the command line."""

    @property
    @abstractmethod
    def camera(self) -> Camera:
        """The camera of every frame, after resizing and cropping."""

    @property
    @abstractmethod
    def modalities(self) -> frozenset[Modality]:
        """What every frame carries; "pose" is ground truth."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def __getitem__(self, index: int) -> Frame: ...

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()

    def check(self) -> None:
        """Raise a DataError for anything missing or damaged that can be found without decoding every image."""
        if len(self) == 0:
            raise DataError(f"dataset {self.name} has no frames; check its path and dataset.frames")

    @property
    def ground_truth_mesh(self) -> Path | None:
        """A mesh of the scene in the ground truth's world, where there is one."""
        return None

    @property
    def bounds(self) -> Float64[Tensor, "2 3"] | None:
        """The corners (min, max) of the scene [m] where the data states them; else algorithms look in the depth."""
        return None

    def frames(self, start: int = 0) -> Iterator[Frame]:
        """Yield every frame in order, from the one at `start` on, following `on_error`."""
        self.num_skipped = 0
        for index in range(start, len(self)):
            try:
                frame = self[index]
            except DataError as error:
                if self.on_error == "raise":
                    raise
                self.num_skipped += 1
                log.warning("frame %d skipped: %s", index, error)
                continue
            yield frame
