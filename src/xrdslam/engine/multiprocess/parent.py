"""The multi-process engine, seen from the process that the user started."""

import logging
import pickle
import time
from contextlib import closing, suppress
from multiprocessing import get_context
from typing import Any

import torch

from xrdslam.core.frame import Frame
from xrdslam.engine.checkpoints import Checkpoints
from xrdslam.engine.context import Run
from xrdslam.engine.interruption import GRACE_S
from xrdslam.engine.multiprocess.accounts import Accounts
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.frame_ring import Holder
from xrdslam.engine.multiprocess.mapper import map_all
from xrdslam.engine.multiprocess.messages import Finished, Mapped, Paused, Tracked
from xrdslam.engine.multiprocess.processes import Processes
from xrdslam.engine.multiprocess.replica import Replica
from xrdslam.engine.multiprocess.resumption import gathered, hand_on
from xrdslam.engine.multiprocess.roles import Role
from xrdslam.engine.multiprocess.tracker import track_all
from xrdslam.engine.multiprocess.watching import Visualizer
from xrdslam.engine.multiprocess.worker import Job
from xrdslam.engine.profile import FrameCost
from xrdslam.engine.progress import ProgressReport
from xrdslam.engine.seeding import num_threads

__all__ = ["run_multiprocess"]

log = logging.getLogger(__name__)
LOOK_EVERY_S = 0.1


def run_multiprocess(run: Run) -> None:
    """Track and map every frame in processes of their own; the run's trajectory, map and profile follow.

    Whatever ends it, no process is left when this returns or raises, and `run` holds the last whole state: what the
    server of the shared algorithm knew, and the last map that was published. A run that is told to end leaves a
    checkpoint of the frame under way, if that ends soon.
    """
    asked_s = time.perf_counter()
    checkpoints = Checkpoints(run)
    channels = Channels.build(get_context("spawn"), run.dataset)
    processes = Processes(channels)
    parent: _Parent | None = None
    try:
        with run.interruption.breaking(GRACE_S), processes.explaining():
            processes.start_server(_readers(run))
            _start_workers(run, processes)  # what they import takes longest
            visualizer = _start_visualizer(run, channels)
            processes.wait_for_server()
            parent = _Parent(run, channels, checkpoints, visualizer, asked_s)
            channels.event_begin.set()
            _go_through(run, parent, processes)
    except (KeyboardInterrupt, Exception):
        log.warning("%s", checkpoints.advice())
        raise
    finally:
        with run.interruption.shielded():
            processes.end_workers()
            if parent is not None:
                parent.take_over()
            processes.end()
            channels.close()


def _go_through(run: Run, parent: "_Parent", processes: Processes) -> None:
    earlier = run.profile.frames
    with ProgressReport(run.title, len(run.dataset), run.config.engine.progress, earlier) as progress:
        try:
            while not parent.is_finished:
                run.interruption.check()
                processes.watch(LOOK_EVERY_S)
                parent.attend()
                parent.follow(progress)
        except KeyboardInterrupt:
            until = time.monotonic() + GRACE_S
            parent.ask_to_pause()
            while parent.may_pause and time.monotonic() < until:
                run.interruption.check()
                processes.watch(LOOK_EVERY_S, is_asked=True)
                parent.follow(progress)
            raise


def _job(run: Run, threads: int) -> Job:
    is_watched = run.config.viewer.name != "none"
    return Job(
        run.config,
        run.dataset,
        run.registry,
        run.device,
        threads,
        run.directory.path,
        run.next_frame,
        run.streams,
        _is_heard(run),
        is_watched,
    )


def _is_heard(run: Run) -> bool:
    return any(run.registry.hears(hook) for hook in ("xrdslam_frame_tracked", "xrdslam_map_updated"))


def _readers(run: Run) -> list[str]:
    """Say who repeats the steps of the run."""
    readers: list[str] = [Role.PARENT, Role.TRACKER, Role.MAPPER]
    return [*readers, Role.VISUALIZER] if run.config.viewer.name != "none" else readers


def _start_workers(run: Run, processes: Processes) -> None:
    """Start tracker and mapper, each with all threads: whoever computes while the other waits has every core."""
    job = pickle.dumps(_job(run, num_threads(run.config.threads)))  # not multiprocessing's, which shares tensors
    processes.start_worker(Role.TRACKER, job, track_all)
    processes.start_worker(Role.MAPPER, job, map_all)


def _start_visualizer(run: Run, channels: Channels) -> Visualizer | None:
    """Start the viewer, if one was chosen; it is closed when the run is measured and everything is saved."""
    if run.config.viewer.name == "none":
        return None
    visualizer = Visualizer(_job(run, threads=1), channels)
    run.closing.enter_context(closing(visualizer))
    run.closing.enter_context(run.registry.listening(visualizer, visualizer.name))
    return visualizer


