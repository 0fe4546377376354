"""The Tracker process: reads the sequence, finds the pose of each frame, hands it on."""

import time
from contextlib import closing

from torch import Tensor

from xrdslam.core.algorithm import Algorithm
from xrdslam.core.frame import Frame
from xrdslam.core.tracking import TrackingMethod, TrackingResult
from xrdslam.datasets.prefetch import prefetch
from xrdslam.engine.multiprocess.channels import Channels, wait_until
from xrdslam.engine.multiprocess.frame_ring import Holder, PlacedFrame
from xrdslam.engine.multiprocess.messages import Meter, Paused, Tracked
from xrdslam.engine.multiprocess.replica import TRACKING, Replica
from xrdslam.engine.multiprocess.resumption import load_tracker_state, tracker_state
from xrdslam.engine.multiprocess.roles import Role
from xrdslam.engine.multiprocess.shared_state import Published
from xrdslam.engine.multiprocess.worker import Job
from xrdslam.engine.profile import FrameCost, Profile, rss_mib
from xrdslam.engine.random_numbers import restore_streams, streams
from xrdslam.engine.stages import Tracker
from xrdslam.ops.threads import warm_up

__all__ = ["track_all"]


def track_all(job: Job, channels: Channels) -> None:
    """Be the tracker of a run."""
    TrackerProcess(job, channels).run()


class TrackerProcess:
    """Tracks each frame against the map as it was last published."""

    def __init__(self, job: Job, channels: Channels) -> None:
        self.job = job
        self.channels = channels
        self.algorithm = job.algorithm()
        steps, own = channels.algorithm(), (Tracked, Paused)
        self.replica = Replica(self.algorithm, job.scene, steps, Role.TRACKER, channels.frames, Holder.TRACKER, own)
        self.tracker = Tracker(self.algorithm, job.scene, Profile())
        self.is_strict = job.config.engine.is_strict
        self._map: Published | None = None
        self._changes = 0
        self.meter = Meter()

    def run(self) -> None:
        """Track every frame, then hand over what the end of the run needs."""
        holders = [Holder.TRACKER, Holder.MAPPER, *([Holder.PARENT] if self.job.is_heard else [])]
        ring = self.channels.frames
        counters, processed = self.channels.counters, self.channels.event_processed
        self._take_up()
        wait_until(lambda: counters.is_up and counters.may_begin, processed)  # starting is no part of the run
        read = self.job.dataset.frames(self.job.next_frame)
        with closing(prefetch(ring.fill(read, holders), self.job.device)) as frames:
            self.meter = Meter()
            asked = time.perf_counter()
            for frame in frames:
                cost = FrameCost(frame.index, reading_ms=1e3 * (time.perf_counter() - asked))
                self._step(ring.take(frame.index), frame, cost)
                asked = time.perf_counter()
        self._wait_for_the_map(may_lag=0)
        self._publish_changes(at_the_end=True)
        self._hand_over(-1)

    def _take_up(self) -> None:
        """Be where a checkpoint was written, if that is where the run begins."""
        for _ in self.replica.news():
            self._map = self.channels.map.latest()
            self.replica.load_map(self._map)
            load_tracker_state(self.algorithm, self.channels.tracking.latest().tensors)
            restore_streams(self.job.streams["tracker"])

    def _step(self, placed: PlacedFrame, frame: Frame, cost: FrameCost) -> None:
        self._wait_for_the_map(0 if self.is_strict else self.job.config.engine.max_lag)
        result = self.tracker.step(frame, cost)
        self._publish_changes()
        cost.rss_mib = rss_mib()
        tracked = Tracked(
            placed.at(frame),
            self.replica.trajectory.take_changes(),
            cost,
            _sent(result, self.job.with_poses),
            self._changes,
            self._map.version if self._map else 0,
            self._pauses(),
            self.meter.began_s,
            self.meter.read(),
        )
        self.replica.hold(tracked, frame)
        self.replica.record(tracked)
        self._hand_over(frame.index)
        self.channels.viz_buffer.put(frame.index)
        if self.channels.counters.tracked == 1:
            warm_up()  # there is time for it while the first frame is mapped
        if tracked.pauses:
            self._pause(frame.index)

    def _pauses(self) -> bool:
        every, counters = self.job.config.engine.checkpoint_every, self.channels.counters
        return counters.is_asked or (every > 0 and len(self.algorithm.trajectory) % every == 0)

    def _pause(self, index: int) -> None:
        """Wait until the mapper has caught up, say what there is to be known, wait until it is written down."""
        self._wait_for_the_map(may_lag=0)
        self.channels.tracking.publish(tracker_state(self.algorithm))
        self.replica.record(Paused(index, streams(), self.meter.read()))
        counters = self.channels.counters
        wait_until(lambda: counters.saved == counters.tracked, self.channels.event_processed)

    def _wait_for_the_map(self, may_lag: int) -> None:
        """Wait until the map is no more than some frames behind; follow what happened meanwhile."""
        counters = self.channels.counters
        behind = min(may_lag, max(0, counters.tracked - 1))  # there is no map before the first frame's
        wait_until(lambda: counters.tracked - counters.mapped <= behind, self.channels.event_processed)
        for _ in self.replica.news():
            pass
        if self.channels.map.version > (self._map.version if self._map else 0):
            self._map = self.channels.map.latest()
            self.replica.load_map(self._map)

    def _publish_changes(self, at_the_end: bool = False) -> None:
        """Hand over what tracking changed in the map, bit by bit; at the end what it knows itself, where asked for."""
        changes: dict[str, Tensor] = {}
        if self.is_strict or not self.algorithm.mapping.changes_map or self._map is None:
            changes = self.replica.changes_since(self._map)
        if at_the_end and _finishes(self.algorithm):
            changes |= {f"{TRACKING}{name}": t for name, t in self.algorithm.tracking.state_dict().items()}
        base = self._map.version if self._map else 0
        self._changes = self.channels.changes.publish(changes, base) if changes else 0

    def _hand_over(self, index: int) -> None:
        self.channels.map_buffer.put(index)
        self.channels.counters.tracked += 1
        self.channels.event_ready.set()


def _finishes(algorithm: Algorithm) -> bool:
    """Say whether the tracker's inner state is needed after the last frame."""
    return (
        type(algorithm.tracking).finish is not TrackingMethod.finish or type(algorithm).finish is not Algorithm.finish
    )


def _sent(result: TrackingResult, with_poses: bool) -> TrackingResult:
    """Return what others are told of a result; only hooks want the poses that moved, which are in the trajectory."""
    return result._replace(poses=dict(result.poses) if with_poses else {})
