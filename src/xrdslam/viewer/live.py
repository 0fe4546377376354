"""`viewer=viser`: a run on a page while it goes on."""

import logging
import threading

import numpy as np

from xrdslam.core.frame import Frame
from xrdslam.core.hookspecs import hookimpl
from xrdslam.core.surface import PointCloud
from xrdslam.pictures.outside import Outside
from xrdslam.viewer.config import LiveViewerConfig
from xrdslam.viewer.latest import Budget, Latest
from xrdslam.viewer.snapshot import Snapshot, Watched, keyframe_cloud, picture, rendering_of, thinned
from xrdslam.viewer.stage import Stage

__all__ = ["LiveViewer"]

log = logging.getLogger(__name__)


class LiveViewer:
    """Watches a run through its hooks and shows it from a thread of its own.

    Without a browser a frame costs a look at an empty list. With one, frames are prepared for at most `share` of the
    run's time, and given to the thread without waiting: a browser that is slow or hangs sees fewer, the run goes on.
    """

    def __init__(self, config: LiveViewerConfig) -> None:
        """Open the page; see Stage for what that may raise."""
        self.config = config
        self.stage = Stage(config.host, config.port, "xrdslam")
        self.slot: Latest[Snapshot] = Latest()
        self.budget = Budget(config.share)
        self.unwatched = 0
        """Frames that nobody looked at."""
        self.over_budget = 0
        """Frames that were not shown because the page had had its share of the time."""
        self._heard = 0
        self._done = 0
        self._kept: dict[int, PointCloud] = {}
        self._total = 0
        self._thread = threading.Thread(target=self._show_all, name="viewer", daemon=True)
        self._thread.start()

    @hookimpl
    def xrdslam_run_started(self, run: Watched) -> None:
        """Say where to look."""
        self._total = len(getattr(run, "dataset", ()))
        self.stage.say(f"**{run.title}**, no frame yet", 0.0)
        log.info("watch this run at %s", self.stage.url)

    @hookimpl
    def xrdslam_frame_tracked(self, run: Watched, frame: Frame, result: object) -> None:
        """Count; show a frame that is not mapped too, where somebody looks and there is time."""
        self._heard += 1
        self._done = len(run.algorithm.trajectory)
        if not self.stage.is_watched:
            self.unwatched += 1
        elif not self.budget.is_open:
            self.over_budget += 1
        else:
            with self.budget.spending():
                self.slot.put(self._snapshot(run, frame))

    @hookimpl
    def xrdslam_run_finished(self, run: Watched, metrics: object) -> None:
        """Say that it is over, and what became of the frames."""
        self.stage.say(f"**{run.title}**, finished after {len(run.algorithm.trajectory)} frames", 1.0)
        log.info(
            "the page showed %d of %d frames (%d without a browser, %d over its share of time, %d overtaken by newer)",
            self._heard - self.unwatched - self.over_budget - self.slot.dropped,
            self._heard,
            self.unwatched,
            self.over_budget,
            self.slot.dropped,
        )

    def close(self) -> None:
        """End the thread and the page; a thread that a browser holds up is left behind."""
        self.slot.close()
        self._thread.join(timeout=2.0)
        self.stage.close()

    def _snapshot(self, run: Watched, frame: Frame) -> Snapshot:
        algorithm, camera = run.algorithm, frame.camera
        trajectory = algorithm.trajectory
        keyframes = [trajectory.pose(keyframe.index).numpy() for keyframe in algorithm.keyframes]
        num_lost = int(trajectory.is_lost.sum())
        lost = f", {num_lost} lost" if num_lost else ""
        status = f"**{run.title}**, frame {len(trajectory)} of {self._total}, {len(keyframes)} keyframes{lost}"
        return Snapshot(
            frame_index=frame.index,
            status=status,
            T_world_camera=trajectory.pose(frame.index).numpy(),
            fov_rad=2 * float(np.arctan2(camera.height / 2, camera.fy)),
            aspect=camera.width / camera.height,
            path=trajectory.current()[:, :3, 3].numpy().copy(),
            keyframes=np.stack(keyframes) if keyframes else np.empty((0, 4, 4)),
            rgb=picture(frame.rgb, self.config.width),
            rendering=rendering_of(algorithm, frame, self.config.width),
            cloud=self._cloud(run),
        )

    def _cloud(self, run: Watched) -> PointCloud:
        """Return the map as points, else what keyframes measured."""
        model = getattr(run.algorithm, "model", None)
        if model is not None and model.supports("point_cloud") and model.size:
            return thinned(model.point_cloud(), self.config.max_points)
        return thinned(keyframe_cloud(run.algorithm, self._kept), self.config.max_points)

    def _show_all(self) -> None:
        while (snapshot := self.slot.take()) is not None:
            try:
                self._show(snapshot)
            except Exception as error:  # the page is a convenience: no fault of it may end the thread in silence
                log.warning("frame %d could not be shown: %s: %s", snapshot.frame_index, type(error).__name__, error)

    def _show(self, snapshot: Snapshot) -> None:
        stage = self.stage
        stage.say(snapshot.status, self._done / max(self._total, 1))
        if snapshot.cloud is not None and len(snapshot.cloud.points):
            stage.cloud("map", snapshot.cloud)
            view = Outside.behind(snapshot.cloud.points, snapshot.T_world_camera[None])
            stage.look(view, np.median(snapshot.cloud.points, axis=0))
        stage.path("path", snapshot.path)
        stage.keyframes(snapshot.keyframes)
        stage.camera(snapshot.T_world_camera, snapshot.fov_rad, snapshot.aspect, snapshot.rgb)
        stage.picture("input", snapshot.rgb)
        if snapshot.rendering is not None:
            stage.picture("rendering", snapshot.rendering)
