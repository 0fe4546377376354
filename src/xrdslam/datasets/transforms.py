"""A transforms.json, as nerfstudio, NeRFCapture, Polycam's import and instant-ngp write it.

    {"fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "p1", "p2",     the camera, here or in each frame
     "depth_unit_scale_factor": 0.001,                                 metres a level of depth
     "frames": [{"file_path": "images/1.png", "depth_file_path": "depth/1.png", "transform_matrix": 4x4}, ...]}

Poses are camera-to-world in OpenGL's axes (x right, y up, z backward) and are turned to ours. Pixel coordinates have
the centre of the first pixel at (0.5, 0.5), half a pixel from ours; a writer that has it at 0 needs
`dataset.pixel_centre=0`. Frames come in the order of their timestamps, else of their names. Intrinsics that differ from
frame to frame by up to a hundredth become their median, said in the log.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.datasets.cameras import lens_of
from xrdslam.datasets.config import TransformsConfig
from xrdslam.datasets.depth_files import probe_any_depth, read_any_depth
from xrdslam.datasets.folders import dataset_name, inside, recording
from xrdslam.datasets.images import first_size
from xrdslam.datasets.matrices import read_mapping
from xrdslam.datasets.naming import natural_key
from xrdslam.datasets.poses import rigid_pose
from xrdslam.datasets.sequence import Record, RgbdSequence
from xrdslam.datasets.source import Lens, stated_lens
from xrdslam.datasets.times import NS_PER_S

__all__ = ["TransformsDataset"]

log = logging.getLogger(__name__)

FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])
SUFFIXES = ("", ".png", ".jpg", ".jpeg")
DEPTH_KEYS = ("depth_file_path", "depth_path")
FOCAL_KEYS = ("fl_x", "fl_y")
CENTRE_KEYS = ("cx", "cy")
VARIATION = 0.01
METRES_A_LEVEL = 0.001  # nerfstudio's default

Frames = Sequence[Mapping[str, Any]]


class TransformsDataset(RgbdSequence):
    """A recording that a transforms.json describes."""

    may_be_grey: ClassVar[bool] = True

    def __init__(self, config: TransformsConfig) -> None:
        """Read the file; find the images that it names."""
        path = recording(config, "the transforms.json or its folder")
        self.file = path / "transforms.json" if path.is_dir() else path
        self.folder = self.file.parent
        values = read_mapping(self.file)
        frames = _frames(values, self.file)
        records = [_record(self.file, n, frame, config) for n, frame in enumerate(frames)]
        colour = {n: record.rgb for n, record in enumerate(records)}
        depth = next((record.depth for record in records if record.depth is not None and record.depth.is_file()), None)
        size = first_size(colour)
        lens = stated_lens(config, None, "") or _lens(values, frames, str(self.file), size, config.pixel_centre)
        scale = 1 / _metres_a_level(values, self.file)
        source = lens.source(size, config, scale, depth_size=None if depth is None else probe_any_depth(depth))
        super().__init__(config, dataset_name(config, self.folder), records, source)

    def probe_depth(self, path: Path) -> tuple[int, int]:
        """Look at the header of a PNG, NPY or EXR."""
        return probe_any_depth(path)

    def read_depth(self, path: Path) -> np.ndarray:
        """Read a PNG, NPY or EXR [m]."""
        return read_any_depth(path, self.source.depth_scale, self.source.invalid_depth)


def _frames(values: Mapping[str, Any], path: Path) -> Frames:
    """Return the frames in the order of time, else of names."""
    frames = values.get("frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise DataError(f"{path}: has no list of frames; it is written by nerfstudio, NeRFCapture, Polycam's import")
    if not all(isinstance(frame.get("file_path"), str) for frame in frames):
        raise DataError(f"{path}: a frame has no file_path; each names its image")
    stamps = [frame.get("timestamp") for frame in frames]
    if all(isinstance(stamp, int | float) and math.isfinite(stamp) for stamp in stamps) and len(set(stamps)) > 1:
        return sorted(frames, key=lambda frame: float(frame["timestamp"]))
    return sorted(frames, key=lambda frame: natural_key(frame["file_path"]))


def _record(path: Path, position: int, frame: Mapping[str, Any], config: TransformsConfig) -> Record:
    """Return one frame's record; what is wrong with it is its fault."""
    name = frame["file_path"]
    source = f"{path}, frame {name}"
    stamp = frame.get("timestamp")
    timed = isinstance(stamp, int | float) and math.isfinite(stamp)
    time_ns = round(float(stamp) * NS_PER_S) if timed and stamp else round(position * NS_PER_S / config.fps)
    rgb = path.parent / name
    try:
        inside(path.parent, name, source)
        rgb = next((rgb.with_name(rgb.name + s) for s in SUFFIXES if rgb.with_name(rgb.name + s).is_file()), rgb)
        named = next((frame[key] for key in DEPTH_KEYS if frame.get(key)), None)
        depth = None if named is None else inside(path.parent, str(named), source)
        return Record(time_ns, rgb, depth, _pose(frame.get("transform_matrix"), source))
    except DataError as error:
        return Record(time_ns, rgb, fault=str(error))


