"""Co-Fusion's synthetic sequences.

    <root>/room4/colour/Color0001.png
                 depth_noise/Depth0001.exr, depth_original/Depth0001.exr     one float channel, metres
                 trajectories/gt-cam-0.txt      number, tx ty tz, qx qy qz qw: camera to world
                 calibration.txt                fx fy cx cy width height [px], where there is one

Without calibration.txt the camera is that of room4, the scene that papers report (360, 360, 320, 240 at 640x480 px);
for any other scene that is said in the log, and `dataset.intrinsics` sets another. Frames count as 30 a second.
"""

import logging
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.datasets.config import CoFusionConfig
from xrdslam.datasets.exr import probe_exr, read_exr_depth
from xrdslam.datasets.folders import dataset_name, scene_folder
from xrdslam.datasets.images import first_size
from xrdslam.datasets.numbered import NumberedParts, numbered_files, numbered_records
from xrdslam.datasets.poses import quaternion_pose, read_pose_lines, read_text
from xrdslam.datasets.sequence import RgbdSequence
from xrdslam.datasets.source import Lens, stated_lens

__all__ = ["CoFusionDataset"]

log = logging.getLogger(__name__)

FRAMES_PER_SECOND = 30.0
ROOM4 = Lens((360.0, 360.0, 320.0, 240.0), stated_in="the camera of Co-Fusion's room4")
COLOUR = re.compile(r"Color(\d+)\.png")
DEPTH = re.compile(r"Depth(\d+)\.exr")


class CoFusionDataset(RgbdSequence):
    """A scene of Co-Fusion."""

    def __init__(self, config: CoFusionConfig) -> None:
        """Find the scene's files, read its camera and the camera's trajectory."""
        self.folder = scene_folder(config)
        for name in ("colour", config.depth):
            if not (self.folder / name).is_dir():
                raise DataError(f"{self.folder / name}: no such folder; a scene holds colour/ and {config.depth}/")
        colour = numbered_files(self.folder / "colour", COLOUR)
        depth = numbered_files(self.folder / config.depth, DEPTH)
        if not colour or not depth:
            raise DataError(
                f"{self.folder}: no colour/Color*.png or no {config.depth}/Depth*.exr; copy the scene there"
            )
        labels = ("colour image (Color*.png)", "depth image (Depth*.exr)", "pose (gt-cam-0.txt)")
        poses = _poses(self.folder / "trajectories" / "gt-cam-0.txt", sorted({*colour, *depth}))
        records = numbered_records(self.folder, NumberedParts(colour, depth, poses, labels), FRAMES_PER_SECOND)
        size = first_size(colour)
        source = _lens(config, self.folder).source(size, config, depth_scale=1.0)
        super().__init__(config, dataset_name(config, self.folder), records, source)

    def probe_depth(self, path: Path) -> tuple[int, int]:
        """Look at the header of an OpenEXR file."""
        return probe_exr(path)

    def read_depth(self, path: Path) -> np.ndarray:
        """Read an OpenEXR file [m]."""
        return read_exr_depth(path) / np.float32(self.source.depth_scale)


def _poses(path: Path, numbers: list[int]) -> dict[int, Callable[[], np.ndarray]]:
    """Return the pose of each number, read when called. Lines are taken in order where their numbers are no frames'."""
    lines = [(text.split(), source) for text, source in read_pose_lines(path)]
    stated = [int(float(words[0])) if words[0].replace(".", "", 1).isdigit() else -1 for words, _ in lines]
    by_number = set(stated) >= set(numbers) or len(lines) != len(numbers)
    keys = stated if by_number else numbers
    return {
        key: partial(quaternion_pose, words[1:], source, "xyzw")
        for key, (words, source) in zip(keys, lines, strict=True)
    }


def _lens(config: CoFusionConfig, folder: Path) -> Lens:
    path = folder / "calibration.txt"
    if config.intrinsics is None and path.is_file():
        words = read_text(path, "fx fy cx cy width height").split()
        try:
            fx, fy, cx, cy = (float(word) for word in words[:4])
        except ValueError as error:
            raise DataError(f"{path}: holds fx fy cx cy width height, found {words[:6]}; mend the file") from error
        return Lens((fx, fy, cx, cy), tuple(config.distortion), str(path))
    lens = stated_lens(config, ROOM4, ROOM4.stated_in)
    assert lens is not None, "there is always room4's"
    if config.intrinsics is None and not folder.resolve().name.startswith("room4"):
        log.warning("%s: no calibration.txt; %s is taken. dataset.intrinsics sets another", folder, ROOM4.stated_in)
    return lens
