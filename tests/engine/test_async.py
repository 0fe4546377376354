"""Tracking ahead of mapping: how far it may go, and that nothing is lost or done twice on the way."""

import dataclasses
import pickle
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from xrdslam.core.config import MultiprocessConfig
from xrdslam.core.errors import ConfigError
from xrdslam.core.geometry import se3
from xrdslam.core.pose import OptimizablePose
from xrdslam.core.saved_state import load_state
from xrdslam.core.shared_algorithm import Entry, SharedAlgorithm
from xrdslam.core.trajectory import Trajectory
from xrdslam.engine import run
from xrdslam.engine.build import build_dataset
from xrdslam.engine.multiprocess import replica
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.frame_ring import Holder
from xrdslam.engine.multiprocess.mapper import MapperProcess
from xrdslam.engine.multiprocess.messages import Finished, Mapped, Message, Tracked
from xrdslam.engine.multiprocess.processes import Processes
from xrdslam.engine.multiprocess.roles import Role
from xrdslam.engine.multiprocess.tracker import TrackerProcess
from xrdslam.engine.multiprocess.worker import Job, Work
from xrdslam.engine.profile import FrameCost
from xrdslam.testing.toy_plugin import toy_config, toy_registry

NUM_FRAMES, MAX_LAG = 9, 2


class Recorded:
    """A run whose mapping takes far longer than its tracking, and every step of it in the order of the server."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.messages: list[Message] = []
        self.threads: dict[str, int] = {}
        real, start_worker = replica.unpack, Processes.start_worker

        def unpack(entry: Entry) -> Message:
            self.messages.append(real(entry))
            return self.messages[-1]

        def start(processes: Processes, role: str, packed: bytes, task: Work) -> None:
            self.threads[role] = pickle.loads(packed).threads
            start_worker(processes, role, packed, task)

        config = toy_config(MultiprocessConfig(progress=False, sync="async", max_lag=MAX_LAG), NUM_FRAMES)
        config.algo.tracking.iterations, config.algo.mapping.iterations = 2, 15
        config.threads = 2
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Processes, "start_worker", start)
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


def test_who_computes_while_the_other_waits_has_every_core(recorded: Recorded) -> None:
    assert recorded.threads == {Role.TRACKER: 2, Role.MAPPER: 2}


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


class Stepped:
    """Tracker and mapper of a run in this process; what each does when is the test's."""

    def __init__(self, folder: Path, num_frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
        config = toy_config(MultiprocessConfig(progress=False, sync="async", max_lag=MAX_LAG), num_frames)
        registry = toy_registry()
        dataset = build_dataset(config, registry)
        self.shared = SharedAlgorithm([Role.TRACKER, Role.MAPPER])
        monkeypatch.setattr(Channels, "algorithm", lambda _channels: self.shared)
        self.channels = Channels.build(get_context("spawn"), dataset)
        job = Job(config, dataset, registry, "cpu", 1, folder, 0, {}, is_heard=False, is_watched=False)
        self.tracker, self.mapper = TrackerProcess(job, self.channels), MapperProcess(job, self.channels)
        self.frames = self.channels.frames.fill(dataset.frames(), [Holder.TRACKER, Holder.MAPPER])

    def track(self) -> None:
        frame = next(self.frames)
        self.tracker._step(self.channels.frames.take(frame.index), frame, FrameCost(frame.index))

    def map(self) -> None:
        counters = self.channels.counters
        self.mapper._step(self.mapper._next(counters.mapped))
        counters.mapped += 1


def test_a_frame_is_mapped_where_its_keyframe_was_moved_to_since_it_was_tracked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Stepped(tmp_path, 6, monkeypatch)
    for _ in range(4):
        run.track()
        run.map()
    run.track()
    run.track()  # frame 5 hangs on keyframe 2, which the mapping of frame 4 is to move
    known, believed = run.tracker.replica.trajectory, run.mapper.replica.trajectory
    keyframe, tracked = known.pose(2), known.pose(5)
    run.map()
    begun: list[Tensor] = []
    monkeypatch.setattr(run.mapper.algorithm, "map", lambda frame: begun.append(frame.pose.matrix().detach().double()))
    run.map()
    assert (believed.pose(2) - keyframe).abs().max() > 1e-4, "a step of adjustment is 1e-3"
    T_keyframe_frame = se3.inverse(keyframe) @ tracked
    torch.testing.assert_close(begun[0], believed.pose(2) @ T_keyframe_frame, rtol=0, atol=1e-6)
    assert (begun[0] - tracked).abs().max() > 1e-4


def test_steps_that_both_have_repeated_are_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = Stepped(tmp_path, 8, monkeypatch)
    kept = []
    for _ in range(8):
        run.track()
        run.map()
        kept.append(len(run.shared._entries))
    assert run.shared.record(Entry("finished", -1, b"")) == 16
    assert kept == [2, 4, 4, 4, 4, 4, 4, 4], (
        "those of two frames: that one knows them it says when it asks for the next"
    )


def test_keyframes_of_the_tracker_are_where_the_mapper_moved_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Stepped(tmp_path, 6, monkeypatch)
    for _ in range(5):
        run.track()
        run.map()
    stale = [keyframe.pose.matrix().detach() for keyframe in run.tracker.algorithm.keyframes]
    run.track()
    theirs, ours = run.mapper.algorithm.keyframes, run.tracker.algorithm.keyframes
    assert [keyframe.index for keyframe in ours] == [keyframe.index for keyframe in theirs] == [0, 2, 4]
    for mine, other in zip(ours, theirs, strict=True):
        assert torch.equal(mine.pose.rotation, other.pose.rotation)
        assert torch.equal(mine.pose.translation, other.pose.translation)
    assert (ours[1].pose.matrix().detach() - stale[1]).abs().max() > 1e-5, "frame 4's mapping moved it"
