"""What a run costs is what this run cost."""

import subprocess
import sys

import numpy as np
import pytest

from xrdslam.engine.profile import FrameCost, Profile, peak_rss_mib, rss_mib


def test_the_peak_of_a_large_parent_is_not_its_childs() -> None:
    large = np.ones(60_000_000)  # 458 MiB
    code = "from xrdslam.engine.profile import peak_rss_mib; print(peak_rss_mib())"
    child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert peak_rss_mib() > 458
    assert float(child.stdout) < peak_rss_mib() - 200
    del large


def test_memory_is_counted_in_mebibytes() -> None:
    before = rss_mib()
    block = np.ones(20_000_000)  # 152.6 MiB
    assert 140 < rss_mib() - before < 165
    assert peak_rss_mib() >= rss_mib() - 5
    del block


def test_figures_are_sums_over_the_frames_they_speak_of() -> None:
    costs = ((0, 1.0, 5.0, 100.0, 0, 10, 7), (1, 3.0, 40.0, 60.0, 20, 6, 9), (2, 2.0, 60.0, 0.0, 20, 0, 9))
    frames = [FrameCost(*cost) for cost in costs]
    figures = Profile(frames, wall_s=1.5).metrics()
    assert figures["frames_per_second"] == 2.0
    assert figures["tracking_ms_per_frame"] == 50.0  # the first frame is not tracked
    assert figures["tracking_ms_per_iteration"] == 2.5
    assert figures["mapping_ms_per_iteration"] == 10.0  # over frames that were mapped
    assert figures["map_size"] == 9.0


def test_a_run_without_frames_has_no_rates() -> None:
    figures = Profile().metrics()
    assert figures["frames"] == 0
    assert figures["frames_per_second"] != figures["frames_per_second"]  # NaN
    assert figures["tracking_ms_per_iteration"] != pytest.approx(0)


def test_timing_csv_has_a_row_a_frame() -> None:
    text = Profile([FrameCost(0, is_keyframe=True), FrameCost(1, 1.23456)]).csv()
    rows = [line.split(",") for line in text.splitlines()]
    assert rows[0][:2] == ["index", "reading_ms"]
    assert rows[2][:2] == ["1", "1.235"]
    assert rows[1][-1] == "1"
