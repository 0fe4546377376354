"""A finished run as a viewer plays it: its frames in order, what was rendered of them, its map."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from numpy.typing import NDArray

from xrdslam.core.errors import RunError
from xrdslam.core.surface import PointCloud, TriangleMesh
from xrdslam.evaluation.surface_files import read_mesh
from xrdslam.pictures.clouds import read_cloud
from xrdslam.pictures.outside import Outside
from xrdslam.pictures.panels import Panels, kept_frames, read_panels
from xrdslam.report.run_files import RunFiles, read_run
from xrdslam.report.trajectory_view import error_of

__all__ = ["Recorded"]


@dataclass(frozen=True, eq=False)
class Recorded:
    """Everything a replay shows. The truth is moved onto the estimate, so that both lie in the map's world."""

    run: RunFiles
    truth: Float64[NDArray[np.float64], "n 3"] | None
    errors_cm: Float64[NDArray[np.float64], " n"] | None
    panels: list[Panels]
    mesh: TriangleMesh | None
    cloud: PointCloud | None

    @classmethod
    def read(cls, path: Path) -> "Recorded":
        """Read a run's directory; RunError where no frame was tracked."""
        run = read_run(path)
        if not len(run.indices):
            raise RunError(f"{path}: no frame was tracked, there is nothing to replay")
        error = error_of(run)
        truth = None
        if error is not None and run.ground_truth is not None:
            a = error.alignment
            truth = (run.ground_truth[:, :3, 3] - a.translation) @ a.rotation / a.scale
        folder = path / "renders" / "panels"
        panels = [read_panels(folder, index) for index in kept_frames(folder)]
        mesh_file, cloud_file = path / "map" / "mesh.ply", path / "map" / "cloud.ply"
        mesh = read_mesh(mesh_file) if mesh_file.is_file() else None
        if mesh is not None:
            mesh.colors = read_cloud(mesh_file).colors
        cloud = read_cloud(cloud_file) if cloud_file.is_file() else None
        return cls(run, truth, None if error is None else error.errors_cm, panels, mesh, cloud)

    @property
    def centres(self) -> Float64[NDArray[np.float64], "n 3"]:
        """Camera centres of the final trajectory [m]."""
        return self.run.final[:, :3, 3]

    @property
    def surface(self) -> TriangleMesh | PointCloud:
        """What is drawn of the map; without a map, where the camera was."""
        if self.mesh is not None and len(self.mesh.faces):
            return self.mesh
        if self.cloud is not None and len(self.cloud.points):
            return self.cloud
        return PointCloud(self.centres[np.isfinite(self.centres).all(1)])

    def view(self, aspect: float, turn_deg: float = -28.0) -> Outside:
        """Return where to look at it from."""
        surface = self.surface
        points = surface.vertices if isinstance(surface, TriangleMesh) else surface.points
        return Outside.behind(points, self.run.final, turn_deg, aspect=aspect)

    def panels_at(self, row: int) -> Panels | None:
        """Return the pictures of the latest frame, up to this row's, that has any."""
        before = [panels for panels in self.panels if panels.index <= self.run.indices[row]]
        return before[-1] if before else None

    def caption(self, row: int) -> str:
        """Say which frame it is, and how far off."""
        parts = [f"frame {self.run.indices[row]}"]
        if self.errors_cm is not None and np.isfinite(self.errors_cm[row]):
            parts.append(f"error {self.errors_cm[row]:.2f} cm")
        if self.run.is_lost[row]:
            parts.append("LOST")
        return ", ".join(parts)
