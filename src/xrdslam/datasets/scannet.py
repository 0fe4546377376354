"""ScanNet, as its own tool exports a .sens file.

    <root>/scene0000_00/frames/color/0.jpg      1296x968
                               depth/0.png      640x480, 16 bits, millimetres; 0: none
                               pose/0.txt       T_world_camera, OpenCV axes, four rows; all -inf where it is unknown
                               intrinsic/intrinsic_color.txt, intrinsic_depth.txt      4x4, [px] of the files' sizes

`frames/` may be left out. Frames have the depth camera and its size; colour, which covers the same view, is averaged
down to it. The files carry no time: frames count as 30 a second, by their number. A frame whose pose is unknown stays,
with a pose of NaN: it can be tracked, it cannot be scored.
"""

import logging
import re
from functools import partial
from pathlib import Path

import numpy as np

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError
from xrdslam.datasets.config import ScanNetConfig
from xrdslam.datasets.folders import dataset_name, scene_folder
from xrdslam.datasets.images import first_size
from xrdslam.datasets.matrices import read_intrinsic_matrix
from xrdslam.datasets.numbered import NumberedParts, numbered_files, numbered_records
from xrdslam.datasets.poses import parse_pose, read_text
from xrdslam.datasets.sequence import RgbdSequence, SourceCamera

__all__ = ["ScanNetDataset"]

log = logging.getLogger(__name__)

FRAMES_PER_SECOND = 30.0
LEVELS_PER_METRE = 1000.0
COLOUR = re.compile(r"(\d+)\.(?:jpe?g|png)")
DEPTH = re.compile(r"(\d+)\.png")
POSE = re.compile(r"(\d+)\.txt")
LABELS = ("colour image (color/*.jpg)", "depth image (depth/*.png)", "pose (pose/*.txt)")
DISAGREEMENT_PX = 2.0


class ScanNetDataset(RgbdSequence):
    """A scene of ScanNet."""

    def __init__(self, config: ScanNetConfig) -> None:
        """Find the scene's files, read its cameras and poses."""
        scene = scene_folder(config)
        self.folder = scene / "frames" if (scene / "frames").is_dir() else scene
        colour, depth, pose = (
            numbered_files(_part(self.folder, name), pattern)
            for name, pattern in (("color", COLOUR), ("depth", DEPTH), ("pose", POSE))
        )
        if not colour or not depth:
            raise DataError(f"{self.folder}: no {' or no '.join(LABELS[:2])}; export the scene's .sens there")
        poses = {number: partial(_pose, path) for number, path in pose.items()}
        records = numbered_records(self.folder, NumberedParts(colour, depth, poses, LABELS), FRAMES_PER_SECOND)
        source = _source(self.folder, first_size(colour), first_size(depth))
        super().__init__(config, dataset_name(config, scene), records, source)


def _part(folder: Path, name: str) -> Path:
    if (folder / name).is_dir():
        return folder / name
    sens = next(folder.glob("*.sens"), None)
    advice = f"export {sens.name} with ScanNet's reader" if sens else "export the scene's .sens there"
    raise DataError(f"{folder / name}: no such folder; a scene holds color/, depth/, pose/, intrinsic/: {advice}")


def _pose(path: Path) -> np.ndarray:
    text = read_text(path)
    return np.full((4, 4), np.nan) if "inf" in text.lower() else parse_pose(text, str(path))


def _source(folder: Path, rgb_size: tuple[int, int], depth_size: tuple[int, int]) -> SourceCamera:
    """Return the depth camera, having held the colour camera against it."""
    path = folder / "intrinsic" / "intrinsic_depth.txt"
    camera = Camera(*read_intrinsic_matrix(path), *depth_size)
    colour = Camera(*read_intrinsic_matrix(path.with_name("intrinsic_color.txt")), *rgb_size).resized(*depth_size)
    corners = np.array([[0.0, 0.0], [depth_size[0] - 1.0, depth_size[1] - 1.0]])
    focal, centre = (np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy]))
    seen = (corners - centre) / focal * (colour.fx, colour.fy) + (colour.cx, colour.cy)
    off = float(np.abs(seen - corners).max())
    if off > DISAGREEMENT_PX:
        log.warning(
            "%s: colour and depth have views that differ by %.1f px at a corner; they are read as one camera, as the"
            " data set's depth is registered to its colour",
            path.parent,
            off,
        )
    return SourceCamera(camera, str(path), LEVELS_PER_METRE, depth_size=depth_size, rgb_size=rgb_size)
