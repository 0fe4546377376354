"""A finished run on the page of the live viewer, under a slider of time."""

import logging
import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from xrdslam.core.surface import PointCloud
from xrdslam.pictures.outside import Outside
from xrdslam.pictures.splat_files import read_splats
from xrdslam.viewer.recorded import Recorded
from xrdslam.viewer.snapshot import thinned
from xrdslam.viewer.stage import TRUTH, Stage

__all__ = ["Replay"]

log = logging.getLogger(__name__)

MOST_TRIANGLES, MOST_POINTS, MOST_SPLATS = 400_000, 200_000, 150_000
"""More than a browser turns smoothly."""
FOV_RAD = 0.9
"""Of the frustum drawn for the camera: the run's files do not say."""


class Replay:
    """Serves a recorded run: the map in each form that there is, the path up to the slider, the pictures there."""

    def __init__(self, recorded: Recorded, host: str = "127.0.0.1", port: int = 8080) -> None:
        """Open the page."""
        self.recorded = recorded
        self.stage = Stage(host, port, recorded.run.title)
        self._layers()
        view = recorded.view(aspect=1.4)
        self.stage.look(view, _target(recorded, view))
        if recorded.truth is not None:
            self.stage.path("ground_truth", recorded.truth, TRUTH)
        keyframes = np.isin(recorded.run.indices, recorded.run.keyframes)
        self.stage.keyframes(recorded.run.final[keyframes])
        last = len(recorded.run.indices) - 1
        gui = self.stage.server.gui
        self.slider: Any = gui.add_slider("frame", min=0, max=max(last, 1), step=1, initial_value=last)
        self.playing = gui.add_checkbox("play", False)
        self.speed = gui.add_slider("frames/s", min=1, max=60, step=1, initial_value=15)
        self.slider.on_update(lambda _: self.show(int(self.slider.value)))
        self.show(last)
        self._stopped = threading.Event()
        self._player = threading.Thread(target=self._play, name="player", daemon=True)
        self._player.start()

    def show(self, row: int) -> None:
        """Show a moment."""
        recorded, run = self.recorded, self.recorded.run
        row = min(row, len(run.indices) - 1)
        self.stage.say(f"**{run.title}**, {recorded.caption(row)}", (row + 1) / len(run.indices))
        self.stage.path("path", recorded.centres[: row + 1])
        panels = recorded.panels_at(row)
        aspect = 4 / 3 if panels is None else panels.rgb.shape[1] / panels.rgb.shape[0]
        self.stage.camera(run.final[row], FOV_RAD, aspect, None if panels is None else panels.rgb)
        if panels is not None:
            self.stage.picture("input", panels.rgb)
            self.stage.picture("rendering", panels.rendered_rgb)

    def close(self) -> None:
        """End the page."""
        self._stopped.set()
        self._player.join(timeout=2.0)
        self.stage.close()

    def _play(self) -> None:
        while not self._stopped.wait(1.0 / max(1, int(self.speed.value))):
            if self.playing.value:
                self.slider.value = (int(self.slider.value) + 1) % len(self.recorded.run.indices)

    def _layers(self) -> None:
        """Add each form of the map with a switch; the first is on."""
        recorded, layers = self.recorded, {}
        mesh, cloud = recorded.mesh, recorded.cloud
        if mesh is not None and 0 < len(mesh.faces) <= MOST_TRIANGLES:
            layers["mesh"] = self.stage.mesh("mesh", mesh)
        elif mesh is not None and len(mesh.vertices):
            log.info("the mesh of %d triangles is shown by its corners", len(mesh.faces))
            corners = thinned(PointCloud(mesh.vertices, mesh.colors), MOST_POINTS)
            layers["mesh (its corners)"] = self.stage.cloud("mesh", corners)
        splats = recorded.run.path / "map" / "splats.ply"
        if splats.is_file():
            layers["splats"] = self.stage.splats("splats", read_splats(splats, MOST_SPLATS))
        if cloud is not None and len(cloud.points):
            layers["points"] = self.stage.cloud("points", thinned(cloud, MOST_POINTS))
        for place, (name, handle) in enumerate(layers.items()):
            handle.visible = place == 0
            box = self.stage.server.gui.add_checkbox(name, place == 0)
            box.on_update(_switch(handle))


def _switch(handle: Any) -> Callable[[Any], None]:  # noqa: ANN401  # viser's handle, and its event
    def switch(event: Any) -> None:  # noqa: ANN401
        handle.visible = event.target.value

    return switch


def _target(recorded: Recorded, view: Outside) -> np.ndarray:
    """Return the middle of what is seen."""
    points = recorded.view(1.4).to_camera(_points(recorded))
    ahead = float(np.median(points[:, 2]))
    middle: np.ndarray = view.T_world_camera[:3, 3] + ahead * view.T_world_camera[:3, 2]
    return middle


def _points(recorded: Recorded) -> np.ndarray:
    surface = recorded.surface
    return np.asarray(surface.points if isinstance(surface, PointCloud) else surface.vertices)