def _pose(given: object, source: str) -> np.ndarray | None:
    """Return T_world_camera in OpenCV axes; none where the frame has no pose."""
    if given is None:
        return None
    try:
        matrix = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError(f"{source}: transform_matrix is no matrix of numbers ({error}); mend it") from error
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0, 0, 1]])
    if matrix.shape != (4, 4):
        raise DataError(f"{source}: transform_matrix is {matrix.shape}, not 4x4; mend it")
    return rigid_pose(matrix, source) @ FLIP_YZ


def _lens(values: Mapping[str, Any], frames: Frames, source: str, size: tuple[int, int], pixel_centre: float) -> Lens:
    """Return the lens of the file, or the median of those of its frames."""
    if values.get("camera_model", "OPENCV") not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        raise DataError(f"{source}: camera_model {values['camera_model']}; only pinhole models: undistort the images")
    named = dict(values)
    width = float(named.get("w") or size[0])
    if "fl_x" not in named and named.get("camera_angle_x"):
        named["fl_x"] = 0.5 * width / math.tan(0.5 * float(named["camera_angle_x"]))
    elif "fl_x" not in named:
        named |= _median(frames, source)
    named.setdefault("cx", 0.5 * width)
    named.setdefault("cy", 0.5 * float(named.get("h") or size[1]))
    lens = lens_of({key: value for key, value in named.items() if "depth" not in key}, source).lens
    fx, fy, cx, cy = lens.intrinsics
    return lens._replace(intrinsics=(fx, fy, cx - pixel_centre, cy - pixel_centre))


def _median(frames: Frames, source: str) -> dict[str, float]:
    """Return one camera for frames that each state their own, refused where they differ by more than a hundredth."""
    found = {}
    for key in (*FOCAL_KEYS, *CENTRE_KEYS, "w", "h"):
        stated = [float(frame[key]) for frame in frames if isinstance(frame.get(key), int | float)]
        if not stated and key == "fl_x":
            raise DataError(f"{source}: no fl_x, neither for all frames nor in each; set dataset.intrinsics=[...]")
        if stated and len(stated) < len(frames):
            raise DataError(f"{source}: {len(frames) - len(stated)} frames have no {key}, others do; complete the file")
        if stated:
            found[key] = float(np.median(stated))
    focal = found["fl_x"]
    spread = max(
        max(abs(float(frame[key]) - found[key]) for frame in frames) / focal
        for key in (*FOCAL_KEYS, *CENTRE_KEYS)
        if key in found
    )
    if spread > VARIATION:
        raise DataError(
            f"{source}: the frames' intrinsics differ by up to {spread:.1%} of the focal length (autofocus, or several"
            " cameras); one camera is needed: fix the focus, or export the images undistorted to one camera"
        )
    if spread > 0:
        log.warning("%s: the frames' intrinsics differ by up to %.2f %%; their median is taken", source, 100 * spread)
    return found


def _metres_a_level(values: Mapping[str, Any], path: Path) -> float:
    given = values.get("depth_unit_scale_factor", values.get("integer_depth_scale", METRES_A_LEVEL))
    if not isinstance(given, int | float) or not 0 < given < math.inf:
        raise DataError(f"{path}: depth_unit_scale_factor is {given}; it is the metres of one level, above 0")
    return float(given)
