"""A soak's arithmetic: what creeps is told from what grows with the map and the keyframes."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.soak import Soak, read_timing, rolling_median
from xrdslam.testing.toy_run import write_toy_run

FRAMES = np.arange(1000.0)
MAP = 5000 * (1 - np.exp(-FRAMES / 200))
KEYFRAMES = FRAMES // 5 + 1


def soak(rss_mib: np.ndarray) -> Soak:
    return Soak(FRAMES, rss_mib, MAP, KEYFRAMES, 10 + 0.001 * MAP, np.full(1000, 7.0), 0.2)


@pytest.mark.parametrize("creep", [0.0, 0.02])
def test_creep_is_what_neither_map_nor_keyframes_explain(creep: float) -> None:
    """A staircase of keyframes, a map that settles, and a line of `creep` MiB a frame."""
    found = soak(300 + 0.01 * MAP + 0.2 * KEYFRAMES + creep * FRAMES)
    per_primitive, rest = found.creep(found.besides_keyframes())
    assert per_primitive == pytest.approx(0.01, rel=1e-6)
    assert rest == pytest.approx(1000 * creep, abs=1e-6)


def test_a_slope_is_over_a_thousand_frames() -> None:
    assert soak(FRAMES).slope(0.03 * FRAMES) == pytest.approx(30)


def test_one_slow_frame_moves_no_median() -> None:
    values = np.full(100, 5.0)
    values[40] = 1e6
    assert np.array_equal(rolling_median(values), np.full(100, 5.0))


def test_frames_that_are_not_mapped_tell_nothing_of_mapping() -> None:
    values = np.where(np.arange(100) % 5 == 0, 7.0, np.nan)
    assert np.array_equal(rolling_median(values), np.full(100, 7.0))


def test_a_run_is_read_and_drawn(tmp_path: Path) -> None:
    found = read_timing(write_toy_run(tmp_path / "run") / "timing.csv", 96 * 72)
    assert found.keyframes.tolist() == [1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3]
    assert found.map_size[-1] == 1110
    found.draw(tmp_path / "soak.png", "toy")
    assert (tmp_path / "soak.png").stat().st_size > 10_000


def test_a_map_of_fixed_size_explains_nothing() -> None:
    fixed = np.full(len(FRAMES), 5000.0)
    soak = Soak(FRAMES, FRAMES, fixed, FRAMES // 5, FRAMES, FRAMES, 0.1)
    assert soak.creep(500 + 0.02 * FRAMES) == pytest.approx((0.0, 20.0))
