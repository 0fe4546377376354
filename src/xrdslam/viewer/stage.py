"""The page: a scene and a column of pictures, served by viser on one port."""

import contextlib
import io
import logging
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from xrdslam.core.errors import MissingExtraError, RunError
from xrdslam.core.surface import PointCloud, TriangleMesh
from xrdslam.pictures.outside import Outside
from xrdslam.pictures.splat_files import Splats

__all__ = ["Stage"]

TRUTH, ESTIMATE = (150, 156, 166), (13, 124, 120)
FOV_RAD = 0.62
"""Of a browser's eye, vertically: about what pictures from outside are drawn with."""


class Stage:
    """What is shown on a page. Every method may be called from any thread, and returns before a browser has seen it."""

    def __init__(self, host: str, port: int, title: str) -> None:
        """Serve a page; MissingExtraError without viser, RunError where no port can be had."""
        try:
            import viser
        except ImportError as error:
            raise MissingExtraError(
                "viewer=viser needs the package viser; pip install 'xrdslam[viewer]', or leave it out (viewer=none)"
            ) from error
        logging.getLogger("websockets").setLevel(logging.CRITICAL)  # a browser that goes away is no error of a run
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # we say where to look
                self.server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        except OSError as error:
            raise RunError(f"viewer.host={host} viewer.port={port}: no page can be served ({error})") from error
        self.url = f"http://{host}:{self.server.get_port()}"
        self.status: Any = self.server.gui.add_markdown(f"**{title}**")
        self.progress: Any = self.server.gui.add_progress_bar(0.0)
        self._images: dict[str, Any] = {}
        self._has_view = False

    @property
    def is_watched(self) -> bool:
        """Say whether a browser is connected."""
        return bool(self.server.get_clients())

    def say(self, text: str, share_done: float) -> None:
        """Show a line and how much is done."""
        self.status.content = text
        self.progress.value = float(np.clip(100 * share_done, 0, 100))

    def look(self, view: Outside, target: Float[np.ndarray, "3"]) -> None:
        """Put the eye of browsers that come later, once; up is the view's."""
        if self._has_view:
            return
        self._has_view = True
        up = -view.T_world_camera[:3, 1]
        self.server.scene.set_up_direction((float(up[0]), float(up[1]), float(up[2])))
        camera = self.server.initial_camera
        camera.position, camera.look_at, camera.up = view.T_world_camera[:3, 3], target, up
        camera.fov = FOV_RAD

    def picture(self, name: str, rgb: UInt8[np.ndarray, "h w 3"]) -> None:
        """Show a picture under its name."""
        if name in self._images:
            self._images[name].image = rgb
        else:
            self._images[name] = self.server.gui.add_image(rgb, label=name, format="jpeg", jpeg_quality=80)

    def path(self, name: str, centres: Float[np.ndarray, "n 3"], colour: tuple[int, int, int] = ESTIMATE) -> None:
        """Show a line through camera centres; a missing one leaves a gap."""
        pairs = np.stack([centres[:-1], centres[1:]], 1)
        pairs = pairs[np.isfinite(pairs).all((1, 2))]
        if len(pairs):
            self.server.scene.add_line_segments(
                f"/{name}", pairs.astype(np.float32), colour, thickness=2.5, thickness_units="screen"
            )

    def camera(
        self,
        T_world_camera: Float[np.ndarray, "4 4"],
        fov_rad: float,
        aspect: float,
        rgb: UInt8[np.ndarray, "h w 3"] | None = None,
    ) -> None:
        """Show where the camera is, its picture in it."""
        if np.isfinite(T_world_camera).all():
            self.server.scene.add_camera_frustum(
                "/camera", fov_rad, aspect, scale=0.15, color=ESTIMATE, image=rgb, **_placed(T_world_camera)
            )

    def keyframes(self, poses: Float[np.ndarray, "k 4 4"]) -> None:
        """Show where keyframes are."""
        poses = poses[np.isfinite(poses).all((1, 2))]
        if len(poses):
            placed = [_placed(pose) for pose in poses]
            self.server.scene.add_batched_axes(
                "/keyframes",
                np.stack([p["wxyz"] for p in placed]).astype(np.float32),
                np.stack([p["position"] for p in placed]).astype(np.float32),
                axes_length=0.06,
                axes_radius=0.004,
            )

    def cloud(self, name: str, cloud: PointCloud, size_m: float = 0.018) -> Any:  # noqa: ANN401  # viser's handle
        """Show points."""
        colors = np.full((len(cloud.points), 3), 0.6) if cloud.colors is None else cloud.colors
        return self.server.scene.add_point_cloud(
            f"/{name}",
            cloud.points.astype(np.float32),
            np.rint(255 * np.clip(colors, 0, 1)).astype(np.uint8),
            point_size=size_m,
            point_shape="circle",
            point_shading="flat",
        )

    def mesh(self, name: str, mesh: TriangleMesh) -> Any:  # noqa: ANN401  # viser's handle
        """Show a surface in its own colours."""
        import trimesh  # comes with viser

        colors = None if mesh.colors is None else np.rint(255 * np.clip(mesh.colors, 0, 1)).astype(np.uint8)
        made = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colors, process=False)
        return self.server.scene.add_mesh_trimesh(f"/{name}", made)

    def splats(self, name: str, splats: Splats) -> Any:  # noqa: ANN401  # viser's handle
        """Show Gaussians."""
        return self.server.scene.add_gaussian_splats(
            f"/{name}", splats.means, splats.covariances, splats.colors, splats.opacities[:, None]
        )

    def close(self) -> None:
        """End the page."""
        self.server.stop()


def _placed(T_world_camera: Float[np.ndarray, "4 4"]) -> dict[str, Any]:
    """Return a pose as viser wants it."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(T_world_camera[:3, :3]).as_quat()
    return {"wxyz": np.array([w, x, y, z]), "position": T_world_camera[:3, 3]}
