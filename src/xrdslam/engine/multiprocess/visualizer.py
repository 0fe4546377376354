"""The Visualizer process: the viewer of a run, shown the newest frame whenever it has time for one."""

import os
import pickle
from contextlib import closing
from enum import StrEnum
from multiprocessing.connection import Connection, wait

from xrdslam.core.algorithm import Algorithm
from xrdslam.core.frame import Frame
from xrdslam.engine.context import Run
from xrdslam.engine.directory import RunDirectory
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.child import Say
from xrdslam.engine.multiprocess.messages import Mapped, Message, Tracked
from xrdslam.engine.multiprocess.replica import Replica
from xrdslam.engine.multiprocess.roles import Role
from xrdslam.engine.multiprocess.shared_state import SharedState
from xrdslam.engine.multiprocess.worker import Job, work

__all__ = ["METRICS", "TRAJECTORY", "UP", "Order", "show_all"]

NICENESS = 10
"""Whoever computes for the run goes first where cores are short."""
TRAJECTORY = "trajectory."
METRICS = "metrics"
UP = "up"
"""What the visualizer says once the viewer is made."""


class Order(StrEnum):
    """What the parent says, a word at a time, so that it need not wait for anybody to listen."""

    FINISHED = "finished"
    """The run is over; how it ended lies in the farewell."""
    CLOSE = "close"


def show_all(packed: bytes, channels: Channels, orders: Connection, farewell: SharedState, say: Say) -> None:
    """Be the visualizer of a run: what its process calls; `packed` is its Job."""
    os.nice(NICENESS)
    work(packed, lambda job, _: VisualizerProcess(job, channels, orders, farewell).run(say), channels, say)


class VisualizerProcess:
    """Follows the run by its steps, as every process does, and calls the viewer's hooks; the run never waits for it.

    It holds no frame back: what is gone by the time that the viewer is ready is dropped.
    """

    def __init__(self, job: Job, channels: Channels, orders: Connection, farewell: SharedState) -> None:
        self.job = job
        self.channels = channels
        self.orders = orders
        self.farewell = farewell
        self.registry = job.registry
        self.viewer = self.registry.viewer(job.config.viewer.name).load()(job.config.viewer)
        self.algorithm: Algorithm = job.algorithm()
        self.replica = Replica(
            self.algorithm, job.scene, channels.algorithm(), Role.VISUALIZER, channels.frames, None, ()
        )
        self._seen = Run(job.config, RunDirectory(job.run_dir), job.dataset, self.algorithm, self.registry, job.device)
        self._frames: dict[int, Frame] = {}

    def run(self, say: Say) -> None:
        """Show frames until the parent says that it is enough."""
        buffer = self.channels.viz_buffer
        with closing(self.viewer), self.registry.listening(self.viewer, f"viewer={self.job.config.viewer.name}"):
            say(UP)
            self._notify("run_started")
            while True:
                if buffer.fileno() in wait([buffer.fileno(), self.orders]):
                    buffer.silence()
                    self._follow()
                elif self._obey(self.orders.recv()):
                    return

    def _obey(self, order: Order) -> bool:
        if order == Order.FINISHED:
            self._finish()
        return order == Order.CLOSE

    def _follow(self) -> None:
        """Catch up with the run; show the newest frame, and how those that were shown went into the map."""
        try:
            messages = list(self.replica.news())
        except (EOFError, OSError):  # the run has ended, and the server with it: its end is in the farewell
            return
        newest = max((m.frame.index for m in messages if isinstance(m, Tracked)), default=None)
        for message in messages:
            self._tell(message, newest)

    def _tell(self, message: Message, newest: int | None) -> None:
        if isinstance(message, Tracked) and message.frame.index == newest:
            frame = self.channels.frames.copy(message.frame)
            is_shown = False
            if frame is not None:
                frame = self._frames[newest] = frame.to(self.job.device)
                is_shown = self._notify("frame_tracked", frame=frame, result=message.result)
            self.channels.viz_buffer.take(newest, is_shown)
        elif isinstance(message, Mapped):
            frame = self._frames.pop(message.index, None)
            if frame is not None and message.result is not None:
                self._notify("map_updated", frame=frame, result=message.result)

    def _notify(self, what: str, **arguments: object) -> bool:
        self.replica.load_latest(self.channels.map, self.channels.changes)
        return self.registry.notify(f"xrdslam_{what}", run=self._seen, **arguments)

    def _finish(self) -> None:
        """Show how the run ended."""
        published = self.farewell.latest()
        tensors = {k.removeprefix(TRAJECTORY): t for k, t in published.tensors.items() if k.startswith(TRAJECTORY)}
        self.algorithm.trajectory.merge(tensors)
        metrics = pickle.loads(published.tensors[METRICS].numpy().tobytes())
        self._notify("run_finished", metrics=metrics)