class _Parent:
    """Follows what the workers do: hooks, progress, costs, and the state that is saved."""

    def __init__(
        self,
        run: Run,
        channels: Channels,
        checkpoints: Checkpoints,
        visualizer: Visualizer | None,
        asked_s: float,
    ) -> None:
        self.run = run
        self.channels = channels
        self.checkpoints = checkpoints
        self.visualizer = visualizer
        self.accounts = Accounts(run.profile, asked_s)
        self.is_heard = _is_heard(run)
        self.is_finished = False
        self.is_paused = False
        self._is_alone = False
        self._frames: dict[int, tuple[Tracked, Frame]] = {}
        self._costs: dict[int, FrameCost] = {}
        self._drawn: dict[str, Any] | None = None
        resumed = hand_on(run, channels) if run.resumed_after else None
        self._steps = channels.algorithm()
        self._replica = Replica(run.algorithm, run.scene, self._steps, Role.PARENT, channels.frames, None, ())
        if resumed is not None:
            self._replica.record(resumed)
            self.follow()
            self._load_map()

    def follow(self, progress: ProgressReport | None = None) -> None:
        """Repeat here what was recorded since the last call."""
        for message in self._replica.news():
            self.accounts.note(message)
            if isinstance(message, Tracked):
                self._tracked(message)
            elif isinstance(message, Mapped):
                self._mapped(message, progress)
            elif isinstance(message, Paused):
                self._save(message)
            elif isinstance(message, Finished):
                run = self.run
                run.profile.finish_wall_s, run.profile.finish_cpu_s = message.finish_wall_s, message.finish_cpu_s
                self.is_finished = True

    @property
    def may_pause(self) -> bool:
        """Whether tracker and mapper are under way."""
        counters = self.channels.counters
        return counters.is_up and counters.may_begin and not (self.is_paused or self.is_finished)

    def ask_to_pause(self) -> None:
        """Let the frame under way be the last."""
        self.channels.counters.is_asked = True

    def _save(self, paused: Paused) -> None:
        """Write a checkpoint while tracker and mapper wait; let them go on, unless they were asked to pause."""
        counters = self.channels.counters
        self.accounts.settle()
        self._load_map()
        state = gathered(self.run.algorithm, self.channels)
        self.checkpoints.save(state, {"streams": self._drawn, "tracker_streams": paused.streams})
        self.is_paused = counters.is_asked
        if not self.is_paused:
            self.accounts.go_on(paused)
            counters.saved = counters.tracked
            self.channels.event_processed.set()

    def attend(self) -> None:
        """Look after the viewer, and let the run begin once it is there, or not waited for."""
        if self.visualizer is not None:
            self.visualizer.attend()
            if self.visualizer.has_ended and not self._is_alone:
                self._is_alone = True
                self._steps.forget(Role.VISUALIZER)
        if not self.channels.counters.may_begin and (self.visualizer is None or self.visualizer.is_settled):
            self.channels.counters.may_begin = True
            self.channels.event_processed.set()

    def take_over(self) -> None:
        """Take the last state that there is, whoever is alive to tell."""
        with suppress(EOFError, OSError):  # the server is gone: what it said before is what is known
            self.follow()
        self._load_map()
        self.accounts.settle()
        if self.visualizer is not None:
            self.accounts.count_drops(self.channels.viz_buffer.num_dropped(self.visualizer.has_ended))

    def _tracked(self, message: Tracked) -> None:
        run, placed = self.run, message.frame
        self._costs[placed.index] = message.cost
        given = placed.T_world_camera_gt
        run.note_truth(placed.index, None if given is None else torch.from_numpy(given))
        if self.is_heard:
            frame = self._replica.frame(placed.index)
            self._frames[placed.index] = message, frame
            self._load_map()
            run.registry.notify("xrdslam_frame_tracked", run=run, frame=frame, result=message.result)

    def _mapped(self, message: Mapped, progress: ProgressReport | None) -> None:
        run, cost = self.run, self._costs.pop(message.index)
        if self.is_heard:
            tracked, frame = self._frames.pop(message.index)
            if message.result is not None:
                self._load_map()
                run.registry.notify("xrdslam_map_updated", run=run, frame=frame, result=message.result)
            self.channels.frames.let_go(tracked.frame, Holder.PARENT)
        self._drawn = message.streams or self._drawn
        for name in ("mapping_ms", "mapping_cpu_ms", "mapping_iterations", "map_size", "is_keyframe"):
            setattr(cost, name, getattr(message.cost, name))
        cost.rss_mib += message.cost.rss_mib
        run.profile.frames.append(cost)
        if progress is not None:
            progress.update(cost)

    def _load_map(self) -> None:
        self._replica.load_latest(self.channels.map, self.channels.changes)
