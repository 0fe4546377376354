"""Each process of a run killed at a moment of its own, and a run told to end by what terminals and schedulers send."""

import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from xrdslam.core.errors import RunError
from xrdslam.engine import resume
from xrdslam.engine.checkpoints import newest_checkpoint
from xrdslam.testing.killing import LIMIT_S, PHASES, Victim, kill, saved_in
from xrdslam.testing.toy_plugin import toy_registry
from xrdslam.testing.victim import NUM_FRAMES

LENGTHS = dict(zip(PHASES, (2.0, 0.5, 0.3, 0.5), strict=True))
"""About how long each phase takes [s]; a moment that falls into the next one is as good."""
DRAWN = random.Random(6)
SHARE_OF_THE_PARENT = DRAWN.random()


@pytest.mark.parametrize(
    ("role", "phase", "share"),
    [
        (role, phase, DRAWN.random())
        for role, phase in (("server", "start-up"), ("tracker", "start-up"), ("mapper", "finishing"))
    ],
)
def test_a_run_of_which_a_process_is_killed_ends_says_so_and_saves(
    tmp_path: Path, role: str, phase: str, share: float
) -> None:
    outcome = kill(role, phase, share, LENGTHS, tmp_path)
    assert outcome.faults() == []


def test_processes_end_with_their_parent_and_resuming_goes_on_or_says_why_not(tmp_path: Path) -> None:
    outcome = kill("parent", "frames", SHARE_OF_THE_PARENT, LENGTHS, tmp_path)
    assert outcome.is_struck
    assert outcome.exit_status == -signal.SIGKILL
    assert outcome.faults() == []
    if newest_checkpoint(tmp_path / "run") is not None:
        assert resume(tmp_path / "run", registry=toy_registry()).exit_status == 0
    else:
        with pytest.raises(RunError, match="left no checkpoint; begin a new one"):
            resume(tmp_path / "run", registry=toy_registry())


def stop(victim: Victim, send: Callable[[int], None], number: signal.Signals) -> float:
    """Send a signal once three frames are mapped; return how long the run then takes [s]."""
    assert victim.wait_for(lambda: victim.frames_done >= 3), victim.lines
    victim.traces.look()
    send(number)
    began_s = time.monotonic()
    return victim.end() - began_s


@pytest.mark.parametrize(
    ("engine", "whom", "number"),
    [
        ("multiprocess", "group", signal.SIGINT),
        ("multiprocess", "group", signal.SIGTERM),
        ("multiprocess", "mapper", signal.SIGTERM),
        ("sequential", "group", signal.SIGHUP),
    ],
)
def test_a_run_that_is_told_to_end_saves_and_ends_whoever_is_told(
    tmp_path: Path, engine: str, whom: str, number: signal.Signals
) -> None:
    victim = Victim(tmp_path, engine)

    def send(number: int) -> None:
        pid = victim.process.pid if whom == "group" else victim.pid(whom)
        assert pid is not None
        (os.killpg if whom == "group" else os.kill)(pid, number)

    seconds = stop(victim, send, number)
    assert victim.process.returncode == 130, victim.lines
    assert seconds < LIMIT_S
    frames, has_map, has_metrics = saved_in(victim.run_dir)
    assert 3 <= frames <= NUM_FRAMES
    assert has_map
    assert has_metrics
    assert victim.traces.left() == []
    assert any("interrupted after" in line for line in victim.lines)
    assert not any("Traceback" in line for line in victim.lines)
