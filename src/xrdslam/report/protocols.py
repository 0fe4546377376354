"""Whether figures may stand in one column: only those that were measured alike."""

import json
from collections import defaultdict
from collections.abc import Sequence

from xrdslam.core.errors import XrdslamError
from xrdslam.report.run_files import RunFiles

__all__ = ["ProtocolError", "by_protocol", "check_protocols", "conditions"]

OUTCOMES = frozenset(
    {
        "alignment_path_along_cm",
        "alignment_path_aside_cm",
        "alignment_scale",
        "ate_sim3_scale",
        "culling_frames",
        "held_out_frames",
        "icp_result",
        "is_alignment_rotation_unique",
        "left_out_because",
        "matched_frames",
        "matched_percent_of_ground_truth",
        "preset",
        "rpe_pairs",
        "rpe_scale",
        "sequence_frames",
        "unavailable",
    }
)
"""Entries of a protocol that say what came out, not how it was measured; so do all that count `frames`."""


class ProtocolError(XrdslamError):
    """Figures of one name that were measured in different ways; the message names what differs, and where."""


def conditions(run: RunFiles, key: str) -> dict[str, str]:
    """Return how a figure was measured: its group's protocol without outcomes, and without what is of other figures.

    An entry whose name begins as another figure's does (`rpe_delta_frames`, `ssim`) is about that one.
    """
    group, _, name = key.rpartition("/")
    prefix = f"{group}/"
    others = {k.removeprefix(prefix).partition("_")[0] for k in run.metrics if k.startswith(prefix)}
    others -= {name.partition("_")[0], "protocol"}
    found = {}
    for entry, value in run.protocol(group).items():
        is_count = entry == "frames" or entry.startswith("frames_")
        if entry in OUTCOMES or is_count or entry.partition("_")[0] in others:
            continue
        found[entry] = json.dumps(value, sort_keys=True).strip('"')
    return found


def by_protocol(runs: Sequence[RunFiles], key: str) -> dict[str, list[RunFiles]]:
    """Return the runs that have a figure, by what is special to how it was measured ("" where all are alike)."""
    having = [run for run in runs if run.figure(key) is not None]
    ways = [conditions(run, key) for run in having]
    differing = _differing(ways)
    split: dict[str, list[RunFiles]] = defaultdict(list)
    for run, way in zip(having, ways, strict=True):
        split[", ".join(f"{entry}={way.get(entry, 'not said')}" for entry in differing)].append(run)
    return dict(split)


def check_protocols(runs: Sequence[RunFiles], keys: Sequence[str]) -> None:
    """Raise a ProtocolError where figures of one name were measured in different ways."""
    faults = [fault for key in keys if (fault := _fault(runs, key))]
    if faults:
        raise ProtocolError(
            f"{'; '.join(dict.fromkeys(faults))}. They cannot stand in one column: measure them alike "
            "(run again with the same evaluation.* and threads), leave out runs, or leave out figures with --columns; "
            "--split gives each protocol a column of its own"
        )


def _fault(runs: Sequence[RunFiles], key: str) -> str:
    having = [run for run in runs if run.figure(key) is not None]
    ways = [conditions(run, key) for run in having]
    differing = _differing(ways)
    if not differing:
        return ""
    said = []
    for entry in differing:
        where: dict[str, list[str]] = defaultdict(list)
        for run, way in zip(having, ways, strict=True):
            where[way.get(entry, "not said")].append(run.path.name)
        said.append(f"{entry} is {' and '.join(f'{value} in {_some(names)}' for value, names in where.items())}")
    return f"{key.rpartition('/')[0]} was measured in different ways: {', '.join(said)}"


def _differing(ways: Sequence[dict[str, str]]) -> list[str]:
    entries = sorted({entry for way in ways for entry in way})
    return [entry for entry in entries if len({way.get(entry) for way in ways}) > 1]


def _some(names: Sequence[str], most: int = 3) -> str:
    rest = len(names) - most
    return ", ".join(names[:most]) + (f" and {rest} more" if rest > 0 else "")
