"""What a run costs is what this run cost."""

import subprocess
import sys
import time

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


def test_frames_per_second_are_of_the_whole_run_of_tracking_alone_and_of_mapping_alone() -> None:
    frames = [
        FrameCost(i, tracking_ms=500.0 if i == 7 else 250.0, mapping_ms=1000.0 if i == 7 else 0.0) for i in (7, 8, 9)
    ]
    figures = Profile(frames, wall_s=6.0).metrics()
    assert figures["frames_per_second"] == 0.5  # what neither stage accounts for counts too
    assert figures["tracking_frames_per_second"] == 4.0  # without the first frame, whatever its index
    assert figures["mapping_frames_per_second"] == 3.0
    assert (figures["tracking_wall_s"], figures["mapping_wall_s"]) == (1.0, 1.0)


def test_a_stage_counts_wall_and_processor_time() -> None:
    profile, cost = Profile(), FrameCost(0)
    with profile.running():
        with profile.stage(cost, "tracking"):
            time.sleep(0.2)
        with profile.stage(cost, "mapping"):
            busy = time.process_time()
            while time.process_time() - busy < 0.1:
                pass
        with profile.finishing():
            time.sleep(0.05)
    profile.frames.append(cost)
    figures = profile.metrics()
    assert 0.2 <= figures["tracking_wall_s"] <= figures["wall_s"] - 0.1
    assert figures["tracking_cpu_s"] < 0.1
    assert 0.1 <= figures["mapping_cpu_s"] <= figures["cpu_s"]
    assert 0.05 <= figures["finish_wall_s"] < figures["wall_s"]


def test_the_processes_of_a_run_are_added_up() -> None:
    profile = Profile(cpu_s=1.0)
    with profile.running():
        pass
    alone = profile.peak_rss_mib
    assert alone > 10
    profile.add_process(cpu_s=2.5, peak_rss_mib=100.0)
    assert profile.metrics()["cpu_s"] == pytest.approx(3.5, abs=0.1)
    assert profile.metrics()["peak_rss_mib"] == alone + 100


def test_the_peak_is_that_of_the_run_not_of_what_follows() -> None:
    profile = Profile()
    with profile.running():
        pass
    before = profile.peak_rss_mib
    block = np.ones(40_000_000)  # 305 MiB after the run
    assert profile.metrics()["peak_rss_mib"] == before
    del block


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
