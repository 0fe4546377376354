"""Microsoft's 7-Scenes.

    <root>/<scene>/<sequence>/frame-000000.color.png (or .color.jpg)
                              frame-000000.depth.png   16 bits, millimetres; 0 and 65535: none
                              frame-000000.pose.txt    T_world_camera, OpenCV axes, four rows of four numbers

640x480 px, fx = fy = 585, cx = 320, cy = 240: the depth camera's, stated by the data set's page. The colour camera is
another one, a few centimetres beside it, and the files are not registered; like everybody, we read both as one camera.
The files carry no time: frames count as 30 a second, by their number.
"""

import re
from functools import partial
from pathlib import Path

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError
from xrdslam.datasets.config import SevenScenesConfig
from xrdslam.datasets.folders import dataset_name, scene_folder, subfolders
from xrdslam.datasets.numbered import NumberedParts, numbered_files, numbered_records
from xrdslam.datasets.poses import read_pose
from xrdslam.datasets.sequence import RgbdSequence, SourceCamera

__all__ = ["SevenScenesDataset"]

FRAMES_PER_SECOND = 30.0
CAMERA = SourceCamera(
    Camera(585.0, 585.0, 320.0, 240.0, 640, 480),
    "the camera of 7-Scenes",
    depth_scale=1000.0,
    invalid_depth=(65535,),
)
COLOUR = re.compile(r"frame-(\d+)\.color\.(?:jpe?g|png)")
DEPTH = re.compile(r"frame-(\d+)\.depth\.png")
POSE = re.compile(r"frame-(\d+)\.pose\.txt")
LABELS = ("colour image (frame-*.color.png or .jpg)", "depth image (frame-*.depth.png)", "pose (frame-*.pose.txt)")


class SevenScenesDataset(RgbdSequence):
    """One sequence of a scene of 7-Scenes."""

    def __init__(self, config: SevenScenesConfig) -> None:
        """Find the sequence's files and read its poses."""
        scene = scene_folder(config)
        self.folder = _sequence_folder(scene, config.sequence)
        colour, depth, pose = (numbered_files(self.folder, pattern) for pattern in (COLOUR, DEPTH, POSE))
        if not colour and not depth:
            raise DataError(f"{self.folder}: no {', no '.join(LABELS)}; copy a sequence there")
        poses = {number: partial(read_pose, path) for number, path in pose.items()}
        records = numbered_records(self.folder, NumberedParts(colour, depth, poses, LABELS), FRAMES_PER_SECOND)
        super().__init__(config, dataset_name(config, scene), records, CAMERA)


def _sequence_folder(scene: Path, sequence: str | None) -> Path:
    """Return the folder of the sequence: the one asked for, the only one, or the scene's folder itself."""
    found = [name for name in subfolders(scene) if name.startswith("seq-")]
    if sequence is not None:
        if not (scene / sequence).is_dir():
            raise DataError(f"dataset.sequence={sequence}: no such folder in {scene}; there is: {', '.join(found)}")
        return scene / sequence
    if len(found) > 1:
        raise DataError(f"{scene}: holds {len(found)} sequences; pick one with dataset.sequence: {', '.join(found)}")
    return scene / found[0] if found else scene
