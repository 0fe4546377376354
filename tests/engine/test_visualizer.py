"""A viewer, however it behaves, changes nothing in a run but a counter and a line of the log."""

import multiprocessing
import threading
from collections.abc import Iterator
from multiprocessing.connection import wait
from pathlib import Path

import pytest
from safetensors.torch import load_file

from xrdslam.core.config import EngineConfig, MultiprocessConfig
from xrdslam.core.errors import MissingExtraError
from xrdslam.core.frame import Frame
from xrdslam.core.hookspecs import hookimpl
from xrdslam.engine import run
from xrdslam.engine.multiprocess import watching
from xrdslam.engine.multiprocess.viz_buffer import NewestFrame
from xrdslam.testing.bits import different_leaves
from xrdslam.testing.misbehaving_viewers import MisbehavingViewerConfig
from xrdslam.testing.toy_plugin import toy_config, toy_registry

STRICT = MultiprocessConfig(progress=False)


@pytest.fixture(autouse=True)
def _nothing_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    assert not multiprocessing.active_children()
    assert set(threading.enumerate()) <= before


@pytest.fixture(scope="module")
def unwatched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what the sequential engine gives without a viewer, which the turn-by-turn one gives too."""
    folder = tmp_path_factory.mktemp("unwatched")
    run(toy_config(EngineConfig(progress=False)), folder, toy_registry())
    return folder


def viewer(folder: Path, fault: str) -> MisbehavingViewerConfig:
    return MisbehavingViewerConfig(fault=fault, heard=str(folder / "heard.txt"))


def heard(folder: Path) -> list[str]:
    return (folder / "heard.txt").read_text().splitlines()


def assert_same_results(one: Path, two: Path) -> None:
    for name in ("trajectory/online.txt", "trajectory/final.txt", "keyframes.json"):
        assert (one / name).read_text() == (two / name).read_text(), name
    maps = [load_file(folder / "map/map.safetensors") for folder in (one, two)]
    assert not different_leaves(*maps)


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if "viewer=" in record.getMessage()]


def test_a_viewer_that_hangs_loses_frames_and_the_run_nothing(
    tmp_path: Path, unwatched: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It hangs on the first; at the end the newest still waits for it, all others are dropped."""
    monkeypatch.setattr(watching, "PATIENCE_S", 0.5)
    found = run(toy_config(STRICT, viewer=viewer(tmp_path, "slow")), tmp_path, toy_registry())
    assert found.exit_status == 0
    assert_same_results(unwatched, tmp_path)
    assert found.metrics["profile/viewer_drops"] == 5
    assert warnings(caplog) == ["viewer=misbehaving does not close within 0.5 s; it is ended"]


def test_a_viewer_that_raises_is_not_called_again_and_async_without_a_lag_gives_the_sequential_bits(
    tmp_path: Path, unwatched: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watching, "PATIENCE_S", 60.0)  # it closes; the machine may be busy
    engine = MultiprocessConfig(progress=False, sync="async", max_lag=0)
    found = run(toy_config(engine, viewer=viewer(tmp_path, "raises")), tmp_path, toy_registry())
    assert found.exit_status == 0
    assert_same_results(unwatched, tmp_path)
    assert found.metrics["profile/viewer_drops"] in (5, 6), "the last one may still be in the buffer"
    (said,) = warnings(caplog)
    assert "hook xrdslam_frame_tracked of viewer=misbehaving raised ZeroDivisionError" in said
    assert "finished 6 6.0" in heard(tmp_path)


class Killer:
    """Kills the visualizer when frame 2 is tracked."""

    @hookimpl
    def xrdslam_frame_tracked(self, frame: Frame) -> None:
        if frame.index == 2:
            (child,) = (c for c in multiprocessing.active_children() if c.name == "xrdslam-visualizer")
            child.kill()
            child.join(timeout=60)


def test_a_viewer_that_is_killed_is_missed_in_one_line(
    tmp_path: Path, unwatched: Path, caplog: pytest.LogCaptureFixture
) -> None:
    registry = toy_registry()
    registry.register(Killer(), "killer 1.0")
    found = run(toy_config(STRICT, viewer=viewer(tmp_path, "none")), tmp_path, registry)
    assert found.exit_status == 0
    assert_same_results(unwatched, tmp_path)
    assert heard(tmp_path)[0] == "started toy on toy/room0"
    shown = sum(line.startswith("tracked") for line in heard(tmp_path))
    assert found.metrics["profile/viewer_drops"] in (6 - shown, 7 - shown)  # it may die before it says so
    assert warnings(caplog) == ["viewer=misbehaving was killed by SIGKILL; the run goes on without it"]


def test_a_viewer_that_cannot_be_made_is_refused_before_the_first_frame(tmp_path: Path) -> None:
    with pytest.raises(MissingExtraError, match="needs what nobody has"):
        run(toy_config(STRICT, viewer=viewer(tmp_path, "absent")), tmp_path, toy_registry())
    assert (tmp_path / "trajectory/online.txt").read_text().count("\n") == 1, "its head alone"


@pytest.mark.parametrize("fault", ["raises", "closing"])
def test_in_one_process_too_a_viewer_that_raises_costs_no_run(
    tmp_path: Path, unwatched: Path, caplog: pytest.LogCaptureFixture, fault: str
) -> None:
    config = toy_config(EngineConfig(progress=False), viewer=viewer(tmp_path, fault))
    assert run(config, tmp_path, toy_registry()).exit_status == 0
    assert_same_results(unwatched, tmp_path)
    assert len(warnings(caplog)) == 1
    assert "ZeroDivisionError" in warnings(caplog)[0]
    assert "finished 6 6.0" in heard(tmp_path)


def test_the_newest_frame_wins_and_the_others_are_counted() -> None:
    buffer = NewestFrame()
    assert wait([buffer], timeout=0) == []
    for index in range(3):
        buffer.put(index)
    assert wait([buffer], timeout=0) == [buffer]
    assert buffer.num_dropped(has_ended=False) == 2
    assert buffer.num_dropped(has_ended=True) == 3
    buffer.silence()
    assert wait([buffer], timeout=0) == []
    buffer.take(2, is_shown=True)
    assert buffer.num_dropped(has_ended=False) == 2
    buffer.put(3)
    buffer.take(3, is_shown=False)
    assert buffer.num_dropped(has_ended=False) == 3
