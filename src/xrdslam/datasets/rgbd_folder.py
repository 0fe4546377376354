"""A folder of one's own images: colour, depth where there is some, poses where there are any.

    <path>/rgb/ (or color, images, ...)     *.png, *.jpg
           depth/                           *.png of 16 bits, *.npy [m], *.exr [m]
           poses.txt (or traj.txt, poses/)  see `trajectories`
           K.txt (or intrinsics.json, ...)  see `cameras`

Images meet by the number in their names; where those are times, by time; where there is neither, in natural order,
which needs equal counts. Every guess can be said instead: `dataset.rgb`, `depth`, `poses`, `camera`, `intrinsics`,
`depth_scale`. Depth may be of another size than colour as long as it covers the same view.
"""

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.datasets.cameras import CAMERA_FILES, Stated, read_camera
from xrdslam.datasets.config import RgbdFolderConfig
from xrdslam.datasets.depth_files import DEPTH_SUFFIXES, probe_any_depth, read_any_depth
from xrdslam.datasets.folders import dataset_name, recording
from xrdslam.datasets.images import first_size
from xrdslam.datasets.naming import natural_key, number_or_time
from xrdslam.datasets.numbered import NumberedParts, record_of
from xrdslam.datasets.sequence import Record, RgbdSequence
from xrdslam.datasets.source import stated_lens
from xrdslam.datasets.times import NS_PER_S, associated
from xrdslam.datasets.trajectories import POSE_FILES, POSE_FOLDERS, Pose, poses_of_frames

__all__ = ["RgbdFolderDataset"]

log = logging.getLogger(__name__)

COLOUR_FOLDERS = ("rgb", "color", "colour", "images", "image", "imgs", "img", "frames", "left", "results", ".")
DEPTH_FOLDERS = ("depth", "depths", "depth_images", "depth_image", "depth_maps", "aligned_depth", "results", ".")
COLOUR_SUFFIXES = (".png", ".jpg", ".jpeg")
LEVELS_PER_METRE = 1000.0
LABELS = ("colour image", "depth image", "pose")
FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])


class Images(NamedTuple):
    """Image files by their numbers or times [ns]."""

    files: dict[int, Path]
    are_times: bool


class RgbdFolderDataset(RgbdSequence):
    """A recording in a folder."""

    may_be_grey: ClassVar[bool] = True

    def __init__(self, config: RgbdFolderConfig) -> None:
        """Find the images, the camera and the poses, and say in the log what was found."""
        self.folder = recording(config, "the folder of the recording")
        if not self.folder.is_dir():
            raise DataError(f"dataset.path={self.folder}: a file, but a folder of images is looked for")
        colour = _images(self.folder, config.rgb, "rgb", COLOUR_FOLDERS, COLOUR_SUFFIXES)
        depth = None if config.depth == "none" else _depth(self.folder, config, colour)
        stated = _stated(self.folder, config)
        poses = _poses(self.folder, config, colour)
        found = [f"{len(colour.files)} colour", f"{len(depth) if depth else 'no'} depth images"]
        log.info("%s: %s, %s; %s poses; camera of %s", self.folder, *found, len(poses) or "no", stated.lens.stated_in)
        super().__init__(
            config,
            dataset_name(config, self.folder),
            _records(self.folder, config, colour, depth, poses),
            stated.lens.source(
                first_size(colour.files),
                config,
                stated.depth_scale or LEVELS_PER_METRE,
                depth_size=_first_depth_size(depth) if depth else None,
            ),
        )

    def probe_depth(self, path: Path) -> tuple[int, int]:
        """Look at the header of a PNG, NPY or EXR."""
        return probe_any_depth(path)

    def read_depth(self, path: Path) -> np.ndarray:
        """Read a PNG, NPY or EXR [m]."""
        return read_any_depth(path, self.source.depth_scale, self.source.invalid_depth)


def _images(folder: Path, given: str | None, key: str, places: Sequence[str], suffixes: Sequence[str]) -> Images:
    """Return the images that a setting names, else those of the first usual place that has any."""
    if given is not None:
        found = sorted((folder / given).iterdir()) if (folder / given).is_dir() else sorted(folder.glob(given))
        files = [path for path in found if path.suffix.lower() in suffixes]
        if not files:
            raise DataError(
                f"dataset.{key}={given}: no {', '.join('*' + s for s in suffixes)} there in {folder}; it is a folder"
                f" inside it, or a pattern of names. There is: {_listing(folder)}"
            )
        return _keyed(files)
    for place in places:
        if (folder / place).is_dir():
            found = [path for path in (folder / place).iterdir() if path.suffix.lower() in suffixes]
            files = [path for path in found if place not in ("results", ".") or _looks_like(path, key)]
            if files:
                return _keyed(files)
    raise DataError(
        f"{folder}: no {'colour' if key == 'rgb' else key} images in {', '.join(places[:-1])} or the folder itself; say"
        f" where with dataset.{key}=<folder or pattern>. There is: {_listing(folder)}"
    )


