"""Processes write checkpoints together and are taken up from one: turn by turn with the uninterrupted run's bits."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from xrdslam.core.config import EngineConfig, MultiprocessConfig
from xrdslam.core.errors import ConfigError
from xrdslam.core.frame import Frame
from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.saved_state import load_state
from xrdslam.engine import resume, run
from xrdslam.engine.checkpoints import newest_checkpoint
from xrdslam.testing.bits import different_leaves
from xrdslam.testing.toy_plugin import toy_config, toy_registry

NUM_FRAMES = 9

KILLED = """
import os, signal, sys
from pathlib import Path
from xrdslam.core import files
from xrdslam.core.config import MultiprocessConfig
from xrdslam.engine import run
from xrdslam.testing.toy_plugin import toy_config, toy_registry

written = 0
def replace(source, target, real=os.replace):
    global written
    written += "checkpoint" in str(target)
    if written == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    real(source, target)

files.os.replace = replace
if __name__ == "__main__":
    engine = MultiprocessConfig(progress=False, checkpoint_every=3)
    run(toy_config(engine, int(sys.argv[2])), Path(sys.argv[1]), toy_registry())
"""


class Interrupter:
    """Asks the run to end, as a scheduler does, when a frame is heard of; remembers which were.

    Workers that are ahead of who hears cannot get to the end meanwhile: every second frame waits for a checkpoint.
    """

    def __init__(self, at: int) -> None:
        self.at = at
        self.heard: list[int] = []

    @hookimpl
    def xrdslam_frame_tracked(self, frame: Frame) -> None:
        self.heard.append(frame.index)
        if frame.index == self.at:
            os.kill(os.getpid(), signal.SIGTERM)


def results(folder: Path) -> dict[str, Any]:
    """Return every bit of a run's trajectory and map."""
    return {n: load_state(folder / n)[0] for n in ("trajectory/trajectory.safetensors", "map/map.safetensors")}


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what the sequential engine gives."""
    folder = tmp_path_factory.mktemp("whole")
    run(toy_config(EngineConfig(progress=False), NUM_FRAMES), folder, toy_registry())
    return folder


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run that got SIGKILL while it wrote its second checkpoint."""
    folder = tmp_path_factory.mktemp("killed")
    command = [sys.executable, "-c", KILLED, str(folder), str(NUM_FRAMES)]
    assert subprocess.run(command, check=False, timeout=300).returncode == -signal.SIGKILL
    return folder


def test_one_engine_goes_on_where_the_other_was_killed_or_stopped_with_the_same_bits(
    killed: Path, uninterrupted: Path
) -> None:
    assert newest_checkpoint(killed) == killed / "checkpoint/after_frame_000002.safetensors"
    registry, interrupter = toy_registry(), Interrupter(at=4)
    registry.register(interrupter, "interrupter 1.0")
    assert resume(killed, ["engine=sequential"], registry).was_interrupted
    assert interrupter.heard == [3, 4], "no frame is done twice"
    assert newest_checkpoint(killed) == killed / "checkpoint/after_frame_000004.safetensors"
    ended = resume(killed, ["engine=multiprocess"], registry=toy_registry())
    assert ended.exit_status == 0
    assert ended.metrics["profile/frames"] == NUM_FRAMES
    assert different_leaves(results(uninterrupted), results(killed)) == []
    assert not (killed / "checkpoint").exists()


def test_async_goes_on_after_a_moment_at_which_everything_is_mapped(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    registry, interrupter = toy_registry(), Interrupter(at=3)
    registry.register(interrupter, "interrupter 1.0")
    engine = MultiprocessConfig(progress=False, sync="async", max_lag=3, checkpoint_every=2)
    config = toy_config(engine, NUM_FRAMES)
    config.algo.tracking.iterations, config.algo.mapping.iterations = 2, 10
    assert run(config, tmp_path, registry).was_interrupted
    path = newest_checkpoint(tmp_path)
    assert path is not None
    state, header = load_state(path)
    assert header["frame"] >= 3
    assert f"resume={tmp_path} goes on after frame {header['frame']}" in caplog.text
    with pytest.raises(ConfigError, match=r"would change the result .* engine\.sync=async"):
        resume(tmp_path, ["engine=sequential"], toy_registry())
    kept = range(0, header["frame"] + 1, 2)
    assert state["keyframes"]["indices"].tolist() == list(kept), "every frame up to it is mapped"
    assert len(header["profile"]["frames"]) == header["frame"] + 1
    ended = resume(tmp_path, registry=toy_registry())
    assert ended.exit_status == 0
    assert ended.metrics["profile/frames"] == NUM_FRAMES
    trajectory = results(tmp_path)["trajectory/trajectory.safetensors"]["trajectory"]
    assert trajectory["indices"].tolist() == list(range(NUM_FRAMES))
