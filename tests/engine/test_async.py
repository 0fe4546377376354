"""Tracking ahead of mapping: how far it may go, and that nothing is lost or done twice on the way."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from xrdslam.core.config import MultiprocessConfig
from xrdslam.core.errors import ConfigError
from xrdslam.core.pose import OptimizablePose
from xrdslam.core.saved_state import load_state
from xrdslam.core.shared_algorithm import Entry
from xrdslam.core.trajectory import Trajectory
from xrdslam.engine import run
from xrdslam.engine.multiprocess import replica
from xrdslam.engine.multiprocess.messages import Finished, Mapped, Message, Tracked
from xrdslam.testing.toy_plugin import toy_config, toy_registry

NUM_FRAMES, MAX_LAG = 9, 2


class Recorded:
    """A run whose mapping takes far longer than its tracking, and every step of it in the order of the server."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.messages: list[Message] = []
        real = replica.unpack

        def unpack(entry: Entry) -> Message:
            self.messages.append(real(entry))
            return self.messages[-1]

        config = toy_config(MultiprocessConfig(progress=False, sync="async", max_lag=MAX_LAG), NUM_FRAMES)
        config.algo.tracking.iterations, config.algo.mapping.iterations = 2, 15
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(replica, "unpack", unpack)  # of this process, which only follows
            self.summary = run(config, folder, toy_registry())

    @property
    def tracked(self) -> list[Tracked]:
        return [m for m in self.messages if isinstance(m, Tracked)]

    @property
    def mapped(self) -> list[Mapped]:
        return [m for m in self.messages if isinstance(m, Mapped)]

    def num_mapped_before(self, tracked: Tracked) -> int:
        place = next(n for n, m in enumerate(self.messages) if m is tracked)
        return sum(isinstance(m, Mapped) for m in self.messages[:place])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    return Recorded(tmp_path_factory.mktemp("async"))


def test_every_frame_is_tracked_once_and_mapped_once_in_order(recorded: Recorded) -> None:
    assert recorded.summary.exit_status == 0
    assert [m.frame.index for m in recorded.tracked] == list(range(NUM_FRAMES))
    assert [m.index for m in recorded.mapped] == list(range(NUM_FRAMES))
    assert [m.index for m in recorded.mapped if m.is_keyframe] == list(range(0, NUM_FRAMES, 2))
    assert all(m.result is not None for m in recorded.mapped)
    assert recorded.summary.metrics["profile/frames"] == NUM_FRAMES


def test_the_tracker_goes_ahead_and_never_too_far(recorded: Recorded) -> None:
    """Frame n is begun when n frames were handed over, of which at most max_lag may not be mapped yet."""
    lags = [n - recorded.num_mapped_before(m) for n, m in enumerate(recorded.tracked)]
    assert max(lags) <= MAX_LAG
    assert max(lags) > 0, "it went ahead"
    assert lags[1] == 0, "there is no map before the first frame's"


def test_the_map_never_goes_back_and_holds_what_it_must(recorded: Recorded) -> None:
    versions = [m.map_version for m in recorded.tracked]
    assert versions == sorted(versions)
    left = [m.version for m in recorded.mapped]
    for n in range(1, NUM_FRAMES):
        assert versions[n] >= left[max(0, n - 1 - MAX_LAG)]
        assert versions[n] <= left[n - 1], "the future is not known"


def test_adjusted_poses_are_in_the_final_trajectory(recorded: Recorded) -> None:
    """Keyframes are where the mapper's last step left their parameters; other frames keep the motion between them."""
    state, _ = load_state(recorded.folder / "trajectory/trajectory.safetensors")
    trajectory = Trajectory()
    trajectory.load_state_dict(state["trajectory"])
    for n, index in enumerate(state["keyframes"]["indices"].tolist()):
        pose = OptimizablePose.from_matrix(torch.eye(4))
        pose.load_state_dict({name[:-1]: state["keyframes"][name][n] for name in ("rotations", "translations")})
        error = (trajectory.pose(index) - pose.matrix().detach().double()).abs().max()
        assert error < 1e-6, "float32's parameters give a matrix to some 1e-7; a step of adjustment is 1e-3"
    moved = (trajectory.current() - trajectory.online()).abs().amax((1, 2))
    assert (moved[2:] > 1e-5).any(), "an adjustment moves poses by about the learning rate, 1e-3, an iteration"
    assert np.loadtxt(recorded.folder / "trajectory/final.txt").shape == (NUM_FRAMES, 8)


def test_the_last_word_on_the_trajectory_is_the_mappers(recorded: Recorded) -> None:
    assert isinstance(recorded.messages[-1], Finished)


def test_without_a_lag_it_is_turn_by_turn() -> None:
    config = MultiprocessConfig(sync="async", max_lag=0)
    assert config.is_strict
    assert not dataclasses.replace(config, max_lag=1).is_strict
    assert MultiprocessConfig(sync="strict", max_lag=3).is_strict
    with pytest.raises(ConfigError, match=r"engine\.max_lag=-1"):
        MultiprocessConfig(max_lag=-1)
