"""What frames measured and what the map rendered of them, kept as small pictures beside a run's figures.

`renders/panels/frame_000005_{input,rendering}.jpg` are colours, `..._{depth,rendered_depth}.png` depths: 16 bit
millimetres, 0 where there is none.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy.typing import NDArray

from xrdslam.core.errors import DataError
from xrdslam.core.files import write_bytes

__all__ = ["Panels", "chosen_frames", "kept_frames", "read_panels", "write_panels"]

Rgb = UInt8[np.ndarray, "h w 3"]
Depth = Float32[NDArray[np.float32], "h w"]
MOST_FRAMES, WIDTH_PX, QUALITY = 24, 480, 92
"""At most so many frames of a run are kept, not wider than this."""
MILLIMETRES = 1000.0


@dataclass(frozen=True, eq=False)
class Panels:
    """One frame's pictures."""

    index: int
    rgb: Rgb
    rendered_rgb: Rgb
    depth: Depth | None
    """Measured [m], 0 where nothing was."""
    rendered_depth: Depth


def chosen_frames(indices: Sequence[int], most: int = MOST_FRAMES) -> set[int]:
    """Return at most `most` of the indices, evenly spread, the first and the last among them."""
    ordered = sorted(indices)
    if len(ordered) <= most:
        return set(ordered)
    return {ordered[place] for place in np.linspace(0, len(ordered) - 1, most).round().astype(int)}


def write_panels(folder: Path, panels: Panels) -> None:
    """Write a frame's pictures, each whole or not at all."""
    stem = f"frame_{panels.index:06d}"
    colours = {"input": panels.rgb, "rendering": panels.rendered_rgb}
    for name, rgb in colours.items():
        bgr = _reduced(rgb, cv2.INTER_AREA)[..., ::-1]
        write_bytes(folder / f"{stem}_{name}.jpg", _encoded(".jpg", bgr, cv2.IMWRITE_JPEG_QUALITY, QUALITY))
    depths = {"depth": panels.depth, "rendered_depth": panels.rendered_depth}
    for name, depth in depths.items():
        if depth is not None:
            known = np.where(np.isfinite(depth), depth, 0)
            steps = np.clip(np.rint(MILLIMETRES * known), 0, 65535).astype(np.uint16)
            reduced = _reduced(steps, cv2.INTER_NEAREST)
            write_bytes(folder / f"{stem}_{name}.png", _encoded(".png", reduced, cv2.IMWRITE_PNG_COMPRESSION, 3))


def kept_frames(folder: Path) -> list[int]:
    """Return the frames whose pictures a folder holds."""
    names = (re.fullmatch(r"frame_(\d+)_input", path.stem) for path in folder.glob("frame_*_input.jpg"))
    return sorted(int(name[1]) for name in names if name)


def read_panels(folder: Path, index: int) -> Panels:
    """Read a frame's pictures; DataError where one is missing or damaged."""
    stem = folder / f"frame_{index:06d}"
    rgb, rendered = (_read(Path(f"{stem}_{name}.jpg"), cv2.IMREAD_COLOR)[..., ::-1] for name in ("input", "rendering"))
    measured = Path(f"{stem}_depth.png")
    return Panels(
        index,
        np.ascontiguousarray(rgb),
        np.ascontiguousarray(rendered),
        _metres(measured) if measured.is_file() else None,
        _metres(Path(f"{stem}_rendered_depth.png")),
    )


def _metres(path: Path) -> Depth:
    return np.asarray(_read(path, cv2.IMREAD_UNCHANGED).astype(np.float32) / np.float32(MILLIMETRES))


def _read(path: Path, flag: int) -> np.ndarray:
    image = cv2.imread(str(path), flag)
    if image is None:
        raise DataError(f"{path}: missing or damaged; `python -m xrdslam.report` does without when the folder is gone")
    return np.asarray(image)


def _reduced(image: np.ndarray, interpolation: int) -> np.ndarray:
    height, width = image.shape[:2]
    if width <= WIDTH_PX:
        return image
    size = (WIDTH_PX, max(1, round(height * WIDTH_PX / width)))
    return np.asarray(cv2.resize(image, size, interpolation=interpolation))


def _encoded(extension: str, image: np.ndarray, option: int, value: int) -> bytes:
    done, data = cv2.imencode(extension, np.ascontiguousarray(image), [option, value])
    assert done, f"OpenCV writes {extension}"
    return bytes(data.tobytes())
