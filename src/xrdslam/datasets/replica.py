"""Replica as NICE-SLAM rendered it, and any folder of that layout.

    <root>/cam_params.json          {"camera": {w, h, fx, fy, cx, cy, scale}}; or inside the scene's folder
    <root>/<scene>/traj.txt         T_world_camera, OpenCV axes, 16 numbers a line, by rows
    <root>/<scene>/results/frame000000.jpg (or .png), depth000000.png (16 bits, `scale` levels a metre, 0: none)
    <root>/<scene>_mesh.ply         the scene's surface, where there is one; or mesh.ply inside the scene's folder

The files carry no time: frames count as 30 a second.
"""

import json
import math
import re
from functools import partial
from pathlib import Path

from xrdslam.core.camera import Camera
from xrdslam.core.errors import DataError
from xrdslam.datasets.config import ReplicaConfig
from xrdslam.datasets.folders import dataset_name, scene_folder
from xrdslam.datasets.numbered import NumberedParts, numbered_files, numbered_records
from xrdslam.datasets.poses import parse_pose, read_pose_lines
from xrdslam.datasets.sequence import Record, RgbdSequence, SourceCamera

__all__ = ["ReplicaDataset"]

FRAMES_PER_SECOND = 30.0
COLOUR = re.compile(r"frame(\d+)\.(?:jpe?g|png)")
DEPTH = re.compile(r"depth(\d+)\.png")


class ReplicaDataset(RgbdSequence):
    """A scene in NICE-SLAM's layout of Replica."""

    def __init__(self, config: ReplicaConfig) -> None:
        """Find the scene's files, read its camera and its trajectory."""
        self.folder = scene_folder(config)
        source = _read_camera(self.folder)
        records, faults = _read_records(self.folder)
        super().__init__(config, dataset_name(config, self.folder), records, source, faults)

    @property
    def ground_truth_mesh(self) -> Path | None:
        """The mesh beside the scene's folder or in it, the first there is."""
        beside = self.folder.parent / f"{self.folder.name}_mesh.ply"
        return next((path for path in (beside, self.folder / "mesh.ply") if path.is_file()), None)


def _read_records(folder: Path) -> tuple[list[Record], list[str]]:
    """Return one record for each frame that has an image, and what is wrong with the sequence as a whole."""
    results, trajectory = folder / "results", folder / "traj.txt"
    if not results.is_dir():
        raise DataError(f"{results}: no such folder; a scene holds results/frame*.jpg, results/depth*.png and traj.txt")
    colour, depth = numbered_files(results, COLOUR), numbered_files(results, DEPTH)
    if not colour and not depth:
        raise DataError(f"{results}: neither frame*.jpg nor frame*.png nor depth*.png; copy the scene's images there")
    lines = [partial(parse_pose, text, source) for text, source in read_pose_lines(trajectory)]
    numbers = sorted({*colour, *depth})
    # Line i belongs to the i-th frame. Where there are more or fewer lines than frames, only the number can tell.
    poses = dict(zip(numbers, lines, strict=True) if len(lines) == len(numbers) else enumerate(lines))
    labels = ("colour image (frame*.jpg or .png)", "depth image (depth*.png)", f"pose ({trajectory.name})")
    records = numbered_records(folder, NumberedParts(colour, depth, poses, labels), FRAMES_PER_SECOND)
    counts = f"{trajectory}: {len(lines)} poses for {len(numbers)} frames"
    return records, [f"{counts}; complete the images, or cut the file to them"] if len(lines) > len(numbers) else []


def _read_camera(folder: Path) -> SourceCamera:
    places = (folder / "cam_params.json", folder.parent / "cam_params.json")
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        raise DataError(f"{places[0]}: no such file, nor {places[1]}; the camera is read from one of them")
    try:
        values = json.loads(path.read_text())["camera"]
        w, h, fx, fy, cx, cy, scale = (float(values[key]) for key in ("w", "h", "fx", "fy", "cx", "cy", "scale"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{path}: not a description of a camera ({type(error).__name__}: {error});"
            ' it is {"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}}, all numbers'
        ) from error
    if not all(math.isfinite(v) for v in (w, h, fx, fy, cx, cy, scale)) or min(w, h, fx, fy, scale) <= 0:
        raise DataError(f"{path}: w, h, fx, fy, scale must be above 0, cx and cy finite, found {values}; mend the file")
    return SourceCamera(Camera(fx, fy, cx, cy, int(w), int(h)), str(path), depth_scale=scale)
