"""Poses in whichever common form somebody left them, for each frame of a recording."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from xrdslam.core.errors import DataError
from xrdslam.datasets.naming import natural_key, number_or_time
from xrdslam.datasets.poses import quaternion_pose, read_pose_lines, read_text, rigid_pose
from xrdslam.datasets.times import nanoseconds
from xrdslam.datasets.tracks import read_tum_track

__all__ = ["POSE_FILES", "POSE_FOLDERS", "Pose", "poses_of_frames"]

POSE_FILES = (
    *("poses.txt", "pose.txt", "traj.txt", "trajectory.txt", "groundtruth.txt", "gt.txt", "camera_poses.txt"),
    *("traj.log", "trajectory.log", "poses.csv", "trajectory.csv", "CameraTrajectory.txt"),
)
POSE_FOLDERS = ("poses", "pose", "extrinsics")

Pose = Callable[[], np.ndarray]
"""A pose that is parsed when it is asked for, so that what is wrong with one is the fault of its frame alone."""


class Entry(NamedTuple):
    """One pose of a file; `key` is the number or the time in front of it, where there is one."""

    pose: Pose
    key: str | None


def poses_of_frames(path: Path, keys: Sequence[int], are_times: bool, tolerance_ns: int) -> dict[int, Pose]:
    """Return the pose of each frame that has one.

    `keys` are the frames' numbers or, where `are_times`, times [ns], in order. Poses with times are interpolated to
    theirs; poses with numbers are found by number; poses without either belong to the frames in order, which needs as
    many of them, or one for every number from 0.
    """
    if path.is_dir():
        return _of_folder(path, keys)
    entries = _entries(path)
    if not entries:
        raise DataError(f"{path}: holds no pose; give one for each frame, or leave poses out with dataset.poses=none")
    if are_times and all(entry.key is not None for entry in entries):
        track, faults = read_tum_track(path)
        if faults:
            raise DataError(f"{faults[0]} (and {len(faults) - 1} more in {path})")
        return {key: partial(track.at, key, tolerance_ns) for key in keys}
    return _by_number(entries, keys) or _in_order(path, entries, keys)


def _by_number(entries: Sequence[Entry], keys: Sequence[int]) -> dict[int, Pose]:
    """Match the numbers in front of poses with those of frames; nothing where they are not the same numbers."""
    stated = [_whole(entry.key) for entry in entries]
    if any(number is None for number in stated) or not set(keys) <= set(stated):
        return {}
    by_number = {number: entry.pose for number, entry in zip(stated, entries, strict=True) if number is not None}
    return {key: by_number[key] for key in keys}


def _in_order(path: Path, entries: Sequence[Entry], keys: Sequence[int]) -> dict[int, Pose]:
    if len(entries) == len(keys):
        return {key: entry.pose for key, entry in zip(keys, entries, strict=True)}
    if max(keys) < len(entries):  # one for every number from 0, of which some have no image
        return {key: entries[key].pose for key in keys}
    raise DataError(
        f"{path}: {len(entries)} poses for {len(keys)} frames, and nothing says which belongs to which; give one for"
        " each, put the frame's number in front of each, or leave poses out with dataset.poses=none"
    )


def _of_folder(folder: Path, keys: Sequence[int]) -> dict[int, Pose]:
    """Read a file for each frame, joined by the number in its name, else in natural order."""
    files = sorted((p for p in folder.iterdir() if p.suffix in (".txt", ".csv")), key=lambda p: natural_key(p.name))
    numbers = [number_or_time(path.stem)[0] for path in files]
    if None not in numbers and set(keys) & set(numbers):
        return {n: partial(_pose_of_file, path) for n, path in zip(numbers, files, strict=True) if n is not None}
    entries = [Entry(partial(_pose_of_file, path), None) for path in files]
    if not entries:
        raise DataError(f"{folder}: holds no *.txt; give a pose for each frame, or leave them out: dataset.poses=none")
    return _in_order(folder, entries, keys)


def _entries(path: Path) -> list[Entry]:
    """Take a file apart by the numbers that its lines have."""
    lines = [(text.replace(",", " ").split(), source) for text, source in read_pose_lines(path)]
    if lines and not _is_number(lines[0][0][0]):
        lines = lines[1:]  # a row of titles
    counts = {len(words) for words, _ in lines}
    if counts <= {3, 4}:
        return _blocks(path, lines)
    entries = []
    for words, source in lines:
        if len(words) in (12, 16):
            entries.append(Entry(partial(_matrix, words, source), None))
        elif len(words) in (13, 17):
            entries.append(Entry(partial(_matrix, words[1:], source), words[0]))
        elif len(words) == 7:
            entries.append(Entry(partial(quaternion_pose, words, source, "xyzw"), None))
        elif len(words) == 8:
            entries.append(Entry(partial(quaternion_pose, words[1:], source, "xyzw"), words[0]))
        else:
            raise DataError(
                f"{source}: {len(words)} numbers; a pose is 16 (4x4 by rows), 12 (3x4), 7 (tx ty tz qx qy qz qw), or"
                " one of these behind a time or number, or four lines of four"
            )
    return entries


def _blocks(path: Path, lines: Sequence[tuple[list[str], str]]) -> list[Entry]:
    """Join four lines of four numbers each; a line of three before them (Redwood's .log) is left out."""
    rows = [(words, source) for words, source in lines if len(words) == 4]
    if len(rows) % 4:
        raise DataError(f"{path}: {len(rows)} rows of four numbers, which is no whole number of 4x4 matrices; mend it")
    return [
        Entry(partial(_matrix, [w for words, _ in rows[i : i + 4] for w in words], rows[i][1]), None)
        for i in range(0, len(rows), 4)
    ]


def _matrix(words: Sequence[str], source: str) -> Float64[np.ndarray, "4 4"]:
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError as error:
        raise DataError(f"{source}: a pose is numbers ({error}); mend the line") from error
    if values.size not in (12, 16):
        raise DataError(f"{source}: a pose is 12 or 16 numbers, found {values.size}; mend it")
    rows = values.reshape(-1, 4)
    return rigid_pose(rows if len(rows) == 4 else np.vstack([rows, [0.0, 0, 0, 1]]), source)


def _pose_of_file(path: Path) -> Float64[np.ndarray, "4 4"]:
    return _matrix(read_text(path).replace(",", " ").split(), str(path))


def _whole(key: str | None) -> int | None:
    """Return the whole number that a word stands for, none where it stands for another."""
    if key is None:
        return None
    try:
        value = nanoseconds(key, "", unit=1000)
    except DataError:
        return None
    return value // 1000 if value % 1000 == 0 else None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
