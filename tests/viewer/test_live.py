"""The live page: what a run pays for it, what a browser sees, what happens without the extra."""

import dataclasses
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from xrdslam.core.algorithm import Algorithm, Scene
from xrdslam.core.errors import ConfigError, MissingExtraError
from xrdslam.core.frame import Frame
from xrdslam.core.registry import Registry
from xrdslam.testing.toy_method import toy_algorithm
from xrdslam.testing.toy_run import write_toy_run
from xrdslam.testing.toy_sequence import toy_sequence
from xrdslam.viewer.config import LiveViewerConfig

FLAGS = "--headless --no-sandbox --disable-background-networking --hide-scrollbars --enable-unsafe-swiftshader"
SOFTWARE_GL = "--use-gl=angle --use-angle=swiftshader --virtual-time-budget=4000"


@dataclasses.dataclass
class ARun:
    """What a viewer reads of a run."""

    algorithm: Algorithm
    dataset: Any
    title: str = "toy on toy/room0"


def carried_out(viewer: object | None = None) -> torch.Tensor:
    """Take the toy method through its room with a viewer listening; return the final poses."""
    registry = Registry()
    sequence = toy_sequence(4, 48, 36)
    run = ARun(toy_algorithm(), sequence)
    algorithm = run.algorithm

    def go() -> None:
        registry.notify("xrdslam_run_started", run=run)
        for frame in sequence:
            result = algorithm.start(Scene.of(sequence), frame) if frame.index == 0 else algorithm.track(frame)
            registry.notify("xrdslam_frame_tracked", run=run, frame=frame, result=result)
            algorithm.map(frame)
        registry.notify("xrdslam_run_finished", run=run, metrics={})

    if viewer is None:
        go()
    else:
        with registry.listening(viewer, "viewer=test"):
            go()
    return algorithm.trajectory.current()


@pytest.fixture
def live() -> Iterator[Any]:
    pytest.importorskip("viser", reason="the extra `viewer` is not installed")
    from xrdslam.viewer.live import LiveViewer

    viewer = LiveViewer(LiveViewerConfig(port=18080, share=1.0))
    yield viewer
    viewer.close()


def test_without_a_browser_nothing_is_prepared(live: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(live), "_snapshot", lambda *_: pytest.fail("nobody looks"))
    carried_out(live)
    assert live.unwatched == 4
    assert live.budget.spent_s == 0


def test_a_watched_run_gives_the_bits_of_an_unwatched_one(live: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(live.stage), "is_watched", True)
    shown: list[int] = []
    monkeypatch.setattr(type(live), "_show", lambda _, snapshot: shown.append(snapshot.frame_index))
    watched = carried_out(live)
    live.close()
    assert shown, "the thread showed something"
    assert shown == sorted(shown)
    assert torch.equal(watched, carried_out())


def test_a_page_that_hangs_costs_the_run_nothing_and_drops_are_counted(
    live: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    hang = threading.Event()
    monkeypatch.setattr(type(live.stage), "is_watched", True)
    monkeypatch.setattr(type(live), "_show", lambda *_: hang.wait(60))
    start = time.perf_counter()
    carried_out(live)
    assert time.perf_counter() - start < 30
    hang.set()
    assert live.slot.dropped >= 2  # one hangs, one waits


def test_time_over_the_share_is_not_spent(live: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(type(live.stage), "is_watched", True)
    live.budget.spent_s = 1e6
    carried_out(live)
    assert live.over_budget == 4


def test_a_page_that_breaks_is_said_and_the_thread_goes_on(
    live: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(type(live.stage), "is_watched", True)
    seen = threading.Event()

    def broken(_: object, snapshot: Any) -> None:
        if snapshot.frame_index == 0:
            raise ValueError("a fault of the page")
        seen.set()

    monkeypatch.setattr(type(live), "_show", broken)
    carried_out(live)
    assert seen.wait(10)
    assert "a fault of the page" in caplog.text


def test_keyframes_measurements_stand_in_for_a_map_without_points() -> None:
    from xrdslam.viewer.snapshot import keyframe_cloud

    frame: Frame = toy_sequence(1, 32, 24)[0]
    algorithm = toy_algorithm()
    assert len(keyframe_cloud(algorithm, {}).points) == 0
    algorithm.keyframes = [frame]
    algorithm.trajectory.append(0, 0, torch.eye(4))
    cloud = keyframe_cloud(algorithm, {})
    np.testing.assert_allclose(cloud.points, frame.points_camera().numpy(), atol=1e-6)
    algorithm.trajectory.update(0, torch.tensor([[1.0, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]))
    np.testing.assert_allclose(keyframe_cloud(algorithm, {}).points - cloud.points, [[5, 0, 0]] * len(cloud.points))


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from xrdslam.viewer.stage import Stage

    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtraError, match=r"xrdslam\[viewer\]"):
        Stage("127.0.0.1", 18080, "title")


@pytest.mark.parametrize("setting", [{"port": 0}, {"share": 0.0}, {"width": 3}, {"max_points": 0}])
def test_nonsense_is_refused(setting: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=f"viewer.{next(iter(setting))}="):
        LiveViewerConfig(**setting)


def test_a_browser_shows_the_replay_of_a_run(tmp_path: Path) -> None:
    pytest.importorskip("viser", reason="the extra `viewer` is not installed")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("no chromium is installed: nothing can look at the page")
    from xrdslam.viewer.recorded import Recorded
    from xrdslam.viewer.replay import Replay

    replay = Replay(Recorded.read(write_toy_run(tmp_path / "run")), port=18090)
    try:
        replay.show(5)
        shot, profile = tmp_path / "shot.png", f"--user-data-dir={tmp_path / 'profile'}"
        options = [*FLAGS.split(), *SOFTWARE_GL.split(), profile, "--window-size=760,480", f"--screenshot={shot}"]
        subprocess.run([chromium, *options, replay.stage.url], capture_output=True, check=True, timeout=90)
    finally:
        replay.close()
    image = cv2.imread(str(shot))
    assert image is not None
    scene = image[60:460, 20:420].reshape(-1, 3).astype(int)
    coloured = (scene.max(1) - scene.min(1)) > 30  # the mesh has the colours of a cube of colour, the page is grey
    assert coloured.mean() > 0.05
