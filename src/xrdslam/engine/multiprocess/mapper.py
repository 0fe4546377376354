"""The Mapper process: puts the frames that were tracked into the map, publishes it, refines it at the end."""

import dataclasses

import torch

from xrdslam.core.frame import Frame
from xrdslam.core.mapping import MappingResult
from xrdslam.engine.multiprocess.channels import Channels, wait_until
from xrdslam.engine.multiprocess.frame_ring import Holder
from xrdslam.engine.multiprocess.messages import Finished, Mapped, Meter, Tracked
from xrdslam.engine.multiprocess.replica import Replica, map_state
from xrdslam.engine.multiprocess.roles import Role
from xrdslam.engine.multiprocess.worker import Job
from xrdslam.engine.profile import FrameCost, Profile, rss_mib
from xrdslam.engine.random_numbers import restore_streams, streams
from xrdslam.engine.stages import Mapper
from xrdslam.ops.threads import warm_up

__all__ = ["map_all"]

MOVED = 1e-9
"""A pose that was carried along with its keyframe differs by more from what was tracked than chains of float64 do."""


def map_all(job: Job, channels: Channels) -> None:
    """Be the mapper of a run."""
    MapperProcess(job, channels).run()


class MapperProcess:
    """Owns the map; each step leaves a published version of it."""

    def __init__(self, job: Job, channels: Channels) -> None:
        self.job = job
        self.channels = channels
        self.algorithm = job.algorithm()
        own = (Mapped, Finished)
        self.replica = Replica(
            self.algorithm, job.scene, channels.algorithm(), Role.MAPPER, channels.frames, Holder.MAPPER, own
        )
        self.profile = Profile()
        self.mapper = Mapper(self.algorithm, self.profile)
        self.meter = Meter()
        self.is_strict = job.config.engine.is_strict
        self._tracked: dict[int, Tracked] = {}
        self._changes = 0
        self._version = 0

    def run(self) -> None:
        """Map frame after frame as they come, then finish."""
        done = 0
        self._take_up()
        self.meter = Meter()
        self.channels.counters.is_up = True
        self.channels.event_processed.set()
        warm_up()  # while the first frame is read
        while (index := self._next(done)) >= 0:
            self._step(index)
            done += 1
            self.channels.counters.mapped = done
            self.channels.event_processed.set()
            self.channels.viz_buffer.ring()
        self._load_changes(self.channels.changes.version)
        if len(self.replica.trajectory):
            self.mapper.finish()
            self._publish()
        profile, changes = self.profile, self.replica.trajectory.take_changes()
        spent = self.meter.read()
        self.replica.record(Finished(changes, self._version, profile.finish_wall_s, profile.finish_cpu_s, spent))

    def _take_up(self) -> None:
        """Be where a checkpoint was written, if that is where the run begins."""
        for _ in self.replica.news():
            published = self.channels.map.latest()
            self._version = published.version
            self.replica.load_map(published)
            self.algorithm.mapping.load_state_dict(self.channels.mapping.latest().tensors)
            restore_streams(self.job.streams["mapper"])

    def _next(self, done: int) -> int:
        """Wait for the next frame and follow what happened meanwhile; -1 after the last."""
        counters = self.channels.counters
        wait_until(lambda: counters.tracked > done, self.channels.event_ready)
        index = self.channels.map_buffer.get()
        for message in self.replica.news():
            if isinstance(message, Tracked):
                self._tracked[message.frame.index] = message
        return index

    def _step(self, index: int) -> None:
        tracked = self._tracked.pop(index)
        self._load_changes(tracked.changes)
        frame = self.replica.frame(index)
        if not self.is_strict:
            self._follow_keyframe(frame)
        cost = FrameCost(index)
        result = self.mapper.step(frame, cost)
        if result is not None or cost.is_keyframe or self._version == 0:
            self._publish()
        if tracked.pauses:
            self.channels.mapping.publish(self.algorithm.mapping.state_dict())
        cost.rss_mib = rss_mib()
        changes, sent = self.replica.trajectory.take_changes(), _sent(result, self.job.with_poses)
        drawn = streams() if tracked.pauses else None
        self.replica.record(
            Mapped(index, changes, cost, sent, cost.is_keyframe, self._version, drawn, self.meter.read())
        )
        self.replica.settle(index, cost.is_keyframe)

    def _load_changes(self, version: int) -> None:
        if version > self._changes and (published := self.channels.changes.read()) is not None:
            self._changes = published.version
            self.replica.load_changes(published)

    def _publish(self) -> None:
        self._version = self.channels.map.publish(map_state(self.algorithm))

    def _follow_keyframe(self, frame: Frame) -> None:
        """Move a frame along with the keyframe that it hangs on, where that moved after the frame was tracked."""
        believed = self.replica.trajectory.pose(frame.index)
        if float((believed - self._online(frame.index)).abs().max()) > MOVED:
            frame.pose.set_(believed.to(frame.rgb))

    def _online(self, index: int) -> torch.Tensor:
        return self.replica.trajectory.state_dict([index])["online"][0]


def _sent(result: MappingResult | None, with_poses: bool) -> MappingResult | None:
    """Return what others are told of a result; only hooks want the poses that moved, which are in the trajectory."""
    return result if result is None or with_poses else dataclasses.replace(result, poses={})
