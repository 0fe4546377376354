"""The RGB-D benchmark of TUM, and any folder of that layout.

    <root>/rgbd_dataset_freiburg1_desk/rgb.txt          time [s], file; also depth.txt. Lines with # are comments
                                       rgb/*.png, depth/*.png (16 bits, 5000 levels a metre, 0: none)
                                       groundtruth.txt  time [s], tx ty tz, qx qy qz qw: colour camera to world

Colour and depth have times and counts of their own: the closest pairs within `dataset.max_time_offset_s` become
frames, at the time of the colour image; colour without such a depth is left out and counted in the log. Ground truth is
interpolated to that time (the benchmark's own tools take the nearest, up to 5 ms off); where there is none, the pose is
NaN. The camera is that of calibration.txt (fx fy cx cy [width height]) where there is one, else it goes by the name of
the folder, as the benchmark states it: its depth is registered to the colour image as the lens saw it, so both are
undistorted alike. What the lens of freiburg1 and 2 did not see is black and without depth, 6 % at the border;
`dataset.crop=[16,12,16,12]` cuts all but a thousandth of it off.
"""

import logging
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.datasets.cameras import read_camera
from xrdslam.datasets.config import TumRgbdConfig
from xrdslam.datasets.folders import dataset_name, inside, scene_folder
from xrdslam.datasets.images import first_size
from xrdslam.datasets.poses import read_pose_lines
from xrdslam.datasets.sequence import Record, RgbdSequence, SourceCamera
from xrdslam.datasets.source import Lens, stated_lens
from xrdslam.datasets.times import NS_PER_S, associated, nanoseconds
from xrdslam.datasets.tracks import Track, read_tum_track

__all__ = ["TumRgbdDataset"]

log = logging.getLogger(__name__)

LENSES = {  # by the number in freiburg<n>; the page's "ROS default" intrinsics are not these
    "1": Lens((517.3, 516.5, 318.6, 255.3), (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "2": Lens((520.9, 521.0, 325.1, 249.7), (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "3": Lens((535.4, 539.2, 320.1, 247.6), ()),
}
LEVELS_PER_METRE = 5000.0


class Listed(NamedTuple):
    """The files of a list, in time order, and what is wrong with its lines."""

    times_ns: list[int]
    paths: list[Path]
    faults: list[str]


class TumRgbdDataset(RgbdSequence):
    """A sequence in TUM's layout."""

    def __init__(self, config: TumRgbdConfig) -> None:
        """Read the lists, join colour, depth and ground truth by time."""
        self.folder = scene_folder(config, re.sub("^fr([123])_", r"rgbd_dataset_freiburg\1_", config.scene))
        colour, depth = read_list(self.folder, "rgb.txt"), read_list(self.folder, "depth.txt")
        tolerance_ns = round(config.max_time_offset_s * NS_PER_S)
        truth = self.folder / "groundtruth.txt"
        track, faults = read_tum_track(truth) if truth.is_file() else (None, [])
        records = _joined(self.folder, colour, depth, track, tolerance_ns)
        source = _source(config, self.folder, colour.paths)
        super().__init__(
            config, dataset_name(config, self.folder), records, source, [*colour.faults, *depth.faults, *faults]
        )


def read_list(folder: Path, name: str) -> Listed:
    """Read a list of times and files; a line that is none is a fault, not an end."""
    found: dict[int, Path] = {}
    faults = []
    for text, source in read_pose_lines(folder / name):
        words = text.replace(",", " ").split()
        try:
            if len(words) < 2:
                raise DataError(f"{source}: a line is a time and a file, found {text.strip()[:40]!r}; complete it")
            time_ns, path = nanoseconds(words[0], source), inside(folder, words[1], source)
        except DataError as error:
            faults.append(str(error))
            continue
        if time_ns in found:
            faults.append(f"{source}: the time {words[0]} stands there twice; remove one of its lines")
        found.setdefault(time_ns, path)
    if not found:
        raise DataError(f"{folder / name}: lists no file; it has a line `time file` for each image")
    times = sorted(found)
    if times != list(found):
        log.warning("%s: the lines are not in time order; they are taken in the order of their times", folder / name)
    return Listed(times, [found[time] for time in times], faults)


def _joined(folder: Path, colour: Listed, depth: Listed, track: Track | None, tolerance_ns: int) -> list[Record]:
    partners, apart_ns = associated(colour.times_ns, depth.times_ns, tolerance_ns)
    seconds = tolerance_ns / NS_PER_S
    if (partners < 0).all():
        raise DataError(
            f"{folder}: no colour image has a depth image within {seconds} s, the nearest are"
            f" {apart_ns.min() / 1e9:.3f} s apart; check that rgb.txt and depth.txt are of one recording, or raise"
            " dataset.max_time_offset_s"
        )
    records = [
        Record(time_ns, path, depth.paths[partner], None if track is None else track.at(time_ns, tolerance_ns))
        for time_ns, path, partner in zip(colour.times_ns, colour.paths, partners.tolist(), strict=True)
        if partner >= 0
    ]
    alone = len(partners) - len(records)
    if alone:
        log.info("%s: %d of %d colour images have no depth within %g s", folder, alone, len(partners), seconds)
    unknown = sum(r.T_world_camera is not None and bool(np.isnan(r.T_world_camera).any()) for r in records)
    if unknown == len(records):
        raise DataError(
            f"{folder / 'groundtruth.txt'}: has no pose within {seconds} s of any frame; give the ground truth of this"
            " recording, or remove the file"
        )
    if unknown:
        log.info("%s: %d of %d frames have no ground truth within %g s", folder, unknown, len(records), seconds)
    return records


def _source(config: TumRgbdConfig, folder: Path, colour: list[Path]) -> SourceCamera:
    """Say which camera took the files: what is set, or the benchmark's by the name of the folder."""
    number = re.search(r"(?:freiburg|fr)_?([123])", folder.resolve().name)
    lens = LENSES[number[1]] if number else None
    stated_in = f"the camera of freiburg{number[1]}" if number else ""
    written = folder / "calibration.txt"  # as `convert` leaves it
    if written.is_file():
        lens, stated_in = read_camera(written).lens, str(written)
    found = stated_lens(config, lens, stated_in)
    if found is None:
        raise DataError(
            f"{folder}: which camera? The folder's name has no freiburg1, 2 or 3; set dataset.intrinsics=[fx,fy,cx,cy],"
            " or put them into calibration.txt there"
        )
    is_known = config.intrinsics is None and not written.is_file()
    size = (640, 480) if is_known else first_size(dict(enumerate(colour)))
    return found.source(size, config, LEVELS_PER_METRE)
