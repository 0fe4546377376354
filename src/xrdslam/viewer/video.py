"""A finished run as a video: the map from outside with the path growing in it, beside it input and rendering."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from xrdslam.core.errors import RunError
from xrdslam.core.files import replaced
from xrdslam.pictures.outside import Drawing
from xrdslam.pictures.palette import ERROR, coloured
from xrdslam.viewer.recorded import Recorded

__all__ = ["Film", "write_video"]

Picture = UInt8[np.ndarray, "_ _ 3"]

SIZE = (1280, 720)
COLUMN = 400
"""The width of input and rendering [px]."""
MARGIN, STRIP = 16, 48
BACKGROUND, INK, TRUTH, HERE = (24, 27, 31), (231, 233, 234), (150, 156, 166), (255, 255, 255)
MOST_FRAMES = 1800
"""A minute at thirty a second; of more, every n-th is shown."""
FONT = cv2.FONT_HERSHEY_SIMPLEX


def write_video(recorded: Recorded, path: Path, frames_per_second: float = 20.0) -> int:
    """Write an MP4 and return how many frames it has; RunError where OpenCV here cannot."""
    rows = range(0, len(recorded.run.indices), -(-len(recorded.run.indices) // MOST_FRAMES))
    film = Film(recorded)
    with replaced(path.with_suffix(".mp4") if path.suffix == "" else path) as temporary:
        target = temporary.with_suffix(".mp4")  # OpenCV tells the container by the name
        writer = cv2.VideoWriter(str(target), cv2.VideoWriter.fourcc(*"mp4v"), frames_per_second, SIZE)
        try:
            if not writer.isOpened():
                raise RunError(
                    f"--video {path}: OpenCV cannot write MP4 here; install opencv-python-headless from PyPI"
                )
            for row in rows:
                writer.write(film.picture(row)[..., ::-1].copy())
        finally:
            writer.release()
            if target.is_file():
                target.replace(temporary)
    return len(rows)


class Film:
    """Draws the frames of a video; the map is drawn once, the path anew."""

    def __init__(self, recorded: Recorded) -> None:
        """Draw the map on the left of an empty frame."""
        self.recorded = recorded
        self._size = SIZE[0] - COLUMN - 2 * MARGIN, SIZE[1] - STRIP - MARGIN
        width, height = self._size
        self._view = recorded.view(width / height)
        self._still = np.empty((SIZE[1], SIZE[0], 3), np.uint8)
        self._still[:] = BACKGROUND
        map_picture = Drawing(recorded.surface, self._view, self._size).picture(BACKGROUND)
        self._still[STRIP : STRIP + height, :width] = map_picture
        if recorded.truth is not None:
            _lines(self._still, self._pixels(recorded.truth), np.tile(TRUTH, (len(recorded.truth), 1)), 2)
        self._path = self._pixels(recorded.centres)
        errors = recorded.errors_cm
        worst = 1.0 if errors is None or not np.isfinite(errors).any() else float(np.nanmax(errors))
        shown = np.zeros(len(self._path)) if errors is None else errors
        self._colours = coloured(shown, ERROR, 0.0, max(worst, 1e-6))

    def picture(self, row: int) -> Picture:
        """Return the frame of a row: the truth in grey, the path so far in the colours of its error."""
        image = self._still.copy()
        _lines(image, self._path[: row + 1], self._colours[: row + 1], 3)
        if np.isfinite(self._path[row]).all():
            cv2.circle(image, _point(self._path[row]), 6, HERE, 2, cv2.LINE_AA)
        panels = self.recorded.panels_at(row)
        if panels is not None:
            _place(image, panels.rgb, f"input, frame {panels.index}", 0)
            _place(image, panels.rendered_rgb, f"rendering, frame {panels.index}", 1)
        _write(image, f"{self.recorded.run.title}   {self.recorded.caption(row)}", (MARGIN, 31), 0.62, INK)
        done = (row + 1) / len(self.recorded.run.indices)
        cv2.rectangle(image, (0, SIZE[1] - 4), (round(SIZE[0] * done), SIZE[1]), (63, 184, 176), -1)
        return image

    def _pixels(self, centres: np.ndarray) -> np.ndarray:
        pixels: np.ndarray = self._view.pixels(centres, *self._size) + np.array([0, STRIP])
        return pixels


def _lines(image: Picture, pixels: np.ndarray, colours: np.ndarray, thickness: int) -> None:
    for a, b, colour in zip(pixels[:-1], pixels[1:], colours[1:], strict=True):
        if np.isfinite(a).all() and np.isfinite(b).all():
            cv2.line(image, _point(a), _point(b), tuple(int(c) for c in colour), thickness, cv2.LINE_AA)


def _place(image: Picture, rgb: Picture, title: str, place: int) -> None:
    """Put a picture into a half of the right column."""
    half = (SIZE[1] - STRIP - MARGIN) // 2
    scale = min(COLUMN / rgb.shape[1], (half - 30) / rgb.shape[0])
    size = (round(rgb.shape[1] * scale), round(rgb.shape[0] * scale))
    left, top = SIZE[0] - MARGIN - COLUMN, STRIP + place * half
    image[top + 22 : top + 22 + size[1], left : left + size[0]] = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    _write(image, title, (left, top + 14), 0.5, INK)


def _write(image: Picture, text: str, at: tuple[int, int], size: float, colour: tuple[int, int, int]) -> None:
    cv2.putText(image, text, at, FONT, size, colour, 1, cv2.LINE_AA)


def _point(pixel: np.ndarray) -> tuple[int, int]:
    return int(np.clip(pixel[0], -9999, 9999)), int(np.clip(pixel[1], -9999, 9999))
