"""What benchmarks.lost reads off a run: errors before and behind a gap, in the world of the first true pose."""

import json
from pathlib import Path

import pytest

from benchmarks.lost import outcome


def write_run(folder: Path, off_m: list[float], lost_frames: list[int]) -> Path:
    """Write what the benchmark reads: a camera that moves along x, estimated off to the side."""
    for name, offsets in (("final", off_m), ("ground_truth", [0.0] * len(off_m))):
        rows = [f"{i} {0.1 * i} {y} 0 0 0 0 1" for i, y in enumerate(offsets)]
        path = folder / "trajectory" / f"{name}.txt"
        path.parent.mkdir(exist_ok=True)
        path.write_text("\n".join(rows))
    (folder / "keyframes.json").write_text(json.dumps({"lost_frames": lost_frames}))
    figures = {"trajectory/recognised_frames": 1, "profile/frames_per_second": 2.0}
    (folder / "metrics.json").write_text(json.dumps(figures))
    return folder


def test_frames_before_in_and_behind_a_gap_are_told_apart(tmp_path: Path) -> None:
    off_m = [0.01] * 10 + [5.0] * 5 + [0.02] * 4 + [0.04] * 10
    found = outcome(write_run(tmp_path, off_m, []), 10, 15)
    assert found.before_cm == pytest.approx(1.0)
    assert found.after_cm == pytest.approx(((4 * 4 + 10 * 16) / 14) ** 0.5)
    assert found.last_cm == pytest.approx(4.0)
    assert (found.lost, found.first_lost, found.recognised) == (0, None, 1)


def test_an_offset_of_the_whole_is_an_error(tmp_path: Path) -> None:
    """Aligned, it would vanish: a camera that is found in another world would seem to be right."""
    found = outcome(write_run(tmp_path, [0.0] * 5 + [0.3] * 5, [5, 6]), 5, 5)
    assert found.before_cm == 0
    assert found.after_cm == pytest.approx(30.0)
    assert found.row().split(" | ")[3:6] == ["2", "5", "1"]
