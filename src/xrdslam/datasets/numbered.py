"""Layouts whose file names carry the number of the frame: colour, depth and pose meet by that number."""

import os
import re
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from xrdslam.core.errors import DataError
from xrdslam.datasets.sequence import Record

__all__ = ["NumberedParts", "numbered_files", "numbered_records", "record_of"]


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
    return [record_of(folder, number, parts, round(number * 1e9 / frames_per_second)) for number in numbers]


def record_of(
    folder: Path, number: int, parts: NumberedParts, timestamp_ns: int, optional: Collection[str] = ()
) -> Record:
    """Return one frame's record, its fault where it lacks a part whose label is not among the `optional` ones."""
    having = dict(zip(parts.labels, parts[:3], strict=True))
    if any(number not in part for label, part in having.items() if label not in optional):
        return Record(timestamp_ns, parts.colour.get(number, folder), fault=_missing(folder, number, parts, optional))
    try:
        pose = parts.pose[number]() if number in parts.pose else None
    except DataError as error:
        return Record(timestamp_ns, parts.colour[number], fault=str(error))
    return Record(timestamp_ns, parts.colour[number], parts.depth.get(number), pose)


def _missing(folder: Path, number: int, parts: NumberedParts, optional: Collection[str]) -> str:
    """Say which part a frame lacks, and how many there are of each."""
    by_label = {label: part for label, part in zip(parts.labels, parts[:3], strict=True) if label not in optional}
    lacking = " and no ".join(label for label, having in by_label.items() if number not in having)
    counts = ", ".join(f"{len(having)} x {label}" for label, having in by_label.items())
    return (
        f"{folder}: frame {number} has no {lacking}; found {counts};"
        " complete the folder, or leave such frames out with dataset.on_error=skip"
    )