def _depth(folder: Path, config: RgbdFolderConfig, colour: Images) -> dict[int, Path] | None:
    """Return the depth images by the keys of colour, none where there are none to be found."""
    try:
        depth = _images(folder, config.depth, "depth", DEPTH_FOLDERS, DEPTH_SUFFIXES)
    except DataError:
        if config.depth is not None:
            raise
        log.info("%s: no depth images in %s; dataset.depth says where they are", folder, ", ".join(DEPTH_FOLDERS))
        return None
    keys = sorted(colour.files)
    if colour.are_times and depth.are_times:
        times = sorted(depth.files)
        partners, _ = associated(keys, times, round(config.max_time_offset_s * NS_PER_S))
        pairs = zip(keys, partners.tolist(), strict=True)
        joined = {key: depth.files[times[partner]] for key, partner in pairs if partner >= 0}
    elif set(keys) & set(depth.files):
        return depth.files
    else:
        joined = dict(zip(keys, depth.files.values(), strict=False)) if len(keys) == len(depth.files) else {}
    if not joined:
        raise DataError(
            f"{folder}: {len(keys)} colour and {len(depth.files)} depth images, but neither numbers nor times nor"
            f" counts agree (such as {colour.files[keys[0]].name} and {next(iter(depth.files.values())).name}); rename"
            " them alike"
        )
    return joined


def _poses(folder: Path, config: RgbdFolderConfig, colour: Images) -> dict[int, Pose]:
    """Return the poses of frames in our convention, nothing where there are none."""
    if config.poses == "none":
        return {}
    names = (*POSE_FILES, *POSE_FOLDERS) if config.poses is None else (config.poses,)
    path = next((folder / name for name in names if (folder / name).exists()), None)
    if path is None:
        if config.poses is not None:
            raise DataError(f"dataset.poses={config.poses}: no such file or folder in {folder}: {_listing(folder)}")
        return {}
    tolerance_ns = round(config.max_time_offset_s * NS_PER_S)
    poses = poses_of_frames(path, sorted(colour.files), colour.are_times, tolerance_ns)
    return {key: _converted(pose, config) for key, pose in poses.items()}


def _converted(pose: Pose, config: RgbdFolderConfig) -> Pose:
    """Return T_world_camera in OpenCV axes of a pose as the file has it."""
    if config.pose_direction == "camera_to_world" and config.pose_axes == "opencv":
        return pose

    def converted() -> np.ndarray:
        T = pose() if config.pose_direction == "camera_to_world" else np.linalg.inv(pose())
        return T @ FLIP_YZ if config.pose_axes == "opengl" else T

    return converted


def _stated(folder: Path, config: RgbdFolderConfig) -> Stated:
    """Return the camera: the command line's, that of the file which is set, or that of the first usual file."""
    names = CAMERA_FILES if config.camera is None else (config.camera,)
    path = next((folder / name for name in names if (folder / name).is_file()), None)
    if config.camera is not None and path is None:
        raise DataError(f"dataset.camera={config.camera}: no such file in {folder}: {_listing(folder)}")
    read = read_camera(path) if path is not None else None
    lens = stated_lens(config, read.lens if read else None, str(path))
    if lens is None:
        raise DataError(
            f"{folder}: which camera? Set dataset.intrinsics=[fx,fy,cx,cy] in pixels, or put them into one of"
            f" {', '.join(CAMERA_FILES)}"
        )
    return Stated(lens, read.depth_scale if read else None)


def _records(
    folder: Path, config: RgbdFolderConfig, colour: Images, depth: dict[int, Path] | None, poses: dict[int, Pose]
) -> list[Record]:
    parts = NumberedParts(colour.files, depth if depth is not None else {}, poses, LABELS)
    optional = [label for label, having in zip(LABELS, parts, strict=False) if not having]
    if colour.are_times and depth is not None:  # rates of their own, so that some are left over
        keys = sorted(set(colour.files) & set(depth))
        if len(keys) < len(colour.files):
            log.info("%s: %d of %d colour images have a depth in time", folder, len(keys), len(colour.files))
    else:
        keys = sorted({*colour.files, *(depth or ())})
    timed = ((key, key if colour.are_times else round(key * NS_PER_S / config.fps)) for key in keys)
    return [record_of(folder, key, parts, time_ns, optional) for key, time_ns in timed]


def _keyed(files: Sequence[Path]) -> Images:
    """Give each file its number or time; where those are not all there and different, its place in natural order."""
    ordered = sorted(files, key=lambda path: natural_key(path.name))
    found = [number_or_time(path.stem) for path in ordered]
    keys = [key for key, _ in found if key is not None]
    kinds = {is_time for _, is_time in found}
    if len(set(keys)) == len(ordered) and len(kinds) == 1:
        return Images(dict(zip(keys, ordered, strict=True)), kinds == {True})
    stems = [path.stem for path in ordered]
    twice = next((stem for stem in stems if stems.count(stem) > 1), None) if len(stems) < 10_000 else None
    if twice is not None:
        raise DataError(f"{ordered[0].parent}: two files are called {twice}; remove one, or give a pattern of names")
    return Images(dict(enumerate(ordered)), False)


def _first_depth_size(depth: dict[int, Path]) -> tuple[int, int]:
    for key in sorted(depth):
        try:
            return probe_any_depth(depth[key])
        except DataError:
            continue
    return probe_any_depth(depth[min(depth)])  # raises, naming the first


def _looks_like(path: Path, key: str) -> bool:
    """Say whether a file that lies among others of both kinds is of this kind."""
    return ("depth" in path.name.lower()) == (key == "depth")


def _listing(folder: Path) -> str:
    names = sorted(path.name for path in folder.iterdir())
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "") or "nothing"
