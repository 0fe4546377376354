"""The multi-process engine, seen from the process that the user started."""

import logging
import pickle
from contextlib import closing, suppress
from multiprocessing import get_context

import torch

from xrdslam.core.frame import Frame
from xrdslam.engine.context import Run
from xrdslam.engine.multiprocess.channels import Channels
from xrdslam.engine.multiprocess.frame_ring import Holder
from xrdslam.engine.multiprocess.mapper import map_all
from xrdslam.engine.multiprocess.messages import Mapped, Meter, Spent, Tracked
from xrdslam.engine.multiprocess.processes import Processes
from xrdslam.engine.multiprocess.replica import Replica
from xrdslam.engine.multiprocess.signals import stop_signals
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
    server of the shared algorithm knew, and the last map that was published.
    """
    with stop_signals() as check:
        channels = Channels.build(get_context("spawn"), run.dataset)
        processes = Processes(channels)
        parent: _Parent | None = None
        try:
            with processes.explaining():
                processes.start_server()
                parent = _Parent(run, channels, _start_visualizer(run, channels))
                with ProgressReport(run.title, len(run.dataset), run.config.engine.progress) as progress:
                    _start_workers(run, processes)
                    while not parent.is_finished:
                        check()
                        processes.watch(LOOK_EVERY_S)
                        parent.attend()
                        parent.follow(progress)
        finally:
            processes.end_workers()
            if parent is not None:
                parent.take_over()
            processes.end()
            channels.close()


def _job(run: Run, threads: int) -> Job:
    is_watched = run.config.viewer.name != "none"
    return Job(
        run.config, run.dataset, run.registry, run.device, threads, run.directory.path, _is_heard(run), is_watched
    )


def _is_heard(run: Run) -> bool:
    return any(run.registry.hears(hook) for hook in ("xrdslam_frame_tracked", "xrdslam_map_updated"))


def _start_workers(run: Run, processes: Processes) -> None:
    threads = num_threads(run.config.threads)
    for role, task, share in (("tracker", track_all, threads // 2), ("mapper", map_all, threads - threads // 2)):
        own = threads if run.config.engine.sync == "strict" else max(1, share)
        job = pickle.dumps(_job(run, own))  # not multiprocessing's pickle, which shares tensors
        processes.start_worker(role, job, task)


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

    def __init__(self, run: Run, channels: Channels, visualizer: Visualizer | None) -> None:
        self.run = run
        self.channels = channels
        self.visualizer = visualizer
        self.is_heard = _is_heard(run)
        self.is_finished = False
        self._replica = Replica(run.algorithm, run.scene, channels.algorithm(), channels.frames, None, ())
        self._frames: dict[int, tuple[Tracked, Frame]] = {}
        self._costs: dict[int, FrameCost] = {}
        self._spent: dict[str, Spent] = {}
        self._began_s = 0.0
        self._meter = Meter()

    def follow(self, progress: ProgressReport | None = None) -> None:
        """Repeat here what was recorded since the last call."""
        for message in self._replica.news():
            self._spent[type(message).__name__] = message.spent
            if isinstance(message, Tracked):
                self._tracked(message)
            elif isinstance(message, Mapped):
                self._mapped(message, progress)
            else:
                run = self.run
                run.profile.finish_wall_s, run.profile.finish_cpu_s = message.finish_wall_s, message.finish_cpu_s
                self.is_finished = True

    def attend(self) -> None:
        """Look after the viewer, and let the run begin once it is there, or not waited for."""
        if self.visualizer is not None:
            self.visualizer.attend()
        if not self.channels.counters.may_begin and (self.visualizer is None or self.visualizer.is_settled):
            self.channels.counters.may_begin = True
            self.channels.event_processed.set()

    def take_over(self) -> None:
        """Take the last state that there is, whoever is alive to tell."""
        with suppress(EOFError, OSError):  # the server is gone: what it said before is what is known
            self.follow()
        self._load_map()
        self._account()

    def _tracked(self, message: Tracked) -> None:
        run, placed = self.run, message.frame
        self._began_s = message.began_s
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
        for name in ("mapping_ms", "mapping_cpu_ms", "mapping_iterations", "map_size", "is_keyframe"):
            setattr(cost, name, getattr(message.cost, name))
        cost.rss_mib += message.cost.rss_mib
        run.profile.frames.append(cost)
        if progress is not None:
            progress.update(cost)

    def _load_map(self) -> None:
        self._replica.load_latest(self.channels.map, self.channels.changes)

    def _account(self) -> None:
        """Add up what the processes used; the clock runs from the first frame's reading to the last refinement."""
        profile, spent, own = self.run.profile, self._spent, self._meter.read()
        mapper = spent.get("Finished") or spent.get("Mapped")
        workers = [s for s in (spent.get("Tracked"), mapper) if s is not None]
        if workers:
            profile.wall_s = max(s.at_s for s in workers) - self._began_s
        for process in (own, *workers):
            profile.add_process(process.cpu_s, process.peak_rss_mib)
        if self.visualizer is not None:
            dropped = self.channels.viz_buffer.num_dropped(self.visualizer.has_ended)
            profile.viewer_drops = (profile.viewer_drops or 0) + dropped
