"""A video file: monocular, with intrinsics from the command line or from a file beside it.

    <path>.mp4 (or .mov, .avi, .mkv, ...)
    <path>.txt, .json or .yaml beside it, or K.txt, intrinsics.json, ... in its folder: see `cameras`

Frames are decoded in order, so that frame n is the n-th there is; going back begins again. Time is counted by the
file's frame rate, else by `dataset.fps`.
"""

import logging
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.datasets.cameras import CAMERA_FILES, read_camera
from xrdslam.datasets.config import VideoConfig
from xrdslam.datasets.folders import recording
from xrdslam.datasets.images import COPY_AGAIN, UNIT_LEVELS
from xrdslam.datasets.sequence import Record, RgbdSequence
from xrdslam.datasets.source import Lens, stated_lens
from xrdslam.datasets.times import NS_PER_S

__all__ = ["VideoDataset"]

log = logging.getLogger(__name__)


class VideoDataset(RgbdSequence):
    """The frames of a video."""

    def __init__(self, config: VideoConfig) -> None:
        """Open the file and count its frames."""
        self.file = recording(config, "the video file")
        self._decoder = _Decoder(self.file)
        lens = _lens(config, self.file, self._decoder.size)
        fps = self._decoder.fps or config.fps
        self._numbers = {self._label(n): n for n in range(self._decoder.count)}
        records = [Record(round(n * NS_PER_S / fps), path) for path, n in self._numbers.items()]
        source = lens.source(self._decoder.size, config, depth_scale=1.0)
        super().__init__(config, f"{config.family}/{self.file.stem}", records, source)

    def check(self) -> None:
        """Decode the last picked frame: a file that was cut ends before it."""
        super().check()
        self.read_rgb(self.records[-1].rgb)

    def probe_rgb(self, path: Path) -> tuple[int, int]:
        """Return the size of every frame."""
        return self._decoder.size

    def read_rgb(self, path: Path) -> np.ndarray:
        """Decode a frame."""
        bgr = self._decoder.read(self._numbers[path])
        return np.asarray(cv2.LUT(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), UNIT_LEVELS), dtype=np.float32)

    def _label(self, number: int) -> Path:
        return self.file / f"frame {number}"  # how messages call it; there is no such file


class _Decoder:
    """Decodes frames by number, forward; it can be pickled, and opens the file again where it arrives."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._next = 0
        capture = self._open()
        self.size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        fps = float(capture.get(cv2.CAP_PROP_FPS))
        self.fps = fps if 0 < fps < 1000 else 0.0
        stated = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        self.count = stated if stated > 0 else self._counted(capture)
        self._capture: Any = None
        if min(self.size) < 1 or self.count < 1:
            raise DataError(f"{path}: a video of {self.count} frames of {self.size} px; {COPY_AGAIN}")

    def read(self, number: int) -> np.ndarray:
        """Decode a frame (BGR, 8 bits)."""
        if self._capture is None or number < self._next:
            self._capture, self._next = self._open(), 0
        while self._next < number:
            if not self._capture.grab():
                raise self._ended(number)
            self._next += 1
        is_read, bgr = self._capture.read()
        if not is_read:
            raise self._ended(number)
        self._next += 1
        return np.asarray(bgr)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_capture": None}

    def _open(self) -> Any:  # noqa: ANN401  # OpenCV ships no types
        if not self.path.is_file():
            raise DataError(f"{self.path}: not a file, but a video is looked for")
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise DataError(
                f"{self.path}: not a video that OpenCV can decode, or one that was cut; copy it again, or convert it,"
                " such as with `ffmpeg -i in -c:v libx264 out.mp4`"
            )
        return capture

    def _counted(self, capture: Any) -> int:  # noqa: ANN401
        count = 0
        while capture.grab():
            count += 1
        return count

    def _ended(self, number: int) -> DataError:
        at, self._capture = self._next, None
        return DataError(
            f"{self.path}: frame {number} of {self.count} cannot be decoded, the file ends or is damaged at frame {at};"
            f" copy it again, or stop before with dataset.frames=[0,{at},1]"
        )


def _lens(config: VideoConfig, path: Path, size: tuple[int, int]) -> Lens:
    """Return the lens that is set, else that of a file beside the video."""
    places = [
        *(path.with_suffix(s) for s in (".txt", ".json", ".yaml")),
        *(path.parent / name for name in CAMERA_FILES),
    ]
    found = next((place for place in places if place.is_file()), None) if config.intrinsics is None else None
    known = None if found is None else read_camera(found).lens
    lens = stated_lens(config, known, str(found))
    if lens is None:
        focal = round(0.8 * max(size))
        raise DataError(
            f"{path}: which camera? Set dataset.intrinsics=[fx,fy,cx,cy] in pixels of the {size[0]}x{size[1]} px"
            f" images, or put them into {path.with_suffix('.txt').name} beside it. A first guess for a phone's main"
            f" camera is [{focal},{focal},{(size[0] - 1) / 2:g},{(size[1] - 1) / 2:g}]"
        )
    return lens
