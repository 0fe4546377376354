"""The sequential engine: one process, frame after frame; the same seed gives the same bits."""

import logging
import time
from contextlib import closing

from xrdslam.core.frame import Frame
from xrdslam.datasets.prefetch import prefetch
from xrdslam.engine.checkpoints import Checkpoints
from xrdslam.engine.context import Run
from xrdslam.engine.interruption import GRACE_S
from xrdslam.engine.profile import FrameCost, rss_mib
from xrdslam.engine.progress import ProgressReport
from xrdslam.engine.stages import Mapper, Tracker

__all__ = ["run_sequential"]

log = logging.getLogger(__name__)


def run_sequential(run: Run) -> None:
    """Track and map every frame, then refine; the run's trajectory, profile and ground truth grow as frames pass.

    Whatever ends it between two frames leaves a checkpoint of that moment; inside a frame, the one before stays.
    """
    checkpoints = Checkpoints(run)
    try:
        with run.interruption.breaking(GRACE_S):
            _go_through(run, checkpoints)
    except (KeyboardInterrupt, Exception):
        checkpoints.save_if_whole()
        log.warning("%s", checkpoints.advice())
        raise


def _go_through(run: Run, checkpoints: Checkpoints) -> None:
    tracker = Tracker(run.algorithm, run.scene, run.profile)
    mapper = Mapper(run.algorithm, run.profile)
    progress = ProgressReport(run.title, len(run.dataset), run.config.engine.progress, run.profile.frames)
    with run.profile.running(), progress:
        with closing(prefetch(run.dataset.frames(run.next_frame), run.device)) as frames:
            asked = time.perf_counter()
            for frame in frames:
                cost = FrameCost(frame.index, reading_ms=1e3 * (time.perf_counter() - asked))
                with checkpoints.changing():
                    _step(run, tracker, mapper, frame, cost)
                progress.update(cost)
                checkpoints.save_if_due()
                run.interruption.check()
                asked = time.perf_counter()
        with checkpoints.changing():
            mapper.finish()


def _step(run: Run, tracker: Tracker, mapper: Mapper, frame: Frame, cost: FrameCost) -> None:
    run.note(frame)
    tracked = tracker.step(frame, cost)
    run.registry.notify("xrdslam_frame_tracked", run=run, frame=frame, result=tracked)
    mapped = mapper.step(frame, cost)
    if mapped is not None:
        run.registry.notify("xrdslam_map_updated", run=run, frame=frame, result=mapped)
    cost.rss_mib = rss_mib()
    run.profile.frames.append(cost)
