"""Layouts whose file names carry the number of the frame: colour, depth and pose meet by that number."""

import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.datasets.sequence import Record

__all__ = ["NumberedParts", "numbered_files", "numbered_records"]


class NumberedParts(NamedTuple):
    """What there is of each frame, by its number; `labels` name the three parts in messages, with their file names.

    A pose is read when called, so that what is wrong with one is the fault of its frame alone.
    """

    colour: Mapping[int, Path]
    depth: Mapping[int, Path]
    pose: Mapping[int, Callable[[], np.ndarray]]
    labels: tuple[str, str, str]


def numbered_files(folder: Path, pattern: re.Pattern[str]) -> dict[int, Path]:
    """Return the files whose whole name matches, by the number in the pattern's first group."""
    found: dict[int, Path] = {}
    for name in os.listdir(folder):
        match = pattern.fullmatch(name)
        if match is None:
            continue
        number = int(match[1])
        if number in found:
            raise DataError(f"{folder}: {found[number].name} and {name} are the same frame; remove one of them")
        found[number] = folder / name
    return found


def numbered_records(folder: Path, parts: NumberedParts, frames_per_second: float) -> list[Record]:
    """Return a record for each number that has a colour or a depth image, in rising order; time is counted by it."""
    numbers = sorted({*parts.colour, *parts.depth})
    return [_record(folder, number, parts, round(number * 1e9 / frames_per_second)) for number in numbers]


def _record(folder: Path, number: int, parts: NumberedParts, timestamp_ns: int) -> Record:
    if number not in parts.colour or number not in parts.depth or number not in parts.pose:
        return Record(timestamp_ns, parts.colour.get(number, folder), fault=_missing(folder, number, parts))
    try:
        pose = parts.pose[number]()
    except DataError as error:
        return Record(timestamp_ns, parts.colour[number], fault=str(error))
    return Record(timestamp_ns, parts.colour[number], parts.depth[number], pose)


def _missing(folder: Path, number: int, parts: NumberedParts) -> str:
    """Say which part a frame lacks, and how many there are of each."""
    by_label = dict(zip(parts.labels, parts[:3], strict=True))
    lacking = " and no ".join(label for label, having in by_label.items() if number not in having)
    counts = ", ".join(f"{len(having)} x {label}" for label, having in by_label.items())
    return (
        f"{folder}: frame {number} has no {lacking}; found {counts};"
        " complete the folder, or leave such frames out with dataset.on_error=skip"
    )
